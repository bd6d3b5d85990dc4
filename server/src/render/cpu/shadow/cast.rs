//! Light visibility of groups of points by RT2AR's adaptive soft shadows (section IV.E): five first samples per
//! light, its centre and four extremes of its visible disc; the rest only if these disagree.
//!
//! There are two kinds of points. On the *ghost surface* the result is Em / Er, the change that virtual objects
//! cause. Rays towards real occluders are cast only if a virtual object blocks the light; otherwise the ratio is
//! one, whatever the real occluders are. On a *virtual surface* the result is the share of direct light that
//! arrives past all occluders, virtual and real.
//!
//! The points of a group are close together. One query proves for a whole group that no virtual object can be
//! between it and a light ([`crate::accel::Tlas::may_intersect`]).

use glam::Vec3A;

use crate::render::cpu::lighting::Lighting;
use crate::render::cpu::photons::light::photon_share;
use crate::render::cpu::tile::PixelSet;
use crate::render::prepare::bsdf::ggx;
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::light::CameraLight;
use crate::render::prepare::light_samples::LightSamples;
use crate::render::prepare::mask::{
    MASK_GLASS, MASK_OPAQUE, MASK_SHADOW, MASK_SHADOW_ANY, MASK_SHEET, MASK_TRANSMISSIVE,
};
use crate::render::prepare::object::Transmissive;
use crate::render::settings::ShadowMethod;
use crate::simd::{LANES, LaneMask};

use super::group::{
    Buffers, CHUNK, CORNERS, Gloss, Sample, ShadowGroup, ShadowPoint, ShadowScratch,
};
use super::rays::{cast_real, cast_virtual, queue_real};

/// Computes the visibility for every group of `scratch`.
pub(crate) fn cast_shadows(
    frame: &PreparedFrame<'_>,
    lighting: &Lighting<'_>,
    scratch: &mut ShadowScratch,
) {
    let ShadowScratch {
        groups,
        n_groups,
        rays,
        owners,
        blocked,
        stats,
        ..
    } = scratch;
    let groups = &mut groups[..*n_groups];
    for group in groups.iter_mut() {
        (group.mixed, group.real) = ([Vec3A::ZERO; LANES], [Vec3A::ZERO; LANES]);
        group.gloss = [[Vec3A::ZERO; 2]; LANES];
        group.touched = group.lit;
        for answer in &mut group.answers {
            answer.penumbra = false;
        }
    }
    let mut buffers = Buffers {
        rays,
        owners,
        blocked,
        light_unclear: false,
    };
    for (l, light) in frame.lights.iter().enumerate() {
        if !frame.go_on() {
            return;
        }
        buffers.light_unclear = false;
        for group in groups.iter_mut() {
            start_light(frame, lighting, group, l, light);
        }
        cast_samples(frame, groups, light, &mut buffers);
        for group in groups.iter_mut() {
            sum_light(frame, group, light);
            group.query.count(stats);
        }
    }
    for group in groups {
        if !frame.go_on() {
            return;
        }
        answer(frame, lighting, group);
    }
}

/// Prepares a group for the samples of a light.
fn start_light(
    frame: &PreparedFrame<'_>,
    lighting: &Lighting<'_>,
    group: &mut ShadowGroup,
    l: usize,
    light: &CameraLight,
) {
    let query = &mut group.query;
    query.reset();
    if group.n == 0 || frame.settings.shadows.method == ShadowMethod::Off {
        return;
    }
    // A point on a virtual surface is inside its own shaft, so nothing can be proven.
    let all = u16::MAX;
    let unproven = match group.on_ghost {
        false => all,
        true if !group.lights.contains(l) => 0,
        true if !frame.settings.shadows.skip_proven => all,
        true => {
            let meets = |cluster: &u16| {
                let shaft = light.shaft(group.ball(*cluster));
                *cluster != 0 && frame.scene.tlas.may_intersect(&shaft, MASK_SHADOW_ANY)
            };
            group.clusters().into_iter().filter(meets).sum()
        }
    };
    // At points lit by photons the real light is needed even if no virtual object occludes it.
    let wanted = unproven | group.lit;
    if wanted == 0 {
        return;
    }
    let query = &mut group.query;
    for lane in LaneMask(wanted)
        .into_iter()
        .take_while(|&lane| lane < group.n)
    {
        let point = &group.points[lane];
        if !group.on_ghost && point.normal.dot(light.illuminate(point.origin).0) <= 0.0 {
            continue;
        }
        if let Some(disc) = light.disc(point.origin) {
            query.discs[lane] = disc;
            query.rotations[lane] = LightSamples::rotation(point.x, point.y);
            query.active |= 1 << lane;
        }
    }
    query.virtual_clear = unproven == 0;
    query.glass = frame.transmissive != Transmissive::None && group.glass.contains(l);
    let opaque = if group.on_ghost {
        MASK_SHADOW
    } else {
        MASK_OPAQUE
    };
    // With caustics, light refracted by glass arrives as photons.
    (query.stops, query.tints) = match lighting.photons {
        Some(_) => (opaque | MASK_GLASS, MASK_SHEET),
        None => (opaque, MASK_TRANSMISSIVE),
    };
    query.asked = query.active;
    query.touched = query.asked & group.lit;
}

