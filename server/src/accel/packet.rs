//! Sixteen rays against one mesh over the binary tree: each box and each triangle is tested
//! against all rays at once. Lanes that are done have `t = -inf`, which no box is nearer than.

use fearless_simd::{Simd, f32x8, f32x16, mask32x8, mask32x16, prelude::*, u32x8, u32x16};

use super::blas::{Blas, LEAF};
use super::ray::{Columns, DIRECTION_RANGE, FLATTEST, PAD};
use super::sah::MAX_DEPTH;
use super::triangle;
use super::{Hit, PacketFilter};

/// The vector types of one packet width.
pub(super) trait Width<S: Simd> {
    /// Lanes of floats.
    type F: SimdFloat<S, Element = f32, Mask = Self::M>;
    /// Lanes of numbers.
    type U: SimdInt<S, Element = u32, Mask = Self::M>;
    /// One truth value per lane.
    type M: SimdMask<S> + Select<Self::F> + Select<Self::U>;
}

/// Sixteen lanes: one AVX-512 register.
pub(super) struct Sixteen;
/// Eight lanes: one AVX2 register.
pub(super) struct Eight;

impl<S: Simd> Width<S> for Sixteen {
    type F = f32x16<S>;
    type U = u32x16<S>;
    type M = mask32x16<S>;
}

impl<S: Simd> Width<S> for Eight {
    type F = f32x8<S>;
    type U = u32x8<S>;
    type M = mask32x8<S>;
}

/// Camera-space rays of a packet, cleaned.
pub(super) struct Rays<S: Simd, W: Width<S>> {
    pub(super) origin: [W::F; 3],
    pub(super) direction: [W::F; 3],
    pub(super) t_min: W::F,
}

/// The nearest hits so far.
pub(super) struct Found<S: Simd, W: Width<S>> {
    /// Nearest `t`, or where the ray ends; -inf once a lane is done.
    pub(super) t: W::F,
    pub(super) u: W::F,
    pub(super) v: W::F,
    pub(super) instance: W::U,
    pub(super) triangle: W::U,
}

/// The instance being walked, and who may refuse its hits.
#[derive(Clone, Copy)]
pub(super) struct PacketTarget<'a> {
    pub(super) instance: u32,
    /// Number of lane 0 within the caller's packet.
    pub(super) first_lane: usize,
    pub(super) filter: Option<PacketFilter<'a>>,
    /// Any hit will do.
    pub(super) any: bool,
}

/// Rays in the space of a tree, as [`super::ray::SpaceRay`]. All lanes share `axes`.
struct SpaceRays<S: Simd, W: Width<S>> {
    inv: [W::F; 3],
    /// Origin plus pad, and minus.
    low_origin: [W::F; 3],
    high_origin: [W::F; 3],
    /// Origin and shear along `axes`.
    sheared_origin: [W::F; 3],
    shear: [W::F; 3],
    axes: [usize; 3],
    t_min: W::F,
}

