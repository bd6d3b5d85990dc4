//! One mesh prepared for ray tracing: its triangles in leaf order under an eight-wide BVH.

use glam::{Vec3, Vec3A};

use super::build::layout::Cell;
use super::build::{BuildError, BuildLimits, build};
use crate::scene::Mesh;
use crate::simd::Pages;

/// A mesh that rays can be traced against. Built once and shared between instances.
#[derive(Debug, Default)]
pub struct Blas {
    /// Centre of the mesh's bounds. The BVH is relative to it, so the mesh's own origin is at minus this.
    pub(crate) centre: Vec3,
    /// Bounds, relative to the centre; meaningless without triangles.
    pub(crate) low: Vec3A,
    pub(crate) high: Vec3A,
    /// Largest absolute coordinate of the bounds.
    pub(crate) extent: f32,
    /// The BVH, root first.
    pub(crate) cells: Pages<Cell>,
    triangles: usize,
}

impl Blas {
    /// Builds the BVH in O(n log n) time in the number of triangles, for any input.
    ///
    /// Triangles without area are left out (no ray hits them), and so are triangles with the same corners as an
    /// earlier one. Hits still report triangle indices of `mesh.triangles`.
    pub fn build(mesh: &Mesh, limits: BuildLimits) -> Result<Self, BuildError> {
        // A mesh without hittable triangles becomes an empty BVH.
        Ok(
            build(mesh, limits)?.map_or_else(Self::default, |built| Self {
                centre: built.centre,
                low: built.low,
                high: built.high,
                extent: built.low.abs().max(built.high.abs()).max_element(),
                cells: built.cells,
                triangles: built.triangles,
            }),
        )
    }

    /// Number of distinct triangles that rays can hit.
    pub fn triangles(&self) -> usize {
        self.triangles
    }

    /// Bounds in the mesh's own space, conservative; `None` if nothing can be hit.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let (low, high) = (Vec3::from(self.low), Vec3::from(self.high));
        // Subtracting the centre and adding it back may each round inwards by half a unit.
        let slack = (self.centre.abs() + low.abs().max(high.abs())) * f32::EPSILON;
        (self.triangles > 0).then(|| (low + self.centre - slack, high + self.centre + slack))
    }

    /// Memory held, bytes.
    pub fn memory(&self) -> usize {
        std::mem::size_of_val(&self.cells[..])
    }
}