/// Casts a light's samples from all groups: the first ones, then the rest from lanes whose first samples
/// disagree.
fn cast_samples(
    frame: &PreparedFrame<'_>,
    groups: &mut [ShadowGroup],
    light: &CameraLight,
    buffers: &mut Buffers<'_>,
) {
    let (n_first, n_all) = if light.is_extended() {
        (frame.light_samples.n_first, frame.light_samples.len())
    } else {
        (1, 1)
    };
    if n_first < n_all {
        cast_first(frame, groups, n_first, light, buffers);
    } else {
        cast_range(frame, groups, 0..n_first, light, buffers);
    }
    // A lane is done if all first samples agree, about virtual and about real occluders.
    let mut penumbra = PixelSet::default();
    for group in groups.iter_mut() {
        let query = &mut group.query;
        query.penumbra = query.asked & query.disagreement();
        // If no first sample is blocked by a real occluder, the remaining samples are assumed not to be either.
        query.real_lit_everywhere = query.ever_real_lit & !query.ever_real_blocked;
        for lane in LaneMask(query.penumbra)
            .into_iter()
            .filter(|_| group.on_ghost)
        {
            penumbra.insert(group.points[lane].x, group.points[lane].y);
        }
    }
    if frame.settings.shadows.method == ShadowMethod::AdaptiveNeighbours
        && n_first < n_all
        && penumbra != PixelSet::default()
    {
        cast_beside(frame, groups, &penumbra, light, buffers);
    }
    for group in groups.iter_mut() {
        group.query.active = group.query.penumbra;
    }
    if n_first < n_all && groups.iter().any(|group| group.query.active != 0) {
        cast_range(frame, groups, n_first..n_all, light, buffers);
    }
}

/// Finds penumbra that the first samples missed, on the real surface beside penumbra that they found: the outer
/// half of the remaining samples is cast there, and all of them only if these disagree.
fn cast_beside(
    frame: &PreparedFrame<'_>,
    groups: &mut [ShadowGroup],
    penumbra: &PixelSet,
    light: &CameraLight,
    buffers: &mut Buffers<'_>,
) {
    let near = penumbra.widened();
    for group in groups.iter_mut() {
        let query = &mut group.query;
        query.active = 0;
        for lane in LaneMask(query.asked & !query.penumbra)
            .into_iter()
            .filter(|_| group.on_ghost)
        {
            let ShadowPoint { x, y, .. } = group.points[lane];
            query.active |= u16::from(near.contains(x, y)) << lane;
        }
    }
    let outer = frame.light_samples.n_first..frame.light_samples.n_outer;
    cast_range(frame, groups, outer, light, buffers);
    for group in groups.iter_mut() {
        let query = &mut group.query;
        query.beside = query.active;
        query.penumbra |= query.beside & query.disagreement();
    }
}

