//! Preparation of a mesh: checks, and removal of triangles that rays cannot hit and of duplicates.

use glam::{DVec3, Vec3, Vec3A};
use rayon::prelude::*;

use super::chunks::SortedChunks;
use super::layout::MOST_TRIANGLES;
use crate::scene::Mesh;

/// Triangles or vertices below which work is not parallel: about a tenth of a millisecond of work.
const TASK: usize = 1 << 12;

/// Larger coordinates would overflow the products of three in the triangle test.
const MAX_COORDINATE: f32 = 1e10;

/// Limits on the cost of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BuildLimits {
    /// Most triangles of one mesh; values above 2^25 have no effect.
    pub max_triangles: usize,
}

impl Default for BuildLimits {
    fn default() -> Self {
        Self {
            max_triangles: 16 << 20,
        }
    }
}

/// Why a mesh cannot be ray traced.
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
    /// A vertex is NaN, infinite or too far from the origin for the arithmetic.
    #[error("vertex {vertex} is at {position}, expected finite coordinates below 1e10")]
    BadPosition {
        /// The vertex.
        vertex: usize,
        /// Its position.
        position: Vec3,
    },
}

/// A prepared mesh: triangles that can be hit, relative to their centre.
pub(crate) struct Prepared<'a> {
    mesh: &'a Mesh,
    /// Centre of the mesh's bounds, subtracted from every corner.
    pub(crate) centre: Vec3,
    /// Mesh indices of the kept triangles.
    pub(crate) ids: Vec<u32>,
}

impl Prepared<'_> {
    /// Corners of a kept triangle, relative to the centre.
    #[inline(always)]
    pub(crate) fn corners(&self, i: usize) -> [Vec3A; 3] {
        corners_of(self.mesh, self.ids[i]).map(|p| Vec3A::from(p - self.centre))
    }
}

/// Corners of a triangle of the mesh.
#[inline(always)]
fn corners_of(mesh: &Mesh, id: u32) -> [Vec3; 3] {
    mesh.triangles[id as usize].map(|i| mesh.positions[i as usize])
}

/// Checks the mesh, drops triangles that cannot be hit, and moves the rest around their centre.
pub(crate) fn prepare(mesh: &Mesh, limits: BuildLimits) -> Result<Prepared<'_>, BuildError> {
    let vertices = mesh.positions.len();
    let limit = limits.max_triangles.min(MOST_TRIANGLES);
    if mesh.triangles.len() > limit {
        return Err(BuildError::TooManyTriangles {
            found: mesh.triangles.len(),
            limit,
        });
    }
    let is_usable = |p: &Vec3| p.is_finite() && p.abs().max_element() <= MAX_COORDINATE;
    // The first bad vertex is searched only if there is one.
    if !mesh.positions.par_iter().with_min_len(TASK).all(is_usable)
        && let Some(vertex) = mesh.positions.iter().position(|p| !is_usable(p))
    {
        return Err(BuildError::BadPosition {
            vertex,
            position: mesh.positions[vertex],
        });
    }
    let in_range = |corners: &[u32; 3]| corners.iter().all(|&i| (i as usize) < vertices);
    if !mesh.triangles.par_iter().with_min_len(TASK).all(in_range)
        && let Some(triangle) = mesh.triangles.iter().position(|t| !in_range(t))
        && let Some(&index) = mesh.triangles[triangle]
            .iter()
            .find(|&&i| i as usize >= vertices)
    {
        return Err(BuildError::IndexOutOfRange {
            triangle,
            index,
            vertices,
        });
    }
    let ids = distinct(mesh);

    let empty = || (Vec3::INFINITY, Vec3::NEG_INFINITY);
    let (low, high) = ids
        .par_iter()
        .with_min_len(TASK)
        .fold(empty, |(low, high), &id| {
            let [a, b, c] = corners_of(mesh, id);
            (low.min(a).min(b).min(c), high.max(a).max(b).max(c))
        })
        .reduce(empty, |a, b| (a.0.min(b.0), a.1.max(b.1)));
    let centre = if ids.is_empty() {
        Vec3::ZERO
    } else {
        (low + high) * 0.5
    };
    Ok(Prepared { mesh, centre, ids })
}

