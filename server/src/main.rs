//! The command line. Every command is a file in `cli/`.
//!
//! Exit codes: 0 when everything asked for came out, 2 with one line on stderr when not,
//! 1 when `compare` finds a bound broken, 130 when stopped by Ctrl-C.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
