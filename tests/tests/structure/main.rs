//! Tests of the structure: which file may import from which.

mod imports;

use std::path::{Path, PathBuf};

use imports::{Package, circles, names_any};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Source folders of the packages, and in each the folders whose files may not be in an import cycle.
const PACKAGES: [(&str, &[&str]); 4] = [
    ("server/src", &["server/src/render"]),
    ("server/lab/src", &[]),
    ("server/cli/src", &[]),
    ("proto/src", &[]),
];

#[test]
fn files_do_not_import_in_circles() {
    let root = root();
    let mut broken = Vec::new();
    for (source, without) in PACKAGES {
        let package = Package::read(&root.join(source));
        let imports = package.imports();
        assert!(
            imports.values().any(|targets| !targets.is_empty()) || imports.len() < 3,
            "{source}: nothing read"
        );
        for circle in circles(&imports) {
            let forbidden = circle.iter().any(|file| {
                without
                    .iter()
                    .any(|folder| file.starts_with(root.join(folder)))
            });
            if circle.len() > 2 || forbidden {
                let names = circle.iter().map(|file| {
                    let arrows = imports[file]
                        .iter()
                        .filter(|target| circle.contains(**target));
                    let arrows: Vec<String> = arrows.map(|target| shown(&root, target)).collect();
                    format!("  {} -> {}", shown(&root, file), arrows.join(", "))
                });
                broken.push(format!(
                    "circle of {}:\n{}",
                    circle.len(),
                    names.collect::<Vec<_>>().join("\n")
                ));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

fn shown(root: &Path, file: &Path) -> String {
    file.strip_prefix(root)
        .unwrap_or(file)
        .display()
        .to_string()
}

#[test]
fn the_renderer_reaches_no_file_network_or_clock() {
    let forbidden = [
        "std::fs",
        "std::net",
        "std::env",
        "std::process",
        "std::io",
        "tokio",
        "axum",
        "Instant",
        "SystemTime",
        "crate::net",
        "crate::recording",
        "crate::replay",
        "crate::output",
        "crate::codec",
    ];
    let root = root();
    let mut broken = Vec::new();
    let mut folders: Vec<PathBuf> = ["render", "ghost", "accel"]
        .iter()
        .map(|name| root.join("server/src").join(name))
        .collect();
    let mut files = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a source folder") {
            let path = entry.expect("an entry").path();
            if path.file_stem().is_some_and(|name| name == "tests") {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            files += 1;
            for name in names_any(&path, &forbidden) {
                broken.push(format!("{} names {name}", shown(&root, &path)));
            }
        }
    }
    assert!(files > 60, "{files} files");
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}
