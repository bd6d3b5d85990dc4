//! A real server on a free port, with ordinary, hostile, slow, silent and disconnected clients.
//!
//! The frames and the renderer are fakes in memory: the tests are about the service. No test measures time; each
//! waits for an event, not for a duration.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

mod bad_input;
mod bad_messages;
mod bad_peers;
mod broken_streams;
mod client;
mod door;
mod fake;
mod later;
mod scenes;
mod streams;
mod time;
