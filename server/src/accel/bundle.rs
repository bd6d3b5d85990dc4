//! The rays of a packet as one: an interval of origins and of reciprocal directions, tested
//! against eight boxes at once. Floating-point operations are monotone, so what bounds the
//! operands in the lanes' own slab test bounds its result, roundings included: a child that is
//! ruled out here would be missed by every lane.

use fearless_simd::{Simd, f32x8, prelude::*};

use super::blas::WideNode;
use super::packet::{SpaceRays, Width};

/// Bounds of the active lanes' slabs. Without [`Bundle::alike`] those of one lane, whose entries
/// tell the order of children only.
pub(super) struct Bundle<S: Simd> {
    /// Origins that make the near planes' distance smallest, and the far planes' largest.
    near_origin: [f32x8<S>; 3],
    far_origin: [f32x8<S>; 3],
    /// Smallest and largest reciprocal direction.
    inv: [[f32x8<S>; 2]; 3],
    t_min: f32x8<S>,
    /// Whether each axis is run towards smaller coordinates.
    pub(super) negative: [bool; 3],
}

impl<S: Simd> Bundle<S> {
    /// Of lanes that agree in their directions' signs, which are given.
    #[inline(always)]
    pub(super) fn alike<W: Width<S>>(
        simd: S,
        rays: &SpaceRays<S, W>,
        active: W::M,
        negative: [bool; 3],
    ) -> Self {
        // Not closures: those would not be inlined, and lose the instruction set.
        macro_rules! least {
            ($v:expr) => {
                active
                    .select($v, W::F::splat(simd, f32::INFINITY))
                    .reduce_min()
            };
        }
        macro_rules! most {
            ($v:expr) => {
                active
                    .select($v, W::F::splat(simd, f32::NEG_INFINITY))
                    .reduce_max()
            };
        }
        macro_rules! axis {
            ($axis:literal) => {{
                let inv = [
                    f32x8::splat(simd, least!(rays.inv[$axis])),
                    f32x8::splat(simd, most!(rays.inv[$axis])),
                ];
                let low = f32x8::splat(simd, most!(rays.low_origin[$axis]));
                let high = f32x8::splat(simd, least!(rays.high_origin[$axis]));
                let (near, far) = if negative[$axis] {
                    (high, low)
                } else {
                    (low, high)
                };
                (near, far, inv)
            }};
        }
        let (x, y, z) = (axis!(0), axis!(1), axis!(2));
        Self {
            near_origin: [x.0, y.0, z.0],
            far_origin: [x.1, y.1, z.1],
            inv: [x.2, y.2, z.2],
            t_min: f32x8::splat(simd, least!(rays.t_min)),
            negative,
        }
    }

    /// Of one lane.
    #[inline(always)]
    pub(super) fn one<W: Width<S>>(simd: S, rays: &SpaceRays<S, W>, lane: usize) -> Self {
        macro_rules! axis {
            ($axis:literal) => {{
                let inv = rays.inv[$axis][lane];
                let low = f32x8::splat(simd, rays.low_origin[$axis][lane]);
                let high = f32x8::splat(simd, rays.high_origin[$axis][lane]);
                let negative = inv < 0.0;
                let (near, far) = if negative { (high, low) } else { (low, high) };
                (near, far, [f32x8::splat(simd, inv); 2], negative)
            }};
        }
        let (x, y, z) = (axis!(0), axis!(1), axis!(2));
        Self {
            near_origin: [x.0, y.0, z.0],
            far_origin: [x.1, y.1, z.1],
            inv: [x.2, y.2, z.2],
            t_min: f32x8::splat(simd, rays.t_min[lane]),
            negative: [x.3, y.3, z.3],
        }
    }

    /// Least entry into each child's box, and the children that a lane whose nearest hit is no
    /// farther than `reach` may enter.
    #[inline(always)]
    pub(super) fn enter(&self, simd: S, node: &WideNode, reach: f32) -> (f32x8<S>, u64) {
        macro_rules! bound {
            ($axis:literal, $far:literal, $origin:ident, $least:ident) => {{
                let side = usize::from(self.negative[$axis] != $far);
                let plane = f32x8::load_array_ref(simd, &node.planes[$axis][side]);
                let d = plane - self.$origin[$axis];
                (d * self.inv[$axis][0]).$least(d * self.inv[$axis][1])
            }};
        }
        let near = bound!(0, false, near_origin, min)
            .max(bound!(1, false, near_origin, min))
            .max(bound!(2, false, near_origin, min));
        let far = bound!(0, true, far_origin, max)
            .min(bound!(1, true, far_origin, max))
            .min(bound!(2, true, far_origin, max));
        let bits = near
            .max(self.t_min)
            .simd_le(far.min(f32x8::splat(simd, reach)))
            .to_bitmask();
        (near, bits)
    }
}
