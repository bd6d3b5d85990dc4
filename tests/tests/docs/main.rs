//! Tests of the documentation: every command runs, every link resolves, every example document is valid, and the
//! generated pages match the program.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

#[cfg(unix)]
mod commands;
mod links;
mod page;
mod reference;
