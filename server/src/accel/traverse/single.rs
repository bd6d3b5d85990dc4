//! One ray through one mesh's eight-wide BVH: eight boxes at once, then all triangles of a leaf at once, nearest
//! child first.

use fearless_simd::{Simd, f32x4, f32x8, prelude::*};

use super::triangle;
use crate::accel::blas::Blas;
use crate::accel::build::layout::{self, Block, Cell, LEAF, LEAF_SIZE, STACK};
use crate::accel::ray::{Hit, HitFilter};
use crate::accel::space::SpaceRay;
use crate::simd::prefetch;

/// A child on the traversal stack.
#[derive(Clone, Copy)]
pub(crate) struct StackEntry {
    /// Ray parameter at the entry into its box; not clamped to the ray's interval.
    pub(crate) near: f32,
    pub(crate) child: u32,
}

impl StackEntry {
    /// The root, to traverse the whole mesh.
    pub(crate) const ROOT: Self = Self {
        near: f32::NEG_INFINITY,
        child: 0,
    };
}

/// Stack of children to visit. It is written for each traversal, so it is aligned to a cache line.
#[repr(align(64))]
pub(crate) struct Stack(pub(crate) [StackEntry; STACK]);

impl Stack {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self([StackEntry::ROOT; STACK])
    }
}

/// Target of a traversal: the instance being traversed, and the filter that may reject its hits.
#[derive(Clone, Copy)]
pub(crate) struct Target<'a> {
    pub(crate) instance: u32,
    pub(crate) filter: Option<HitFilter<'a>>,
    /// Any hit is sufficient.
    pub(crate) any: bool,
}

impl Target<'_> {
    /// Records the hit in `best` if it is in range, wins and passes the filter.
    #[inline(always)]
    pub(crate) fn take(&self, best: &mut Hit, t_min: f32, hit: Hit) -> bool {
        let wins = hit.t >= t_min
            && (hit.t < best.t
                || (hit.t == best.t
                    && (hit.instance, hit.triangle) < (best.instance, best.triangle)));
        let taken = wins && self.filter.is_none_or(|filter| filter(&hit));
        if taken {
            *best = hit;
        }
        taken
    }
}

/// Prefetches a child that will be visited later.
#[inline(always)]
pub(crate) fn prefetch_child<S: Simd>(simd: S, cells: &[Cell], child: u32) {
    // Every second cell starts a cache line; a leaf is no larger than a node.
    if let Some(bytes) = layout::bytes(cells, child) {
        prefetch(simd, &bytes[0]);
        prefetch(simd, &bytes[2]);
        prefetch(simd, &bytes[4]);
        prefetch(simd, &bytes[6]);
    }
}

