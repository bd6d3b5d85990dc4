//! The rays of a packet as one: an interval of origins and of reciprocal directions, tested
//! against eight boxes at once. Floating-point operations are monotone, so what bounds the
//! operands in the lanes' own slab test bounds its result, roundings included: a child that is
//! ruled out here would be missed by every lane.

use fearless_simd::{Simd, f32x8, prelude::*, u32x8};

use super::coherence::Way;
use super::rays::SpaceRays;
use crate::accel::build::layout::{NONE, WideNode};
use crate::simd::Width;

/// Bounds of the active lanes' slabs. With [`Bundle::one`] those of one lane, whose entries tell
/// the order of children only.
pub(crate) struct Bundle<S: Simd> {
    axes: [Axis<S>; 3],
    t_min: f32x8<S>,
}

/// Bounds along an axis.
///
/// Where lanes run in both directions, no box is left at a bounded distance, but one that lies
/// ahead of all origins is entered no earlier than by the fastest lane that runs ahead, and lies
/// behind all others; so with one behind.
#[derive(Clone, Copy)]
struct Axis<S: Simd> {
    way: Way,
    /// Where the nearest side of boxes seems nearest from, and the farthest side farthest. With
    /// both ways: largest origin for boxes ahead, smallest for those behind.
    origin: [f32x8<S>; 2],
    /// Smallest and largest reciprocal direction; with both ways the smallest one ahead and the
    /// smallest in size behind.
    inv: [f32x8<S>; 2],
}

impl<S: Simd> Bundle<S> {
    /// Of all active lanes of some vectors. Where some go both ways, none may have a negative `t_min`.
    #[inline(always)]
    pub(crate) fn all<W: Width<S>, const N: usize>(
        simd: S,
        rays: &[SpaceRays<S, W>; N],
        active: &[W::M; N],
        ways: [Way; 3],
    ) -> Self {
        // Not closures: those would not be inlined, and lose the instruction set.
        macro_rules! least {
            (|$n:ident| $v:expr, $lanes:expr) => {{
                let none = W::F::splat(simd, f32::INFINITY);
                let mut all = none;
                for $n in 0..N {
                    all = all.min($lanes.select($v, none));
                }
                f32x8::splat(simd, all.reduce_min())
            }};
        }
        macro_rules! most {
            (|$n:ident| $v:expr, $lanes:expr) => {{
                let none = W::F::splat(simd, f32::NEG_INFINITY);
                let mut all = none;
                for $n in 0..N {
                    all = all.max($lanes.select($v, none));
                }
                f32x8::splat(simd, all.reduce_max())
            }};
        }
        macro_rules! axis {
            ($axis:literal) => {{
                let low = most!(|n| rays[n].low_origin[$axis], active[n]);
                let high = least!(|n| rays[n].high_origin[$axis], active[n]);
                let way = ways[$axis];
                let (mut ahead, mut behind) = (*active, *active);
                if way == Way::Both {
                    for n in 0..N {
                        let back = rays[n].inv[$axis].simd_lt(W::F::splat(simd, 0.0));
                        ahead[n] = active[n] & !back;
                        behind[n] = active[n] & back;
                    }
                }
                Axis {
                    way,
                    origin: if way == Way::Behind {
                        [high, low]
                    } else {
                        [low, high]
                    },
                    inv: [
                        least!(|n| rays[n].inv[$axis], ahead[n]),
                        most!(|n| rays[n].inv[$axis], behind[n]),
                    ],
                }
            }};
        }
        Self {
            axes: [axis!(0), axis!(1), axis!(2)],
            t_min: least!(|n| rays[n].t_min, active[n]),
        }
    }

    /// Of one lane.
    #[inline(always)]
    pub(crate) fn one<W: Width<S>>(simd: S, rays: &SpaceRays<S, W>, lane: usize) -> Self {
        macro_rules! axis {
            ($axis:literal) => {{
                let inv = rays.inv[$axis][lane];
                let low = f32x8::splat(simd, rays.low_origin[$axis][lane]);
                let high = f32x8::splat(simd, rays.high_origin[$axis][lane]);
                let (way, origin) = if inv < 0.0 {
                    (Way::Behind, [high, low])
                } else {
                    (Way::Ahead, [low, high])
                };
                Axis {
                    way,
                    origin,
                    inv: [f32x8::splat(simd, inv); 2],
                }
            }};
        }
        Self {
            axes: [axis!(0), axis!(1), axis!(2)],
            t_min: f32x8::splat(simd, rays.t_min[lane]),
        }
    }

    /// Least entry into each child's box, and the children that a lane whose nearest hit is no
    /// farther than `reach` may enter. `ONE_WAY`: along all axes.
    #[inline(always)]
    pub(crate) fn enter<const ONE_WAY: bool>(
        &self,
        simd: S,
        node: &WideNode,
        reach: f32,
    ) -> (f32x8<S>, u64) {
        let mut near = self.t_min;
        let mut far = f32x8::splat(simd, reach);
        macro_rules! cut {
            ($axis:literal) => {{
                let Axis { way, origin, inv } = &self.axes[$axis];
                let side = usize::from(*way == Way::Behind);
                let planes = &node.planes[$axis];
                let d = f32x8::load_array_ref(simd, &planes[side]) - origin[0];
                let e = f32x8::load_array_ref(simd, &planes[1 - side]) - origin[1];
                if !ONE_WAY && *way == Way::Both {
                    near = near.max((d * inv[0]).max(e * inv[1]));
                } else {
                    near = near.max((d * inv[0]).min(d * inv[1]));
                    far = far.min((e * inv[0]).max(e * inv[1]));
                }
            }};
        }
        cut!(0);
        cut!(1);
        cut!(2);
        let bits = near.simd_le(far).to_bitmask();
        if ONE_WAY {
            (near, bits)
        } else {
            // The boxes of absent children are empty only to those who go one way.
            let children = u32x8::load_array_ref(simd, &node.children);
            let there = children.simd_ne(u32x8::splat(simd, NONE));
            (near, bits & there.to_bitmask())
        }
    }
}
