//! Loads mesh files of every format, by their extension.

use std::path::Path;
use std::sync::{Arc, PoisonError};

use super::error::MeshError;
use super::model::{MAX_FILE_BYTES, Model};
use super::{LoadContext, Mesh, draco, gltf, obj, ply};

/// Most notes kept per file.
const MAX_NOTES: usize = 20;

/// Whether a file name has the extension of a mesh format.
pub fn is_mesh(path: &Path) -> bool {
    let known = ["obj", "ply", "glb", "gltf", "drc"];
    path.extension()
        .is_some_and(|e| known.contains(&e.to_string_lossy().to_lowercase().as_str()))
}

/// The meshes of a file, each in its own space, loaded by the file's extension and without memory limits. A scene
/// document places them; this function is for callers that only need the triangles.
pub fn load_meshes(path: &Path) -> Result<Vec<Arc<Mesh>>, MeshError> {
    Model::load_with(&LoadContext::default(), path).map(|model| model.meshes)
}

impl LoadContext {
    /// The model of a mesh file, which is read only once.
    pub(super) fn model(&self, path: &Path) -> Result<Arc<Model>, MeshError> {
        let models = || self.models.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = models().get(path) {
            return Ok(Arc::clone(known));
        }
        let model = Arc::new(Model::load_with(self, path)?);
        models().insert(path.to_owned(), Arc::clone(&model));
        Ok(model)
    }
}

impl Model {
    /// Loads a mesh file by its extension, as [`Self::load_with`] without limits.
    #[cfg(test)]
    pub(crate) fn load(path: &Path) -> Result<Self, MeshError> {
        Self::load_with(&LoadContext::default(), path)
    }

    /// Loads a mesh file by its extension.
    pub(crate) fn load_with(context: &LoadContext, path: &Path) -> Result<Self, MeshError> {
        let model = Self::read(context, path);
        context.close_files();
        let model = model?;
        let bytes = model.meshes.iter().map(|mesh| mesh.bytes()).sum();
        context
            .keep(bytes, "triangles")
            .map_err(|error| MeshError::new(&path.display().to_string(), error.to_string()))?;
        Ok(model)
    }

    fn read(context: &LoadContext, path: &Path) -> Result<Self, MeshError> {
        let name = path.display().to_string();
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_lowercase())
            .unwrap_or_default();
        let read = |max| {
            context
                .read(path, max)
                .map_err(|reason| MeshError::new(&name, reason))
        };
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut model = match extension.as_str() {
            "obj" => obj::load_with(context, &read(MAX_FILE_BYTES)?, &name, folder),
            "ply" => ply::load_with(context, &read(MAX_FILE_BYTES)?, &name, folder),
            "glb" | "gltf" => gltf::load_with(context, &read(MAX_FILE_BYTES)?, &name, folder),
            "drc" => draco::load(context, &read(MAX_FILE_BYTES)?, &name),
            other => Err(MeshError::new(
                &name,
                format!("expected a mesh in .obj, .ply, .glb, .gltf or .drc, got {other:?}"),
            )),
        }?;
        // The number of notes is limited, because a broken exporter causes the same note for every part.
        let n = model.notes.len();
        if n > MAX_NOTES {
            model.notes.truncate(MAX_NOTES);
            model
                .notes
                .push(format!("and {} notes more", n - MAX_NOTES));
        }
        Ok(model)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::test_data;

    #[test]
    fn real_meshes_hold_what_is_known_of_them() {
        let Some(data) = test_data::folder() else {
            return;
        };
        let load = |name: &str| Model::load(&data.join(name));
        for (name, triangles) in [
            ("meshes/teapot.obj", 6_320),
            ("meshes/utah-teapot-16k.obj", 16_256),
            ("meshes/stanford-bunny.obj", 69_451),
            ("meshes/dragon-100k.ply", 100_000),
            ("meshes/lucy-100k.drc", 100_000),
            ("gltf/Box.glb", 12),
            ("gltf/Duck.glb", 4_212),
            ("gltf/DamagedHelmet.glb", 15_452),
            ("gltf/TransmissionRoughnessTest.glb", 77_792),
            // Both vases contain the flowers.
            ("gltf/GlassVaseFlowers.glb", 14_036),
            ("gltf/ClearCoatTest.glb", 37_116),
            ("gltf/EmissiveStrengthTest.glb", 90),
        ] {
            let model = load(name).unwrap();
            assert!(model.report.is_clean(), "{name}: {}", model.report);
            assert_eq!(model.n_drawn(), triangles, "{name}");
            for mesh in &model.meshes {
                assert!(
                    mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-5),
                    "{name}"
                );
                if name.starts_with("meshes") {
                    assert_eq!(mesh.normals.len(), mesh.positions.len(), "{name}");
                }
            }
        }
        let spheres = load("gltf/MetalRoughSpheresNoTextures.glb").unwrap();
        // Two triangles of the sphere that is drawn 98 times have no area.
        assert_eq!(spheres.n_drawn(), 1_040_409 - 2 * 98, "{:?}", spheres.notes);
        // Spheres and labels share 26 sets of buffers.
        assert_eq!((spheres.parts.len(), spheres.meshes.len()), (123, 26));
        let sky = data.join("env/brown_photostudio_02_1k.hdr");
        let (sky, notes) =
            crate::scene::Environment::load(&sky, 1.0, glam::DQuat::IDENTITY).unwrap();
        assert_eq!((sky.width, sky.height, notes.len()), (1024, 512, 0));
        assert!(sky.mean_radiance().min_element() > 0.01);
        assert_eq!(sky.to_lights(8).lights.len(), 8);
    }
}
