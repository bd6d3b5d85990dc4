//! Sixteen rays against all instances: the TLAS is traversed once for all lanes.

use fearless_simd::{Simd, prelude::*};
use glam::Vec3A;

use super::group::{self, GROUP};
use super::hits::{PacketHits, PacketTarget};
use super::rays::{Rays, padded, slabs, usable};
use super::walk::walk;
use crate::accel::ray::{HitPacket, NO_HIT, PacketFilter, RayPacket};
use crate::accel::tlas::{STACK, Tlas};
use crate::simd::Width;

/// A query for one packet.
#[derive(Clone, Copy)]
pub(crate) struct PacketQuery<'a> {
    pub(crate) tlas: &'a Tlas,
    pub(crate) rays: &'a RayPacket,
    pub(crate) active: u16,
    pub(crate) mask: u8,
    pub(crate) filter: Option<PacketFilter<'a>>,
}

/// A query for the packets of one group.
#[derive(Clone, Copy)]
pub(crate) struct GroupQuery<'a> {
    pub(crate) tlas: &'a Tlas,
    pub(crate) rays: &'a [RayPacket],
    pub(crate) active: &'a [u16],
    pub(crate) mask: u8,
    pub(crate) filter: Option<PacketFilter<'a>>,
    /// Index of lane 0 in the caller's packets.
    pub(crate) first_lane: usize,
}

/// Number of packets per group.
pub(crate) const fn packets_of_group(lanes_of_vector: usize) -> usize {
    GROUP * lanes_of_vector / 16
}

/// Nearest hits of all lanes, processed in vectors of `W`. Returns the lanes that hit.
#[inline(always)]
pub(crate) fn nearest<S: Simd, W: Width<S>>(
    simd: S,
    query: PacketQuery<'_>,
    hits: &mut HitPacket,
) -> u16 {
    let mut lanes = 0;
    for first in (0..16).step_by(W::F::LEN) {
        let found = trace_from::<S, W>(simd, query, first, false);
        lanes |= hit::<S, W>(simd, &found) << first;
        store(simd, &found, first, hits);
    }
    lanes
}

/// The lanes that hit anything. Separate from [`nearest`], so that each is compiled for its own case.
#[inline(always)]
pub(crate) fn any<S: Simd, W: Width<S>>(simd: S, query: PacketQuery<'_>) -> u16 {
    let mut lanes = 0;
    for first in (0..16).step_by(W::F::LEN) {
        let found = trace_from::<S, W>(simd, query, first, true);
        lanes |= hit::<S, W>(simd, &found) << first;
    }
    lanes
}

#[inline(always)]
fn hit<S: Simd, W: Width<S>>(simd: S, found: &PacketHits<S, W>) -> u16 {
    let hit = found.instance.simd_ne(W::U::splat(simd, NO_HIT));
    hit.to_bitmask() as u16
}

/// Loads the lanes from `first` on that fit into `W`, with no hits yet.
#[inline(always)]
fn load<S: Simd, W: Width<S>>(
    simd: S,
    packet: &RayPacket,
    active: u16,
    first: usize,
) -> (Rays<S, W>, PacketHits<S, W>, W::M) {
    let zero = W::F::splat(simd, 0.0);
    let load = |lanes: &[f32; 16]| W::F::from_slice(simd, &lanes[first..first + W::F::LEN]);
    let origin = [
        load(&packet.origin[0]),
        load(&packet.origin[1]),
        load(&packet.origin[2]),
    ];
    let direction = [
        load(&packet.direction[0]) + zero,
        load(&packet.direction[1]) + zero,
        load(&packet.direction[2]) + zero,
    ];
    let (t_min, t_max) = (load(&packet.t_min), load(&packet.t_max));
    let usable = usable::<S, W>(simd, &origin, &direction)
        & t_min.is_finite()
        & t_min.simd_le(t_max)
        & W::M::from_bitmask(simd, u64::from(active >> first));
    // Unusable lanes must not bring NaN into minima, whose result would then depend on the instruction set.
    let clean = |x: W::F| usable.select(x, zero);
    let rays = Rays::<S, W> {
        origin: [clean(origin[0]), clean(origin[1]), clean(origin[2])],
        direction: [
            clean(direction[0]),
            clean(direction[1]),
            usable.select(direction[2], W::F::splat(simd, 1.0)),
        ],
        t_min: clean(t_min),
    };
    let done = W::F::splat(simd, f32::NEG_INFINITY);
    let found = PacketHits::<S, W> {
        t: usable.select(t_max, done),
        u: zero,
        v: zero,
        instance: W::U::splat(simd, NO_HIT),
        triangle: W::U::splat(simd, NO_HIT),
    };
    (rays, found, usable)
}

