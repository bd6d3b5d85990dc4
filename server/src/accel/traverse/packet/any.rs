//! Any-hit traversal of sixteen rays through one mesh. No order has to be kept, so all lanes are tested when a node
//! is visited, and children that no lane enters are not pushed. Few unpredictable branches remain.

use std::array::{from_mut, from_ref};

use fearless_simd::{Simd, prelude::*, u32x8};

use super::bundle::Bundle;
use super::coherence::{DirectionSign, INCOHERENT, LEAF_BY_RAY, MIXED, TOO_FEW};
use super::hits::{PacketHits, PacketTarget};
use super::lanes::walk_lanes;
use super::leaf::{leaf, leaf_by_ray};
use super::rays::SpaceRays;
use super::slabs::PacketSlabs;
use crate::accel::blas::Blas;
use crate::accel::build::layout::{self, Cell, LEAF, NONE, STACK};
use crate::accel::traverse::single::prefetch_child;
use crate::simd::Width;

/// A child, and the lanes that enter it.
#[derive(Clone, Copy, Default)]
struct LaneEntry {
    child: u32,
    lanes: u32,
}

/// Finds the lanes of the given kind that hit anything.
#[inline(always)]
pub(crate) fn sweep<S: Simd, W: Width<S>, const KIND: u8>(
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
    let done = W::F::splat(simd, f32::NEG_INFINITY);
    let reach = found.t.reduce_max();
    let mut stack = [LaneEntry::default(); STACK];
    let mut height = 0;
    // The leaves of the node that lanes enter; `nears` holds the entries.
    let mut leaves = [LaneEntry::default(); 8];
    let mut nears = [done; 8];
    let mut index = 0_u32;
    loop {
        let node = layout::node(cells, index);
        let children = u32x8::load_array_ref(simd, &node.children);
        let bits = if KIND == INCOHERENT {
            children.simd_ne(u32x8::splat(simd, NONE)).to_bitmask()
        } else if KIND == MIXED {
            bundle.enter::<false>(simd, node, reach).1
        } else {
            bundle.enter::<true>(simd, node, reach).1
        };
        macro_rules! enter {
            ($slot:ident) => {{
                let child = node.children[$slot];
                prefetch_child(simd, cells, child);
                let (near, far) = boxes.cross(simd, node, $slot);
                let lanes = near.max(rays.t_min).simd_le(far.min(found.t));
                let lanes = lanes.to_bitmask() as u32;
                (LaneEntry { child, lanes }, near)
            }};
        }
        let are_leaves = children.simd_ge(u32x8::splat(simd, LEAF)).to_bitmask();
        let mut count = 0;
        let mut todo = bits & are_leaves;
        while todo != 0 {
            let slot = todo.trailing_zeros() as usize & 7;
            todo &= todo - 1;
            let (entered, near) = enter!(slot);
            leaves[count & 7] = entered;
            nears[count & 7] = near;
            count += usize::from(entered.lanes != 0);
        }
        // The nearest leaf is taken last.
        while count != 0 {
            count -= 1;
            let LaneEntry { child, lanes } = leaves[count & 7];
            let near = nears[count & 7];
            let block = layout::block(cells, child);
            if lanes.count_ones() <= LEAF_BY_RAY {
                leaf_by_ray(
                    simd,
                    block,
                    from_ref(rays),
                    &[near],
                    lanes.into(),
                    target,
                    from_mut(found),
                );
            } else {
                let count = layout::triangles(child);
                let lanes = W::M::from_bitmask(simd, lanes.into());
                leaf::<S, W>(simd, block, count, rays, near, lanes, target, found);
            }
        }
        let mut todo = bits & !are_leaves;
        while todo != 0 {
            let slot = todo.trailing_zeros() as usize & 7;
            todo &= todo - 1;
            let (entered, _) = enter!(slot);
            stack[height] = entered;
            height += usize::from(entered.lanes != 0);
        }
        let mut open = found.t.simd_gt(done).to_bitmask() as u32;
        loop {
            if height == 0 || open == 0 {
                return;
            }
            height -= 1;
            let LaneEntry { child, lanes } = stack[height];
            let lanes = lanes & open;
            let few = lanes.count_ones();
            if few > TOO_FEW[KIND as usize] {
                index = child;
                break;
            }
            if few != 0 {
                walk_lanes::<S, W>(simd, blas, rays, child, lanes.into(), target, found);
                open = found.t.simd_gt(done).to_bitmask() as u32;
            }
        }
    }
}
