//! From a mesh to the eight-wide tree that rays are traced against: checks (`sanitise`), a binary
//! tree by the surface area heuristic (`sah`, with `bins` to find cuts and `cells` for the first
//! levels of large meshes), its collapse to eight children a node (`collapse`)
//! and the memory that kernels read (`layout`). `split` builds the tree over the instances of a
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

/// A mesh ready for rays.
pub(crate) struct Built {
    /// Middle of the mesh's bounds, the origin of everything below.
    pub(crate) centre: Vec3,
    /// Bounds around the centre.
    pub(crate) low: Vec3A,
    pub(crate) high: Vec3A,
    /// The tree, its root first.
    pub(crate) cells: Pages<Cell>,
    /// Number of triangles in the tree.
    pub(crate) triangles: usize,
}

/// Builds the tree of a mesh; `None` if no triangle is left that a ray could hit.
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