/// Casts the first samples. A 4x4 block of pixels on one surface is probed: the light's centre from all sixteen
/// pixels, its extremes from the corners. If all agree, about virtual and about real occluders, that is the
/// result; otherwise every pixel casts the other samples too.
fn cast_first(
    frame: &PreparedFrame<'_>,
    groups: &mut [ShadowGroup],
    n_first: usize,
    light: &CameraLight,
    buffers: &mut Buffers<'_>,
) {
    let chunk = 0..n_first;
    buffers.clear();
    for (g, group) in groups.iter_mut().enumerate() {
        let (coherent, query) = (group.coherent, &mut group.query);
        if query.active == 0 {
            continue;
        }
        if !frame.go_on() {
            return;
        }
        query.samples[chunk.clone()].fill(Sample::OPEN);
        query.todo[..n_first].fill(query.active);
        if coherent {
            query.todo[1..n_first].fill(query.active & CORNERS);
        } else {
            let coarse = |lane: &usize| group.points[*lane].coarse;
            let coarse = LaneMask(query.active)
                .into_iter()
                .filter(coarse)
                .fold(0, |all, lane| all | 1 << lane);
            query.todo[1..n_first].fill(query.active & !coarse);
        }
        cast_virtual(frame, group, &chunk);
        let query = &mut group.query;
        if coherent && query.virtual_disagreement(&chunk) {
            query.rest_of(&chunk);
            cast_virtual(frame, group, &chunk);
        }
        let query = &mut group.query;
        for (todo, sample) in query.todo.iter_mut().zip(&query.samples[chunk.clone()]) {
            *todo = sample.cast;
        }
        queue_real(frame, group, g, &chunk, light, buffers);
    }
    cast_real(frame, groups, buffers);
    buffers.clear();
    for (g, group) in groups.iter_mut().enumerate() {
        let query = &mut group.query;
        if query.active != 0 && group.coherent && query.real_disagreement(&chunk) {
            query.rest_of(&chunk);
            cast_virtual(frame, group, &chunk);
            queue_real(frame, group, g, &chunk, light, buffers);
        }
    }
    cast_real(frame, groups, buffers);
    for group in groups.iter_mut().filter(|group| group.query.active != 0) {
        sum_samples(frame, group, &chunk);
    }
}

/// Casts the samples of `range` from the active lanes that have not cast them yet.
fn cast_range(
    frame: &PreparedFrame<'_>,
    groups: &mut [ShadowGroup],
    range: std::ops::Range<usize>,
    light: &CameraLight,
    buffers: &mut Buffers<'_>,
) {
    for start in range.clone().step_by(CHUNK) {
        let chunk = start..range.end.min(start + CHUNK);
        buffers.clear();
        for (g, group) in groups.iter_mut().enumerate() {
            let query = &mut group.query;
            if query.active != 0 {
                if !frame.go_on() {
                    return;
                }
                query.samples[..chunk.len()].fill(Sample::OPEN);
                for (todo, i) in query.todo.iter_mut().zip(chunk.clone()) {
                    let done = i < frame.light_samples.n_outer;
                    *todo = query.active & if done { !query.beside } else { u16::MAX };
                }
                cast_virtual(frame, group, &chunk);
                queue_real(frame, group, g, &chunk, light, buffers);
            }
        }
        cast_real(frame, groups, buffers);
        for group in groups.iter_mut().filter(|group| group.query.active != 0) {
            sum_samples(frame, group, &chunk);
        }
    }
}

/// Accumulates the samples of `chunk`.
fn sum_samples(frame: &PreparedFrame<'_>, group: &mut ShadowGroup, chunk: &std::ops::Range<usize>) {
    let query = &mut group.query;
    for (k, i) in chunk.clone().enumerate() {
        let weight = if frame.light_samples.len() == 1 {
            1.0
        } else {
            frame.light_samples.weight(i)
        };
        let sample = &query.samples[k];
        for lane in LaneMask(sample.cast) {
            query.weight[lane] += weight;
        }
        for lane in LaneMask(sample.cast & !sample.real_blocked) {
            query.real_lit[lane] += weight;
            if sample.virtual_blocked & (1 << lane) == 0 {
                let tint = if sample.tinted & (1 << lane) == 0 {
                    Vec3A::ONE
                } else {
                    frame.scene.objects[sample.glass[lane] as usize].shadow_tint
                };
                query.mixed_lit[lane] += tint * weight;
            }
        }
        let blocked = sample.virtual_blocked | sample.tinted | sample.real_blocked;
        query.ever_blocked |= blocked & sample.cast;
        query.ever_lit |= !blocked & sample.cast;
        query.ever_real_blocked |= sample.real_blocked;
        query.ever_real_lit |= !sample.real_blocked & sample.cast & query.relevant;
    }
}

/// Irradiance from a light without occlusion.
fn cosine_irradiance(light: &CameraLight, point: &ShadowPoint) -> Vec3A {
    let (to_light, e) = light.illuminate(point.origin);
    e * point.normal.dot(to_light).max(0.0)
}

