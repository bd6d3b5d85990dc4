//! From a mesh to a binary tree: checks, removal of triangles that rays cannot hit or that
//! repeat another, and the choice of builder.
//!
//! obvhs (PLOC with reinsertion) makes the better tree, but where many boxes share a centre or
//! overlap it takes time quadratic in their number, and its tree may be as deep. Such meshes, and trees too deep for the
//! traversals' stacks, are split at medians instead.

use std::time::Duration;

use glam::{DVec3, Vec3, Vec3A};
use obvhs::{BvhBuildParams, aabb::Aabb, bvh2::builder::build_bvh2};

use super::split::{BinaryNode, BinaryTree};
use crate::numerics::uniform;
use crate::scene::Mesh;

/// Most triangles in a leaf, and in the vector test of a leaf.
pub(super) const LEAF_SIZE: usize = 4;

/// Deepest binary tree that is walked, in edges from the root: the packet kernel keeps one
/// sibling per level.
pub(super) const MAX_DEPTH: usize = 94;

/// Coordinates beyond this would overflow the triangle test's products of three.
const MAX_COORDINATE: f32 = 1e10;

/// Boxes that share a centre (to 21 bits per axis) before obvhs is not asked: below this its
/// quadratic time on them is not felt.
const MAX_COINCIDENT: usize = 256;

/// Sum of the boxes' areas over the area around them all, from which obvhs is not asked: its
/// reinsertion looks at every subtree that overlaps, so each of n boxes would take time in
/// proportion. Surfaces stay below 10, dense foliage below 100.
const MAX_OVERLAP: f32 = 256.0;

/// What a mesh may cost.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BuildLimits {
    /// Most triangles of one mesh.
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
pub(super) struct Prepared {
    /// Middle of the mesh's bounds, subtracted from every corner.
    pub(super) centre: Vec3,
    /// Corners of the kept triangles.
    pub(super) corners: Vec<[Vec3A; 3]>,
    /// Their numbers in the mesh.
    pub(super) ids: Vec<u32>,
}

/// Checks the mesh, drops what cannot be hit, and moves the rest around its centre.
pub(super) fn prepare(mesh: &Mesh, limits: BuildLimits) -> Result<Prepared, BuildError> {
    let vertices = mesh.positions.len();
    // Ids are u32 and a tree has up to twice as many nodes, one bit of an index being a flag.
    let limit = limits.max_triangles.min(1 << 29);
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

/// The better tree that `fits`, or the one split at medians, which always does.
pub(super) fn build_tree<T>(
    corners: &[[Vec3A; 3]],
    fit: impl Fn(&BinaryTree) -> Option<T>,
) -> Option<T> {
    let boxes: Vec<Aabb> = corners.iter().map(|c| Aabb::from_points(c)).collect();
    if !many_coincide(&boxes)
        && !much_overlaps(&boxes)
        && let Some(fitted) = obvhs_tree(&boxes).as_ref().and_then(&fit)
    {
        return Some(fitted);
    }
    let mut tree = BinaryTree::default();
    tree.rebuild(boxes.len() as u32, LEAF_SIZE as u32, |i| {
        let b = boxes[i as usize];
        Some((b.min, b.max))
    });
    fit(&tree)
}

/// Whether more than [`MAX_COINCIDENT`] boxes share the centre that obvhs would sort them by.
fn many_coincide(boxes: &[Aabb]) -> bool {
    if boxes.len() <= MAX_COINCIDENT {
        return false;
    }
    let centres = || boxes.iter().map(|b| b.min + b.max);
    let low = centres().fold(Vec3A::INFINITY, Vec3A::min);
    let size = centres().fold(Vec3A::NEG_INFINITY, Vec3A::max) - low;
    let steps = 2_097_151.0 / size.max(Vec3A::splat(f32::MIN_POSITIVE));
    let mut cells: Vec<u64> = centres()
        .map(|c| {
            let [x, y, z] = ((c - low) * steps).to_array().map(|x| x as u64);
            x | y << 21 | z << 42
        })
        .collect();
    cells.sort_unstable();
    cells
        .windows(MAX_COINCIDENT + 1)
        .any(|w| w[0] == w[MAX_COINCIDENT])
}

/// Whether the boxes overlap more than [`MAX_OVERLAP`].
fn much_overlaps(boxes: &[Aabb]) -> bool {
    let all = boxes
        .iter()
        .fold(Aabb::INVALID, |all, b| all.union(b))
        .half_area();
    boxes.iter().map(Aabb::half_area).sum::<f32>() > MAX_OVERLAP * all
}

/// obvhs's tree with boxes recomputed exactly from the leaves, or `None` if it is too deep.
fn obvhs_tree(boxes: &[Aabb]) -> Option<BinaryTree> {
    if boxes.is_empty() {
        return Some(BinaryTree::default());
    }
    let params = BvhBuildParams {
        max_prims_per_leaf: LEAF_SIZE as u32,
        ..BvhBuildParams::medium_build()
    };
    // Where all neighbours are equally good (an even row), PLOC would merge one pair per pass. Boxes
    // grown by up to a hundredth break the ties; only the tree's shape sees that.
    let uneven: Vec<Aabb> = boxes
        .iter()
        .zip(0..)
        .map(|(b, i)| {
            let grow = b.diagonal().max_element() * 0.01 * uniform(i, 0, 0);
            Aabb::new(b.min - grow, b.max + grow)
        })
        .collect();
    let built = build_bvh2(&uneven, params, &mut Duration::default());
    let mut nodes: Vec<BinaryNode> = built
        .nodes
        .iter()
        .map(|n| BinaryNode {
            low: n.aabb().min,
            high: n.aabb().max,
            first: n.first_index,
            count: n.prim_count,
        })
        .collect();
    let order = built.primitive_indices;

    // Parents before children; boxes are then folded upwards in reverse.
    let mut visited = Vec::with_capacity(nodes.len());
    let mut pending = vec![(0_u32, 0_usize)];
    while let Some((index, depth)) = pending.pop() {
        if depth > MAX_DEPTH || visited.len() > nodes.len() {
            return None;
        }
        visited.push(index);
        let node = nodes[index as usize];
        if node.count == 0 {
            pending.push((node.first, depth + 1));
            pending.push((node.first + 1, depth + 1));
        } else if node.count as usize > LEAF_SIZE {
            return None;
        }
    }
    for &index in visited.iter().rev() {
        let node = nodes[index as usize];
        let first = node.first as usize;
        let (low, high) = if node.count == 0 {
            let (l, r) = (nodes[first], nodes[first + 1]);
            (l.low.min(r.low), l.high.max(r.high))
        } else {
            order[first..first + node.count as usize].iter().fold(
                (Vec3A::INFINITY, Vec3A::NEG_INFINITY),
                |(low, high), &i| {
                    let b = boxes[i as usize];
                    (low.min(b.min), high.max(b.max))
                },
            )
        };
        nodes[index as usize].low = low;
        nodes[index as usize].high = high;
    }
    Some(BinaryTree::from_parts(nodes, order))
}
