//! Lanes of a packet that are traced one by one through the eight-wide BVH.

use fearless_simd::{Simd, prelude::*};

use super::hits::{PacketHits, PacketTarget};
use super::rays::SpaceRays;
use crate::accel::blas::Blas;
use crate::accel::ray::{Hit, HitFilter, NO_HIT};
use crate::accel::traverse::single::{self, Target};
use crate::simd::Width;

/// Traces each of the given lanes by itself through the subtree of a child that is not a leaf.
#[inline(always)]
pub(crate) fn walk_lanes<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    rays: &SpaceRays<S, W>,
    child: u32,
    mut lanes: u64,
    target: PacketTarget<'_>,
    found: &mut PacketHits<S, W>,
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
        if single::walk(simd, blas, &rays.get(lane), child, one, &mut best) {
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
