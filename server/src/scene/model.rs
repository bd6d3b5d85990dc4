//! A mesh file, whatever its format, as meshes, materials and where the parts lie.

use std::path::Path;
use std::sync::Arc;

use glam::DAffine3;

use super::error::MeshError;
use super::sanitise::SanitiseReport;
use super::{Material, Mesh, file, gltf, obj, ply};

/// Largest mesh file read, bytes.
pub const MAX_FILE_BYTES: u64 = 2 << 30;

/// Most triangles that are stored for one scene (instances share them).
pub const MAX_TRIANGLES: usize = 16_000_000;

/// What a mesh file holds.
#[derive(Debug, Clone, Default)]
pub(crate) struct Model {
    pub(crate) meshes: Vec<Arc<Mesh>>,
    pub(crate) materials: Vec<Material>,
    pub(crate) parts: Vec<Part>,
    /// What was odd, one sentence each.
    pub(crate) notes: Vec<String>,
    /// Sum over the meshes.
    pub(crate) report: SanitiseReport,
}

/// One placed mesh of a model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    /// Index into [`Model::meshes`].
    pub(crate) mesh: usize,
    /// Index into [`Model::materials`]; `None` where the file says nothing.
    pub(crate) material: Option<usize>,
    /// Model space from mesh space.
    pub(crate) model_from_mesh: DAffine3,
}

impl Model {
    /// Triangles drawn: those of shared meshes counted once per part.
    pub(crate) fn n_drawn(&self) -> usize {
        self.parts
            .iter()
            .map(|part| self.meshes[part.mesh].triangles.len())
            .sum()
    }

    /// Triangles stored.
    pub(crate) fn n_stored(&self) -> usize {
        self.meshes.iter().map(|mesh| mesh.triangles.len()).sum()
    }

    /// Notes what sanitising changed, if anything.
    pub(super) fn note_report(&mut self) {
        if !self.report.is_clean() {
            self.notes.push(self.report.to_string());
        }
    }

    /// Reads a mesh file by its extension.
    pub(crate) fn load(path: &Path) -> Result<Self, MeshError> {
        let name = path.display().to_string();
        let extension = path
            .extension()
            .map(|e| e.to_string_lossy().to_lowercase())
            .unwrap_or_default();
        let read = |max| file::read(path, max).map_err(|reason| MeshError::new(&name, reason));
        let folder = path.parent().unwrap_or(Path::new(""));
        match extension.as_str() {
            "obj" => obj::load(&read(MAX_FILE_BYTES)?, &name, folder),
            "ply" => ply::load(&read(MAX_FILE_BYTES)?, &name),
            "glb" | "gltf" => gltf::load(&read(MAX_FILE_BYTES)?, &name, folder),
            "drc" => Err(MeshError::new(
                &name,
                "Draco compression is not supported: expected .obj, .ply, .glb or .gltf",
            )),
            other => Err(MeshError::new(
                &name,
                format!("expected a mesh in .obj, .ply, .glb or .gltf, got {other:?}"),
            )),
        }
    }
}
