//! Nearest hits of one vector of rays in one mesh.

use std::array::{from_mut, from_ref};

use fearless_simd::{Simd, prelude::*};

use super::bundle::Bundle;
use super::coherence::{DirectionSign, INCOHERENT, LEAF_BY_RAY, MIXED, TOO_FEW};
use super::hits::{PacketHits, PacketTarget};
use super::lanes::walk_lanes;
use super::leaf::{leaf, leaf_by_ray};
use super::rays::SpaceRays;
use super::slabs::PacketSlabs;
use super::stack::push;
use crate::accel::blas::Blas;
use crate::accel::build::layout::{self, Cell, LEAF, NONE};
use crate::accel::traverse::single::Stack;
use crate::simd::Width;

/// Finds the nearest hits of rays of the given kind. The children of a node are tested with the bundle and pushed,
/// nearest on top; the lanes are tested when a child is popped.
#[inline(always)]
pub(crate) fn descend<S: Simd, W: Width<S>, const KIND: u8>(
    simd: S,
    blas: &Blas,
    rays: &SpaceRays<S, W>,
    bundle: &Bundle<S>,
    signs: [DirectionSign; 3],
    target: PacketTarget<'_>,
    found: &mut PacketHits<S, W>,
) {
    let cells: &[Cell] = &blas.cells;
    let boxes = PacketSlabs::<S, W, KIND>::new(rays, signs);
    let Stack(stack) = &mut Stack::new();
    let mut height = 0;
    let mut index = 0_u32;
    let mut reach = found.t.reduce_max();
    loop {
        let node = layout::node(cells, index);
        let (near, mut bits) = if KIND == MIXED {
            bundle.enter::<false>(simd, node, reach)
        } else {
            bundle.enter::<true>(simd, node, reach)
        };
        if KIND == INCOHERENT {
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
            if KIND != INCOHERENT && entry.near > reach {
                continue;
            }
            let parent = layout::node(cells, entry.child >> 3);
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
                let block = layout::block(cells, child);
                if few <= LEAF_BY_RAY {
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
                        layout::triangles(child),
                        rays,
                        near,
                        hit,
                        target,
                        found,
                    );
                }
            } else if few <= TOO_FEW[KIND as usize] {
                walk_lanes::<S, W>(simd, blas, rays, child, lanes, target, found);
            } else {
                index = child;
                break;
            }
            reach = found.t.reduce_max();
        }
    }
}
