//! Tests the page in a real browser against the program. The checks are in `client-web/browser/`.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

use std::path::Path;
use std::process::{Command, Stdio};

const PROGRAM: &str = env!("CARGO_BIN_EXE_ghostlight-under-test");

/// Oldest major version of Node.js whose test runner has the features used.
const NODE: u32 = 20;

fn node_version() -> Option<u32> {
    let output = Command::new("node").arg("--version").output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    text.trim()
        .trim_start_matches('v')
        .split('.')
        .next()?
        .parse()
        .ok()
}

/// What the machine lacks for this test, if anything.
fn missing(browser: &str) -> Option<String> {
    if node_version().is_none_or(|v| v < NODE) {
        return Some(format!("Node.js {NODE} or later is not installed"));
    }
    let found = Command::new(browser)
        .arg("--version")
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status();
    if !found.is_ok_and(|status| status.success()) {
        return Some(format!("{browser} is not installed"));
    }
    None
}

#[test]
fn the_page_in_a_browser() {
    let browser = std::env::var("CHROMIUM").unwrap_or_else(|_| "chromium".to_owned());
    if let Some(why) = missing(&browser) {
        let required = std::env::var("GHOSTLIGHT_REQUIRE").unwrap_or_default();
        assert!(!required.split(',').any(|r| r == "browser"), "{why}");
        println!("SKIPPED: {why}");
        return;
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let output = Command::new("node")
        .args(["--test", "--test-reporter=spec", "--test-concurrency=1"])
        .args(["page", "stream"].map(|f| root.join(format!("client-web/browser/{f}.test.mjs"))))
        .env("GHOSTLIGHT_PROGRAM", PROGRAM)
        .env("CHROMIUM", browser)
        .output()
        .unwrap();
    println!("{}", String::from_utf8_lossy(&output.stdout));
    println!("{}", String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "the page's tests failed");
}
