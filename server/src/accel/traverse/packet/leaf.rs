//! Sixteen rays against the triangles of a leaf.

use fearless_simd::{Simd, f32x4, prelude::*};

use super::hits::{PacketHits, PacketTarget};
use super::rays::SpaceRays;
use crate::accel::build::layout::{Block, LEAF_SIZE};
use crate::accel::ray::Hit;
use crate::accel::traverse::triangle;
use crate::simd::Width;

/// Tests the triangles of a leaf against the lanes that enter it; see [`triangle::cross`].
#[inline(always)]
#[allow(
    clippy::too_many_arguments,
    reason = "split from its caller for reading only"
)]
pub(crate) fn leaf<S: Simd, W: Width<S>>(
    simd: S,
    block: &Block,
    count: usize,
    rays: &SpaceRays<S, W>,
    near: W::F,
    lanes: W::M,
    target: PacketTarget<'_>,
    found: &mut PacketHits<S, W>,
) {
    let splat = |x: f32| W::F::splat(simd, x);
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
            let [u, v, w] = triangle::edges(a, b, c);
            let inside = triangle::inside(simd, [u, v, w]) & lanes;
            let scale = splat(1.0) / ((u + v) + w);
            let mut t = (((u * a[2] + v * b[2]) + w * c[2]) * scale) * sz;
            let mut weight_v = v * scale;
            let mut weight_w = w * scale;
            let edge = triangle::on_edge(simd, [u, v, w]) & inside;
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
            let id = block.ids[k];
            let ties = taken & t.simd_eq(found.t);
            // With any-hit, a lane that already has a hit is done, so ties cannot occur.
            if !target.any && ties.any_true() {
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

/// Tests all triangles of a leaf at once against as many rays as fit (a quarter of the vector width), for leaves that
/// few lanes of `N` vectors enter. Lane `l` of vector `v` is bit `v LEN + l` of `lanes`.
#[inline(always)]
pub(crate) fn leaf_by_ray<S: Simd, W: Width<S>, const N: usize>(
    simd: S,
    block: &Block,
    rays: &[SpaceRays<S, W>; N],
    near: &[W::F; N],
    lanes: u64,
    target: PacketTarget<'_>,
    found: &mut [PacketHits<S, W>; N],
) {
    const { assert!(LEAF_SIZE == 4 && N.is_power_of_two()) };
    let at_once = W::F::LEN / LEAF_SIZE;
    for kz in 0..3 {
        let mut along = 0;
        for (n, rays) in rays.iter().enumerate() {
            along |= rays.along[kz].to_bitmask() << (n * W::F::LEN);
        }
        let mut lanes = lanes & along;
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        while lanes != 0 {
            // Always as many rays as fit, because a loop that ends early is usually mispredicted. Unused ray slots
            // hold copies of lane 0, whose results are ignored.
            let rays_left = (lanes.count_ones() as usize).min(at_once);
            let asked = (1_u64 << (rays_left * LEAF_SIZE)).wrapping_sub(1);
            let mut owners = [0; 4];
            macro_rules! take {
                ($n:expr) => {{
                    let lane = lanes.trailing_zeros() as usize & (N * W::F::LEN - 1);
                    lanes &= lanes.wrapping_sub(1);
                    owners[$n & 3] = lane;
                    lane
                }};
            }
            macro_rules! splat {
                (|$rays:ident| $v:expr, $lane:expr) => {{
                    let $rays = &rays[($lane / W::F::LEN) & (N - 1)];
                    W::F::splat(simd, $v[$lane % W::F::LEN])
                }};
            }
            let first = take!(0);
            let mut ox = splat!(|rays| rays.origin[kx], first);
            let mut oy = splat!(|rays| rays.origin[ky], first);
            let mut oz = splat!(|rays| rays.origin[kz], first);
            let mut sx = splat!(|rays| rays.shear[0], first);
            let mut sy = splat!(|rays| rays.shear[1], first);
            for n in 1..at_once {
                let lane = take!(n);
                // The triangles of this ray and the following ones.
                let rest = W::M::from_bitmask(simd, u64::MAX << (n * LEAF_SIZE));
                ox = rest.select(splat!(|rays| rays.origin[kx], lane), ox);
                oy = rest.select(splat!(|rays| rays.origin[ky], lane), oy);
                oz = rest.select(splat!(|rays| rays.origin[kz], lane), oz);
                sx = rest.select(splat!(|rays| rays.shear[0], lane), sx);
                sy = rest.select(splat!(|rays| rays.shear[1], lane), sy);
            }
            macro_rules! sheared {
                ($corner:literal) => {{
                    let p = &block.corners[$corner];
                    macro_rules! axis {
                        ($axis:expr) => {
                            W::F::block_splat(f32x4::load_array_ref(simd, &p[$axis]))
                        };
                    }
                    let z = axis!(kz) - oz;
                    let x = (axis!(kx) - ox) - sx * z;
                    let y = (axis!(ky) - oy) - sy * z;
                    [x, y, z]
                }};
            }
            let a = sheared!(0);
            let b = sheared!(1);
            let c = sheared!(2);
            let [u, v, w] = triangle::edges(a, b, c);
            let mut bits = triangle::inside(simd, [u, v, w]).to_bitmask() & asked;
            if bits == 0 {
                continue;
            }
            let edges = triangle::on_edge(simd, [u, v, w]).to_bitmask();
            let scale = W::F::splat(simd, 1.0) / ((u + v) + w);
            let t = ((u * a[2] + v * b[2]) + w * c[2]) * scale;
            let (v, w) = (v * scale, w * scale);
            while bits != 0 {
                let at = bits.trailing_zeros() as usize & 15;
                bits &= bits - 1;
                let owner = owners[at / LEAF_SIZE];
                let (n, lane) = ((owner / W::F::LEN) & (N - 1), owner % W::F::LEN);
                let z_scale = rays[n].shear[2][lane];
                let crossing = if edges >> at & 1 != 0 {
                    macro_rules! corner {
                        ($c:ident) => {
                            [$c[0][at], $c[1][at], $c[2][at]]
                        };
                    }
                    triangle::resolve(corner!(a), corner!(b), corner!(c), z_scale)
                } else {
                    Some((t[at] * z_scale, v[at], w[at]))
                };
                if let Some((t, u, v)) = crossing {
                    let hit = Hit {
                        t: t.max(near[n][lane]),
                        instance: target.instance,
                        triangle: block.ids[at % LEAF_SIZE],
                        u,
                        v,
                    };
                    let target = PacketTarget {
                        first_lane: target.first_lane + n * W::F::LEN,
                        ..target
                    };
                    take_lane::<S, W>(simd, hit, rays[n].t_min[lane], lane, target, &mut found[n]);
                }
            }
        }
    }
}

/// Records a hit of one lane if it is in range, wins and passes the filter.
#[inline(always)]
fn take_lane<S: Simd, W: Width<S>>(
    simd: S,
    hit: Hit,
    t_min: f32,
    lane: usize,
    target: PacketTarget<'_>,
    found: &mut PacketHits<S, W>,
) {
    // The copy stays in registers until a lane is read; the closest-hit case needs more values, for which memory is
    // faster.
    let wins = if target.any {
        let best = found.t;
        hit.t >= t_min && hit.t <= best[lane & 15]
    } else {
        let best = found.t[lane & 15];
        hit.t >= t_min
            && (hit.t < best
                || (hit.t == best
                    && (hit.instance, hit.triangle)
                        < (found.instance[lane & 15], found.triangle[lane & 15])))
    };
    if !wins
        || target
            .filter
            .is_some_and(|filter| !filter(target.first_lane + lane, &hit))
    {
        return;
    }
    let only = W::M::from_bitmask(simd, 1 << lane);
    if target.any {
        found.t = only.select(W::F::splat(simd, f32::NEG_INFINITY), found.t);
    } else {
        found.t = only.select(W::F::splat(simd, hit.t), found.t);
        found.u = only.select(W::F::splat(simd, hit.u), found.u);
        found.v = only.select(W::F::splat(simd, hit.v), found.v);
        found.instance = only.select(W::U::splat(simd, hit.instance), found.instance);
        found.triangle = only.select(W::U::splat(simd, hit.triangle), found.triangle);
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
