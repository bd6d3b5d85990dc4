//! Light visibility by RT2AR's adaptive soft shadows (section IV.E): five first samples per light,
//! its centre and four extremes of its visible disc; only where they disagree the rest.
//!
//! Two kinds of point are asked about. On the *ghost surface* the answer is Em / Er, the change
//! that virtual objects cause: rays towards real occluders are cast only where something virtual
//! blocks the light, for elsewhere the ratio is one whatever is real. On a *virtual surface* it is
//! the share of direct light that arrives past everything, virtual and real.
//!
//! Points are asked about in groups that lie close together, and a light that a whole group is
//! proven to see past everything virtual costs one question ([`crate::accel::Tlas::may_meet`]).

use glam::Vec3A;

use crate::render::{FrameStats, ShadowMethod};

use super::FrameContext;
use super::MASK_VIRTUAL_ANY;
use super::light::CameraLight;
use super::pattern::LightPattern;
use super::shadow_group::{
    Buffers, CHUNK, CORNERS, LANES, PixelSet, Sample, ShadowGroup, ShadowPoint, ShadowScratch,
    lanes,
};
use super::tile::{PixelLight, Seen, Tile};

/// Fills `tile.light` for every lit surface of the tile.
pub(super) fn trace_tile(ctx: &FrameContext<'_>, tile: &mut Tile, scratch: &mut ShadowScratch) {
    tile.light.fill(PixelLight::default());
    tile.has_penumbra = false;
    scratch.stats = FrameStats::default();
    tile.shadow_stats = scratch.stats;
    if ctx.settings.shadows.method == ShadowMethod::Off || ctx.lights.is_empty() {
        return;
    }
    scratch.clear();
    for (bx, by) in tile.blocks() {
        let pixels = (0..16)
            .map(|lane| (bx + lane % 4, by + lane / 4))
            .filter(|&(dx, dy)| dx < tile.width && dy < tile.height);
        if !tile.lights.is_empty() {
            let group = scratch.group(true, tile.lights);
            for (dx, dy) in pixels.clone() {
                if let Some(point) = ctx.ghost_point(tile.x0 + dx, tile.y0 + dy) {
                    group.push(point);
                }
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
                ctx.surface(&pixel.hit, ctx.ray_direction(x as f32, y as f32))
                    .shadow_point(x, y)
            })
        });
        scratch.object_block(lit, ctx.settings.ghost.edge_relative);
    }
    ctx.cast_shadows(scratch);
    for group in scratch.groups() {
        for (point, answer) in group.answered() {
            let light = &mut tile.light[Tile::index(point.x - tile.x0, point.y - tile.y0)];
            if group.on_ghost {
                light.ghost = answer.share;
                light.ghost_penumbra = answer.penumbra;
            } else {
                light.object = answer.share;
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
        } = scratch;
        let groups = &mut groups[..*n_groups];
        for group in groups.iter_mut() {
            (group.mixed, group.real) = ([Vec3A::ZERO; LANES], [Vec3A::ZERO; LANES]);
            group.touched = 0;
            for answer in &mut group.answers {
                answer.penumbra = false;
            }
        }
        let mut buffers = Buffers {
            rays,
            owners,
            blocked,
        };
        for (l, light) in self.lights.iter().enumerate() {
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
            self.answer(group);
        }
    }

    /// Prepares a group for the samples of a light.
    fn start_light(&self, group: &mut ShadowGroup, l: usize, light: &CameraLight) {
        let cast = &mut group.cast;
        cast.reset();
        if group.n == 0 || (group.on_ghost && !group.lights.contains(l)) {
            return;
        }
        // A point on a virtual surface is in the way of its own shaft.
        if group.on_ghost
            && self.settings.shadows.skip_proven
            && !self
                .tlas
                .may_meet(&light.shaft(group.ball()), MASK_VIRTUAL_ANY)
        {
            return;
        }
        let cast = &mut group.cast;
        for (lane, point) in group.points[..group.n].iter().enumerate() {
            if !group.on_ghost && point.normal.dot(light.illuminate(point.origin).0) <= 0.0 {
                continue;
            }
            if let Some(disc) = light.disc(point.origin) {
                cast.discs[lane] = disc;
                cast.rotations[lane] = LightPattern::rotation(point.x, point.y);
                cast.active |= 1 << lane;
            }
        }
        cast.asked = cast.active;
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
            self.cast_first(groups, n_first, buffers);
        } else {
            self.cast_range(groups, 0..n_first, buffers);
        }
        // A lane is decided if every first sample says the same, of virtual and of real things.
        let mut penumbra = PixelSet::default();
        for group in groups.iter_mut() {
            let cast = &mut group.cast;
            cast.penumbra = cast.asked & cast.disagreement();
            for lane in lanes(cast.penumbra).filter(|_| group.on_ghost) {
                penumbra.insert(group.points[lane].x, group.points[lane].y);
            }
        }
        let widens = self.settings.shadows.method == ShadowMethod::AdaptiveNeighbours;
        let beside = penumbra.widened();
        let mut any = false;
        for group in groups.iter_mut() {
            let cast = &mut group.cast;
            if widens && group.on_ghost && penumbra != PixelSet::default() {
                for lane in lanes(cast.asked & !cast.penumbra) {
                    let ShadowPoint { x, y, .. } = group.points[lane];
                    cast.penumbra |= u16::from(beside.contains(x, y)) << lane;
                }
            }
            // Where no first sample meets anything real, the rest are taken not to either.
            cast.real_lit_everywhere = cast.ever_real_lit & !cast.ever_real_blocked;
            cast.active = cast.penumbra;
            any |= cast.active != 0;
        }
        if any && n_first < n_all {
            self.cast_range(groups, n_first..n_all, buffers);
        }
    }

    /// Casts the first samples. A 4x4 block of pixels on one surface is probed: the light's centre
    /// from all sixteen, its extremes from the corners. If all say the same, of virtual and of real
    /// things, that is the answer; else every pixel casts the others too.
    fn cast_first(&self, groups: &mut [ShadowGroup], n_first: usize, buffers: &mut Buffers<'_>) {
        let chunk = 0..n_first;
        buffers.clear();
        for (g, group) in groups.iter_mut().enumerate() {
            let (coherent, cast) = (group.coherent, &mut group.cast);
            if cast.active == 0 {
                continue;
            }
            cast.samples[chunk.clone()].fill(Sample::OPEN);
            cast.todo[..n_first].fill(cast.active);
            if coherent {
                cast.todo[1..n_first].fill(cast.active & CORNERS);
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
            self.queue_real(group, g, &chunk, buffers);
        }
        self.cast_real(groups, buffers);
        buffers.clear();
        for (g, group) in groups.iter_mut().enumerate() {
            let cast = &mut group.cast;
            if cast.active != 0 && group.coherent && cast.real_disagreement(&chunk) {
                cast.rest_of(&chunk);
                self.cast_virtual(group, &chunk);
                self.queue_real(group, g, &chunk, buffers);
            }
        }
        self.cast_real(groups, buffers);
        for group in groups.iter_mut().filter(|group| group.cast.active != 0) {
            self.sum_samples(group, &chunk);
        }
    }

    /// Casts the samples of `range` from the active lanes.
    fn cast_range(
        &self,
        groups: &mut [ShadowGroup],
        range: std::ops::Range<usize>,
        buffers: &mut Buffers<'_>,
    ) {
        for start in range.clone().step_by(CHUNK) {
            let chunk = start..range.end.min(start + CHUNK);
            buffers.clear();
            for (g, group) in groups.iter_mut().enumerate() {
                let cast = &mut group.cast;
                if cast.active != 0 {
                    cast.samples[..chunk.len()].fill(Sample::OPEN);
                    cast.todo[..chunk.len()].fill(cast.active);
                    self.cast_virtual(group, &chunk);
                    self.queue_real(group, g, &chunk, buffers);
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
            }
        }
    }

    /// The answers of a group whose lights are all summed up.
    fn answer(&self, group: &mut ShadowGroup) {
        for (lane, point) in group.points[..group.n].iter().enumerate() {
            let (mixed, real) = (group.mixed[lane], group.real[lane]);
            group.answers[lane].share = if !group.on_ghost {
                ratio(mixed, real)
            } else if group.touched & (1 << lane) == 0 {
                Vec3A::ONE
            } else {
                let mut all = self.surroundings.irradiance(point.normal);
                for light in self.lights {
                    all += self.cosine_irradiance(light, point);
                }
                let er = all + real;
                ratio(er + mixed, er)
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
