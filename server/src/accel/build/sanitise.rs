//! What comes before the tree: checks, and removal of triangles that rays cannot hit or that
//! repeat another.

use glam::{DVec3, Vec3, Vec3A};

use super::layout::MOST_TRIANGLES;
use crate::scene::Mesh;

/// Coordinates beyond this would overflow the triangle test's products of three.
const MAX_COORDINATE: f32 = 1e10;

/// What a mesh may cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BuildLimits {
    /// Most triangles of one mesh; beyond 2^25 it makes no difference.
    pub max_triangles: usize,
}

impl Default for BuildLimits {
    fn default() -> Self {
        Self {
            max_triangles: 16 << 20,
        }
    }
}

/// Why a mesh cannot be traced.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum BuildError {
    /// More triangles than [`BuildLimits::max_triangles`].
    #[error("mesh has {found} triangles, expected at most {limit}")]
    TooManyTriangles {
        /// Triangles in the mesh.
        found: usize,
        /// The limit.
        limit: usize,
    },
    /// A triangle refers to a vertex that does not exist.
    #[error("triangle {triangle} refers to vertex {index}, expected below {vertices}")]
    IndexOutOfRange {
        /// The triangle.
        triangle: usize,
        /// Its vertex index.
        index: u32,
        /// Vertices in the mesh.
        vertices: usize,
    },
    /// A vertex is NaN, infinite or too far out to compute with.
    #[error("vertex {vertex} is at {position}, expected finite coordinates below 1e10")]
    BadPosition {
        /// The vertex.
        vertex: usize,
        /// Its position.
        position: Vec3,
    },
}

/// A mesh made ready: triangles that can be hit, around their centre.
pub(crate) struct Prepared {
    /// Middle of the mesh's bounds, subtracted from every corner.
    pub(crate) centre: Vec3,
    /// Corners of the kept triangles.
    pub(crate) corners: Vec<[Vec3A; 3]>,
    /// Their numbers in the mesh.
    pub(crate) ids: Vec<u32>,
}

/// Checks the mesh, drops what cannot be hit, and moves the rest around its centre.
pub(crate) fn prepare(mesh: &Mesh, limits: BuildLimits) -> Result<Prepared, BuildError> {
    let vertices = mesh.positions.len();
    let limit = limits.max_triangles.min(MOST_TRIANGLES);
    if mesh.triangles.len() > limit {
        return Err(BuildError::TooManyTriangles {
            found: mesh.triangles.len(),
            limit,
        });
    }
    if let Some((vertex, &position)) = mesh
        .positions
        .iter()
        .enumerate()
        .find(|(_, p)| !(p.is_finite() && p.abs().max_element() <= MAX_COORDINATE))
    {
        return Err(BuildError::BadPosition { vertex, position });
    }
    for (triangle, corners) in mesh.triangles.iter().enumerate() {
        if let Some(&index) = corners.iter().find(|&&i| i as usize >= vertices) {
            return Err(BuildError::IndexOutOfRange {
                triangle,
                index,
                vertices,
            });
        }
    }
    let corners_of = |id: u32| mesh.triangles[id as usize].map(|i| mesh.positions[i as usize]);
    let mut ids: Vec<u32> = (0..mesh.triangles.len() as u32)
        .filter(|&id| has_area(corners_of(id)))
        .collect();
    drop_repeats(&mut ids, corners_of);

    let (low, high) = ids
        .iter()
        .flat_map(|&id| corners_of(id))
        .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| {
            (low.min(p), high.max(p))
        });
    let centre = if ids.is_empty() {
        Vec3::ZERO
    } else {
        (low + high) * 0.5
    };
    let corners = ids
        .iter()
        .map(|&id| corners_of(id).map(|p| Vec3A::from(p - centre)))
        .collect();
    Ok(Prepared {
        centre,
        corners,
        ids,
    })
}

/// Whether the corners span an area. In doubles, so that thin is not taken for empty.
fn has_area([a, b, c]: [Vec3; 3]) -> bool {
    let [a, b, c]: [DVec3; 3] = [a, b, c].map(Vec3::as_dvec3);
    (b - a).cross(c - a) != DVec3::ZERO
}

/// Keeps the lowest id of triangles with the same three corners, in whatever order these are.
fn drop_repeats(ids: &mut Vec<u32>, corners_of: impl Fn(u32) -> [Vec3; 3]) {
    // Adding +0.0 makes the two zeros one.
    let key = |id: u32| {
        let mut key = corners_of(id).map(|p| p.to_array().map(|x| (x + 0.0).to_bits()));
        key.sort_unstable();
        key
    };
    // The hash only speeds up the sort: equal hashes are compared in full, so hashes that were
    // made to collide cost no more than a comparison each.
    let hash = |id: u32| {
        key(id)
            .iter()
            .flatten()
            .fold(0xcbf2_9ce4_8422_2325_u64, |hash, &word| {
                (hash ^ u64::from(word))
                    .wrapping_mul(0x9e37_79b9_7f4a_7c15)
                    .rotate_left(29)
            })
    };
    let mut keyed: Vec<(u64, u32)> = ids.iter().map(|&id| (hash(id), id)).collect();
    keyed.sort_unstable_by(|x, y| {
        x.0.cmp(&y.0)
            .then_with(|| key(x.1).cmp(&key(y.1)))
            .then(x.1.cmp(&y.1))
    });
    keyed.dedup_by(|later, earlier| later.0 == earlier.0 && key(later.1) == key(earlier.1));
    ids.clear();
    ids.extend(keyed.iter().map(|&(_, id)| id));
    ids.sort_unstable();
}
