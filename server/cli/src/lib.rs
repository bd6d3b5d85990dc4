//! The command line of Ghostlight: commands, their help, and error messages. A library, so that the tests can
//! build the program under another name.
//!
//! Exit codes: 0 if everything requested was produced, 2 with one line on stderr if not, 1 if `compare` finds a
//! broken bound, 130 if stopped by Ctrl-C.

mod bundled;
mod compare;
mod completions;
mod demo;
mod input;
mod inspect;
mod man;
mod presets;
mod replay;
mod schema;
mod synth;

use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory as _, Parser, Subcommand};
use ghostlight::net::Stopped;
use ghostlight::net::args::{SendArgs, ServeArgs};
use ghostlight::output::{self, StdoutError};
use ghostlight_lab::compare::BoundsBroken;

/// Ray traces virtual objects into RGB-D frames: occluded by, mirrored in and lit with the
/// real scene.
#[derive(Debug, Parser)]
#[command(name = "ghostlight", version, after_help = EXAMPLES)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "Examples:
  ghostlight demo
  ghostlight replay my-recording --object duck.glb --out film.mp4
  ghostlight replay recordings/desk --scene recordings/scenes/teapot.json --out film.mp4
  ghostlight inspect my-recording";

#[derive(Debug, Subcommand)]
enum Command {
    /// Serve the bundled recording with a teapot, for viewing in a browser
    Demo(demo::DemoArgs),
    /// Render a scene into every frame of a recording: pictures or a film
    Replay(replay::ReplayArgs),
    /// Render a recording of a desk with exact depth, poses and sensor noise
    Synth(synth::SynthArgs),
    /// Describe a recording, scene or mesh, and list anything unusual
    Inspect(inspect::InspectArgs),
    /// Measure speed against error for every approximation
    Compare(compare::CompareArgs),
    /// Serve sessions over WebSocket: frames in, composites out
    Serve(ServeArgs),
    /// List the material presets
    Presets(presets::PresetsArgs),
    /// Print the JSON Schema of scene documents or render settings
    Schema(schema::SchemaArgs),
    /// Stream a recording to a server; report latency and losses
    Send(SendArgs),
    /// Print a shell completion script
    Completions(completions::CompletionsArgs),
    /// Print the manual page, or write one for every command
    Man(man::ManArgs),
}

/// Runs the command given by the arguments.
pub fn main() -> ExitCode {
    let cli = match Cli::try_parse() {
        Ok(cli) => cli,
        Err(error) => return usage(&error),
    };
    let result = match cli.command {
        Command::Demo(args) => demo::run(&args),
        Command::Replay(args) => replay::run(&args),
        Command::Synth(args) => synth::run(&args),
        Command::Inspect(args) => inspect::run(&args),
        Command::Compare(args) => compare::run(&args),
        Command::Presets(args) => presets::run(&args),
        Command::Schema(args) => schema::run(&args),
        Command::Serve(args) => args.run(),
        Command::Send(args) => args.run(),
        Command::Completions(args) => completions::run(&args, &mut Cli::command()),
        Command::Man(args) => man::run(&args, Cli::command()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            if error.downcast_ref().is_some_and(StdoutError::reader_left) {
                return ExitCode::SUCCESS;
            }
            output::tell(format_args!("error: {}", describe(&error)));
            if error.is::<BoundsBroken>() {
                return ExitCode::from(1);
            }
            if error.is::<Stopped>() {
                return ExitCode::from(130);
            }
            ExitCode::from(2)
        }
    }
}

/// Prints help and version as clap does, and any error in one line, like all other errors.
fn usage(error: &clap::Error) -> ExitCode {
    let help = [
        ErrorKind::DisplayHelp,
        ErrorKind::DisplayVersion,
        ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand,
    ];
    if help.contains(&error.kind()) {
        error.exit();
    }
    let text = error.to_string();
    let parts = text
        .split("\n\n")
        .take_while(|part| !part.starts_with("Usage:") && !part.starts_with("For more"));
    let parts: Vec<&str> = parts.collect();
    output::tell(one_line(&parts.join("; ")));
    ExitCode::from(2)
}

/// An error and its causes, in one line. Most errors already contain the text of their cause.
fn describe(error: &anyhow::Error) -> String {
    let mut line = String::new();
    for cause in error.chain() {
        let cause = one_line(&cause.to_string());
        if line.is_empty() {
            line = cause;
        } else if !line.ends_with(&cause) {
            line = format!("{line}: {cause}");
        }
    }
    line
}

fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}
