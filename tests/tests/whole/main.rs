//! Runs the whole program as its users do.

mod bad_input;
mod newcomer;
#[cfg(unix)]
mod outputs;
mod replay;
mod stage;
