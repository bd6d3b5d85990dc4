//! `ghostlight completions`.

use anyhow::Result;
use clap_complete::Shell;
use ghostlight::output;

/// Print a shell completion script.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight completions bash > ~/.local/share/bash-completion/completions/ghostlight
  ghostlight completions zsh > ~/.zfunc/_ghostlight
  ghostlight completions fish > ~/.config/fish/completions/ghostlight.fish")]
pub(crate) struct CompletionsArgs {
    /// Shell to complete in
    #[arg(value_enum)]
    shell: Shell,
}

pub(crate) fn run(args: &CompletionsArgs, command: &mut clap::Command) -> Result<()> {
    let mut script = Vec::new();
    clap_complete::generate(args.shell, command, "ghostlight", &mut script);
    output::print(String::from_utf8_lossy(&script).trim_end())?;
    Ok(())
}