/// Traces the lanes from `first` on that fit into `W`. With `any`, a lane's instance tells only whether the lane has
/// a hit.
#[inline(always)]
fn trace_from<S: Simd, W: Width<S>>(
    simd: S,
    query: PacketQuery<'_>,
    first: usize,
    any: bool,
) -> PacketHits<S, W> {
    let PacketQuery {
        tlas,
        rays: packet,
        active,
        mask,
        filter,
    } = query;
    let done = W::F::splat(simd, f32::NEG_INFINITY);
    let (rays, mut found, usable) = load::<S, W>(simd, packet, active, first);
    if tlas.tree.nodes.is_empty() {
        return found;
    }
    let (inv, low_origin, high_origin) =
        padded::<S, W>(simd, rays.origin, rays.direction, tlas.pad, tlas.extent);
    let mut stack = [0_u32; STACK];
    let mut height = 1;
    // The lanes that enter a box before their nearest hit.
    macro_rules! reach {
        ($bounds:expr) => {
            entering::<S, W>(
                simd,
                $bounds,
                [&inv, &low_origin, &high_origin],
                rays.t_min,
                found.t,
            )
        };
    }
    while height > 0 {
        height -= 1;
        let node = tlas.tree.nodes[stack[height] as usize];
        let of_node = reach!((node.low, node.high));
        if !of_node.any_true() {
            continue;
        }
        if node.count == 0 {
            stack[height] = node.first + 1;
            stack[height + 1] = node.first;
            height += 2;
            continue;
        }
        for &index in &tlas.tree.order[node.first as usize..(node.first + node.count) as usize] {
            let instance = &tlas.instances[index as usize];
            let Some(bounds) = instance.bounds.filter(|_| instance.mask & mask != 0) else {
                continue;
            };
            // A node with one instance has the same box as the instance.
            let open = if node.count > 1 {
                reach!(bounds)
            } else {
                of_node
            };
            if !open.any_true() {
                continue;
            }
            let target = PacketTarget {
                instance: index,
                first_lane: first,
                filter: filter.filter(|_| instance.filtered),
                any,
            };
            walk::<S, W>(
                simd,
                &instance.blas,
                &instance.columns,
                &rays,
                open,
                target,
                &mut found,
            );
        }
    }
    if any {
        // Lanes that were usable and are done have a hit.
        let hit = usable & found.t.simd_eq(done);
        found.instance = hit.select(W::U::splat(simd, 0), found.instance);
    }
    found
}

/// Nearest hits of [`packets_of_group`] packets.
#[inline(always)]
pub(crate) fn nearest_of_group<S: Simd, W: Width<S>>(
    simd: S,
    query: GroupQuery<'_>,
    hits: &mut [HitPacket],
) {
    let GroupQuery {
        tlas,
        rays,
        active,
        mask,
        filter,
        first_lane,
    } = query;
    let vectors = 16 / W::F::LEN;
    let (one, none, _) = load::<S, W>(simd, &rays[0], active[0], 0);
    let mut all = [one; GROUP];
    let mut found = [none; GROUP];
    for n in 1..GROUP {
        let (packet, first) = (n / vectors, n % vectors * W::F::LEN);
        (all[n], found[n], _) = load::<S, W>(simd, &rays[packet], active[packet], first);
    }
    if !tlas.tree.nodes.is_empty() {
        walk_group(simd, tlas, mask, filter, first_lane, &all, &mut found);
    }
    for n in 0..GROUP {
        store(
            simd,
            &found[n],
            n % vectors * W::F::LEN,
            &mut hits[n / vectors],
        );
    }
}