/// Weight of a light's highlight on a virtual surface, per irradiance.
fn gloss_weight(light: &CameraLight, point: &ShadowPoint) -> f32 {
    let Gloss { incoming, alpha } = point.gloss;
    let (to_light, _) = light.illuminate(point.origin);
    let (n_dot_v, n_dot_l) = (-incoming.dot(point.normal), to_light.dot(point.normal));
    let half = (to_light - incoming).try_normalize();
    match half.filter(|_| n_dot_v > 0.0 && n_dot_l > 0.0 && alpha > 0.0) {
        Some(h) => {
            let widened = light.widened_alpha(point.origin, alpha);
            ggx(n_dot_v, n_dot_l, point.normal.dot(h).max(0.0), widened)
        }
        None => 0.0,
    }
}

/// Adds the share of one light to a group's sums.
fn sum_light(frame: &PreparedFrame<'_>, group: &mut ShadowGroup, light: &CameraLight) {
    let query = &group.query;
    group.touched |= query.touched;
    for lane in LaneMask(query.penumbra) {
        group.answers[lane].penumbra = true;
    }
    let counted = if group.on_ghost {
        query.touched
    } else {
        (u32::MAX >> (32 - LANES)) as u16
    };
    for lane in LaneMask(counted)
        .into_iter()
        .take_while(|&lane| lane < group.n)
    {
        let (mixed, real) = if query.asked & (1 << lane) == 0 {
            (Vec3A::ONE, 1.0)
        } else {
            let total = query.weight[lane];
            (
                (query.mixed_lit[lane] / total).min(Vec3A::ONE),
                (query.real_lit[lane] / total).min(1.0),
            )
        };
        let e = cosine_irradiance(light, &group.points[lane]);
        if group.on_ghost {
            // The light that virtual and real occluders remove; the unoccluded sum is added at the end.
            group.mixed[lane] += e * (mixed - Vec3A::splat(real));
            group.real[lane] += e * (real - 1.0);
        } else {
            group.mixed[lane] += e * mixed;
            group.real[lane] += e;
            // With a single lamp, the share of its highlight equals that of the diffuse light.
            if frame.lights.len() > 1 {
                let mirrored = e * gloss_weight(light, &group.points[lane]);
                group.gloss[lane][0] += mirrored * mixed;
                group.gloss[lane][1] += mirrored;
            }
        }
    }
}

/// Computes the results of a group whose lights have all been summed.
fn answer(frame: &PreparedFrame<'_>, lighting: &Lighting<'_>, group: &mut ShadowGroup) {
    for (lane, point) in group.points[..group.n].iter().enumerate() {
        if group.on_ghost && group.touched & (1 << lane) == 0 {
            continue;
        }
        let (mixed, real) = (group.mixed[lane], group.real[lane]);
        let ambient = &group.ambient[lane];
        let [gloss, all_gloss] = group.gloss[lane];
        group.answers[lane].share = if !group.on_ghost {
            ratio(mixed, real)
        } else {
            let mut all = lighting.surroundings.irradiance(point.normal);
            for light in frame.lights {
                all += cosine_irradiance(light, point);
            }
            let er = all + real;
            let mut shadow = ratio(er + mixed, er);
            if ambient.delta != Vec3A::ZERO {
                let change = ambient.delta / er.max(Vec3A::splat(f32::MIN_POSITIVE));
                shadow = (shadow + change).max(Vec3A::ZERO);
            }
            if group.lit & (1 << lane) == 0 {
                shadow
            } else {
                let added = photon_share(&frame.sensed, group.photons[lane], er, point.x, point.y);
                (shadow + added).max(Vec3A::ZERO)
            }
        };
        group.answers[lane].gloss = if all_gloss == Vec3A::ZERO {
            group.answers[lane].share
        } else {
            ratio(gloss, all_gloss)
        };
    }
}

/// Channel-wise a / b; one where both are zero.
fn ratio(a: Vec3A, b: Vec3A) -> Vec3A {
    Vec3A::select(
        b.cmpgt(Vec3A::ZERO),
        (a / b.max(Vec3A::splat(f32::MIN_POSITIVE))).clamp(Vec3A::ZERO, Vec3A::ONE),
        Vec3A::ONE,
    )
}
