//! Sixteen rays against one mesh: each box and each triangle is tested against all rays at once,
//! as long as enough of them come near it. Lanes that are done have `t = -inf`, which no box is nearer than.

use std::array::{from_mut, from_ref};

use fearless_simd::{Simd, f32x4, f32x8, f32x16, mask32x8, mask32x16, prelude::*, u32x8, u32x16};

use super::blas::Blas;
use super::bundle::{Bundle, Way};
use super::cells::{self, Cell, LEAF, NONE};
use super::packet_any::sweep;
use super::packet_boxes::Boxes;
use super::packet_leaf::{leaf, leaf_by_ray};
use super::packet_space::{Rays, SpaceRays};
use super::ray::Columns;
use super::wide::{self, STACK, Stack, Target, Waiting, prefetch_child};
use super::{Hit, HitFilter, NO_HIT, PacketFilter};

/// The vector types of one packet width.
pub(super) trait Width<S: Simd>: Copy {
    /// Lanes of floats.
    type F: SimdFloat<S, Element = f32, Mask = Self::M, Block = f32x4<S>>;
    /// Lanes of numbers.
    type U: SimdInt<S, Element = u32, Mask = Self::M>;
    /// One truth value per lane.
    type M: SimdMask<S> + Select<Self::F> + Select<Self::U>;
}

/// Sixteen lanes: one AVX-512 register.
#[derive(Clone, Copy)]
pub(super) struct Sixteen;
/// Eight lanes: one AVX2 register.
#[derive(Clone, Copy)]
pub(super) struct Eight;

impl<S: Simd> Width<S> for Sixteen {
    type F = f32x16<S>;
    type U = u32x16<S>;
    type M = mask32x16<S>;
}

impl<S: Simd> Width<S> for Eight {
    type F = f32x8<S>;
    type U = u32x8<S>;
    type M = mask32x8<S>;
}

/// The nearest hits so far.
#[derive(Clone, Copy)]
pub(super) struct Found<S: Simd, W: Width<S>> {
    /// Nearest `t`, or where the ray ends; -inf once a lane is done.
    pub(super) t: W::F,
    pub(super) u: W::F,
    pub(super) v: W::F,
    pub(super) instance: W::U,
    pub(super) triangle: W::U,
}

/// The instance being walked, and who may refuse its hits.
#[derive(Clone, Copy)]
pub(super) struct PacketTarget<'a> {
    pub(super) instance: u32,
    /// Number of lane 0 within the caller's packet.
    pub(super) first_lane: usize,
    pub(super) filter: Option<PacketFilter<'a>>,
    /// Any hit will do.
    pub(super) any: bool,
}

/// Carries the rays of `open` into the instance and walks its mesh. With `target.any`, lanes that hit
/// retire.
#[inline(always)]
pub(super) fn walk<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    columns: &Columns,
    rays: &Rays<S, W>,
    open: W::M,
    target: PacketTarget<'_>,
    found: &mut Found<S, W>,
) {
    if blas.cells.is_empty() {
        return;
    }
    let (space, active) = SpaceRays::<S, W>::enter(simd, blas, columns, rays, open);
    walk_entered(simd, blas, &space, active, target, found);
}

