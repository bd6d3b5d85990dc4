//! Light visibility by RT2AR's adaptive soft shadows (section IV.E): five first samples per light,
//! its centre and four extremes of its visible disc; only where they disagree the rest.
//!
//! Two kinds of point are asked about. On the *ghost surface* the answer is Em / Er, the change
//! that virtual objects cause: rays towards real occluders are cast only where something virtual
//! blocks the light, for elsewhere the ratio is one whatever is real. On a *virtual surface* it is
//! the share of direct light that arrives past everything, virtual and real.

use glam::Vec3A;

use crate::accel::{HitPacket, Ray, RayPacket};
use crate::frame::depth_sigma_m;
use crate::render::ShadowMethod;

use super::FrameContext;
use super::light::{CameraLight, LightDisc, LightPattern};
use super::plan::Occluders;
use super::tile::{PixelLight, Seen, Tile};

/// Lanes of a packet.
const LANES: usize = 16;

/// A point whose light is asked for.
#[derive(Debug, Clone, Copy)]
pub(super) struct ShadowPoint {
    /// Where rays start, already lifted off its own surface by the rounding error of the point.
    pub(super) origin: Vec3A,
    /// Unit normal; for ghost points found only when needed.
    pub(super) normal: Vec3A,
    /// Pixel, for the pattern's rotation and the ghost normal.
    pub(super) x: u32,
    pub(super) y: u32,
    pub(super) on_ghost: bool,
}

impl Default for ShadowPoint {
    fn default() -> Self {
        Self { origin: Vec3A::ZERO, normal: Vec3A::ZERO, x: 0, y: 0, on_ghost: false }
    }
}

/// Answer for one point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Visibility {
    /// Em / Er on the ghost surface; lit share of direct light on a virtual one.
    pub(super) share: Vec3A,
    pub(super) penumbra: bool,
}

/// Visibility of one light from up to sixteen points.
struct LightVisibility {
    /// Past everything.
    mixed: [Vec3A; LANES],
    /// Past real things only; exact only where `mixed` is not all ones.
    real: [f32; LANES],
    penumbra: u16,
    /// Lanes where something virtual takes light away.
    touched: u16,
}

/// Fills `tile.light` for every lit surface of the tile.
pub(super) fn trace_tile(ctx: &FrameContext<'_>, tile: &mut Tile, scratch: &mut ShadowScratch) {
    tile.light.fill(PixelLight::default());
    tile.has_penumbra = false;
    scratch.n_rays = 0;
    tile.shadow_rays = 0;
    if ctx.settings.shadows.method == ShadowMethod::Off || ctx.lights.is_empty() {
        return;
    }
    let mut points = [ShadowPoint::default(); LANES];
    let mut places = [0usize; LANES];
    for (bx, by) in tile.blocks() {
        if !tile.occluders.is_empty() {
            let mut n = 0;
            for lane in 0..16 {
                let (dx, dy) = (bx + lane % 4, by + lane / 4);
                let (x, y) = (tile.x0 + dx, tile.y0 + dy);
                if dx >= tile.width || dy >= tile.height {
                    continue;
                }
                if let Some(point) = ctx.ghost_point(x, y) {
                    points[n] = point;
                    places[n] = Tile::index(dx, dy);
                    n += 1;
                }
            }
            let answers = ctx.visibility(&mut points[..n], tile.occluders, scratch);
            for (answer, &place) in answers[..n].iter().zip(&places) {
                tile.light[place].ghost = answer.share;
                tile.light[place].ghost_penumbra = answer.penumbra;
                tile.has_penumbra |= answer.penumbra;
            }
        }
        let mut n = 0;
        for lane in 0..16 {
            let (dx, dy) = (bx + lane % 4, by + lane / 4);
            let place = Tile::index(dx, dy);
            if dx >= tile.width || dy >= tile.height || tile.pixels[place].seen != Seen::Object {
                continue;
            }
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            let hit = tile.pixels[place].hit;
            if ctx.objects[hit.instance as usize].needs_light {
                let surface = ctx.surface(&hit, ctx.ray_direction(x as f32, y as f32));
                points[n] = surface.shadow_point(x, y);
                places[n] = place;
                n += 1;
            }
        }
        let answers = ctx.visibility(&mut points[..n], Occluders::ALL, scratch);
        for (answer, &place) in answers[..n].iter().zip(&places) {
            tile.light[place].object = answer.share;
            tile.light[place].object_penumbra = answer.penumbra;
            tile.has_penumbra |= answer.penumbra;
        }
    }
    tile.shadow_rays = scratch.n_rays;
}

