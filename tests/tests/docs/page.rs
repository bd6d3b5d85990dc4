//! A reader of Markdown pages, for these tests.

use std::path::{Path, PathBuf};

/// Start of the line before a block of commands that these tests do not run; the reason follows.
const NOT_RUN: &str = "<!-- not run: ";

/// The root of the repository.
pub(crate) fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A page of the repository.
pub(crate) struct Page {
    /// Relative to the root.
    pub(crate) path: PathBuf,
    pub(crate) text: String,
}

/// A fenced block.
pub(crate) struct Block {
    /// Page and line, for test messages.
    pub(crate) at: String,
    /// The word after the fence.
    pub(crate) language: String,
    pub(crate) text: String,
    /// The reason why its commands are not run, if they are not.
    pub(crate) not_run: Option<String>,
}

impl Page {
    pub(crate) fn read(path: impl AsRef<Path>) -> Self {
        let path = path.as_ref().to_owned();
        let text = std::fs::read_to_string(root().join(&path));
        let text = text.unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Self { path, text }
    }

    /// README and the pages of the book.
    pub(crate) fn guides() -> Vec<Self> {
        let mut names: Vec<PathBuf> = std::fs::read_dir(root().join("docs"))
            .unwrap()
            .map(|entry| Path::new("docs").join(entry.unwrap().file_name()))
            .filter(|path| path.extension().is_some_and(|extension| extension == "md"))
            .collect();
        names.sort();
        names.insert(0, "README.md".into());
        names.into_iter().map(Self::read).collect()
    }

    /// Every page written for people.
    pub(crate) fn all() -> Vec<Self> {
        let others = [
            "ARCHITECTURE.md",
            "CHANGELOG.md",
            "CONTRIBUTING.md",
            "proto/README.md",
            "recordings/README.md",
            "tests/record/README.md",
        ];
        let mut pages = Self::guides();
        pages.extend(others.map(Self::read));
        pages
    }

    pub(crate) fn blocks(&self) -> Vec<Block> {
        let mut blocks = Vec::new();
        let mut open: Option<Block> = None;
        let mut before = "";
        for (i, line) in self.text.lines().enumerate() {
            match (line.trim_start().strip_prefix("```"), &mut open) {
                (Some(language), None) => {
                    let reason = before.strip_prefix(NOT_RUN);
                    open = Some(Block {
                        at: format!("{}:{}", self.path.display(), i + 1),
                        language: language.to_owned(),
                        text: String::new(),
                        not_run: reason.map(|reason| reason.trim_end_matches(" -->").to_owned()),
                    });
                }
                (Some(_), Some(_)) => blocks.extend(open.take()),
                (None, Some(block)) => {
                    block.text.push_str(line);
                    block.text.push('\n');
                }
                (None, None) => {}
            }
            before = line;
        }
        assert!(open.is_none(), "{}: an open fence", self.path.display());
        blocks
    }

    /// The text outside blocks, without code between backticks.
    pub(crate) fn prose(&self) -> String {
        let mut prose = String::new();
        let mut in_block = false;
        for line in self.text.lines() {
            if line.trim_start().starts_with("```") {
                in_block = !in_block;
            } else if !in_block {
                prose.extend(line.split('`').step_by(2));
                prose.push('\n');
            }
        }
        prose
    }

    /// The anchors of its headings, as GitHub and mdBook make them.
    pub(crate) fn anchors(&self) -> Vec<String> {
        let mut in_block = false;
        let headings = self.text.lines().filter(|line| {
            in_block ^= line.trim_start().starts_with("```");
            !in_block && line.starts_with('#')
        });
        let anchor = |heading: &str| {
            let heading = heading.trim_start_matches('#').trim().to_lowercase();
            let kept = heading.chars().filter_map(|c| match c {
                ' ' => Some('-'),
                '_' | '-' => Some(c),
                _ if c.is_alphanumeric() => Some(c),
                _ => None,
            });
            kept.collect()
        };
        headings.map(anchor).collect()
    }

    /// The targets of its links and pictures.
    pub(crate) fn links(&self) -> Vec<String> {
        let prose = self.prose();
        let targets = prose.split("](").skip(1);
        let targets = targets.filter_map(|rest| rest.split_once(')'));
        targets.map(|(target, _)| target.to_owned()).collect()
    }
}
