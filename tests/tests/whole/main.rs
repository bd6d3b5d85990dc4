//! The whole program, run as its users do.

mod bad_input;
#[cfg(unix)]
mod outputs;
mod replay;
mod stage;
