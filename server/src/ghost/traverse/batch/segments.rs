//! Converts a group of rays to segments, clipped sixteen at a time.
//!
//! The operations and their order are those of [`Frustum::clip`], so every lane gets the same bits.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x4, f32x16, f64x8, mask64x8};
use glam::Vec3A;

use crate::accel::Ray;
use crate::ghost::traverse::segment::{End, Frustum, Segment, Z_NEAR};

/// Rays of a group: few enough that their segments stay in the second-level cache, and enough that the idle lanes
/// at the end of a group hardly count.
pub(crate) const GROUP: usize = 1024;

/// Rays clipped together.
pub(crate) const LANES: usize = 16;

/// Cells tested together.
pub(crate) const CELLS: usize = 8;

/// Sets of lanes that take turns, so that a memory load of one overlaps the work of the others.
pub(crate) const SETS: usize = 2;

/// Segments of a group as a structure of arrays; see [`Segment`]. Entries of rays that clipping removed are
/// undefined.
#[derive(Debug)]
pub(crate) struct Group {
    pub(crate) u: [f64; GROUP],
    pub(crate) v: [f64; GROUP],
    pub(crate) w: [f64; GROUP],
    pub(crate) a: [f64; GROUP],
    pub(crate) du: [f64; GROUP],
    pub(crate) dv: [f64; GROUP],
    pub(crate) dw: [f64; GROUP],
    pub(crate) da: [f64; GROUP],
    pub(crate) inv_du: [f64; GROUP],
    pub(crate) inv_dv: [f64; GROUP],
    pub(crate) w_max: [f64; GROUP],
    t_min: [f32; GROUP],
    t_max: [f32; GROUP],
    /// Bits for each sixteen rays: the ray is invalid.
    pub(crate) invalid: [u16; GROUP / LANES],
    /// A part of the ray is inside the image.
    pub(crate) inside: [u16; GROUP / LANES],
    /// The ray ends inside the image; see [`End`].
    pub(crate) ends_inside: [u16; GROUP / LANES],
}

impl Group {
    pub(crate) const EMPTY: Self = Self {
        u: [0.0; GROUP],
        v: [0.0; GROUP],
        w: [0.0; GROUP],
        a: [0.0; GROUP],
        du: [0.0; GROUP],
        dv: [0.0; GROUP],
        dw: [0.0; GROUP],
        da: [0.0; GROUP],
        inv_du: [0.0; GROUP],
        inv_dv: [0.0; GROUP],
        w_max: [0.0; GROUP],
        t_min: [0.0; GROUP],
        t_max: [0.0; GROUP],
        invalid: [0; GROUP / LANES],
        inside: [0; GROUP / LANES],
        ends_inside: [0; GROUP / LANES],
    };

    /// The segment of a ray that is inside.
    #[inline(always)]
    pub(crate) fn segment(&self, k: usize) -> Segment {
        let ends_inside = self.ends_inside[k / LANES] >> (k % LANES) & 1 != 0;
        Segment {
            u: self.u[k],
            v: self.v[k],
            w: self.w[k],
            a: self.a[k],
            du: self.du[k],
            dv: self.dv[k],
            dw: self.dw[k],
            da: self.da[k],
            inv_du: self.inv_du[k],
            inv_dv: self.inv_dv[k],
            w_max: self.w_max[k],
            t_min: f64::from(self.t_min[k]),
            t_max: f64::from(self.t_max[k]),
            end: if ends_inside {
                End::Inside
            } else {
                End::Border
            },
        }
    }

    /// Ray parameters and pixel positions of sixteen segments' hits at segment parameters s. The operations are
    /// those of [`crate::ghost::GhostSurface::outcome`].
    #[inline(always)]
    pub(crate) fn hits<S: Simd>(&self, simd: S, block: usize, s: &[f64; GROUP]) -> [f32x16<S>; 3] {
        let at = block * LANES;
        let first = f32x16::from_slice(simd, &self.t_min[at..at + LANES]).widen();
        let last = f32x16::from_slice(simd, &self.t_max[at..at + LANES]).widen();
        let low = self.hits_half(simd, at, s, first.0, last.0);
        let high = self.hits_half(simd, at + 8, s, first.1, last.1);
        [
            // Adding 0.0 turns -0.0 into +0.0.
            low[0].narrow(high[0]) + 0.0,
            low[1].narrow(high[1]),
            low[2].narrow(high[2]),
        ]
    }