/// Traverses the subtree of `start`, a node; returns whether a hit was recorded. With `target.any`, the first hit
/// ends the traversal.
#[inline(always)]
pub(crate) fn walk<S: Simd>(
    simd: S,
    blas: &Blas,
    ray: &SpaceRay,
    start: u32,
    target: Target<'_>,
    best: &mut Hit,
) -> bool {
    let cells: &[Cell] = &blas.cells;
    if cells.is_empty() {
        return false;
    }
    let splat = |x: f32| f32x8::splat(simd, x);
    let slabs = &ray.slabs;
    // Not `map`: it would not be inlined, and vectors would go through memory.
    let near_origin = [
        splat(slabs.near_origin.x),
        splat(slabs.near_origin.y),
        splat(slabs.near_origin.z),
    ];
    let far_origin = [
        splat(slabs.far_origin.x),
        splat(slabs.far_origin.y),
        splat(slabs.far_origin.z),
    ];
    let inv = [splat(slabs.inv.x), splat(slabs.inv.y), splat(slabs.inv.z)];
    let negative = slabs.negative.bitmask() as usize;
    let t_min = splat(slabs.t_min);

    let Stack(stack) = &mut Stack::new();
    let mut height = 0;
    let mut current = StackEntry {
        child: start,
        ..StackEntry::ROOT
    };
    let mut found = false;
    loop {
        if current.child & LEAF != 0 {
            let block = layout::block(cells, current.child);
            let taken = leaf(simd, block, ray, current.near, target, best);
            found |= taken;
            if target.any && taken {
                return true;
            }
        } else {
            let node = layout::node(cells, current.child);
            let plane = |axis: usize, far: usize| {
                f32x8::load_array_ref(simd, &node.planes[axis][(negative >> axis ^ far) & 1])
            };
            let near = ((plane(0, 0) - near_origin[0]) * inv[0])
                .max((plane(1, 0) - near_origin[1]) * inv[1])
                .max((plane(2, 0) - near_origin[2]) * inv[2]);
            let far = ((plane(0, 1) - far_origin[0]) * inv[0])
                .min((plane(1, 1) - far_origin[1]) * inv[1])
                .min((plane(2, 1) - far_origin[2]) * inv[2]);
            let reach = near.max(t_min).simd_le(far.min(splat(best.t)));
            let mut bits = reach.to_bitmask();
            if bits != 0 {
                let near = near.to_array();
                let waiting = |slot: u32| StackEntry {
                    near: near[slot as usize & 7],
                    child: node.children[slot as usize & 7],
                };
                let first = waiting(bits.trailing_zeros());
                bits &= bits - 1;
                if bits == 0 {
                    // Visited directly: pushing it to the stack and popping it would take longer than the box tests.
                    current = first;
                    continue;
                }
                prefetch_child(simd, cells, first.child);
                let bottom = height;
                stack[height] = first;
                height += 1;
                while bits != 0 {
                    let entry = waiting(bits.trailing_zeros());
                    bits &= bits - 1;
                    prefetch_child(simd, cells, entry.child);
                    // Insertion sort, nearest on top: two or three children are usual.
                    let mut at = height;
                    while !target.any && at > bottom && stack[at - 1].near < entry.near {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = entry;
                    height += 1;
                }
            }
        }
        loop {
            if height == 0 {
                return found;
            }
            height -= 1;
            current = stack[height];
            if current.near <= best.t {
                break;
            }
        }
    }
}

/// Tests the triangles of a leaf that the ray enters at `near`; see [`triangle::cross`].
#[inline(always)]
fn leaf<S: Simd>(
    simd: S,
    block: &Block,
    ray: &SpaceRay,
    near: f32,
    target: Target<'_>,
    best: &mut Hit,
) -> bool {
    const { assert!(LEAF_SIZE == 4) };
    let [kx, ky, kz] = ray.axes;
    let splat = |x: f32| f32x4::splat(simd, x);
    let (ox, oy, oz) = (
        splat(ray.origin[kx]),
        splat(ray.origin[ky]),
        splat(ray.origin[kz]),
    );
    let (sx, sy, sz) = (
        splat(ray.shear[0]),
        splat(ray.shear[1]),
        splat(ray.shear[2]),
    );
    macro_rules! sheared {
        ($corner:literal) => {{
            let p = &block.corners[$corner];
            let z = f32x4::load_array_ref(simd, &p[kz]) - oz;
            let x = (f32x4::load_array_ref(simd, &p[kx]) - ox) - sx * z;
            let y = (f32x4::load_array_ref(simd, &p[ky]) - oy) - sy * z;
            [x, y, z]
        }};
    }
    let a = sheared!(0);
    let b = sheared!(1);
    let c = sheared!(2);
    let [u, v, w] = triangle::edges(a, b, c);
    let mut bits = triangle::inside(simd, [u, v, w]).to_bitmask();
    if bits == 0 {
        return false;
    }
    let edges = triangle::on_edge(simd, [u, v, w]).to_bitmask();
    let scale = splat(1.0) / ((u + v) + w);
    let t = ((((u * a[2] + v * b[2]) + w * c[2]) * scale) * sz).to_array();
    let (v, w) = ((v * scale).to_array(), (w * scale).to_array());
    let mut found = false;
    while bits != 0 {
        let k = (bits.trailing_zeros() as usize) & 3;
        bits &= bits - 1;
        let crossing = if edges >> k & 1 != 0 {
            let corner = |c: [f32x4<S>; 3]| [c[0][k], c[1][k], c[2][k]];
            triangle::resolve(corner(a), corner(b), corner(c), ray.shear[2])
        } else {
            Some((t[k], v[k], w[k]))
        };
        if let Some((t, u, v)) = crossing {
            let hit = Hit {
                t: t.max(near),
                instance: target.instance,
                triangle: block.ids[k],
                u,
                v,
            };
            found |= target.take(best, ray.slabs.t_min, hit);
        }
    }
    found
}