/// Walks a mesh with the active ones of rays in its space.
#[inline(always)]
pub(super) fn walk_entered<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    space: &SpaceRays<S, W>,
    active: W::M,
    target: PacketTarget<'_>,
    found: &mut Found<S, W>,
) {
    let lanes = active.to_bitmask();
    if lanes & lanes.wrapping_sub(1) == 0 {
        // None, or one: it needs no bundle.
        alone(simd, blas, space, 0, lanes, target, found);
        return;
    }
    let done = W::F::splat(simd, f32::NEG_INFINITY);
    let whole = found.t;
    found.t = active.select(whole, done);
    let zero = W::F::splat(simd, 0.0);
    let ways = [
        Way::of((space.inv[0].simd_lt(zero) & active).to_bitmask(), lanes),
        Way::of((space.inv[1].simd_lt(zero) & active).to_bitmask(), lanes),
        Way::of((space.inv[2].simd_lt(zero) & active).to_bitmask(), lanes),
    ];
    macro_rules! go {
        ($kind:ident, $bundle:ident) => {
            if target.any {
                sweep::<S, W, { $kind }>(simd, blas, space, &$bundle, ways, target, found);
            } else {
                descend::<S, W, { $kind }>(simd, blas, space, &$bundle, ways, target, found);
            }
        };
    }
    let both = ways.iter().filter(|&&way| way == Way::Both).count();
    if both == 0 {
        let bundle = Bundle::all(simd, from_ref(space), &[active], ways);
        go!(ALIKE, bundle);
    } else if both <= MOST_BOTH && !(space.t_min.simd_lt(zero) & active).any_true() {
        let bundle = Bundle::all(simd, from_ref(space), &[active], ways);
        go!(CLOSE, bundle);
    } else {
        let first = lanes.trailing_zeros() as usize;
        let bundle = Bundle::one(simd, space, first);
        go!(LOOSE, bundle);
    }
    found.t = active.select(found.t, whole);
}

/// All lanes run the same way along all axes.
pub(super) const ALIKE: u8 = 0;
/// Along most axes.
pub(super) const CLOSE: u8 = 1;
/// In all directions.
pub(super) const LOOSE: u8 = 2;

/// Axes along which lanes that are [`CLOSE`] may run both ways.
const MOST_BOTH: usize = 1;

/// Lanes that are too few to walk on together, by kind: each goes on alone.
pub(super) const FEW: [u32; 3] = [1, 1, 4];

/// Lanes that are tested against the triangles of a leaf at once: up to so many.
pub(super) const TOGETHER: u32 = 4;

/// Finds the nearest hits of rays of the given kind: children are tested, and enter the stack,
/// nearest first, and lanes are tested when a child's turn has come.
#[inline(always)]
fn descend<S: Simd, W: Width<S>, const KIND: u8>(
    simd: S,
    blas: &Blas,
    rays: &SpaceRays<S, W>,
    bundle: &Bundle<S>,
    ways: [Way; 3],
    target: PacketTarget<'_>,
    found: &mut Found<S, W>,
) {
    let cells: &[Cell] = &blas.cells;
    let boxes = Boxes::<S, W, KIND>::new(rays, ways);
    let Stack(stack) = &mut Stack::new();
    let mut height = 0;
    let mut index = 0_u32;
    let mut reach = found.t.reduce_max();
    loop {
        let node = cells::node(cells, index);
        let (near, mut bits) = if KIND == CLOSE {
            bundle.enter::<false>(simd, node, reach)
        } else {
            bundle.enter::<true>(simd, node, reach)
        };
        if KIND == LOOSE {
            bits = 0;
            for slot in (0..8).take_while(|&slot| node.children[slot] != NONE) {
                let (near, far) = boxes.cross(simd, node, slot);
                let hit = near.max(rays.t_min).simd_le(far.min(found.t));
                bits |= u64::from(hit.any_true()) << slot;
            }
        }
        height = push(simd, cells, index, near, bits, stack, height);
        loop {
            if height == 0 {
                return;
            }
            height -= 1;
            let entry = stack[height];
            if KIND != LOOSE && entry.near > reach {
                continue;
            }
            let parent = cells::node(cells, entry.child >> 3);
            let slot = (entry.child & 7) as usize;
            let (near, far) = boxes.cross(simd, parent, slot);
            let hit = near.max(rays.t_min).simd_le(far.min(found.t));
            let lanes = hit.to_bitmask();
            if lanes == 0 {
                continue;
            }
            let child = parent.children[slot];
            let few = lanes.count_ones();
            if child & LEAF != 0 {
                let block = cells::block(cells, child);
                if few <= TOGETHER {
                    leaf_by_ray(
                        simd,
                        block,
                        from_ref(rays),
                        &[near],
                        lanes,
                        target,
                        from_mut(found),
                    );
                } else {
                    leaf::<S, W>(
                        simd,
                        block,
                        cells::triangles(child),
                        rays,
                        near,
                        hit,
                        target,
                        found,
                    );
                }
            } else if few <= FEW[KIND as usize] {
                alone::<S, W>(simd, blas, rays, child, lanes, target, found);
            } else {
                index = child;
                break;
            }
            reach = found.t.reduce_max();
        }
    }
}

