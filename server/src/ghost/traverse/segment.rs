//! A ray as a segment in (u, v, w = 1/z): clipped in camera space, then projected.
//!
//! All values are f64. Coordinates reach thousands of pixels, and w covers seven decades (1/1 mm to 1/10 km)
//! along one ray; in f32, rounding would move a grazing ray to the other side of the surface.

use crate::accel::Ray;
use crate::camera::Intrinsics;
use crate::frame::DepthImage;

/// What ends a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// The image's border or the camera's plane: the ray leaves the camera's view.
    Border,
    /// The ray's `t_max` or infinity, inside the image.
    Inside,
}

/// The result of clipping a ray to the volume that the image sees.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Clipped {
    /// NaN, no direction, infinite origin, or an empty parameter interval.
    Invalid,
    /// No part of the ray is inside.
    Outside,
    /// The part that is inside.
    Inside(Segment),
}

/// The part of a ray that the image sees. At parameter s in 0..=1 the pixel position is
/// `(u + s du, v + s dv)`, the inverse depth `w + s dw`, and the ray's own parameter
/// `(a + s da) / (w + s dw)`: both `t w` and `w` are linear on the image.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Segment {
    pub(crate) u: f64,
    pub(crate) v: f64,
    pub(crate) w: f64,
    pub(crate) a: f64,
    pub(crate) du: f64,
    pub(crate) dv: f64,
    pub(crate) dw: f64,
    pub(crate) da: f64,
    /// 1/du, infinite for a segment without extent in u.
    pub(crate) inv_du: f64,
    /// 1/dv.
    pub(crate) inv_dv: f64,
    /// Largest w on the segment.
    pub(crate) w_max: f64,
    /// The ray's interval, to which a hit's parameter is clamped after rounding.
    pub(crate) t_min: f64,
    pub(crate) t_max: f64,
    pub(crate) end: End,
}

impl Segment {
    /// The ray's parameter at `s`.
    #[inline(always)]
    pub(crate) fn t(&self, s: f64) -> f64 {
        ((self.a + s * self.da) / (self.w + s * self.dw))
            .max(self.t_min)
            .min(self.t_max)
    }
}

/// The volume that an image sees, bounded by its outermost vertices: five half-spaces.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frustum {
    pub(crate) fx: f64,
    pub(crate) fy: f64,
    pub(crate) cx: f64,
    pub(crate) cy: f64,
    /// Largest vertex coordinates, width - 1 and height - 1.
    pub(crate) u_max: f64,
    pub(crate) v_max: f64,
}

/// Smallest depth that a segment reaches, metres.
pub(crate) const Z_NEAR: f64 = DepthImage::MIN_M as f64;

impl Frustum {
    pub(crate) fn new(intrinsics: &Intrinsics) -> Self {
        Self {
            fx: intrinsics.fx,
            fy: intrinsics.fy,
            cx: intrinsics.cx,
            cy: intrinsics.cy,
            u_max: f64::from(intrinsics.width) - 1.0,
            v_max: f64::from(intrinsics.height) - 1.0,
        }
    }

    /// Clips before projecting: in camera space every bound is linear in the ray's parameter, so rays from behind
    /// the camera and rays to infinity need no special case.
    #[inline(always)]
    pub(crate) fn clip(&self, ray: &Ray) -> Clipped {
        let (ox, oy, oz) = (
            f64::from(ray.origin.x),
            f64::from(ray.origin.y),
            f64::from(ray.origin.z),
        );
        let (dx, dy, dz) = (
            f64::from(ray.direction.x),
            f64::from(ray.direction.y),
            f64::from(ray.direction.z),
        );
        let t_min = f64::from(ray.t_min);
        let t_max = f64::from(ray.t_max);
        // One sum is finite only if all its terms are (sums of six f32s cannot overflow in f64).
        let valid = (ox + oy + oz + dx + dy + dz + t_min).is_finite()
            & ((dx != 0.0) | (dy != 0.0) | (dz != 0.0))
            & (t_min <= t_max);
        if !valid {
            return Clipped::Invalid;
        }
        // u >= 0, u <= u_max, v >= 0, v <= v_max times z, then z >= z_near: g(t) = o + t d >= 0.
        let (right, bottom) = (self.u_max - self.cx, self.v_max - self.cy);
        let o = [
            self.fx * ox + self.cx * oz,
            right * oz - self.fx * ox,
            self.fy * oy + self.cy * oz,
            bottom * oz - self.fy * oy,
            oz - Z_NEAR,
        ];
        let d = [
            self.fx * dx + self.cx * dz,
            right * dz - self.fx * dx,
            self.fy * dy + self.cy * dz,
            bottom * dz - self.fy * dy,
            dz,
        ];
        // The last inward crossing and the first outward one, as fractions with denominators above zero, compared
        // without dividing.
        let (mut enter, mut exit) = ((t_min, 1.0), (t_max, 1.0));
        let mut end = End::Inside;
        let mut outside = false;
        for (o, d) in o.into_iter().zip(d) {
            if d > 0.0 && -o * enter.1 > enter.0 * d {
                enter = (-o, d);
            }
            if d < 0.0 && o * exit.1 < exit.0 * -d {
                exit = (o, -d);
                end = End::Border;
            }
            outside |= d == 0.0 && o < 0.0;
        }
        let (enter, exit) = (enter.0 / enter.1, exit.0 / exit.1);
        if outside || enter > exit {
            return Clipped::Outside;
        }
        let z0 = (oz + enter * dz).max(Z_NEAR);
        let w0 = 1.0 / z0;
        let u0 = self.cx + self.fx * (ox + enter * dx) * w0;
        let v0 = self.cy + self.fy * (oy + enter * dy) * w0;
        let a0 = enter * w0;
        let (w1, u1, v1, a1) = if exit == f64::INFINITY {
            // The vanishing point. Only a ray with dz > 0 stays inside forever.
            let inv_dz = 1.0 / dz;
            (
                0.0,
                self.cx + self.fx * dx * inv_dz,
                self.cy + self.fy * dy * inv_dz,
                inv_dz,
            )
        } else {
            let z1 = (oz + exit * dz).max(Z_NEAR);
            let w1 = 1.0 / z1;
            (
                w1,
                self.cx + self.fx * (ox + exit * dx) * w1,
                self.cy + self.fy * (oy + exit * dy) * w1,
                exit * w1,
            )
        };
        // Clipping has put both ends inside; the clamp only removes rounding errors.
        let (u0, u1) = (clamp(u0, self.u_max), clamp(u1, self.u_max));
        let (v0, v1) = (clamp(v0, self.v_max), clamp(v1, self.v_max));
        let (du, dv) = (u1 - u0, v1 - v0);
        Clipped::Inside(Segment {
            u: u0,
            v: v0,
            w: w0,
            a: a0,
            du,
            dv,
            dw: w1 - w0,
            da: a1 - a0,
            inv_du: 1.0 / du,
            inv_dv: 1.0 / dv,
            w_max: w0.max(w1),
            t_min,
            t_max,
            end,
        })
    }
}

#[inline(always)]
fn clamp(x: f64, max: f64) -> f64 {
    // `max(0.0)` comes first, so that a NaN becomes 0. 0/0 cannot arise, but excluding it costs nothing.
    x.max(0.0).min(max)
}
