//! Checks links, the summary of the book, and example documents.

use std::path::Path;

use ghostlight::recording::Recording;
use ghostlight::render::RenderSettings;
use ghostlight::scene::SceneDocument;

use crate::page::{Page, root};

#[test]
fn every_page_of_the_book_is_in_its_summary() {
    let summary = Page::read("docs/SUMMARY.md").links();
    for page in Page::guides().iter().skip(1) {
        let name = page.path.file_name().unwrap().to_str().unwrap();
        let listed = summary.iter().any(|link| link == name);
        assert!(
            listed || name == "SUMMARY.md",
            "{name} is not in SUMMARY.md"
        );
    }
}

#[test]
fn links_resolve() {
    let mut n_links = 0;
    for page in Page::all() {
        let at = page.path.display();
        let folder = root().join(page.path.parent().unwrap());
        for link in page.links() {
            if link.starts_with("https://") || link.starts_with("http://") {
                continue;
            }
            n_links += 1;
            let (path, anchor) = link.split_once('#').unwrap_or((&link, ""));
            // mdBook copies only files in its folder.
            let in_book = page.path.starts_with("docs");
            assert!(
                !in_book || !path.contains(".."),
                "{at}: {link} leaves the book"
            );
            if !path.is_empty() {
                assert!(folder.join(path).exists(), "{at}: {link} leads nowhere");
            }
            if !anchor.is_empty() {
                let target = match path {
                    "" => Page::read(&page.path),
                    path => Page::read(page.path.parent().unwrap().join(path)),
                };
                let found = target.anchors().iter().any(|a| a == anchor);
                assert!(found, "{at}: {link}: no such heading");
            }
        }
    }
    assert!(n_links > 40, "{n_links}");
}

#[test]
fn included_files_are_there() {
    let mut n_includes = 0;
    for page in Page::guides() {
        for include in page.text.split("{{#include ").skip(1) {
            let (path, _) = include.split_once([':', '}']).unwrap();
            assert!(root().join("docs").join(path).is_file(), "{path}");
            n_includes += 1;
        }
    }
    assert_eq!(n_includes, 1);
}

#[test]
fn blocks_say_their_language_and_documents_are_valid() {
    let mut n_documents = 0;
    for page in Page::guides() {
        for block in page.blocks() {
            let known = ["sh", "json", "rust", "ini", "text", "toml"];
            assert!(
                known.contains(&block.language.as_str()),
                "{}: {:?} is none of {known:?}",
                block.at,
                block.language
            );
            if block.language != "json" {
                continue;
            }
            n_documents += 1;
            if block.text.contains("\"version\"") {
                let read = SceneDocument::parse(&block.text, &block.at);
                assert!(read.is_ok(), "{:?}", read.err());
            } else {
                let read: Result<RenderSettings, _> = serde_json::from_str(&block.text);
                let read = read.unwrap_or_else(|error| panic!("{}: {error}", block.at));
                assert!(read.validate().is_ok(), "{}", block.at);
            }
        }
    }
    assert!(n_documents >= 4, "{n_documents}");
}

#[test]
fn the_readme_stays_short() {
    let n_lines = Page::read("README.md").text.lines().count();
    assert!(n_lines < 150, "{n_lines} lines");
}

#[test]
fn the_protocol_page_is_the_normative_file() {
    let page = Page::read("docs/protocol.md");
    assert!(page.text.contains("{{#include ../proto/README.md:2:}}"));
    // The include omits the first line, which is the title.
    let normative = Page::read(Path::new("proto/README.md"));
    assert!(normative.text.starts_with("# "));
    assert!(
        normative
            .text
            .lines()
            .skip(1)
            .all(|line| !line.starts_with("# "))
    );
}

#[test]
fn every_recording_layout_is_described() {
    let page = Page::read("docs/recordings.md").text;
    for (name, _) in Recording::layouts() {
        assert!(
            page.contains(&format!("| {name} ")),
            "docs/recordings.md: {name}"
        );
    }
}
