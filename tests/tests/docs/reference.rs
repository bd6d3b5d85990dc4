//! Checks the generated pages.

use std::process::Command;

use crate::page::Page;

#[test]
fn generated_pages_are_those_of_this_program() {
    for of in ["scene", "settings"] {
        let output = Command::new(env!("CARGO_BIN_EXE_ghostlight-under-test"))
            .args(["schema", of, "--markdown"])
            .output()
            .unwrap();
        assert!(output.status.success());
        let generated = String::from_utf8(output.stdout).unwrap();
        let page = Page::read(format!("docs/{of}.md"));
        assert!(
            page.text == generated,
            "docs/{of}.md is stale: write it anew with\n  \
             cargo run -- schema {of} --markdown > docs/{of}.md"
        );
    }
}
