//! The rays of a packet in camera space and in the space of a mesh; see [`crate::accel::space`] for one ray.

use fearless_simd::{Simd, prelude::*};
use glam::Vec3A;

use crate::accel::blas::Blas;
use crate::accel::space::{Columns, DIRECTION_RANGE, FLATTEST, PAD, Slabs, SpaceRay};
use crate::simd::Width;

/// Camera-space rays of a packet, cleaned.
#[derive(Clone, Copy)]
pub(crate) struct Rays<S: Simd, W: Width<S>> {
    pub(crate) origin: [W::F; 3],
    pub(crate) direction: [W::F; 3],
    pub(crate) t_min: W::F,
}

/// Rays in the space of a BVH; see [`SpaceRay`].
#[derive(Clone, Copy)]
pub(crate) struct SpaceRays<S: Simd, W: Width<S>> {
    pub(crate) inv: [W::F; 3],
    /// Origin plus padding, and origin minus padding.
    pub(crate) low_origin: [W::F; 3],
    pub(crate) high_origin: [W::F; 3],
    pub(crate) origin: [W::F; 3],
    /// Woop's shear, along the axes of the lane.
    pub(crate) shear: [W::F; 3],
    /// Lanes by the axis of their direction's largest component.
    pub(crate) along: [W::M; 3],
    pub(crate) t_min: W::F,
}

impl<S: Simd, W: Width<S>> SpaceRays<S, W> {
    /// One of the rays.
    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> SpaceRay {
        macro_rules! vector {
            ($v:ident) => {
                Vec3A::new(self.$v[0][lane], self.$v[1][lane], self.$v[2][lane])
            };
        }
        let inv = vector!(inv);
        let (low, high) = (vector!(low_origin), vector!(high_origin));
        let negative = inv.cmplt(Vec3A::ZERO);
        let [along_x, along_y, _] = self.along.map(|lanes| lanes.to_bitmask() >> lane & 1 != 0);
        let kz = if along_x {
            0
        } else if along_y {
            1
        } else {
            2
        };
        SpaceRay {
            slabs: Slabs {
                inv,
                near_origin: Vec3A::select(negative, high, low),
                far_origin: Vec3A::select(negative, low, high),
                negative,
                t_min: self.t_min[lane],
            },
            origin: vector!(origin).to_array(),
            axes: [(kz + 1) % 3, (kz + 2) % 3, kz],
            shear: vector!(shear).to_array(),
        }
    }

    /// Transforms rays to an instance's mesh space; also returns the lanes of `open` that can hit something there.
    #[inline(always)]
    pub(crate) fn enter(
        simd: S,
        blas: &Blas,
        columns: &Columns,
        rays: &Rays<S, W>,
        open: W::M,
    ) -> (Self, W::M) {
        let splat = |x: f32| W::F::splat(simd, x);
        let turn = |axis: usize, v: &[W::F; 3]| {
            (splat(columns[0][axis]) * v[0] + splat(columns[1][axis]) * v[1])
                + splat(columns[2][axis]) * v[2]
        };
        let shift = |axis: usize, v: &[W::F; 3]| {
            (splat(columns[0][axis]) * v[0] + splat(columns[1][axis]) * v[1])
                + (splat(columns[2][axis]) * v[2] + splat(columns[3][axis]))
        };
        let zero = splat(0.0);
        let origin = [
            shift(0, &rays.origin),
            shift(1, &rays.origin),
            shift(2, &rays.origin),
        ];
        let direction = [
            turn(0, &rays.direction) + zero,
            turn(1, &rays.direction) + zero,
            turn(2, &rays.direction) + zero,
        ];
        let active = open & usable::<S, W>(simd, &origin, &direction);
        let (inv, low_origin, high_origin) =
            padded::<S, W>(simd, origin, direction, PAD, blas.extent);

        let size = [direction[0].abs(), direction[1].abs(), direction[2].abs()];
        let along_x = size[0].simd_ge(size[1]) & size[0].simd_ge(size[2]);
        let along_y = !along_x & size[1].simd_ge(size[2]);
        // The component `n` axes after the largest one. Not a closure: it would not be inlined, and would be compiled
        // for the baseline instruction set.
        macro_rules! after {
            ($v:ident, $n:literal) => {
                along_x.select(
                    $v[$n % 3],
                    along_y.select($v[(1 + $n) % 3], $v[(2 + $n) % 3]),
                )
            };
        }
        let largest = after!(direction, 0);
        let space = Self {
            inv,
            low_origin,
            high_origin,
            origin,
            // The largest component is never replaced by [`FLATTEST`].
            shear: [
                after!(direction, 1) / largest,
                after!(direction, 2) / largest,
                after!(inv, 0),
            ],
            along: [along_x, along_y, !along_x & !along_y],
            t_min: rays.t_min,
        };
        (space, active)
    }
}

