//! `ghostlight schema`.

use anyhow::Result;
use clap::ValueEnum;
use ghostlight::{output, schema};

/// Print the JSON Schema of scene documents or render settings.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight schema scene > scene.schema.json
  ghostlight schema settings > settings.schema.json
  ghostlight schema settings --markdown > settings.md

Editors complete and check a document that begins {\"$schema\": \"scene.schema.json\", ...}.
The reference pages of the documentation are made with --markdown.")]
pub(crate) struct SchemaArgs {
    /// Document type
    #[arg(value_enum)]
    of: Of,
    /// Print a reference page in Markdown instead of the schema
    #[arg(long)]
    markdown: bool,
}

/// Document types.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Of {
    /// Scene documents
    Scene,
    /// Render settings
    Settings,
}

pub(crate) fn run(args: &SchemaArgs) -> Result<()> {
    let (schema, command) = match args.of {
        Of::Scene => (schema::scene(), "ghostlight schema scene --markdown"),
        Of::Settings => (schema::settings(), "ghostlight schema settings --markdown"),
    };
    if args.markdown {
        // `print` adds the last line break.
        let page = schema::markdown(&schema, command);
        return Ok(output::print(page.trim_end())?);
    }
    Ok(output::print(serde_json::to_string_pretty(&schema)?)?)
}
