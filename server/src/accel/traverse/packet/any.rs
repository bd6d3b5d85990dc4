//! Sixteen rays against one mesh, when any hit will do. Without an order to keep, all lanes are
//! tested at once where a node is visited, and what no lane enters is not even stored: hardly a branch is
//! left that the processor cannot guess.

use std::array::{from_mut, from_ref};

use fearless_simd::{Simd, prelude::*, u32x8};

use super::alone::alone;
use super::bundle::Bundle;
use super::coherence::{CLOSE, FEW, LOOSE, TOGETHER, Way};
use super::hits::{Found, PacketTarget};
use super::leaf::{leaf, leaf_by_ray};
use super::rays::SpaceRays;
use super::slabs::Boxes;
use crate::accel::blas::Blas;
use crate::accel::build::layout::{self, Cell, LEAF, NONE, STACK};
use crate::accel::traverse::single::prefetch_child;
use crate::simd::Width;

/// A child, and the lanes that enter it.
#[derive(Clone, Copy, Default)]
struct Entered {
    child: u32,
    lanes: u32,
}

/// Finds out which lanes of the given kind hit anything.
#[inline(always)]
pub(crate) fn sweep<S: Simd, W: Width<S>, const KIND: u8>(
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
    let done = W::F::splat(simd, f32::NEG_INFINITY);
    let reach = found.t.reduce_max();
    let mut stack = [Entered::default(); STACK];
    let mut height = 0;
    // The leaves of a node that lanes enter, and where.
    let mut leaves = [Entered::default(); 8];
    let mut nears = [done; 8];
    let mut index = 0_u32;
    loop {
        let node = layout::node(cells, index);
        let children = u32x8::load_array_ref(simd, &node.children);
        let bits = if KIND == LOOSE {
            children.simd_ne(u32x8::splat(simd, NONE)).to_bitmask()
        } else if KIND == CLOSE {
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
                (Entered { child, lanes }, near)
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
        // The smallest comes last.
        while count != 0 {
            count -= 1;
            let Entered { child, lanes } = leaves[count & 7];
            let near = nears[count & 7];
            let block = layout::block(cells, child);
            if lanes.count_ones() <= TOGETHER {
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
            let Entered { child, lanes } = stack[height];
            let lanes = lanes & open;
            let few = lanes.count_ones();
            if few > FEW[KIND as usize] {
                index = child;
                break;
            }
            if few != 0 {
                alone::<S, W>(simd, blas, rays, child, lanes.into(), target, found);
                open = found.t.simd_gt(done).to_bitmask() as u32;
            }
        }
    }
}