impl FrameContext<'_> {
    /// The ghost surface at a pixel as a shadow point; `None` in a hole.
    fn ghost_point(&self, x: u32, y: u32) -> Option<ShadowPoint> {
        let z = self.occlusion_depth[y as usize * self.frame.color.width as usize + x as usize];
        if z.is_nan() {
            return None;
        }
        let origin = self.ray_direction(x as f32, y as f32) * z;
        Some(ShadowPoint { origin, normal: Vec3A::ZERO, x, y, on_ghost: true })
    }

    /// Light at up to sixteen points, which only `occluders` may shade.
    pub(super) fn visibility(&self, points: &mut [ShadowPoint], occluders: Occluders, scratch: &mut ShadowScratch) -> [Visibility; LANES] {
        let mut answers = [Visibility { share: Vec3A::ONE, penumbra: false }; LANES];
        if points.is_empty() {
            return answers;
        }
        // Sums of irradiance with everything, with real things only, and unshadowed.
        let mut mixed = [Vec3A::ZERO; LANES];
        let mut real = [Vec3A::ZERO; LANES];
        let mut touched = 0u16;
        for (l, light) in self.lights.iter().enumerate() {
            let mut may_block = 0u16;
            for (lane, point) in points.iter().enumerate() {
                may_block |= u16::from(occluders.may_block(point.origin, l, light, self.balls)) << lane;
            }
            let found = self.one_light(points, light, may_block, scratch);
            for (lane, point) in points.iter().enumerate() {
                if found.touched & (1 << lane) != 0 {
                    touched |= 1 << lane;
                }
                answers[lane].penumbra |= found.penumbra & (1 << lane) != 0;
                if !point.on_ghost {
                    let e = self.cosine_irradiance(light, point);
                    mixed[lane] += e * found.mixed[lane];
                    real[lane] += e;
                } else if found.touched & (1 << lane) != 0 {
                    // The light it takes away; what remains of the sum is added below.
                    let e = self.cosine_irradiance(light, point);
                    mixed[lane] += e * (found.mixed[lane] - Vec3A::splat(found.real[lane]));
                    real[lane] += e * (found.real[lane] - 1.0);
                }
            }
        }
        for (lane, point) in points.iter().enumerate() {
            if point.on_ghost {
                if touched & (1 << lane) == 0 {
                    continue;
                }
                let mut all = self.surroundings.irradiance(point.normal);
                for light in self.lights {
                    all += self.cosine_irradiance(light, point);
                }
                let er = all + real[lane];
                answers[lane].share = ratio(er + mixed[lane], er);
            } else {
                answers[lane].share = ratio(mixed[lane], real[lane]);
            }
        }
        answers
    }

    /// Irradiance from a light without occlusion.
    fn cosine_irradiance(&self, light: &CameraLight, point: &ShadowPoint) -> Vec3A {
        let (to_light, e) = light.illuminate(point.origin);
        e * point.normal.dot(to_light).max(0.0)
    }

    /// One light from up to sixteen points.
    fn one_light(
        &self,
        points: &mut [ShadowPoint],
        light: &CameraLight,
        may_block: u16,
        scratch: &mut ShadowScratch,
    ) -> LightVisibility {
        let mut found = LightVisibility { mixed: [Vec3A::ONE; LANES], real: [1.0; LANES], penumbra: 0, touched: 0 };
        let mut cast = Cast { may_block, ..Cast::default() };
        for (lane, point) in points.iter().enumerate() {
            let away = !point.on_ghost && point.normal.dot(light.illuminate(point.origin).0) <= 0.0;
            if away || (point.on_ghost && may_block & (1 << lane) == 0) {
                continue;
            }
            cast.discs[lane] = light.disc(point.origin);
            cast.rotations[lane] = LightPattern::rotation(point.x, point.y);
            cast.active |= u16::from(cast.discs[lane].is_some()) << lane;
            cast.on_ghost |= u16::from(point.on_ghost) << lane;
        }
        let asked = cast.active;
        if asked == 0 {
            return found;
        }
        let (n_first, n_all) = if light.is_extended() { (self.pattern.n_first, self.pattern.len()) } else { (1, 1) };
        let mut weight = 0.0;
        let mut ranges = ChunkedRanges { next: 0, end: n_first };
        while let Some(range) = ranges.next() {
            weight += self.cast_samples(points, &mut cast, range, scratch);
        }
        let first_weight = weight;
        // A lane is decided if every first sample says the same, of virtual and of real things.
        let penumbra = asked & cast.disagreement();
        // Where no first sample meets anything real, the rest are taken not to either.
        cast.real_lit_everywhere = cast.ever_real_lit & !cast.ever_real_blocked;
        let refined = if n_first < n_all { penumbra } else { 0 };
        if refined != 0 {
            cast.active = refined;
            let mut ranges = ChunkedRanges { next: n_first, end: n_all };
            while let Some(range) = ranges.next() {
                weight += self.cast_samples(points, &mut cast, range, scratch);
            }
        }
        for lane in lanes(asked) {
            let total = if refined & (1 << lane) != 0 { weight } else { first_weight };
            found.mixed[lane] = (cast.mixed_lit[lane] / total).min(Vec3A::ONE);
            found.real[lane] = (cast.real_lit[lane] / total).min(1.0);
        }
        found.touched = cast.touched;
        found.penumbra = penumbra;
        found
    }

    /// Casts the samples of `range` from the active lanes; returns their weight.
    fn cast_samples(
        &self,
        points: &mut [ShadowPoint],
        cast: &mut Cast,
        range: std::ops::Range<usize>,
        scratch: &mut ShadowScratch,
    ) -> f32 {
        let weight_of = |i: usize| if self.pattern.len() == 1 { 1.0 } else { self.pattern.weight(i) };
        let mut virtual_blocked = [0u16; CHUNK];
        let mut glass = [[NO_GLASS; LANES]; CHUNK];
        let mut rays = RayPacket::default();
        for (k, i) in range.clone().enumerate() {
            let threatened = cast.active & cast.may_block;
            if threatened == 0 {
                break;
            }
            for lane in lanes(threatened) {
                let Some(disc) = &cast.discs[lane] else { continue };
                let direction = disc.direction(self.pattern.point(i, cast.rotations[lane]));
                rays.set(lane, &Ray { origin: points[lane].origin, direction, t_min: 0.0, t_max: disc.t_max });
            }
            scratch.n_rays += u64::from(threatened.count_ones());
            virtual_blocked[k] = self.occluded_packet(&rays, threatened, super::MASK_OPAQUE);
            cast.touched |= virtual_blocked[k];
            if self.has_transmissive {
                let open = threatened & !virtual_blocked[k];
                let mut hits = HitPacket::default();
                self.intersect_packet(&rays, open, super::MASK_TRANSMISSIVE, &mut hits);
                for lane in lanes(open).filter(|&lane| hits.instance[lane] != u32::MAX) {
                    glass[k][lane] = hits.instance[lane];
                    cast.touched |= 1 << lane;
                }
            }
        }
        // Real occluders: for a virtual point wherever light is left; for a ghost point only where
        // something virtual takes light (the ratio is one elsewhere, whatever is real).
        let relevant = cast.active & (!cast.on_ghost | cast.touched) & !cast.real_lit_everywhere;
        scratch.rays.clear();
        scratch.owners.clear();
        for lane in lanes(relevant) {
            let Some(disc) = &cast.discs[lane] else { continue };
            let point = &mut points[lane];
            let on_ghost = cast.on_ghost & (1 << lane) != 0;
            if on_ghost && point.normal == Vec3A::ZERO {
                point.normal = self.ghost_normal(point.x, point.y);
            }
            // Lifted off the sheet by the sensor's noise, or a noisy surface shadows itself.
            let lift = self.settings.ghost.bias_sigmas * depth_sigma_m(point.origin.z.max(0.0));
            let origin = if on_ghost { point.origin + point.normal * lift } else { point.origin };
            for (k, i) in range.clone().enumerate() {
                if !on_ghost && virtual_blocked[k] & (1 << lane) != 0 {
                    continue;
                }
                let direction = disc.direction(self.pattern.point(i, cast.rotations[lane]));
                let t_min = lift / direction.length().max(f32::MIN_POSITIVE);
                scratch.rays.push(Ray { origin, direction, t_min, t_max: disc.t_max });
                scratch.owners.push((k as u16, lane as u16));
            }
        }
        let mut real_blocked = [0u16; CHUNK];
        scratch.n_rays += scratch.rays.len() as u64;
        scratch.blocked.clear();
        scratch.blocked.resize(scratch.rays.len(), false);
        self.ghost.occluded_batch(&scratch.rays, &mut scratch.blocked);
        for ((ray, &(k, lane)), blocked) in scratch.rays.iter().zip(&scratch.owners).zip(&mut scratch.blocked) {
            if self.has_ghost_objects && !*blocked {
                *blocked = self.occluded(ray, crate::accel::MASK_GHOST);
            }
            real_blocked[usize::from(k)] |= u16::from(*blocked) << lane;
        }
        let mut total = 0.0;
        for (k, i) in range.enumerate() {
            let weight = weight_of(i);
            total += weight;
            let mut tinted = 0u16;
            for lane in lanes(cast.active & !real_blocked[k]) {
                cast.real_lit[lane] += weight;
                if virtual_blocked[k] & (1 << lane) == 0 {
                    let tint = match glass[k][lane] {
                        NO_GLASS => Vec3A::ONE,
                        instance => self.objects[instance as usize].shadow_tint,
                    };
                    tinted |= u16::from(glass[k][lane] != NO_GLASS) << lane;
                    cast.mixed_lit[lane] += tint * weight;
                }
            }
            let blocked = virtual_blocked[k] | tinted | real_blocked[k];
            cast.ever_blocked |= blocked & cast.active;
            cast.ever_lit |= !blocked & cast.active;
            cast.ever_real_blocked |= real_blocked[k];
            cast.ever_real_lit |= !real_blocked[k] & relevant;
        }
        total
    }

    /// Normal of the ghost surface for shading: that of the 2x2 block, if its corner lies on the same
    /// surface (fits are wider than that, and cost more than the rays); towards the camera where none
    /// can be fitted.
    pub(super) fn ghost_normal(&self, x: u32, y: u32) -> Vec3A {
        let block = (x & !1, y & !1);
        let z = |(x, y): (u32, u32)| self.frame.depth.z_m[(y * self.frame.color.width + x) as usize];
        let step = self.settings.ghost.edge_relative * z((x, y));
        // False for a NaN on either side.
        let (x, y) = if (z((x, y)) - z(block)).abs() < step { block } else { (x, y) };
        self.ghost
            .normal_at(x, y)
            .or_else(|| (-self.ray_direction(x as f32, y as f32)).try_normalize())
            .unwrap_or(-Vec3A::Z)
    }
}

