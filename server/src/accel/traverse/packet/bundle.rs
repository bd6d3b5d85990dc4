//! The rays of a packet as one bundle: an interval of origins and of reciprocal directions, tested against eight
//! boxes at once. Floating-point operations are monotone, so bounds of the operands of the lanes' slab test also
//! bound its result, including rounding: a child that is rejected here would be missed by every lane.

use fearless_simd::{Simd, f32x8, prelude::*, u32x8};

use super::coherence::DirectionSign;
use super::rays::SpaceRays;
use crate::accel::build::layout::{NONE, WideNode};
use crate::simd::Width;

/// Bounds of the active lanes' slabs. [`Bundle::one`] has the slabs of one lane, whose entries only determine the
/// order of children.
pub(crate) struct Bundle<S: Simd> {
    axes: [Axis<S>; 3],
    t_min: f32x8<S>,
}

/// Bounds along an axis.
///
/// If lanes have both signs along the axis, there is no bound on the exit from a box. But a box ahead of all origins
/// (at larger coordinates) is entered no earlier than by the fastest lane in the positive direction, and is behind
/// all lanes of the negative direction. The same holds with the signs swapped.
#[derive(Clone, Copy)]
struct Axis<S: Simd> {
    sign: DirectionSign,
    /// Origins for the near and the far side of boxes, chosen conservatively. With both signs: the largest origin for
    /// boxes ahead, the smallest for boxes behind.
    origin: [f32x8<S>; 2],
    /// Smallest and largest reciprocal direction. With both signs: the smallest positive one, and the negative one of
    /// the smallest size.
    inv: [f32x8<S>; 2],
}

impl<S: Simd> Bundle<S> {
    /// Bounds of all active lanes of some vectors. If lanes disagree in sign, none may have a negative `t_min`.
    #[inline(always)]
    pub(crate) fn all<W: Width<S>, const N: usize>(
        simd: S,
        rays: &[SpaceRays<S, W>; N],
        active: &[W::M; N],
        signs: [DirectionSign; 3],
    ) -> Self {
        // Macros instead of closures: closures would not be inlined, and would be compiled for the baseline
        // instruction set.
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
                let sign = signs[$axis];
                let (mut ahead, mut behind) = (*active, *active);
                if sign == DirectionSign::Both {
                    for n in 0..N {
                        let back = rays[n].inv[$axis].simd_lt(W::F::splat(simd, 0.0));
                        ahead[n] = active[n] & !back;
                        behind[n] = active[n] & back;
                    }
                }
                Axis {
                    sign,
                    origin: if sign == DirectionSign::Negative {
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

    /// Bounds of one lane.
    #[inline(always)]
    pub(crate) fn one<W: Width<S>>(simd: S, rays: &SpaceRays<S, W>, lane: usize) -> Self {
        macro_rules! axis {
            ($axis:literal) => {{
                let inv = rays.inv[$axis][lane];
                let low = f32x8::splat(simd, rays.low_origin[$axis][lane]);
                let high = f32x8::splat(simd, rays.high_origin[$axis][lane]);
                let (sign, origin) = if inv < 0.0 {
                    (DirectionSign::Negative, [high, low])
                } else {
                    (DirectionSign::Positive, [low, high])
                };
                Axis {
                    sign,
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

    /// Least entry into each child's box, and the children that a lane may enter if its nearest hit is at most at
    /// `reach`. `ONE_WAY`: all lanes agree in sign along all axes.
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
                let Axis { sign, origin, inv } = &self.axes[$axis];
                let side = usize::from(*sign == DirectionSign::Negative);
                let planes = &node.planes[$axis];
                let d = f32x8::load_array_ref(simd, &planes[side]) - origin[0];
                let e = f32x8::load_array_ref(simd, &planes[1 - side]) - origin[1];
                if !ONE_WAY && *sign == DirectionSign::Both {
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
            // The boxes of absent children are empty only for rays of one sign.
            let children = u32x8::load_array_ref(simd, &node.children);
            let there = children.simd_ne(u32x8::splat(simd, NONE));
            (near, bits & there.to_bitmask())
        }
    }
}
