//! Packs a scene document and every file that it needs as uploads.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::{Map, Value};

use crate::codec;
use crate::scene::SceneDocument;

/// Largest file that is uploaded, bytes; the server's own limit may be lower.
const MAX_FILE_BYTES: u64 = 1 << 30;

/// A document that refers to uploads only, and the uploads by name.
pub(super) struct Package {
    pub(super) document: Map<String, Value>,
    pub(super) files: BTreeMap<String, Vec<u8>>,
}

/// Gathers a scene's files. They are in one folder on the server, so their names must differ.
pub(super) fn package(path: &Path) -> Result<Package> {
    let (mut document, folder) = SceneDocument::load(path)?;
    // The server does not know whether a mesh was given without a document, so sizes are settled here.
    document.settle_sizes(&folder)?;
    let mut files = BTreeMap::new();
    for object in &mut document.objects {
        object.mesh = gather(&folder, &object.mesh, &mut files)?;
    }
    if let Some(environment) = &mut document.environment {
        environment.map = gather(&folder, &environment.map, &mut files)?;
    }
    match serde_json::to_value(&document)? {
        Value::Object(document) => Ok(Package { document, files }),
        other => bail!("{}: expected an object, got {other}", path.display()),
    }
}

/// Reads a file and the files that it refers to; returns its name without folders.
fn gather(folder: &Path, file: &str, files: &mut BTreeMap<String, Vec<u8>>) -> Result<String> {
    let path = folder.join(file);
    let name = path
        .file_name()
        .with_context(|| format!("{}: expected a file", path.display()))?
        .to_string_lossy()
        .into_owned();
    let bytes = codec::read_file(&path, MAX_FILE_BYTES)?;
    if let Some(known) = files.get(&name) {
        if *known != bytes {
            bail!("{name}: expected files of different names, got two of this one");
        }
        return Ok(name);
    }
    let others = named_in(&name, &bytes);
    files.insert(name.clone(), bytes);
    let home = path.parent().unwrap_or(Path::new(""));
    for other in others {
        // Mesh files refer to their companions by plain names; with folders they would not be found on the
        // server.
        if Path::new(&other).components().count() == 1 && home.join(&other).is_file() {
            gather(home, &other, files)?;
        }
    }
    Ok(name)
}

/// Files that a mesh or material file refers to.
fn named_in(name: &str, bytes: &[u8]) -> Vec<String> {
    let extension = name.rsplit('.').next().unwrap_or("").to_lowercase();
    match extension.as_str() {
        "obj" | "mtl" => String::from_utf8_lossy(bytes)
            .lines()
            .filter_map(|line| {
                let (keyword, rest) = line.trim().split_once(char::is_whitespace)?;
                let keyword = keyword.to_lowercase();
                let refers = keyword == "mtllib" || keyword.starts_with("map_");
                // Options may precede the name, which comes last.
                let file = rest.split_whitespace().last()?;
                refers.then(|| file.to_owned())
            })
            .collect(),
        "gltf" => match serde_json::from_slice::<Value>(bytes) {
            Ok(root) => ["buffers", "images"]
                .iter()
                .filter_map(|list| root[list].as_array())
                .flatten()
                .filter_map(|item| item["uri"].as_str())
                .filter(|uri| !uri.starts_with("data:"))
                .map(str::to_owned)
                .collect(),
            Err(_) => Vec::new(),
        },
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_takes_its_files_along() {
        let folder = tempfile::tempdir().unwrap();
        let put = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, text).unwrap();
        };
        put("meshes/a.obj", "mtllib a.mtl\nv 0 0 0\n");
        put(
            "meshes/a.mtl",
            "newmtl m\nmap_Kd -clamp on a.png\nmap_d none.png\n",
        );
        put("meshes/a.png", "pixels");
        let scene = r#"{"version":1,"objects":[{"mesh":"meshes/a.obj"},{"mesh":"meshes/a.obj"}]}"#;
        put("scene.json", scene);
        let package = package(&folder.path().join("scene.json")).unwrap();
        let names: Vec<&str> = package.files.keys().map(String::as_str).collect();
        assert_eq!(names, ["a.mtl", "a.obj", "a.png"]);
        assert_eq!(package.document["objects"][1]["mesh"], "a.obj");
        // A different file of the same name cannot be uploaded beside it.
        put("other/a.obj", "v 1 1 1\n");
        let scene = r#"{"version":1,"objects":[{"mesh":"meshes/a.obj"},{"mesh":"other/a.obj"}]}"#;
        put("scene.json", scene);
        assert!(super::package(&folder.path().join("scene.json")).is_err());
    }
}
