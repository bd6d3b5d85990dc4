//! Light visibility by RT2AR's adaptive soft shadows (section IV.E): five first samples per light,
//! its centre and four extremes of its visible disc; only where they disagree the rest.
//!
//! Two kinds of point are asked about. On the *ghost surface* the answer is Em / Er, the change
//! that virtual objects cause: rays towards real occluders are cast only where something virtual
//! blocks the light, for elsewhere the ratio is one whatever is real. On a *virtual surface* it is
//! the share of direct light that arrives past everything, virtual and real.
//!
//! Points are asked about in groups that lie close together, and a light that a whole group is
//! proven to see past everything virtual costs one question ([`crate::accel::Tlas::may_intersect`]).

use glam::Vec3A;

use crate::render::{FrameStats, ShadowMethod};

use super::FrameContext;
use super::MASK_SHADOW_ANY;
use super::bsdf::ggx;
use super::context::Glass;
use super::light::CameraLight;
use super::pattern::LightPattern;
use super::shadow_group::{
    Buffers, CHUNK, CORNERS, Gloss, LANES, PixelSet, Sample, ShadowGroup, ShadowPoint,
    ShadowScratch, lanes,
};
use super::tile::{PixelLight, Seen, Tile};

/// Fills `tile.light` for every lit surface of the tile.
pub(super) fn trace_tile(
    ctx: &FrameContext<'_>,
    tile: &mut Tile,
    slot: usize,
    scratch: &mut ShadowScratch,
) {
    tile.has_penumbra = false;
    tile.is_relit = false;
    tile.shadow_stats = FrameStats::default();
    tile.only_ambient = !tile.sees_objects && tile.lights.is_empty() && !tile.has_photons;
    if tile.only_ambient {
        tile.is_relit = ctx.has_ambient(slot);
        return;
    }
    for (place, light) in tile.light.iter_mut().enumerate() {
        *light = PixelLight {
            ghost: ctx.ambient_share(slot, place),
            ..PixelLight::default()
        };
    }
    tile.is_relit = tile.light.iter().any(|light| light.ghost != Vec3A::ONE);
    scratch.stats = FrameStats::default();
    let off = ctx.settings.shadows.method == ShadowMethod::Off;
    if (off && !tile.has_photons) || ctx.lights.is_empty() || !ctx.go_on() {
        return;
    }
    scratch.clear();
    let mut photons = std::mem::take(&mut scratch.photons);
    ctx.gather_tile(tile, &mut photons);
    for (bx, by) in tile.blocks() {
        let pixels = (0..16)
            .map(|lane| (bx + lane % 4, by + lane / 4))
            .filter(|&(dx, dy)| dx < tile.width && dy < tile.height);
        if !tile.lights.is_empty() || tile.has_photons {
            let group = scratch.group(true, tile.lights, tile.glass);
            for (dx, dy) in pixels.clone() {
                let Some(mut point) = ctx.ghost_point(tile.x0 + dx, tile.y0 + dy) else {
                    continue;
                };
                let place = Tile::index(dx, dy);
                let ambient = ctx.ambient_at(slot, place);
                point.normal = ambient.normal;
                match photons.at(place) {
                    None => group.push(point),
                    Some((e, normal)) => {
                        point.normal = normal;
                        group.push_lit(point, e);
                    }
                }
                group.set_ambient(ambient);
            }
            group.coherent = group.is_one_surface(ctx.settings.ghost.edge_relative);
        }
        let lit = pixels.filter_map(|(dx, dy)| {
            let pixel = &tile.pixels[Tile::index(dx, dy)];
            // Each lens ray asks for itself.
            let lit = !tile.lens.rays
                && pixel.seen == Seen::Object
                && ctx.objects[pixel.hit.instance as usize].needs_light;
            lit.then(|| {
                let (x, y) = (tile.x0 + dx, tile.y0 + dy);
                ctx.primary_surface(&pixel.hit, x, y).shadow_point(x, y)
            })
        });
        scratch.object_block(lit, ctx.settings.ghost.edge_relative);
    }
    scratch.photons = photons;
    ctx.cast_shadows(scratch);
    for group in scratch.groups() {
        // Where no lamp's light changes, the share of ambient light is there already.
        let answered = group.answered().enumerate();
        let asked = answered.filter(|(lane, _)| !group.on_ghost || group.touched & 1 << lane != 0);
        for (_, (point, answer)) in asked {
            let light = &mut tile.light[Tile::index(point.x - tile.x0, point.y - tile.y0)];
            if group.on_ghost {
                light.ghost = answer.share;
                tile.is_relit |= answer.share != Vec3A::ONE;
                light.ghost_penumbra = answer.penumbra;
            } else {
                light.object = answer.of_object();
                light.object_penumbra = answer.penumbra;
            }
            tile.has_penumbra |= answer.penumbra;
        }
    }
    tile.shadow_stats = scratch.stats;
}