/// Samples cast at once: bounds the records kept between the virtual and the real half.
const CHUNK: usize = 32;
/// No transmissive object on the way.
const NO_GLASS: u32 = u32::MAX;

/// A range of samples in pieces of at most [`CHUNK`].
struct ChunkedRanges {
    next: usize,
    end: usize,
}

impl ChunkedRanges {
    fn next(&mut self) -> Option<std::ops::Range<usize>> {
        let start = self.next;
        self.next = self.end.min(start + CHUNK);
        (start < self.end).then_some(start..self.next)
    }
}

/// Buffers of a thread, and its count of rays.
#[derive(Default)]
pub(super) struct ShadowScratch {
    rays: Vec<Ray>,
    owners: Vec<(u16, u16)>,
    blocked: Vec<bool>,
    pub(super) n_rays: u64,
}

/// What is known of one light from sixteen points: per lane sums over the samples so far.
#[derive(Default)]
struct Cast {
    discs: [Option<LightDisc>; LANES],
    rotations: [[f32; 2]; LANES],
    active: u16,
    /// Lanes that something virtual may shade.
    may_block: u16,
    on_ghost: u16,
    mixed_lit: [Vec3A; LANES],
    real_lit: [f32; LANES],
    touched: u16,
    ever_blocked: u16,
    ever_lit: u16,
    ever_real_blocked: u16,
    ever_real_lit: u16,
    real_lit_everywhere: u16,
}

impl Cast {
    /// Lanes whose samples do not all say the same, of everything or of real things.
    fn disagreement(&self) -> u16 {
        (self.ever_blocked & self.ever_lit) | (self.ever_real_blocked & self.ever_real_lit)
    }
}

/// Set bits, lowest first.
fn lanes(mask: u16) -> impl Iterator<Item = usize> {
    (0..LANES).filter(move |lane| mask & (1 << lane) != 0)
}

/// Channel-wise a / b, one where nothing arrives either way.
fn ratio(a: Vec3A, b: Vec3A) -> Vec3A {
    Vec3A::select(b.cmpgt(Vec3A::ZERO), (a / b.max(Vec3A::splat(f32::MIN_POSITIVE))).clamp(Vec3A::ZERO, Vec3A::ONE), Vec3A::ONE)
}