    /// Eight of [`Self::hits`], before they are rounded to f32.
    #[inline(always)]
    fn hits_half<S: Simd>(
        &self,
        simd: S,
        at: usize,
        s: &[f64; GROUP],
        t_min: f64x8<S>,
        t_max: f64x8<S>,
    ) -> [f64x8<S>; 3] {
        let s = f64x8_at(simd, s, at);
        let a = f64x8_at(simd, &self.a, at) + s * f64x8_at(simd, &self.da, at);
        let w = f64x8_at(simd, &self.w, at) + s * f64x8_at(simd, &self.dw, at);
        [
            (a / w).max(t_min).min(t_max).min(f64::from(f32::MAX)),
            f64x8_at(simd, &self.u, at) + s * f64x8_at(simd, &self.du, at),
            f64x8_at(simd, &self.v, at) + s * f64x8_at(simd, &self.dv, at),
        ]
    }

    /// Clips up to sixteen rays into the entries from `16 block` on.
    #[inline(always)]
    pub(crate) fn clip<S: Simd>(&mut self, simd: S, frustum: &Frustum, rays: &[Ray], block: usize) {
        const NO_RAY: Ray = Ray {
            origin: Vec3A::ZERO,
            direction: Vec3A::ZERO,
            t_min: 0.0,
            t_max: 0.0,
        };
        let mut padded = [NO_RAY; LANES];
        let rays = <&[Ray; LANES]>::try_from(rays).unwrap_or_else(|_| {
            padded.iter_mut().zip(rays).for_each(|(to, ray)| *to = *ray);
            &padded
        });
        let [ox, oy, oz, _] = fields(simd, rays, |ray| ray.origin.extend(0.0).to_array());
        let [dx, dy, dz, _] = fields(simd, rays, |ray| ray.direction.extend(0.0).to_array());
        let [t_min, t_max, ..] = fields(simd, rays, |ray| [ray.t_min, ray.t_max, 0.0, 0.0]);
        t_min.store_slice(&mut self.t_min[block * LANES..][..LANES]);
        t_max.store_slice(&mut self.t_max[block * LANES..][..LANES]);
        let (ox, oy, oz) = (ox.widen(), oy.widen(), oz.widen());
        let (dx, dy, dz) = (dx.widen(), dy.widen(), dz.widen());
        let (t_min, t_max) = (t_min.widen(), t_max.widen());
        let low = [ox.0, oy.0, oz.0, dx.0, dy.0, dz.0, t_min.0, t_max.0];
        let high = [ox.1, oy.1, oz.1, dx.1, dy.1, dz.1, t_min.1, t_max.1];
        let low = self.clip_half(simd, frustum, low, block * LANES);
        let high = self.clip_half(simd, frustum, high, block * LANES + 8);
        // Lanes without a ray are invalid: their direction is zero.
        let bits = |k: usize| low[k].to_bitmask() as u16 | (high[k].to_bitmask() as u16) << 8;
        self.invalid[block] = bits(0);
        self.inside[block] = bits(1);
        self.ends_inside[block] = bits(2);
    }

