//! Finds the files that a mesh names, even if the path is from another computer, has backslashes or different case,
//! or the file is in another folder beside the mesh.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::text;

/// Most entries read per folder.
const MAX_ENTRIES: usize = 50_000;

/// Deepest path that is searched, components.
const MAX_DEPTH: usize = 16;

/// Usual texture folders beside the mesh, searched if a file is not at its path.
const USUAL: [&str; 8] = [
    "textures",
    "texture",
    "tex",
    "maps",
    "images",
    "materials",
    "source",
    "img",
];

/// Finds files in one folder and its subfolders.
pub(super) struct Files<'a> {
    folder: &'a Path,
    /// The entries of each folder, by name in lower case.
    listings: HashMap<PathBuf, HashMap<String, PathBuf>>,
}

impl<'a> Files<'a> {
    pub(super) fn new(folder: &'a Path) -> Self {
        Self {
            folder,
            listings: HashMap::new(),
        }
    }

    /// Finds a file by its name as written, never outside of the folder: if a path is absolute or leaves the folder,
    /// only its last parts are used.
    pub(super) fn find(&mut self, name: &[u8]) -> Option<PathBuf> {
        let parts = parts(name);
        let (base, _) = parts
            .split_last()
            .map(|(base, rest)| (base.clone(), rest))?;
        let starts = (0..parts.len()).take(MAX_DEPTH);
        starts
            .map(|start| parts[start..].to_vec())
            .chain(USUAL.iter().map(|usual| {
                let usual = Part {
                    bytes: usual.as_bytes().to_vec(),
                    lower: (*usual).to_owned(),
                };
                vec![usual, base.clone()]
            }))
            .collect::<Vec<_>>()
            .iter()
            .find_map(|parts| self.walk(parts))
    }

    fn walk(&mut self, parts: &[Part]) -> Option<PathBuf> {
        let mut path = self.folder.to_owned();
        for part in parts {
            let exact = path.join(text::path_from_bytes(&part.bytes));
            path = match exact.symlink_metadata() {
                Ok(_) => exact,
                Err(_) => self.listing(&path).get(&part.lower)?.clone(),
            };
        }
        path.is_file().then_some(path)
    }

    fn listing(&mut self, folder: &Path) -> &HashMap<String, PathBuf> {
        self.listings.entry(folder.to_owned()).or_insert_with(|| {
            let folder = match folder.as_os_str().is_empty() {
                true => Path::new("."),
                false => folder,
            };
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            let mut paths: Vec<PathBuf> = entries
                .take(MAX_ENTRIES)
                .map(|entry| entry.path())
                .collect();
            // Sorted, so that the choice among several paths does not depend on the system.
            paths.sort_unstable_by(|a, b| b.cmp(a));
            let named = paths.into_iter().filter_map(|path| {
                let name = text::decode(path.file_name()?.as_encoded_bytes());
                Some((name.text.to_lowercase(), path.clone()))
            });
            named.collect()
        })
    }
}

/// One component of a path.
#[derive(Debug, Clone)]
struct Part {
    bytes: Vec<u8>,
    lower: String,
}

/// The components of a path of any system, after the last `..`.
fn parts(name: &[u8]) -> Vec<Part> {
    let name = name.trim_ascii();
    let quoted = |quote: u8| name.len() > 1 && name[0] == quote && name[name.len() - 1] == quote;
    let name = if quoted(b'"') || quoted(b'\'') {
        name[1..name.len() - 1].trim_ascii()
    } else {
        name
    };
    let mut parts = Vec::new();
    for part in name.split(|b| matches!(b, b'/' | b'\\')) {
        match part {
            b"" | b"." => {}
            b".." => parts.clear(),
            // A drive letter.
            [_, b':'] if parts.is_empty() => {}
            part if part.contains(&0) => return Vec::new(),
            part => parts.push(Part {
                bytes: part.to_vec(),
                lower: text::decode(part).text.to_lowercase(),
            }),
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn names_of_other_computers_are_found_beside_the_mesh() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("mesh");
        for path in [
            "tex.png",
            "my tex.png",
            "textures/wood.png",
            "Maps/ü.JPG",
            "a/b/c.png",
        ] {
            let path = folder.join(path);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"x").unwrap();
        }
        std::fs::write(dir.path().join("outside.png"), b"x").unwrap();
        let mut files = Files::new(&folder);
        for (name, expected) in [
            ("tex.png", Some("tex.png")),
            (".\\tex.png", Some("tex.png")),
            ("./tex.png", Some("tex.png")),
            ("C:\\Users\\me\\tex.png", Some("tex.png")),
            ("C:/Users/me/textures/wood.png", Some("textures/wood.png")),
            ("/home/me/tex.png", Some("tex.png")),
            ("\\\\server\\share\\TEX.PNG", Some("tex.png")),
            ("TEX.png", Some("tex.png")),
            ("\"my tex.png\"", Some("my tex.png")),
            ("My Tex.PNG", Some("my tex.png")),
            ("textures\\wood.png", Some("textures/wood.png")),
            ("Textures/WOOD.png", Some("textures/wood.png")),
            ("wood.png", Some("textures/wood.png")),
            ("../other/wood.png", Some("textures/wood.png")),
            ("maps/Ü.jpg", Some("Maps/ü.JPG")),
            ("a//b/./c.png", Some("a/b/c.png")),
            ("../outside.png", None),
            ("a/../../outside.png", None),
            ("textures", None),
            ("none.png", None),
            ("..", None),
            ("C:", None),
            ("\"", None),
            ("", None),
        ] {
            let found = files.find(name.as_bytes());
            assert_eq!(found, expected.map(|path| folder.join(path)), "{name}");
        }
        // The name is in Latin-1, the file system uses UTF-8.
        let found = files.find(b"maps\\\xFC.jpg");
        assert_eq!(found, Some(folder.join("Maps/ü.JPG")));
    }

    proptest! {
        #[test]
        fn nothing_outside_is_found(name in "[./\\\\a-c:]{0,12}") {
            let dir = tempfile::tempdir().unwrap();
            let folder = dir.path().join("c");
            std::fs::create_dir(&folder).unwrap();
            for name in ["a", "b"] {
                std::fs::write(dir.path().join(name), b"x").unwrap();
            }
            prop_assert_eq!(Files::new(&folder).find(name.as_bytes()), None);
        }
    }
}