/// Whether the corners span an area. In double precision, so that thin triangles do not count as degenerate.
fn has_area([a, b, c]: [Vec3; 3]) -> bool {
    let [a, b, c]: [DVec3; 3] = [a, b, c].map(Vec3::as_dvec3);
    (b - a).cross(c - a) != DVec3::ZERO
}

/// Indices of the triangles that have an area. Of triangles with the same three corners, in any order, only the
/// lowest index is kept.
fn distinct(mesh: &Mesh) -> Vec<u32> {
    let count = mesh.triangles.len();
    // Adding +0.0 turns -0.0 into +0.0.
    let bits = |p: Vec3| p.to_array().map(|x| (x + 0.0).to_bits());
    let vertices = mesh.positions.par_iter().with_min_len(TASK);
    let hashes: Vec<u64> = vertices.map(|&p| mixed(bits(p))).collect();
    // A sum, so that the order of the corners does not matter.
    let hash = |id: u32| {
        let corners = mesh.triangles[id as usize].map(|i| hashes[i as usize]);
        corners.into_iter().fold(0_u64, u64::wrapping_add)
    };
    // Bucketed by the first bits of their hashes, a few hundred triangles per bucket: small sorts stay in the cache.
    // The last bucket takes triangles without an area.
    let bits_of_buckets = (count / 256).next_power_of_two().ilog2().clamp(1, 12);
    let flat = 1 << bits_of_buckets;
    let bucket = |i: usize| {
        if has_area(corners_of(mesh, i as u32)) {
            (hash(i as u32) >> (64 - bits_of_buckets)) as u32
        } else {
            flat as u32
        }
    };
    // Key: the next 32 bits of the hash, then the triangle index.
    let value = |i: usize| hash(i as u32) << bits_of_buckets & !u64::from(u32::MAX) | i as u64;
    let buckets = SortedChunks::new(count, flat + 1, bucket, value);
    let key = |id: u32| {
        let mut key = corners_of(mesh, id).map(bits);
        key.sort_unstable();
        key
    };
    // The hash only finds candidates: triangles with equal hashes are compared in full. Input crafted to make hashes
    // collide costs no more than one large sort.
    let repeats = (0..flat).into_par_iter().flat_map_iter(|bucket| {
        let mut bucket: Vec<u64> = buckets.of(bucket).flatten().copied().collect();
        bucket.sort_unstable();
        let mut repeats = Vec::new();
        for same in bucket.chunk_by(|a, b| a >> 32 == b >> 32) {
            if same.len() > 1 {
                let mut same: Vec<_> = same.iter().map(|&x| (key(x as u32), x as u32)).collect();
                same.sort_unstable();
                let pairs = same.windows(2).filter(|pair| pair[0].0 == pair[1].0);
                repeats.extend(pairs.map(|pair| pair[1].1));
            }
        }
        repeats
    });
    let mut left_out: Vec<u32> = repeats.collect();
    left_out.extend(buckets.of(flat).flatten().map(|&x| x as u32));
    let ids = (0..count as u32).into_par_iter().with_min_len(TASK);
    if left_out.is_empty() {
        return ids.collect();
    }
    left_out.sort_unstable();
    ids.filter(|id| left_out.binary_search(id).is_err())
        .collect()
}

/// Mixes a corner's bits into 64 bits, with the multiplications of the xxHash finaliser.
fn mixed([x, y, z]: [u32; 3]) -> u64 {
    let mut hash =
        (u64::from(x) << 32 | u64::from(y)) ^ u64::from(z).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    hash = (hash ^ hash >> 33).wrapping_mul(0xc2b2_ae3d_27d4_eb4f);
    hash = (hash ^ hash >> 29).wrapping_mul(0x1656_67b1_9e37_79f9);
    hash ^ hash >> 32
}
