//! Reads scene documents: JSON files, or a mesh file as a document of one object.

use std::path::{Path, PathBuf};

use glam::DMat3;
use serde::Deserialize;
use serde_json::Value;

use super::document::{Object, SceneDocument};
use super::error::SceneError;
use super::file;
use super::load::LoadContext;
use super::mesh_file::is_mesh;
use super::model::Model;
use super::resolve::{FIT_SIZE_M, PLAUSIBLE_M};
use crate::json::SchemaLink;
use crate::settings::former_names;
use crate::{json, text};

/// Only the version of a document, because unknown fields of newer versions would be errors.
#[derive(Deserialize)]
struct Version {
    version: u32,
}

/// A document's settings, unparsed. Everything else is skipped, because documents may be large.
#[derive(Deserialize)]
struct Raw {
    settings: Option<Value>,
}

impl SceneDocument {
    /// Most objects of one document.
    pub const MAX_OBJECTS: usize = 10_000;
    /// Most lights of one document.
    pub const MAX_LIGHTS: usize = 1_000;
    /// Largest document, bytes.
    pub const MAX_BYTES: u64 = 32 << 20;

    /// A document with only these objects; `file` is for messages.
    pub fn of_objects(objects: Vec<Object>, file: String) -> Self {
        Self {
            schema: SchemaLink,
            version: 1,
            objects,
            lights: Vec::new(),
            environment: None,
            settings: None,
            file,
            notes: Vec::new(),
        }
    }

    /// Reads and checks a document, or makes a document of a mesh file. Also returns the folder that its paths are
    /// relative to.
    pub fn load(path: &Path) -> Result<(Self, PathBuf), SceneError> {
        let base = path.parent().unwrap_or(Path::new("")).to_owned();
        let file = path.display().to_string();
        if let (true, Some(name)) = (is_mesh(path), path.file_name()) {
            let object = Object::of_mesh(name.to_string_lossy().into_owned());
            return Ok((Self::of_objects(vec![object], file), base));
        }
        let bytes = file::read(path, Self::MAX_BYTES).map_err(|reason| SceneError::File {
            file: file.clone(),
            reason,
        })?;
        let document = Self::parse(&text::decode(&bytes).text, &file)?;
        Ok((document, base))
    }

    /// Writes a plausible size into objects that were given without a document, as `resolve` does: for documents that
    /// are sent to another process.
    pub fn settle_sizes(&mut self, base_dir: &Path) -> Result<(), SceneError> {
        for object in self.objects.iter_mut().filter(|object| object.bare) {
            let place = &mut object.place;
            if place.scale.is_some() || place.size_m.is_some() {
                continue;
            }
            let model = Model::load_with(&LoadContext::default(), &base_dir.join(&object.mesh))?;
            let (lo, hi) = model.bounds_under(DMat3::IDENTITY).unwrap_or_default();
            let size_m = (hi - lo).max_element();
            if size_m > 0.0 && !PLAUSIBLE_M.contains(&size_m) {
                place.size_m = Some(FIT_SIZE_M);
            }
        }
        Ok(())
    }

    /// Reads and checks the text of a document; `file` is for messages.
    pub fn parse(text: &str, file: &str) -> Result<Self, SceneError> {
        let Version { version } = json::from_str(text, file)?;
        if version != 1 {
            return Err(SceneError::Field {
                file: file.to_owned(),
                path: "version".to_owned(),
                problem: format!("expected 1, got {version}"),
            });
        }
        let mut document: Self = json::from_str(text, file)?;
        document.file = file.to_owned();
        let Raw { settings } = json::from_str(text, file)?;
        document.notes = settings.iter().flat_map(former_names).collect();
        document.check()?;
        Ok(document)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{MaterialSpec, Preset, Triple};
    use super::*;

    #[test]
    fn former_names_of_settings_are_noted() {
        let text = r#"{"version": 1, "objects": [], "settings": {"detail_px": 1}}"#;
        let document = SceneDocument::parse(text, "a").unwrap();
        assert_eq!(document.settings.unwrap().lod_error_px, 1.0);
        assert_eq!(document.notes, ["detail_px is now called lod_error_px"]);
    }

    #[test]
    fn a_written_document_reads_back() {
        let text = "{\"version\": 1, \"objects\": [{\"mesh\": \"brick.obj\", \"place\": {\"pixel\": [60, 50], \"scale\": [1, 2, 3]}, \"material\": {\"preset\": \"gold\", \"emissive\": 2}}]}";
        let document = SceneDocument::parse(text, "a").unwrap();
        let written = serde_json::to_string(&document).unwrap();
        let again = SceneDocument::parse(&written, "b").unwrap();
        assert_eq!(serde_json::to_string(&again).unwrap(), written);
        let spec = MaterialSpec {
            preset: Some(Preset::Gold),
            emissive: Some(Triple([2.0; 3])),
            ..MaterialSpec::default()
        };
        assert_eq!(again.objects[0].material, Some(spec));
    }
}