    /// Clips eight rays into the entries from `at` on. Returns which are invalid, which have a part inside, and
    /// which end inside.
    #[inline(always)]
    fn clip_half<S: Simd>(
        &mut self,
        simd: S,
        frustum: &Frustum,
        [ox, oy, oz, dx, dy, dz, t_min, t_max]: [f64x8<S>; 8],
        at: usize,
    ) -> [mask64x8<S>; 3] {
        let splat = |x: f64| f64x8::splat(simd, x);
        let (zero, one, infinity) = (splat(0.0), splat(1.0), splat(f64::INFINITY));
        let Frustum {
            fx,
            fy,
            cx,
            cy,
            u_max,
            v_max,
        } = *frustum;
        let invalid = !((ox + oy + oz + dx + dy + dz + t_min)
            .abs()
            .simd_lt(infinity)
            & (!dx.simd_eq(zero) | !dy.simd_eq(zero) | !dz.simd_eq(zero))
            & t_min.simd_le(t_max));
        let (right, bottom) = (u_max - cx, v_max - cy);
        let planes = [
            (ox * fx + oz * cx, dx * fx + dz * cx),
            (oz * right - ox * fx, dz * right - dx * fx),
            (oy * fy + oz * cy, dy * fy + dz * cy),
            (oz * bottom - oy * fy, dz * bottom - dy * fy),
            (oz - Z_NEAR, dz),
        ];
        let (mut enter, mut enter_by) = (t_min, one);
        let (mut exit, mut exit_by) = (t_max, one);
        let mut outside = invalid;
        let mut ends_inside = mask64x8::splat(simd, true);
        for (o, d) in planes {
            let later = d.simd_gt(zero) & (-o * enter_by).simd_gt(enter * d);
            enter = later.select(-o, enter);
            enter_by = later.select(d, enter_by);
            let earlier = d.simd_lt(zero) & (o * exit_by).simd_lt(exit * -d);
            exit = earlier.select(o, exit);
            exit_by = earlier.select(-d, exit_by);
            ends_inside &= !earlier;
            outside |= d.simd_eq(zero) & o.simd_lt(zero);
        }
        let (enter, exit) = (enter / enter_by, exit / exit_by);
        outside |= enter.simd_gt(exit);
        let z0 = (oz + enter * dz).max(splat(Z_NEAR));
        let w0 = one / z0;
        let u0 = (ox + enter * dx) * fx * w0 + cx;
        let v0 = (oy + enter * dy) * fy * w0 + cy;
        let a0 = enter * w0;
        // At infinity: the vanishing point, with 1/dz in place of 1/z.
        let endless = exit.simd_eq(infinity);
        let z1 = (oz + exit * dz).max(splat(Z_NEAR));
        let inverse = one / endless.select(dz, z1);
        let x1 = endless.select(dx, ox + exit * dx);
        let y1 = endless.select(dy, oy + exit * dy);
        let w1 = endless.select(zero, inverse);
        let u1 = x1 * fx * inverse + cx;
        let v1 = y1 * fy * inverse + cy;
        let a1 = endless.select(one, exit) * inverse;
        let (u_max, v_max) = (splat(u_max), splat(v_max));
        let (u0, u1) = (u0.max(zero).min(u_max), u1.max(zero).min(u_max));
        let (v0, v1) = (v0.max(zero).min(v_max), v1.max(zero).min(v_max));
        let (du, dv) = (u1 - u0, v1 - v0);
        let fields = [
            (&mut self.u, u0),
            (&mut self.v, v0),
            (&mut self.w, w0),
            (&mut self.a, a0),
            (&mut self.du, du),
            (&mut self.dv, dv),
            (&mut self.dw, w1 - w0),
            (&mut self.da, a1 - a0),
            (&mut self.inv_du, one / du),
            (&mut self.inv_dv, one / dv),
            (&mut self.w_max, w0.max(w1)),
        ];
        for (field, values) in fields {
            values.store_slice(&mut field[at..at + 8]);
        }
        [invalid, !outside, ends_inside]
    }
}

/// Sixteen values of a group in f32.
#[inline(always)]
pub(crate) fn f32x16_at<S: Simd>(simd: S, field: &[f64; GROUP], at: usize) -> f32x16<S> {
    f64x8_at(simd, field, at).narrow(f64x8_at(simd, field, at + 8))
}

/// Eight values of a group.
#[inline(always)]
fn f64x8_at<S: Simd>(simd: S, field: &[f64; GROUP], at: usize) -> f64x8<S> {
    f64x8::from_slice(simd, &field[at..at + 8])
}

/// The four numbers of each of sixteen rays, as one vector for each number.
#[inline(always)]
fn fields<S: Simd>(
    simd: S,
    rays: &[Ray; LANES],
    numbers: impl Fn(&Ray) -> [f32; 4],
) -> [f32x16<S>; 4] {
    let row = |ray: usize| f32x4::load_array(simd, numbers(&rays[ray]));
    let a = transposed([row(0), row(1), row(2), row(3)]);
    let b = transposed([row(4), row(5), row(6), row(7)]);
    let c = transposed([row(8), row(9), row(10), row(11)]);
    let d = transposed([row(12), row(13), row(14), row(15)]);
    let joined = |k: usize| a[k].combine(b[k]).combine(c[k].combine(d[k]));
    [joined(0), joined(1), joined(2), joined(3)]
}

/// Transposes four rows of four numbers.
#[inline(always)]
fn transposed<S: Simd>([a, b, c, d]: [f32x4<S>; 4]) -> [f32x4<S>; 4] {
    let (ac_low, ac_high) = a.interleave(c);
    let (bd_low, bd_high) = b.interleave(d);
    let (x, y) = ac_low.interleave(bd_low);
    let (z, w) = ac_high.interleave(bd_high);
    [x, y, z, w]
}
