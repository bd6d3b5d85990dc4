//! The rays of soft shadows: to virtual occluders in packets, to real ones in batches.

use std::ops::Range;

use glam::Vec3A;

use crate::accel::{HitPacket, MASK_GHOST, Ray, RayPacket};
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::light::CameraLight;
use crate::render::prepare::light_samples::LightSamples;
use crate::render::prepare::object::Transmissive;
use crate::render::prepare::sensed::NormalMemo;
use crate::simd::{LANES, LaneMask};

use super::group::{Buffers, CHUNK, LightQuery, ShadowGroup};

/// Casts the samples in `todo` towards virtual occluders, in packets of sixteen across lanes and samples:
/// neighbouring points of the light together, because their rays visit the same parts of meshes.
pub(crate) fn cast_virtual(
    frame: &PreparedFrame<'_>,
    group: &mut ShadowGroup,
    chunk: &Range<usize>,
) {
    let ShadowGroup { points, query, .. } = group;
    for (k, i) in chunk.clone().enumerate() {
        query.samples[k].cast |= query.todo[k];
        if frame.light_samples.point(i, 0) != [0.0; 2] {
            for lane in LaneMask(query.todo[k] & !query.opened) {
                query.discs[lane].open();
            }
            query.opened |= query.todo[k];
        }
    }
    if query.virtual_clear {
        return;
    }
    // A counting sort by position on the light.
    let mut ends = [0_u16; LightSamples::N_PLACES + 1];
    for (k, i) in chunk.clone().enumerate() {
        for lane in LaneMask(query.todo[k]) {
            query.n_rays[lane] += 1;
            ends[usize::from(frame.light_samples.place(i, query.rotations[lane])) + 1] += 1;
        }
    }
    for place in 0..LightSamples::N_PLACES {
        ends[place + 1] += ends[place];
    }
    let n = usize::from(ends[LightSamples::N_PLACES]);
    let mut owners = [(0_u8, 0_u8); CHUNK * LANES];
    for (k, i) in chunk.clone().enumerate() {
        for lane in LaneMask(query.todo[k]) {
            let place = frame.light_samples.place(i, query.rotations[lane]);
            let end = &mut ends[usize::from(place)];
            owners[usize::from(*end)] = (k as u8, lane as u8);
            *end += 1;
        }
    }
    let mut rays = RayPacket::default();
    for owners in owners[..n].chunks(LANES) {
        for (slot, &(k, lane)) in owners.iter().enumerate() {
            let (i, lane) = (chunk.start + usize::from(k), usize::from(lane));
            let disc = &query.discs[lane];
            rays.set(
                slot,
                &Ray {
                    origin: points[lane].origin,
                    direction: disc.direction(frame.light_samples.point(i, query.rotations[lane])),
                    t_min: 0.0,
                    t_max: disc.t_max,
                },
            );
        }
        resolve_packet(frame, &rays, owners, query);
    }
}

/// Traces a packet, one ray per owner (sample, lane).
fn resolve_packet(
    frame: &PreparedFrame<'_>,
    rays: &RayPacket,
    owners: &[(u8, u8)],
    query: &mut LightQuery,
) {
    let active = (u32::MAX >> (32 - owners.len())) as u16;
    let blocked = frame.scene.occluded_packet(rays, active, query.stops);
    for slot in LaneMask(blocked) {
        let (k, lane) = (usize::from(owners[slot].0), usize::from(owners[slot].1));
        query.samples[k].virtual_blocked |= 1 << lane;
        query.touched |= 1 << lane;
    }
    let open = active & !blocked;
    if query.glass && open != 0 {
        let mut hits = HitPacket::default();
        let tinted = if let Transmissive::SameTint(glass) = frame.transmissive {
            hits.instance = [glass; LANES];
            frame.scene.occluded_packet(rays, open, query.tints)
        } else {
            frame
                .scene
                .intersect_packet(rays, open, query.tints, &mut hits);
            let met = |&slot: &usize| hits.instance[slot] != u32::MAX;
            LaneMask(open)
                .into_iter()
                .filter(met)
                .fold(0, |all, slot| all | 1 << slot)
        };
        for slot in LaneMask(tinted) {
            let (k, lane) = (usize::from(owners[slot].0), usize::from(owners[slot].1));
            query.samples[k].glass[lane] = hits.instance[slot];
            query.samples[k].tinted |= 1 << lane;
            query.touched |= 1 << lane;
        }
    }
}

