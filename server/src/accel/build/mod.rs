//! Builds the eight-wide BVH of a mesh: checks (`sanitise`), a binary BVH by the surface area heuristic (`sah`, with
//! `bins` to find splits and `cells` for the first levels of large meshes), its collapse to eight children per node
//! (`collapse`), and the memory layout that kernels read (`layout`). `split` builds the BVH over the instances of a
//! frame.

mod bins;
mod cells;
mod chunks;
mod collapse;
pub(super) mod layout;
mod sah;
mod sanitise;
pub(super) mod split;

use glam::{Vec3, Vec3A};

use crate::scene::Mesh;
use crate::simd::Pages;
use layout::Cell;

pub use sanitise::{BuildError, BuildLimits};

/// A mesh prepared for ray tracing.
pub(crate) struct Built {
    /// Centre of the mesh's bounds; all coordinates below are relative to it.
    pub(crate) centre: Vec3,
    /// Bounds, relative to the centre.
    pub(crate) low: Vec3A,
    pub(crate) high: Vec3A,
    /// The BVH, root first.
    pub(crate) cells: Pages<Cell>,
    /// Number of triangles in the BVH.
    pub(crate) triangles: usize,
}

/// Builds the BVH of a mesh; `None` if no triangle remains that a ray could hit.
pub(crate) fn build(mesh: &Mesh, limits: BuildLimits) -> Result<Option<Built>, BuildError> {
    let prepared = sanitise::prepare(mesh, limits)?;
    let tree = sah::build(prepared.ids.len(), |i| prepared.corners(i));
    Ok(tree.nodes.first().map(|root| Built {
        centre: prepared.centre,
        low: root.low.into(),
        high: root.high.into(),
        cells: collapse::collapse(&tree, &prepared),
        triangles: prepared.ids.len(),
    }))
}