impl FrameContext<'_> {
    /// The ghost surface at a pixel as a shadow point; `None` in a hole.
    fn ghost_point(&self, x: u32, y: u32) -> Option<ShadowPoint> {
        let z = self.occlusion_depth[y as usize * self.frame.color.width as usize + x as usize];
        if z.is_nan() {
            return None;
        }
        Some(ShadowPoint {
            origin: self.ray_direction(x as f32, y as f32) * z,
            normal: Vec3A::ZERO,
            gloss: Gloss::default(),
            coarse: false,
            x,
            y,
        })
    }

    /// Answers every group of `scratch`.
    pub(super) fn cast_shadows(&self, scratch: &mut ShadowScratch) {
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
        for (l, light) in self.lights.iter().enumerate() {
            if !self.go_on() {
                return;
            }
            buffers.light_unclear = false;
            for group in groups.iter_mut() {
                self.start_light(group, l, light);
            }
            self.cast_samples(groups, light, &mut buffers);
            for group in groups.iter_mut() {
                self.sum_light(group, light);
                group.cast.count(stats);
            }
        }
        for group in groups {
            if !self.go_on() {
                return;
            }
            self.answer(group);
        }
    }

    /// Prepares a group for the samples of a light.
    fn start_light(&self, group: &mut ShadowGroup, l: usize, light: &CameraLight) {
        let cast = &mut group.cast;
        cast.reset();
        if group.n == 0 || self.settings.shadows.method == ShadowMethod::Off {
            return;
        }
        // A point on a virtual surface is in the way of its own shaft.
        let all = u16::MAX;
        let unproven = match group.on_ghost {
            false => all,
            true if !group.lights.contains(l) => 0,
            true if !self.settings.shadows.skip_proven => all,
            true => {
                let meets = |sheet: &u16| {
                    let shaft = light.shaft(group.ball(*sheet));
                    *sheet != 0 && self.tlas.may_intersect(&shaft, MASK_SHADOW_ANY)
                };
                group.sheets().into_iter().filter(meets).sum()
            }
        };
        // Where photons fall, real light is wanted though nothing virtual takes of it.
        let wanted = unproven | group.lit;
        if wanted == 0 {
            return;
        }
        let cast = &mut group.cast;
        for lane in lanes(wanted).take_while(|&lane| lane < group.n) {
            let point = &group.points[lane];
            if !group.on_ghost && point.normal.dot(light.illuminate(point.origin).0) <= 0.0 {
                continue;
            }
            if let Some(disc) = light.disc(point.origin) {
                cast.discs[lane] = disc;
                cast.rotations[lane] = LightPattern::rotation(point.x, point.y);
                cast.active |= 1 << lane;
            }
        }
        cast.virtual_clear = unproven == 0;
        cast.glass = self.glass != Glass::None && group.glass.contains(l);
        cast.asked = cast.active;
        cast.touched = cast.asked & group.lit;
    }

    /// Casts a light's samples from all groups: the first ones, then the rest from where those
    /// disagree.
    fn cast_samples(
        &self,
        groups: &mut [ShadowGroup],
        light: &CameraLight,
        buffers: &mut Buffers<'_>,
    ) {
        let (n_first, n_all) = if light.is_extended() {
            (self.pattern.n_first, self.pattern.len())
        } else {
            (1, 1)
        };
        if n_first < n_all {
            self.cast_first(groups, n_first, light, buffers);
        } else {
            self.cast_range(groups, 0..n_first, light, buffers);
        }
        // A lane is decided if every first sample says the same, of virtual and of real things.
        let mut penumbra = PixelSet::default();
        for group in groups.iter_mut() {
            let cast = &mut group.cast;
            cast.penumbra = cast.asked & cast.disagreement();
            // Where no first sample meets anything real, the rest are taken not to either.
            cast.real_lit_everywhere = cast.ever_real_lit & !cast.ever_real_blocked;
            for lane in lanes(cast.penumbra).filter(|_| group.on_ghost) {
                penumbra.insert(group.points[lane].x, group.points[lane].y);
            }
        }
        if self.settings.shadows.method == ShadowMethod::AdaptiveNeighbours
            && n_first < n_all
            && penumbra != PixelSet::default()
        {
            self.cast_beside(groups, &penumbra, light, buffers);
        }
        for group in groups.iter_mut() {
            group.cast.active = group.cast.penumbra;
        }
        if n_first < n_all && groups.iter().any(|group| group.cast.active != 0) {
            self.cast_range(groups, n_first..n_all, light, buffers);
        }
    }

    /// Finds penumbra that the first samples missed, on the real surface beside what they found: the
    /// outer half of the rest is cast there, and only where it disagrees all.
    fn cast_beside(
        &self,
        groups: &mut [ShadowGroup],
        penumbra: &PixelSet,
        light: &CameraLight,
        buffers: &mut Buffers<'_>,
    ) {
        let near = penumbra.widened();
        for group in groups.iter_mut() {
            let cast = &mut group.cast;
            cast.active = 0;
            for lane in lanes(cast.asked & !cast.penumbra).filter(|_| group.on_ghost) {
                let ShadowPoint { x, y, .. } = group.points[lane];
                cast.active |= u16::from(near.contains(x, y)) << lane;
            }
        }
        let outer = self.pattern.n_first..self.pattern.n_outer;
        self.cast_range(groups, outer, light, buffers);
        for group in groups.iter_mut() {
            let cast = &mut group.cast;
            cast.beside = cast.active;
            cast.penumbra |= cast.beside & cast.disagreement();
        }
    }

    /// Casts the first samples. A 4x4 block of pixels on one surface is probed: the light's centre
    /// from all sixteen, its extremes from the corners. If all say the same, of virtual and of real
    /// things, that is the answer; else every pixel casts the others too.
    fn cast_first(
        &self,
        groups: &mut [ShadowGroup],
        n_first: usize,
        light: &CameraLight,
        buffers: &mut Buffers<'_>,
    ) {
        let chunk = 0..n_first;
        buffers.clear();
        for (g, group) in groups.iter_mut().enumerate() {
            let (coherent, cast) = (group.coherent, &mut group.cast);
            if cast.active == 0 {
                continue;
            }
            if !self.go_on() {
                return;
            }
            cast.samples[chunk.clone()].fill(Sample::OPEN);
            cast.todo[..n_first].fill(cast.active);
            if coherent {
                cast.todo[1..n_first].fill(cast.active & CORNERS);
            } else {
                let coarse = |lane: &usize| group.points[*lane].coarse;
                let coarse = lanes(cast.active)
                    .filter(coarse)
                    .fold(0, |all, lane| all | 1 << lane);
                cast.todo[1..n_first].fill(cast.active & !coarse);
            }
            self.cast_virtual(group, &chunk);
            let cast = &mut group.cast;
            if coherent && cast.virtual_disagreement(&chunk) {
                cast.rest_of(&chunk);
                self.cast_virtual(group, &chunk);
            }
            let cast = &mut group.cast;
            for (todo, sample) in cast.todo.iter_mut().zip(&cast.samples[chunk.clone()]) {
                *todo = sample.cast;
            }
            self.queue_real(group, g, &chunk, light, buffers);
        }
        self.cast_real(groups, buffers);
        buffers.clear();
        for (g, group) in groups.iter_mut().enumerate() {
            let cast = &mut group.cast;
            if cast.active != 0 && group.coherent && cast.real_disagreement(&chunk) {
                cast.rest_of(&chunk);
                self.cast_virtual(group, &chunk);
                self.queue_real(group, g, &chunk, light, buffers);
            }
        }
        self.cast_real(groups, buffers);
        for group in groups.iter_mut().filter(|group| group.cast.active != 0) {
            self.sum_samples(group, &chunk);
        }
    }

    /// Casts the samples of `range` from the active lanes that have not cast them.
    fn cast_range(
        &self,
        groups: &mut [ShadowGroup],
        range: std::ops::Range<usize>,
        light: &CameraLight,
        buffers: &mut Buffers<'_>,
    ) {
        for start in range.clone().step_by(CHUNK) {
            let chunk = start..range.end.min(start + CHUNK);
            buffers.clear();
            for (g, group) in groups.iter_mut().enumerate() {
                let cast = &mut group.cast;
                if cast.active != 0 {
                    if !self.go_on() {
                        return;
                    }
                    cast.samples[..chunk.len()].fill(Sample::OPEN);
                    for (todo, i) in cast.todo.iter_mut().zip(chunk.clone()) {
                        let done = i < self.pattern.n_outer;
                        *todo = cast.active & if done { !cast.beside } else { u16::MAX };
                    }
                    self.cast_virtual(group, &chunk);
                    self.queue_real(group, g, &chunk, light, buffers);
                }
            }
            self.cast_real(groups, buffers);
            for group in groups.iter_mut().filter(|group| group.cast.active != 0) {
                self.sum_samples(group, &chunk);
            }
        }
    }

    /// Adds the samples of `chunk` up.
    fn sum_samples(&self, group: &mut ShadowGroup, chunk: &std::ops::Range<usize>) {
        let cast = &mut group.cast;
        for (k, i) in chunk.clone().enumerate() {
            let weight = if self.pattern.len() == 1 {
                1.0
            } else {
                self.pattern.weight(i)
            };
            let sample = &cast.samples[k];
            for lane in lanes(sample.cast) {
                cast.weight[lane] += weight;
            }
            for lane in lanes(sample.cast & !sample.real_blocked) {
                cast.real_lit[lane] += weight;
                if sample.virtual_blocked & (1 << lane) == 0 {
                    let tint = if sample.tinted & (1 << lane) == 0 {
                        Vec3A::ONE
                    } else {
                        self.objects[sample.glass[lane] as usize].shadow_tint
                    };
                    cast.mixed_lit[lane] += tint * weight;
                }
            }
            let blocked = sample.virtual_blocked | sample.tinted | sample.real_blocked;
            cast.ever_blocked |= blocked & sample.cast;
            cast.ever_lit |= !blocked & sample.cast;
            cast.ever_real_blocked |= sample.real_blocked;
            cast.ever_real_lit |= !sample.real_blocked & sample.cast & cast.relevant;
        }
    }

    /// Irradiance from a light without occlusion.
    fn cosine_irradiance(&self, light: &CameraLight, point: &ShadowPoint) -> Vec3A {
        let (to_light, e) = light.illuminate(point.origin);
        e * point.normal.dot(to_light).max(0.0)
    }

    /// How much of a light's highlight a virtual surface shows, per irradiance.
    fn gloss_weight(&self, light: &CameraLight, point: &ShadowPoint) -> f32 {
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

    /// Adds one light's share to a group's sums.
    fn sum_light(&self, group: &mut ShadowGroup, light: &CameraLight) {
        let cast = &group.cast;
        group.touched |= cast.touched;
        for lane in lanes(cast.penumbra) {
            group.answers[lane].penumbra = true;
        }
        let counted = if group.on_ghost {
            cast.touched
        } else {
            (u32::MAX >> (32 - LANES)) as u16
        };
        for lane in lanes(counted).take_while(|&lane| lane < group.n) {
            let (mixed, real) = if cast.asked & (1 << lane) == 0 {
                (Vec3A::ONE, 1.0)
            } else {
                let total = cast.weight[lane];
                (
                    (cast.mixed_lit[lane] / total).min(Vec3A::ONE),
                    (cast.real_lit[lane] / total).min(1.0),
                )
            };
            let e = self.cosine_irradiance(light, &group.points[lane]);
            if group.on_ghost {
                // What each takes away; what remains of the sum is added in the end.
                group.mixed[lane] += e * (mixed - Vec3A::splat(real));
                group.real[lane] += e * (real - 1.0);
            } else {
                group.mixed[lane] += e * mixed;
                group.real[lane] += e;
                // One lamp's highlight has as much of it as all else.
                if self.lights.len() > 1 {
                    let mirrored = e * self.gloss_weight(light, &group.points[lane]);
                    group.gloss[lane][0] += mirrored * mixed;
                    group.gloss[lane][1] += mirrored;
                }
            }
        }
    }

    /// The answers of a group whose lights are all summed up.
    fn answer(&self, group: &mut ShadowGroup) {
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
                let mut all = self.surroundings.irradiance(point.normal);
                for light in self.lights {
                    all += self.cosine_irradiance(light, point);
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
                    let added = self.photon_share(group.photons[lane], er, point.x, point.y);
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
}

/// Channel-wise a / b, one where nothing arrives either way.
fn ratio(a: Vec3A, b: Vec3A) -> Vec3A {
    Vec3A::select(
        b.cmpgt(Vec3A::ZERO),
        (a / b.max(Vec3A::splat(f32::MIN_POSITIVE))).clamp(Vec3A::ZERO, Vec3A::ONE),
        Vec3A::ONE,
    )
}