/// Queues the rays of the samples in `todo` towards real occluders. A point on a virtual surface needs them if
/// any light is left, a ghost point only if a virtual object removes light (otherwise the ratio is one, whatever
/// the real occluders are). Lanes that are proven to have no real occluder need none.
pub(crate) fn queue_real(
    frame: &PreparedFrame<'_>,
    group: &mut ShadowGroup,
    g: usize,
    chunk: &Range<usize>,
    light: &CameraLight,
    buffers: &mut Buffers<'_>,
) {
    let query = &mut group.query;
    query.relevant = query.active & !query.real_lit_everywhere;
    if group.on_ghost {
        query.relevant &= query.touched;
    }
    let mut starts = [(Vec3A::ZERO, 0.0); LANES];
    let mut normals = NormalMemo::default();
    for lane in LaneMask(query.relevant) {
        let point = &mut group.points[lane];
        // Offset from the ghost surface by the sensor's noise; without the offset a noisy surface would shadow
        // itself.
        let lift = frame.sensed.lift(point.origin);
        let mut origin = point.origin;
        if group.on_ghost {
            if point.normal == Vec3A::ZERO {
                point.normal = frame.sensed.block_normal(point.x, point.y, &mut normals);
            }
            origin += point.normal * lift;
        }
        starts[lane] = (origin, lift);
    }
    prove_clear(frame, query, &starts, light, buffers);
    for lane in LaneMask(query.relevant & !query.clear) {
        let disc = &query.discs[lane];
        let (origin, lift) = starts[lane];
        for (k, i) in chunk.clone().enumerate() {
            let bit = 1 << lane;
            let needless = !group.on_ghost && query.samples[k].virtual_blocked & bit != 0;
            if needless || query.todo[k] & bit == 0 {
                continue;
            }
            let direction = disc.direction(frame.light_samples.point(i, query.rotations[lane]));
            query.n_rays[lane] += 1;
            buffers.rays.push(Ray {
                origin,
                direction,
                t_min: lift / direction.length().max(f32::MIN_POSITIVE),
                t_max: disc.t_max,
            });
            buffers.owners.push((g as u32, k as u8, lane as u8));
        }
    }
}

/// Tries to prove with one query for all lanes that there is no real occluder. After one group without a proof,
/// the other groups of the tile are not tried for this light: an occluder of one block usually reaches the next,
/// and a light beside a real surface never has a proof.
fn prove_clear(
    frame: &PreparedFrame<'_>,
    query: &mut LightQuery,
    starts: &[(Vec3A, f32); LANES],
    light: &CameraLight,
    buffers: &mut Buffers<'_>,
) {
    let asked = query.relevant & !query.clear_asked;
    // Modelled real objects may differ from the ghost surface.
    let may_ask = frame.settings.shadows.skip_proven && !frame.has_ghost_objects;
    if asked == 0 || !may_ask || buffers.light_unclear {
        return;
    }
    query.clear_asked |= asked;
    let (mut points, mut n, mut radius) = ([Vec3A::ZERO; LANES], 0, 0.0f32);
    for lane in LaneMask(asked) {
        let (origin, lift) = starts[lane];
        let (point, spread) = query.discs[lane].start_of_rays(origin, lift);
        points[n] = point;
        n += 1;
        radius = radius.max(spread);
    }
    if frame
        .sensed
        .ghost
        .is_unoccluded(&points[..n], radius, light.beam_end())
    {
        query.clear |= asked;
    } else {
        buffers.light_unclear = true;
    }
}

/// Traces the queued rays.
pub(crate) fn cast_real(
    frame: &PreparedFrame<'_>,
    groups: &mut [ShadowGroup],
    buffers: &mut Buffers<'_>,
) {
    let Buffers {
        rays,
        owners,
        blocked,
        ..
    } = buffers;
    blocked.clear();
    blocked.resize(rays.len(), false);
    frame.sensed.ghost.occluded_batch(rays, blocked);
    for ((ray, &(g, k, lane)), &blocked) in rays.iter().zip(&**owners).zip(&**blocked) {
        if blocked || (frame.has_ghost_objects && frame.scene.occluded(ray, MASK_GHOST)) {
            groups[g as usize].query.samples[usize::from(k)].real_blocked |= 1 << lane;
        }
    }
}