/// Reciprocal directions and padded origins; see [`crate::accel::space::Slabs::new`].
#[inline(always)]
#[allow(clippy::type_complexity, reason = "three groups of three lanes")]
pub(crate) fn padded<S: Simd, W: Width<S>>(
    simd: S,
    origin: [W::F; 3],
    direction: [W::F; 3],
    pad: f32,
    extent: f32,
) -> ([W::F; 3], [W::F; 3], [W::F; 3]) {
    let size = [direction[0].abs(), direction[1].abs(), direction[2].abs()];
    let flattest = size[0].max(size[1]).max(size[2]) * W::F::splat(simd, FLATTEST);
    let reach = origin[0].abs().max(origin[1].abs()).max(origin[2].abs());
    let pad = W::F::splat(simd, pad) * (reach + W::F::splat(simd, extent));
    let one = W::F::splat(simd, 1.0);
    // Cleaned directions hold no -0.0, so the sign is that of `< 0`.
    let inv = |axis: usize| one / size[axis].max(flattest).copysign(direction[axis]);
    (
        [inv(0), inv(1), inv(2)],
        [origin[0] + pad, origin[1] + pad, origin[2] + pad],
        [origin[0] - pad, origin[1] - pad, origin[2] - pad],
    )
}

/// Entry and exit of a box; see [`crate::accel::space::Slabs::cross`].
#[inline(always)]
pub(crate) fn slabs<S: Simd, W: Width<S>>(
    simd: S,
    low: &[f32; 3],
    high: &[f32; 3],
    low_origin: &[W::F; 3],
    high_origin: &[W::F; 3],
    inv: &[W::F; 3],
) -> (W::F, W::F) {
    let x = (W::F::splat(simd, low[0]) - low_origin[0]) * inv[0];
    let y = (W::F::splat(simd, low[1]) - low_origin[1]) * inv[1];
    let z = (W::F::splat(simd, low[2]) - low_origin[2]) * inv[2];
    let xx = (W::F::splat(simd, high[0]) - high_origin[0]) * inv[0];
    let yy = (W::F::splat(simd, high[1]) - high_origin[1]) * inv[1];
    let zz = (W::F::splat(simd, high[2]) - high_origin[2]) * inv[2];
    (
        x.min(xx).max(y.min(yy)).max(z.min(zz)),
        x.max(xx).min(y.max(yy)).min(z.max(zz)),
    )
}

/// Lanes whose ray can hit something; see [`crate::accel::space::Slabs::new`].
#[inline(always)]
pub(crate) fn usable<S: Simd, W: Width<S>>(
    simd: S,
    origin: &[W::F; 3],
    direction: &[W::F; 3],
) -> W::M {
    let largest = direction[0]
        .abs()
        .max(direction[1].abs())
        .max(direction[2].abs());
    largest.simd_ge(W::F::splat(simd, *DIRECTION_RANGE.start()))
        & largest.simd_le(W::F::splat(simd, *DIRECTION_RANGE.end()))
        & direction[0].is_finite()
        & direction[1].is_finite()
        & direction[2].is_finite()
        & origin[0].is_finite()
        & origin[1].is_finite()
        & origin[2].is_finite()
}