/// Traverses the instances that a group may hit.
#[inline(always)]
fn walk_group<S: Simd, W: Width<S>>(
    simd: S,
    tlas: &Tlas,
    mask: u8,
    filter: Option<PacketFilter<'_>>,
    first_lane: usize,
    rays: &[Rays<S, W>; GROUP],
    found: &mut [PacketHits<S, W>; GROUP],
) {
    let pads = padded::<S, W>(
        simd,
        rays[0].origin,
        rays[0].direction,
        tlas.pad,
        tlas.extent,
    );
    let mut slabs = [pads; GROUP];
    for n in 1..GROUP {
        slabs[n] = padded::<S, W>(
            simd,
            rays[n].origin,
            rays[n].direction,
            tlas.pad,
            tlas.extent,
        );
    }
    // The lanes that enter a box before their nearest hit.
    macro_rules! reach {
        ($bounds:expr) => {{
            let mut open = [W::M::from_bitmask(simd, 0); GROUP];
            let mut lanes = 0;
            for n in 0..GROUP {
                let (inv, low_origin, high_origin) = &slabs[n];
                open[n] = entering::<S, W>(
                    simd,
                    $bounds,
                    [inv, low_origin, high_origin],
                    rays[n].t_min,
                    found[n].t,
                );
                lanes |= open[n].to_bitmask();
            }
            (open, lanes != 0)
        }};
    }
    let mut stack = [0_u32; STACK];
    let mut height = 1;
    while height > 0 {
        height -= 1;
        let node = tlas.tree.nodes[stack[height] as usize];
        let (of_node, any) = reach!((node.low, node.high));
        if !any {
            continue;
        }
        if node.count == 0 {
            stack[height] = node.first + 1;
            stack[height + 1] = node.first;
            height += 2;
            continue;
        }
        for &index in &tlas.tree.order[node.first as usize..(node.first + node.count) as usize] {
            let instance = &tlas.instances[index as usize];
            let Some(bounds) = instance.bounds.filter(|_| instance.mask & mask != 0) else {
                continue;
            };
            // A node with one instance has the same box as the instance.
            let (open, any) = if node.count > 1 {
                reach!(bounds)
            } else {
                (of_node, true)
            };
            if !any {
                continue;
            }
            let target = PacketTarget {
                instance: index,
                first_lane,
                filter: filter.filter(|_| instance.filtered),
                any: false,
            };
            group::walk(
                simd,
                &instance.blas,
                &instance.columns,
                rays,
                &open,
                target,
                found,
            );
        }
    }
}

/// The lanes that enter the box before their nearest hit.
#[inline(always)]
fn entering<S: Simd, W: Width<S>>(
    simd: S,
    (low, high): (Vec3A, Vec3A),
    [inv, low_origin, high_origin]: [&[W::F; 3]; 3],
    t_min: W::F,
    t: W::F,
) -> W::M {
    let (near, far) = slabs::<S, W>(
        simd,
        &low.to_array(),
        &high.to_array(),
        low_origin,
        high_origin,
        inv,
    );
    near.max(t_min).simd_le(far.min(t))
}

#[inline(always)]
fn store<S: Simd, W: Width<S>>(
    simd: S,
    found: &PacketHits<S, W>,
    first: usize,
    hits: &mut HitPacket,
) {
    let lanes = first..first + W::F::LEN;
    let none = found.instance.simd_eq(W::U::splat(simd, NO_HIT));
    let t = none.select(W::F::splat(simd, f32::INFINITY), found.t);
    t.store_slice(&mut hits.t[lanes.clone()]);
    found.u.store_slice(&mut hits.u[lanes.clone()]);
    found.v.store_slice(&mut hits.v[lanes.clone()]);
    found
        .instance
        .store_slice(&mut hits.instance[lanes.clone()]);
    found.triangle.store_slice(&mut hits.triangle[lanes]);
}
