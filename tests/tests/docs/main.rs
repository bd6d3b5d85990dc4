//! The documentation: every command in it runs, every link resolves, every example document is
//! valid, and the generated pages are those of this program.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

#[cfg(unix)]
mod commands;
mod links;
mod page;
mod reference;
