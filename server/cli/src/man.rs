//! `ghostlight man`.

use std::path::PathBuf;

use anyhow::{Context, Result};
use ghostlight::output;

/// Print the manual page, or write one for every command.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight man | man -l -
  ghostlight man --out ~/.local/share/man/man1")]
pub(crate) struct ManArgs {
    /// Folder for ghostlight.1 and a page for every command, ghostlight-replay.1 and so on
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(crate) fn run(args: &ManArgs, command: clap::Command) -> Result<()> {
    let Some(folder) = &args.out else {
        let page = rendered(command)?;
        output::print(String::from_utf8_lossy(&page).trim_end())?;
        return Ok(());
    };
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    let commands = command.get_subcommands().map(|subcommand| {
        let name = format!("ghostlight-{}", subcommand.get_name());
        subcommand.clone().name(name)
    });
    for command in std::iter::once(command.clone()).chain(commands) {
        let path = folder.join(format!("{}.1", command.get_name()));
        let page = rendered(command)?;
        output::write_file(&path, &page).with_context(|| path.display().to_string())?;
    }
    Ok(())
}

fn rendered(command: clap::Command) -> Result<Vec<u8>> {
    let mut page = Vec::new();
    clap_mangen::Man::new(command).render(&mut page)?;
    Ok(page)
}
