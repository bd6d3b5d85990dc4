//! Several vectors of rays traced through one mesh as one bundle: the cost of a node is shared by all of them, and
//! the few lanes of each vector that reach a leaf are tested together.

use fearless_simd::{Simd, prelude::*};

use super::bundle::Bundle;
use super::coherence::{COHERENT, DirectionSign, LEAF_BY_RAY};
use super::hits::{PacketHits, PacketTarget};
use super::lanes::walk_lanes;
use super::leaf::{leaf, leaf_by_ray};
use super::rays::{Rays, SpaceRays};
use super::slabs::PacketSlabs;
use super::stack::push;
use super::walk::walk_entered;
use crate::accel::blas::Blas;
use crate::accel::build::layout::{self, Cell, LEAF};
use crate::accel::space::Columns;
use crate::accel::traverse::single::Stack;
use crate::simd::Width;

/// Vectors in a group.
pub(crate) const GROUP: usize = 4;

/// A leaf that more lanes of a group enter is tested vector by vector.
const LEAF_BY_RAY_OF_GROUP: u32 = GROUP as u32 * LEAF_BY_RAY;

/// One value per vector of a group.
type Group<T> = [T; GROUP];

/// Transforms the rays of `open` to the instance's space and finds their nearest hits. Vectors whose lanes disagree
/// in sign along some axis are traced one after the other.
#[inline(always)]
pub(crate) fn walk<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    columns: &Columns,
    rays: &Group<Rays<S, W>>,
    open: &Group<W::M>,
    target: PacketTarget<'_>,
    found: &mut Group<PacketHits<S, W>>,
) {
    if blas.cells.is_empty() {
        return;
    }
    let zero = W::F::splat(simd, 0.0);
    let (space, active) = SpaceRays::<S, W>::enter(simd, blas, columns, &rays[0], open[0]);
    let mut spaces = [space; GROUP];
    let mut actives = [active; GROUP];
    for n in 1..GROUP {
        (spaces[n], actives[n]) = SpaceRays::<S, W>::enter(simd, blas, columns, &rays[n], open[n]);
    }
    let mut lanes = 0;
    let mut negative = [0; 3];
    for n in 0..GROUP {
        let at = n * W::F::LEN;
        lanes |= actives[n].to_bitmask() << at;
        for (negative, inv) in negative.iter_mut().zip(&spaces[n].inv) {
            let back = inv.simd_lt(zero) & actives[n];
            *negative |= back.to_bitmask() << at;
        }
    }
    if lanes == 0 {
        return;
    }
    let signs = [
        DirectionSign::of(negative[0], lanes),
        DirectionSign::of(negative[1], lanes),
        DirectionSign::of(negative[2], lanes),
    ];
    if signs.contains(&DirectionSign::Both) {
        for n in 0..GROUP {
            let target = PacketTarget {
                first_lane: target.first_lane + n * W::F::LEN,
                ..target
            };
            walk_entered(simd, blas, &spaces[n], actives[n], target, &mut found[n]);
        }
        return;
    }
    let mut whole = [zero; GROUP];
    for n in 0..GROUP {
        whole[n] = found[n].t;
        found[n].t = actives[n].select(whole[n], W::F::splat(simd, f32::NEG_INFINITY));
    }
    let bundle = Bundle::all(simd, &spaces, &actives, signs);
    descend(simd, blas, &spaces, &bundle, signs, target, found);
    for n in 0..GROUP {
        found[n].t = actives[n].select(found[n].t, whole[n]);
    }
}

/// As [`super::nearest::descend`], for several vectors.
#[inline(always)]
fn descend<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    rays: &Group<SpaceRays<S, W>>,
    bundle: &Bundle<S>,
    signs: [DirectionSign; 3],
    target: PacketTarget<'_>,
    found: &mut Group<PacketHits<S, W>>,
) {
    let cells: &[Cell] = &blas.cells;
    let boxes = PacketSlabs::<S, W, COHERENT>::new(&rays[0], signs);
    let mut boxes = [boxes; GROUP];
    for n in 1..GROUP {
        boxes[n] = PacketSlabs::new(&rays[n], signs);
    }
    let Stack(stack) = &mut Stack::new();
    let mut height = 0;
    let mut index = 0_u32;
    let mut reach = farthest(found);
    loop {
        let node = layout::node(cells, index);
        let (near, bits) = bundle.enter::<true>(simd, node, reach);
        height = push(simd, cells, index, near, bits, stack, height);
        loop {
            if height == 0 {
                return;
            }
            height -= 1;
            let entry = stack[height];
            if entry.near > reach {
                continue;
            }
            let parent = layout::node(cells, entry.child >> 3);
            let slot = (entry.child & 7) as usize;
            let child = parent.children[slot];
            let mut nears = [W::F::splat(simd, 0.0); GROUP];
            let mut lanes = 0;
            for n in 0..GROUP {
                let (near, far) = boxes[n].cross(simd, parent, slot);
                let hit = near.max(rays[n].t_min).simd_le(far.min(found[n].t));
                nears[n] = near;
                lanes |= hit.to_bitmask() << (n * W::F::LEN);
            }
            if lanes == 0 {
                continue;
            }
            let few = lanes.count_ones();
            if child & LEAF != 0 {
                let block = layout::block(cells, child);
                if few <= LEAF_BY_RAY_OF_GROUP {
                    leaf_by_ray(simd, block, rays, &nears, lanes, target, found);
                } else {
                    for n in 0..GROUP {
                        let at = n * W::F::LEN;
                        let mine = lanes >> at & (u64::MAX >> (64 - W::F::LEN));
                        if mine == 0 {
                            continue;
                        }
                        leaf::<S, W>(
                            simd,
                            block,
                            layout::triangles(child),
                            &rays[n],
                            nears[n],
                            W::M::from_bitmask(simd, mine),
                            PacketTarget {
                                first_lane: target.first_lane + at,
                                ..target
                            },
                            &mut found[n],
                        );
                    }
                }
            } else if few == 1 {
                let lane = lanes.trailing_zeros() as usize;
                let n = lane / W::F::LEN;
                let target = PacketTarget {
                    first_lane: target.first_lane + n * W::F::LEN,
                    ..target
                };
                let lanes = 1 << (lane % W::F::LEN);
                walk_lanes(simd, blas, &rays[n], child, lanes, target, &mut found[n]);
            } else {
                index = child;
                break;
            }
            reach = farthest(found);
        }
    }
}

/// Largest `t` at which a lane still accepts a hit.
#[inline(always)]
fn farthest<S: Simd, W: Width<S>>(found: &Group<PacketHits<S, W>>) -> f32 {
    let mut all = found[0].t;
    for one in &found[1..] {
        all = all.max(one.t);
    }
    all.reduce_max()
}
