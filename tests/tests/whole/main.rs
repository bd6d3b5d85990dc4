//! The whole program, run as its users do.

mod bad_input;
mod newcomer;
mod replay;
mod stage;
