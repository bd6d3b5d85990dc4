//! The watertight triangle test (Woop, Benthin, Wald 2013, "Watertight Ray/Triangle
//! Intersection", JCGT 2(1)), one triangle and one ray. The vector forms in `single` and `packet`
//! do the same operations in the same order and fall back to [`resolve`] in the same cases.

use std::ops::{Mul, Sub};

use fearless_simd::{Simd, prelude::*};

use crate::accel::space::SpaceRay;

/// `t` and the barycentric weights of vertices 1 and 2.
pub(crate) type Crossing = (f32, f32, f32);

/// A vertex in the ray's space: x and y sheared, z along the largest axis.
#[inline(always)]
fn sheared(ray: &SpaceRay, p: [f32; 3]) -> [f32; 3] {
    let [kx, ky, kz] = ray.axes;
    let z = p[kz] - ray.origin[kz];
    [
        (p[kx] - ray.origin[kx]) - ray.shear[0] * z,
        (p[ky] - ray.origin[ky]) - ray.shear[1] * z,
        z,
    ]
}

/// Edge functions of three sheared vertices: twice the signed areas that the ray's line, now at the origin, spans
/// with the opposite edges. Each product is rounded on its own: equal products cancel, and rounding is monotone, so a
/// sign is never wrong, though a small difference may round to zero.
#[inline(always)]
pub(crate) fn edges<F>(a: [F; 3], b: [F; 3], c: [F; 3]) -> [F; 3]
where
    F: Copy + Mul<Output = F> + Sub<Output = F>,
{
    [
        c[0] * b[1] - c[1] * b[0],
        a[0] * c[1] - a[1] * c[0],
        b[0] * a[1] - b[1] * a[0],
    ]
}

/// Lanes whose three edge functions have the same sign: their lines pass through the inside or an edge.
#[inline(always)]
pub(crate) fn inside<S: Simd, F: SimdFloat<S, Element = f32>>(
    simd: S,
    [u, v, w]: [F; 3],
) -> F::Mask {
    let zero = F::splat(simd, 0.0);
    (u.simd_ge(zero) & v.simd_ge(zero) & w.simd_ge(zero))
        | (u.simd_le(zero) & v.simd_le(zero) & w.simd_le(zero))
}

/// Lanes with an edge function that is zero.
#[inline(always)]
pub(crate) fn on_edge<S: Simd, F: SimdFloat<S, Element = f32>>(
    simd: S,
    [u, v, w]: [F; 3],
) -> F::Mask {
    let zero = F::splat(simd, 0.0);
    u.simd_eq(zero) | v.simd_eq(zero) | w.simd_eq(zero)
}

/// Intersection of the ray's line with the triangle (either side), for any `t`.
#[inline(always)]
pub(crate) fn cross(ray: &SpaceRay, corners: [[f32; 3]; 3]) -> Option<Crossing> {
    let [a, b, c] = corners.map(|p| sheared(ray, p));
    let [u, v, w] = edges(a, b, c);
    let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
    if !inside {
        return None;
    }
    if u == 0.0 || v == 0.0 || w == 0.0 {
        return resolve(a, b, c, ray.shear[2]);
    }
    let scale = 1.0 / ((u + v) + w);
    let t = (((u * a[2] + v * b[2]) + w * c[2]) * scale) * ray.shear[2];
    Some((t, v * scale, w * scale))
}

/// Recomputes the edge functions in double precision for a ray that seems to hit an edge: the products are exact
/// there and their difference is rounded once, so signs and zeros are exact for the sheared vertices. Without this, a
/// ray in a triangle's plane could hit it far outside.
#[cold]
#[inline(never)]
pub(crate) fn resolve(a: [f32; 3], b: [f32; 3], c: [f32; 3], z_scale: f32) -> Option<Crossing> {
    let [a, b, c] = [a, b, c].map(|p| p.map(f64::from));
    let [u, v, w] = edges(a, b, c);
    let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
    let area = u + v + w;
    if !inside || area == 0.0 {
        return None;
    }
    let t = (u * a[2] + v * b[2] + w * c[2]) / area * f64::from(z_scale);
    Some((t as f32, (v / area) as f32, (w / area) as f32))
}
