//! The whole program, run as its users do.

mod bad_input;
mod replay;
mod stage;