/// Reciprocal directions and padded origins; see [`super::ray::Slabs::new`].
#[inline(always)]
#[allow(clippy::type_complexity, reason = "three groups of three lanes")]
pub(super) fn padded<S: Simd, W: Width<S>>(
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

/// Entry and exit of a box; see [`super::ray::Slabs::cross`].
#[inline(always)]
pub(super) fn slabs<S: Simd, W: Width<S>>(
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

/// Carries the rays into the instance and walks its mesh, once for each direction axis that is
/// some active lane's largest. With `target.any`, lanes that hit retire.
#[inline(always)]
pub(super) fn walk<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    columns: &Columns,
    rays: &Rays<S, W>,
    target: PacketTarget<'_>,
    found: &mut Found<S, W>,
) {
    if blas.pairs.is_empty() {
        return;
    }
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
    let usable = usable::<S, W>(simd, &origin, &direction);
    let (inv, low_origin, high_origin) = padded::<S, W>(simd, origin, direction, PAD, blas.extent);

    let size = [direction[0].abs(), direction[1].abs(), direction[2].abs()];
    let active = found.t.simd_gt(splat(f32::NEG_INFINITY)) & usable;
    let along_x = size[0].simd_ge(size[1]) & size[0].simd_ge(size[2]);
    let along_y = !along_x & size[1].simd_ge(size[2]);
    let along = [along_x, along_y, !along_x & !along_y];
    for kz in 0..3 {
        let lanes = active & along[kz];
        if !lanes.any_true() {
            continue;
        }
        let kx = (kz + 1) % 3;
        let ky = (kx + 1) % 3;
        let space = SpaceRays::<S, W> {
            inv,
            low_origin,
            high_origin,
            sheared_origin: [origin[kx], origin[ky], origin[kz]],
            shear: [
                direction[kx] / direction[kz],
                direction[ky] / direction[kz],
                splat(1.0) / direction[kz],
            ],
            axes: [kx, ky, kz],
            t_min: rays.t_min,
        };
        let whole = found.t;
        found.t = lanes.select(whole, splat(f32::NEG_INFINITY));
        descend::<S, W>(simd, blas, &space, target, found);
        found.t = lanes.select(found.t, whole);
    }
}

/// Lanes whose ray can hit something; see [`super::ray::Slabs::new`].
#[inline(always)]
pub(super) fn usable<S: Simd, W: Width<S>>(
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

#[inline(always)]
fn descend<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    rays: &SpaceRays<S, W>,
    target: PacketTarget<'_>,
    found: &mut Found<S, W>,
) {
    let mut stack = [0_u32; MAX_DEPTH + 2];
    let mut height = 0;
    let mut current = 0_u32;
    loop {
        let node = &blas.pairs[current as usize];
        macro_rules! enter {
            ($side:literal) => {
                slabs::<S, W>(
                    simd,
                    &node.low[$side],
                    &node.high[$side],
                    &rays.low_origin,
                    &rays.high_origin,
                    &rays.inv,
                )
            };
        }
        let (near0, far0) = enter!(0);
        let (near1, far1) = enter!(1);
        let hit0 = near0.max(rays.t_min).simd_le(far0.min(found.t));
        let hit1 = near1.max(rays.t_min).simd_le(far1.min(found.t));
        let mut go0 = hit0.any_true();
        let mut go1 = hit1.any_true();
        if go0 && node.children[0] & LEAF != 0 {
            leaf::<S, W>(
                simd,
                blas,
                node.children[0],
                node.counts[0],
                rays,
                near0,
                hit0,
                target,
                found,
            );
            go0 = false;
        }
        if go1 && node.children[1] & LEAF != 0 {
            leaf::<S, W>(
                simd,
                blas,
                node.children[1],
                node.counts[1],
                rays,
                near1,
                hit1,
                target,
                found,
            );
            go1 = false;
        }
        if go0 && go1 {
            // The child that more rays enter first goes first.
            let first0 = (near0.simd_le(near1) & hit0 & hit1)
                .to_bitmask()
                .count_ones();
            let both = (hit0 & hit1).to_bitmask().count_ones();
            let swap = usize::from(2 * first0 < both);
            current = node.children[swap];
            stack[height] = node.children[1 - swap];
            height += 1;
        } else if go0 {
            current = node.children[0];
        } else if go1 {
            current = node.children[1];
        } else if height == 0 {
            return;
        } else {
            height -= 1;
            current = stack[height];
        }
    }
}

/// Tests the triangles of a leaf against the lanes that enter it; see [`triangle::cross`].
#[inline(always)]
#[allow(
    clippy::too_many_arguments,
    reason = "split from its caller for reading only"
)]
fn leaf<S: Simd, W: Width<S>>(
    simd: S,
    blas: &Blas,
    child: u32,
    count: u32,
    rays: &SpaceRays<S, W>,
    near: W::F,
    lanes: W::M,
    target: PacketTarget<'_>,
    found: &mut Found<S, W>,
) {
    let Some(block) = blas.blocks.get((child & !LEAF) as usize) else {
        // An absent sibling.
        return;
    };
    let splat = |x: f32| W::F::splat(simd, x);
    let zero = splat(0.0);
    let [kx, ky, kz] = rays.axes;
    let [ox, oy, oz] = rays.sheared_origin;
    let [sx, sy, sz] = rays.shear;
    for k in 0..(count as usize).min(block.ids.len()) {
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