/// Puts the children in `bits` of the node at cell `index` onto the stack, nearest on top; returns its
/// new height.
#[inline(always)]
pub(super) fn push<S: Simd>(
    simd: S,
    cells: &[Cell],
    index: u32,
    near: f32x8<S>,
    mut bits: u64,
    stack: &mut [Waiting; STACK],
    mut height: usize,
) -> usize {
    let node = cells::node(cells, index);
    let near = near.to_array();
    let bottom = height;
    let waiting = |slot: usize| Waiting {
        near: near[slot & 7],
        child: index << 3 | (slot & 7) as u32,
    };
    // The first two, the nearer on top, without a branch to mispredict: most nodes have no more
    // and none is like the last. Where there is one, it is both; where none, nothing is kept.
    let rest = bits & bits.wrapping_sub(1);
    let first = bits.trailing_zeros() as usize & 7;
    let second = (rest | bits << 8).trailing_zeros() as usize & 7;
    prefetch_child(simd, cells, node.children[first]);
    prefetch_child(simd, cells, node.children[second]);
    let swap = usize::from(near[second] < near[first]).wrapping_neg();
    let change = (first ^ second) & swap;
    let two = usize::from(rest != 0);
    stack[height] = waiting(second ^ change);
    stack[height + two] = waiting(first ^ change);
    height += usize::from(bits != 0) + two;
    bits = rest & rest.wrapping_sub(1);
    while bits != 0 {
        let slot = bits.trailing_zeros() as usize & 7;
        bits &= bits - 1;
        let entry = waiting(slot);
        prefetch_child(simd, cells, node.children[slot]);
        // Insertion sort, nearest on top: two or three children are usual.
        let mut at = height;
        while at > bottom && stack[at - 1].near < entry.near {
            stack[at] = stack[at - 1];
            at -= 1;
        }
        stack[at] = entry;
        height += 1;
    }
    height
}

/// Lets each of some lanes walk below a child that is no leaf by itself.
#[inline(always)]
pub(super) fn alone<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    rays: &SpaceRays<S, W>,
    child: u32,
    mut lanes: u64,
    target: PacketTarget<'_>,
    found: &mut Found<S, W>,
) {
    while lanes != 0 {
        let lane = lanes.trailing_zeros() as usize;
        lanes &= lanes - 1;
        let mut best = if target.any {
            let t = found.t;
            Hit {
                t: t[lane],
                instance: NO_HIT,
                triangle: NO_HIT,
                u: 0.0,
                v: 0.0,
            }
        } else {
            Hit {
                t: found.t[lane],
                instance: found.instance[lane],
                triangle: found.triangle[lane],
                u: found.u[lane],
                v: found.v[lane],
            }
        };
        let ask = |hit: &Hit| {
            target
                .filter
                .is_none_or(|filter| filter(target.first_lane + lane, hit))
        };
        let filter: Option<HitFilter<'_>> = target.filter.is_some().then_some(&ask);
        let one = Target {
            instance: target.instance,
            filter,
            any: target.any,
        };
        if wide::walk(simd, blas, &rays.get(lane), child, one, &mut best) {
            if target.any {
                let only = W::M::from_bitmask(simd, 1 << lane);
                found.t = only.select(W::F::splat(simd, f32::NEG_INFINITY), found.t);
            } else {
                found.t[lane] = best.t;
                found.instance[lane] = best.instance;
                found.triangle[lane] = best.triangle;
                found.u[lane] = best.u;
                found.v[lane] = best.v;
            }
        }
    }
}
