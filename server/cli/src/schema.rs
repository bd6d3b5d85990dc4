//! `ghostlight schema`.

use anyhow::Result;
use clap::ValueEnum;
use ghostlight::{output, schema};

/// Print the JSON Schema of scene documents or render settings, for editors and checks.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight schema scene > scene.schema.json
  ghostlight schema settings > settings.schema.json

Editors then complete and check a document that begins {\"$schema\": \"scene.schema.json\", ...}.")]
pub(crate) struct Args {
    /// Whose
    #[arg(value_enum)]
    of: Of,
}

/// What has a schema.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Of {
    /// Scene documents
    Scene,
    /// Render settings
    Settings,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let schema = match args.of {
        Of::Scene => schema::scene(),
        Of::Settings => schema::settings(),
    };
    Ok(output::print(serde_json::to_string_pretty(&schema)?)?)
}
