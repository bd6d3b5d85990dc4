//! The program `ghostlight`.

use std::process::ExitCode;

fn main() -> ExitCode {
    ghostlight_cli::main()
}
