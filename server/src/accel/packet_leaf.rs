//! Sixteen rays against the triangles of a leaf.

use fearless_simd::{Simd, prelude::*};

use super::Hit;
use super::blas::Block;
use super::packet::{Found, PacketTarget, SpaceRays, Width};
use super::triangle;

/// Tests the triangles of a leaf against the lanes that enter it; see [`triangle::cross`].
#[inline(always)]
#[allow(
    clippy::too_many_arguments,
    reason = "split from its caller for reading only"
)]
pub(super) fn leaf<S: Simd, W: Width<S>>(
    simd: S,
    block: &Block,
    count: usize,
    rays: &SpaceRays<S, W>,
    near: W::F,
    lanes: W::M,
    target: PacketTarget<'_>,
    found: &mut Found<S, W>,
) {
    let splat = |x: f32| W::F::splat(simd, x);
    let zero = splat(0.0);
    let [sx, sy, sz] = rays.shear;
    for kz in 0..3 {
        let lanes = lanes & rays.along[kz];
        if !lanes.any_true() {
            continue;
        }
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        let (ox, oy, oz) = (rays.origin[kx], rays.origin[ky], rays.origin[kz]);
        for k in 0..count {
            macro_rules! sheared {
                ($corner:literal) => {{
                    let p = &block.corners[$corner];
                    let z = splat(p[kz][k]) - oz;
                    let x = (splat(p[kx][k]) - ox) - sx * z;
                    let y = (splat(p[ky][k]) - oy) - sy * z;
                    [x, y, z]
                }};
            }
            let a = sheared!(0);
            let b = sheared!(1);
            let c = sheared!(2);
            let u = c[0] * b[1] - c[1] * b[0];
            let v = a[0] * c[1] - a[1] * c[0];
            let w = b[0] * a[1] - b[1] * a[0];
            let inside = ((u.simd_ge(zero) & v.simd_ge(zero) & w.simd_ge(zero))
                | (u.simd_le(zero) & v.simd_le(zero) & w.simd_le(zero)))
                & lanes;
            if !inside.any_true() {
                continue;
            }
            let scale = splat(1.0) / ((u + v) + w);
            let mut t = (((u * a[2] + v * b[2]) + w * c[2]) * scale) * sz;
            let mut weight_v = v * scale;
            let mut weight_w = w * scale;
            let edge = (u.simd_eq(zero) | v.simd_eq(zero) | w.simd_eq(zero)) & inside;
            let mut inside = inside;
            if edge.any_true() {
                resolve_lanes::<S, W>(
                    [a, b, c],
                    sz,
                    edge.to_bitmask(),
                    &mut inside,
                    [&mut t, &mut weight_v, &mut weight_w],
                );
            }
            let t = t.max(near);
            let mut taken = inside & t.simd_ge(rays.t_min) & t.simd_le(found.t);
            if !taken.any_true() {
                continue;
            }
            let id = block.ids[k];
            let ties = taken & t.simd_eq(found.t);
            if ties.any_true() {
                let mut bits = ties.to_bitmask();
                while bits != 0 {
                    let lane = bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    let incumbent = (found.instance[lane], found.triangle[lane]);
                    if incumbent <= (target.instance, id) {
                        taken.set(lane, false);
                    }
                }
            }
            if let Some(filter) = target.filter {
                let mut bits = taken.to_bitmask();
                while bits != 0 {
                    let lane = bits.trailing_zeros() as usize;
                    bits &= bits - 1;
                    let hit = Hit {
                        t: t[lane],
                        instance: target.instance,
                        triangle: id,
                        u: weight_v[lane],
                        v: weight_w[lane],
                    };
                    if !filter(target.first_lane + lane, &hit) {
                        taken.set(lane, false);
                    }
                }
            }
            if target.any {
                found.t = taken.select(splat(f32::NEG_INFINITY), found.t);
                if !found.t.simd_gt(splat(f32::NEG_INFINITY)).any_true() {
                    return;
                }
            } else {
                found.t = taken.select(t, found.t);
                found.u = taken.select(weight_v, found.u);
                found.v = taken.select(weight_w, found.v);
                found.instance = taken.select(W::U::splat(simd, target.instance), found.instance);
                found.triangle = taken.select(W::U::splat(simd, id), found.triangle);
            }
        }
    }
}

/// [`triangle::resolve`] for the lanes in `bits`.
#[inline(always)]
fn resolve_lanes<S: Simd, W: Width<S>>(
    corners: [[W::F; 3]; 3],
    z_scale: W::F,
    mut bits: u64,
    inside: &mut W::M,
    [t, v, w]: [&mut W::F; 3],
) {
    while bits != 0 {
        let lane = bits.trailing_zeros() as usize;
        bits &= bits - 1;
        let [a, b, c] = [0, 1, 2].map(|i: usize| {
            [
                corners[i][0][lane],
                corners[i][1][lane],
                corners[i][2][lane],
            ]
        });
        match triangle::resolve(a, b, c, z_scale[lane]) {
            Some(crossing) => (t[lane], v[lane], w[lane]) = crossing,
            None => inside.set(lane, false),
        }
    }
}
