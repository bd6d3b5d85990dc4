//! One mesh ready for rays: its triangles in leaf order under an eight-wide tree.

use glam::{Vec3, Vec3A};

use super::build::{BuildError, BuildLimits, prepare};
use super::cells::Cell;
use super::collapse::collapse;
use super::pages::Pages;
use super::ray::SpaceRay;
use super::{sah, scalar};
use crate::scene::Mesh;

/// A mesh that rays can be traced against. Built once and shared between instances.
#[derive(Debug, Default)]
pub struct Blas {
    /// The mesh's own origin lies at minus this.
    pub(super) centre: Vec3,
    /// Bounds around the centre; meaningless without triangles.
    pub(super) low: Vec3A,
    pub(super) high: Vec3A,
    /// Largest coordinate of the bounds.
    pub(super) extent: f32,
    /// The tree, its root first.
    pub(super) cells: Pages<Cell>,
    triangles: usize,
}

impl Blas {
    /// Builds the trees. Time is bounded by n log n in the number of triangles, whatever they are.
    ///
    /// Triangles without area are left out (no ray hits them), and so are those with the same
    /// corners as an earlier one. Hits report numbers in `mesh.triangles` all the same.
    pub fn build(mesh: &Mesh, limits: BuildLimits) -> Result<Self, BuildError> {
        let prepared = prepare(mesh, limits)?;
        let tree = sah::build(&prepared.corners);
        let Some(root) = tree.nodes.first() else {
            // No triangle is left: nothing to hit.
            return Ok(Self::default());
        };
        Ok(Self {
            centre: prepared.centre,
            low: root.low,
            high: root.high,
            extent: root.low.abs().max(root.high.abs()).max_element(),
            cells: collapse(&tree, &prepared),
            triangles: prepared.ids.len(),
        })
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

    /// About how many nodes and leaves a ray visits between two points of the mesh's space, if it hits
    /// nothing; counts up to `most`.
    pub fn visits(&self, from: Vec3A, to: Vec3A, most: usize) -> usize {
        let (origin, along) = (from - Vec3A::from(self.centre), to - from);
        SpaceRay::new(origin, along, 0.0, self.extent)
            .map_or(0, |ray| scalar::count_visits(self, &ray, 1.0, most))
    }

    /// Memory held, bytes.
    pub fn memory(&self) -> usize {
        std::mem::size_of_val(&self.cells[..])
    }
}
