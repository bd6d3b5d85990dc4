//! `ghostlight compare` as a script uses it: its list, its errors and its files.

use std::path::Path;
use std::process::{Command, Output};

fn compare(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_ghostlight-under-test"))
        .arg("compare")
        .args(args)
        .env_remove("GHOSTLIGHT_DATA")
        .current_dir(folder)
        .output()
        .expect("the program starts")
}

/// Expects exit code 2, one line that contains all of `named`, and no files left behind.
#[track_caller]
fn refuse(folder: &Path, args: &[&str], named: &[&str]) {
    let before = names(folder);
    let output = compare(folder, args);
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {told}");
    assert!(output.stdout.is_empty(), "{args:?} said something");
    assert_eq!(told.lines().count(), 1, "{args:?}: {told}");
    for name in named {
        assert!(
            told.contains(name),
            "{args:?}: {told}: does not name {name}"
        );
    }
    assert_eq!(names(folder), before, "{args:?} left something behind");
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder lists");
    let mut names: Vec<String> = entries
        .map(|entry| {
            let name = entry.expect("a folder lists").file_name();
            name.to_string_lossy().into_owned()
        })
        .collect();
    names.sort();
    names
}

#[test]
fn the_list_names_every_experiment_and_its_question() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = compare(folder.path(), &["--list"]);
    assert!(output.status.success());
    let text = String::from_utf8(output.stdout).expect("text");
    for name in ["traversal", "kernels", "shadows", "reflections", "cost"] {
        let line = text.lines().find(|line| line.starts_with(name));
        let line = line.unwrap_or_else(|| panic!("{name} is not listed:\n{text}"));
        assert!(
            line.ends_with('?') && line.len() > name.len() + 12,
            "{line}"
        );
    }
    assert!(names(folder.path()).is_empty());
}

#[test]
fn what_cannot_be_done_is_refused_before_any_work() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    refuse(folder, &[], &["--out"]);
    refuse(folder, &["--quick"], &["--out"]);
    refuse(
        folder,
        &["--out", "r", "--only", "shadow"],
        &["--only", "shadow", "shadows"],
    );
    refuse(folder, &["--out", "r", "--threads", "x"], &["--threads"]);
    refuse(folder, &["--out", "r", "--data", "none"], &["none"]);

    std::fs::write(folder.join("file"), "in the way").expect("a file");
    refuse(folder, &["--out", "file"], &["file", "expected a folder"]);
    std::fs::create_dir(folder.join("site")).expect("a folder");
    std::fs::write(folder.join("site/index.html"), "mine").expect("a file");
    refuse(
        folder,
        &["--out", "site"],
        &["site", "index.html", "overwritten"],
    );
    let kept = std::fs::read_to_string(folder.join("site/index.html"));
    assert_eq!(kept.expect("a file"), "mine");
}

#[test]
fn a_report_comes_out_and_a_second_one_replaces_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let args = ["--quick", "--quiet", "--only", "bloom", "--out", "a/report"];
    for _ in 0..2 {
        let output = compare(folder.path(), &args);
        let told = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{told}");
        assert!(told.is_empty() && output.stdout.is_empty(), "{told}");
    }
    let report = folder.path().join("a/report");
    let found = names(&report);
    let expected = [
        ".ghostlight-compare",
        "bloom.csv",
        "compare.json",
        "index.html",
    ];
    assert_eq!(found, expected);
    let json = std::fs::read(report.join("compare.json")).expect("a file");
    let json: serde_json::Value = serde_json::from_slice(&json).expect("JSON");
    assert_eq!(json["settings"]["quick"], true);
    assert_eq!(json["findings"][0]["name"], "bloom");
    let bounds = json["findings"][0]["section"]["bounds"].as_array();
    let bounds = bounds.expect("bounds");
    assert!(!bounds.is_empty() && bounds.iter().all(|bound| bound["kept"] == true));
    let page = std::fs::read_to_string(report.join("index.html")).expect("a file");
    for part in [
        "<svg",
        "data:image/png;base64,",
        "bounds are kept",
        "</html>",
    ] {
        assert!(page.contains(part), "no {part}");
    }
}
