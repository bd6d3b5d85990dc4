//! Sixteen rays through one mesh: each box and each triangle is tested against all rays at once, as long as enough
//! rays are active there. Finished lanes have `t = -inf`, so they enter no box.

use std::array::from_ref;

use fearless_simd::{Simd, prelude::*};

use super::any::sweep;
use super::bundle::Bundle;
use super::coherence::{COHERENT, DirectionSign, INCOHERENT, MIXED, MOST_MIXED_AXES};
use super::hits::{PacketHits, PacketTarget};
use super::lanes::walk_lanes;
use super::nearest::descend;
use super::rays::{Rays, SpaceRays};
use crate::accel::blas::Blas;
use crate::accel::space::Columns;
use crate::simd::Width;

/// Transforms the rays of `open` to the instance's space and traverses its mesh. With `target.any`, lanes that hit
/// are finished.
#[inline(always)]
pub(crate) fn walk<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    columns: &Columns,
    rays: &Rays<S, W>,
    open: W::M,
    target: PacketTarget<'_>,
    found: &mut PacketHits<S, W>,
) {
    if blas.cells.is_empty() {
        return;
    }
    let (space, active) = SpaceRays::<S, W>::enter(simd, blas, columns, rays, open);
    walk_entered(simd, blas, &space, active, target, found);
}

/// Traverses a mesh with the active rays, which are in its space.
#[inline(always)]
pub(crate) fn walk_entered<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    space: &SpaceRays<S, W>,
    active: W::M,
    target: PacketTarget<'_>,
    found: &mut PacketHits<S, W>,
) {
    let lanes = active.to_bitmask();
    if lanes & lanes.wrapping_sub(1) == 0 {
        // At most one lane, which needs no bundle.
        walk_lanes(simd, blas, space, 0, lanes, target, found);
        return;
    }
    let done = W::F::splat(simd, f32::NEG_INFINITY);
    let whole = found.t;
    found.t = active.select(whole, done);
    let zero = W::F::splat(simd, 0.0);
    let signs = [
        DirectionSign::of((space.inv[0].simd_lt(zero) & active).to_bitmask(), lanes),
        DirectionSign::of((space.inv[1].simd_lt(zero) & active).to_bitmask(), lanes),
        DirectionSign::of((space.inv[2].simd_lt(zero) & active).to_bitmask(), lanes),
    ];
    macro_rules! go {
        ($kind:ident, $bundle:ident) => {
            if target.any {
                sweep::<S, W, { $kind }>(simd, blas, space, &$bundle, signs, target, found);
            } else {
                descend::<S, W, { $kind }>(simd, blas, space, &$bundle, signs, target, found);
            }
        };
    }
    let both = signs
        .iter()
        .filter(|&&sign| sign == DirectionSign::Both)
        .count();
    if both == 0 {
        let bundle = Bundle::all(simd, from_ref(space), &[active], signs);
        go!(COHERENT, bundle);
    } else if both <= MOST_MIXED_AXES && !(space.t_min.simd_lt(zero) & active).any_true() {
        let bundle = Bundle::all(simd, from_ref(space), &[active], signs);
        go!(MIXED, bundle);
    } else {
        let first = lanes.trailing_zeros() as usize;
        let bundle = Bundle::one(simd, space, first);
        go!(INCOHERENT, bundle);
    }
    found.t = active.select(found.t, whole);
}
