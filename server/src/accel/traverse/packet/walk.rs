//! Sixteen rays against one mesh: each box and each triangle is tested against all rays at once,
//! as long as enough of them come near it. Lanes that are done have `t = -inf`, which no box is nearer than.

use std::array::from_ref;

use fearless_simd::{Simd, prelude::*};

use super::alone::alone;
use super::any::sweep;
use super::bundle::Bundle;
use super::coherence::{ALIKE, CLOSE, LOOSE, MOST_BOTH, Way};
use super::hits::{Found, PacketTarget};
use super::nearest::descend;
use super::rays::{Rays, SpaceRays};
use crate::accel::blas::Blas;
use crate::accel::space::Columns;
use crate::simd::Width;

/// Carries the rays of `open` into the instance and walks its mesh. With `target.any`, lanes that hit
/// retire.
#[inline(always)]
pub(crate) fn walk<S: Simd, W: Width<S>>(
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
pub(crate) fn walk_entered<S: Simd, W: Width<S>>(
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
