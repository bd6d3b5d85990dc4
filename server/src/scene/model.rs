//! A mesh file of any format as meshes, materials and placed parts.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};

use super::sanitise::SanitiseReport;
use super::{Material, Mesh};

/// Largest mesh file, bytes.
pub const MAX_FILE_BYTES: u64 = 2 << 30;

/// Most stored triangles per scene (instances share them).
pub const MAX_TRIANGLES: usize = 16_000_000;

/// Content of a mesh file.
#[derive(Debug, Clone, Default)]
pub(crate) struct Model {
    pub(crate) meshes: Vec<Arc<Mesh>>,
    pub(crate) materials: Vec<Material>,
    pub(crate) parts: Vec<Part>,
    /// Notes on unusual content, one sentence each.
    pub(crate) notes: Vec<String>,
    /// Sum over all meshes.
    pub(crate) report: SanitiseReport,
}

/// One placed mesh of a model.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Part {
    /// Index into [`Model::meshes`].
    pub(crate) mesh: usize,
    /// Index into [`Model::materials`]; `None` if the file assigns no material.
    pub(crate) material: Option<usize>,
    /// Model space from mesh space.
    pub(crate) model_from_mesh: DAffine3,
}

impl Model {
    /// Number of drawn triangles: shared meshes count once per part.
    pub(crate) fn n_drawn(&self) -> usize {
        self.parts
            .iter()
            .map(|part| self.meshes[part.mesh].triangles.len())
            .sum()
    }

    /// Number of stored triangles.
    pub(crate) fn n_stored(&self) -> usize {
        self.meshes.iter().map(|mesh| mesh.triangles.len()).sum()
    }

    /// Bounds after a linear map, of the vertices that triangles use. `None` without triangles.
    pub(super) fn bounds_under(&self, map: DMat3) -> Option<(DVec3, DVec3)> {
        let map = DAffine3::from_mat3(map);
        let mut bounds: Option<(DVec3, DVec3)> = None;
        for part in &self.parts {
            let mesh = &self.meshes[part.mesh];
            let from_mesh = map * part.model_from_mesh;
            for &index in mesh.triangles.iter().flatten() {
                let p = from_mesh.transform_point3(mesh.positions[index as usize].as_dvec3());
                bounds = Some(bounds.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))));
            }
        }
        bounds
    }

    /// Adds a note on the changes made by sanitising, if any.
    pub(super) fn note_report(&mut self) {
        if !self.report.is_clean() {
            self.notes.push(self.report.to_string());
        }
    }
}
