//! A real server on a free port, and clients that are good, bad, slow, silent and gone.
//!
//! The frames and the renderer are fakes in memory: what is tested is the service. Nothing
//! here measures time; waits end when what is waited for has happened.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

mod bad_input;
mod bad_messages;
mod bad_peers;
mod client;
mod fake;
mod later;
mod streams;
mod time;
