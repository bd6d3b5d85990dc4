//! Shading, secondary rays and compositing of one tile.
//!
//! Every pixel gets `If = M Im + (1 - M)(Ic + Im - Ir)` (Kan and Kaufmann 2012), averaged over its
//! samples. On the real surface the diffuse albedo is estimated from the camera's pixel and the
//! modelled irradiance, `rho = pi Ic / Er`; then Ir is Ic itself and Ic + Im - Ir = Ic Em / Er, the
//! camera's pixel times the share of light that virtual objects leave.
//!
//! Paths are traced breadth first: all rays of a tile that have bounced equally often together.
//! A contribution is a sum over paths, so their order inside a tile is fixed and the picture does
//! not depend on threads.

use glam::Vec3A;

use crate::accel::{Hit, HitPacket, Ray, RayPacket};
use crate::frame::depth_sigma_m;
use crate::ghost::GhostOutcome;
use crate::numerics::{linear_from_srgb, uniform};
use crate::render::{FrameStats, Traversal};

use super::FrameContext;
use super::bsdf::{f0_of_ior, fresnel_dielectric, fresnel_schlick, ggx, refract, sample_ggx};
use super::light::CameraLight;
use super::plan::Occluders;
use super::shadow::{ShadowPoint, ShadowScratch};
use super::surface::Surface;
use super::tile::{Seen, TILE_PIXELS, Tile};

/// Roughness under which a surface is traced as a perfect mirror: its GGX lobe is then narrower
/// than a pixel of a curved object's reflection.
pub(super) const MIRROR_ROUGHNESS: f32 = 0.06;

/// Paths that carry less than this share of light end: at radiance 1 that is a quarter of the
/// smallest 8-bit step in linear light (1 / (255 * 12.92)).
const MIN_THROUGHPUT: f32 = 1.0 / (4.0 * 255.0 * 12.92);

/// Depth step between neighbouring pixels of one object that counts as its silhouette against
/// itself, relative to depth.
const SILHOUETTE_STEP: f32 = 0.02;

/// A secondary ray under way.
#[derive(Debug, Clone, Copy)]
struct Path {
    origin: Vec3A,
    /// Unit length.
    direction: Vec3A,
    throughput: Vec3A,
    pixel: u16,
    /// Rough reflections get lights from the shading model instead.
    sees_lights: bool,
    /// Meets only what is real, and counts negative: the Ir of a modelled real mirror.
    real: bool,
}

/// The result of a tile.
#[derive(Debug, Clone)]
pub(super) struct Shaded {
    /// Linear composite; meaningful where `touched`.
    pub(super) color: Box<[Vec3A; TILE_PIXELS]>,
    /// M Im: the virtual part of `color`, what bloom and glare spread.
    pub(super) virtual_light: Box<[Vec3A; TILE_PIXELS]>,
    /// M.
    pub(super) mask: Box<[f32; TILE_PIXELS]>,
    /// Pixels that differ from the camera's.
    pub(super) touched: Box<[bool; TILE_PIXELS]>,
    /// Largest luminance of `virtual_light`.
    pub(super) peak: f32,
    pub(super) stats: FrameStats,
}

impl Shaded {
    pub(super) fn new() -> Self {
        Self {
            color: Box::new([Vec3A::ZERO; TILE_PIXELS]),
            virtual_light: Box::new([Vec3A::ZERO; TILE_PIXELS]),
            mask: Box::new([0.0; TILE_PIXELS]),
            touched: Box::new([false; TILE_PIXELS]),
            peak: 0.0,
            stats: FrameStats::default(),
        }
    }
}

/// Buffers of a thread.
#[derive(Default)]
pub(super) struct Scratch {
    paths: Vec<Path>,
    next: Vec<Path>,
    hits: Vec<Option<Hit>>,
    ghost_rays: Vec<Ray>,
    outcomes: Vec<GhostOutcome>,
    lit: Vec<(Surface, Path)>,
    shadow: ShadowScratch,
}

/// Luminance, Rec. 709.
pub(super) fn luminance(c: Vec3A) -> f32 {
    c.dot(Vec3A::new(0.2126, 0.7152, 0.0722))
}

/// Shades one tile.
pub(super) fn shade_tile(ctx: &FrameContext<'_>, tile: &Tile, out: &mut Shaded, scratch: &mut Scratch) {
    out.virtual_light.fill(Vec3A::ZERO);
    out.mask.fill(0.0);
    out.touched.fill(false);
    out.color.fill(Vec3A::ZERO);
    out.peak = 0.0;
    out.stats = FrameStats { shadow_rays: tile.shadow_rays, ..FrameStats::default() };
    scratch.paths.clear();
    scratch.shadow.n_rays = 0;

    // The change that virtual objects cause on modelled real mirrors, Im - Ir, per pixel.
    let mut delta = [Vec3A::ZERO; TILE_PIXELS];
    let mut any_delta = false;
    for dy in 0..tile.height {
        for dx in 0..tile.width {
            let place = Tile::index(dx, dy);
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            let pixel = tile.pixels[place];
            let light = ctx.light(x, y);
            if tile.sees_objects && ctx.settings.edge_samples > 1 && ctx.is_edge(x, y) {
                ctx.shade_edge(tile, x, y, place, out, scratch);
            } else {
                match pixel.seen {
                    Seen::Camera => {}
                    Seen::Object => {
                        let surface = ctx.surface(&pixel.hit, ctx.ray_direction(x as f32, y as f32));
                        out.mask[place] = 1.0;
                        out.virtual_light[place] += ctx.direct(&surface, light.object, Vec3A::ONE);
                        let path = seed(&surface, place, 1.0, false);
                        ctx.scatter(&surface, &path, 0, &mut scratch.paths);
                    }
                    Seen::GhostObject => {
                        let surface = ctx.surface(&pixel.hit, ctx.ray_direction(x as f32, y as f32));
                        if ctx.is_specular(&surface) {
                            any_delta = true;
                            for real in [false, true] {
                                let path = seed(&surface, place, 1.0, real);
                                ctx.scatter(&surface, &path, 0, &mut scratch.paths);
                            }
                        }
                    }
                }
            }
        }
    }
    ctx.trace_to_end(tile, out, &mut delta, scratch);
    if tile.sees_objects && ctx.settings.edge_samples > 1 && ctx.refine_contrast(tile, out, scratch) {
        ctx.trace_to_end(tile, out, &mut delta, scratch);
    }
    out.stats.shadow_rays += scratch.shadow.n_rays;

    for dy in 0..tile.height {
        for dx in 0..tile.width {
            let place = Tile::index(dx, dy);
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            let share = ctx.light(x, y).ghost;
            let mask = out.mask[place];
            let relit = share != Vec3A::ONE;
            let changed = any_delta && delta[place] != Vec3A::ZERO;
            if mask == 0.0 && !relit && !changed {
                continue;
            }
            out.touched[place] = true;
            let camera = ctx.camera_color(x, y);
            // Real mirrors: Im - Ir was summed with the sign of each ray.
            let background = camera * share + delta[place];
            out.color[place] = out.virtual_light[place] + background.max(Vec3A::ZERO) * (1.0 - mask);
            out.peak = out.peak.max(luminance(out.virtual_light[place]));
            out.stats.virtual_pixels += u64::from(mask > 0.0);
            out.stats.relit_pixels += u64::from(relit && mask < 1.0);
        }
    }
    out.stats.traced_pixels += u64::from(tile.width * tile.height);
}

/// The path state at a primary hit, before it scatters.
fn seed(surface: &Surface, place: usize, weight: f32, real: bool) -> Path {
    Path {
        origin: surface.position,
        direction: surface.incoming,
        throughput: Vec3A::splat(weight),
        pixel: place as u16,
        sees_lights: true,
        real,
    }
}

impl FrameContext<'_> {
    /// The camera's pixel in linear light.
    pub(super) fn camera_color(&self, x: u32, y: u32) -> Vec3A {
        let [r, g, b, _] = self.frame.color.rgba[y as usize * self.frame.color.width as usize + x as usize];
        Vec3A::new(linear_from_srgb(r), linear_from_srgb(g), linear_from_srgb(b))
    }

    /// The camera's picture at any position on it, as virtual objects light it.
    fn relit_camera(&self, u: f32, v: f32) -> Vec3A {
        let (right, bottom) = (self.frame.color.width - 1, self.frame.color.height - 1);
        let u = u.clamp(0.0, right as f32);
        let v = v.clamp(0.0, bottom as f32);
        let (x0, y0) = (u as u32, v as u32);
        let (fx, fy) = (u - x0 as f32, v - y0 as f32);
        let (x1, y1) = ((x0 + 1).min(right), (y0 + 1).min(bottom));
        let at = |x, y| self.camera_color(x, y) * self.light(x, y).ghost;
        at(x0, y0).lerp(at(x1, y0), fx).lerp(at(x0, y1).lerp(at(x1, y1), fx), fy)
    }

    /// Whether a pixel lies on the outline of something virtual.
    fn is_edge(&self, x: u32, y: u32) -> bool {
        let here = self.pixel(x, y);
        let (right, bottom) = (self.frame.color.width - 1, self.frame.color.height - 1);
        let neighbours = [
            (x > 0).then(|| (x - 1, y)),
            (x < right).then(|| (x + 1, y)),
            (y > 0).then(|| (x, y - 1)),
            (y < bottom).then(|| (x, y + 1)),
        ];
        neighbours.into_iter().flatten().any(|(nx, ny)| {
            let there = self.pixel(nx, ny);
            let any_object = here.seen == Seen::Object || there.seen == Seen::Object;
            any_object
                && (here.seen != there.seen
                    || here.hit.instance != there.hit.instance
                    || (here.hit.t - there.hit.t).abs() > SILHOUETTE_STEP * here.hit.t.min(there.hit.t))
        })
    }

    /// Anti-aliasing by image gradient (RT2AR, section III.A): virtual pixels that differ much from a
    /// neighbour, as reflections do where they are squeezed, are shaded again with several samples.
    fn refine_contrast(&self, tile: &Tile, out: &mut Shaded, scratch: &mut Scratch) -> bool {
        let mut refine = [false; TILE_PIXELS];
        // As bright as displayed, roughly: a square root for the transfer curve.
        let shown = |place: usize| luminance(out.virtual_light[place]).clamp(0.0, 1.0).sqrt();
        let whole = |place: usize| out.mask[place] == 1.0;
        for dy in 0..tile.height {
            for dx in 0..tile.width {
                let here = Tile::index(dx, dy);
                for (nx, ny) in [(dx + 1, dy), (dx, dy + 1)] {
                    if nx >= tile.width || ny >= tile.height {
                        continue;
                    }
                    let there = Tile::index(nx, ny);
                    if whole(here) && whole(there) && (shown(here) - shown(there)).abs() > self.settings.edge_contrast {
                        refine[here] = true;
                        refine[there] = true;
                    }
                }
            }
        }
        for dy in 0..tile.height {
            for dx in 0..tile.width {
                let place = Tile::index(dx, dy);
                let (x, y) = (tile.x0 + dx, tile.y0 + dy);
                // Outlines have had their samples.
                if refine[place] && !self.is_edge(x, y) {
                    out.mask[place] = 0.0;
                    out.virtual_light[place] = Vec3A::ZERO;
                    self.shade_edge(tile, x, y, place, out, scratch);
                }
            }
        }
        !scratch.paths.is_empty()
    }

    /// Follows every path of the tile to its end.
    fn trace_to_end(&self, tile: &Tile, out: &mut Shaded, delta: &mut [Vec3A; TILE_PIXELS], scratch: &mut Scratch) {
        for depth in 1..=self.settings.max_bounces {
            if scratch.paths.is_empty() {
                break;
            }
            self.trace_paths(tile, depth, out, delta, scratch);
        }
        scratch.paths.clear();
    }

    /// Several samples for a pixel on an outline, stratified over its area.
    fn shade_edge(&self, tile: &Tile, x: u32, y: u32, place: usize, out: &mut Shaded, scratch: &mut Scratch) {
        let n = self.settings.edge_samples;
        let weight = 1.0 / n as f32;
        let mut rays = RayPacket::default();
        let mut hits = HitPacket::default();
        for first in (0..n).step_by(16) {
            let lanes = (n - first).min(16);
            for lane in 0..lanes {
                // Hammersley's points: one in each row and column of an n x n grid.
                let i = first + lane;
                let su = (i as f32 + 0.5) * weight - 0.5;
                let sv = (i.reverse_bits() >> 8) as f32 * (1.0 / 16_777_216.0) + 0.5 * weight - 0.5;
                let direction = self.ray_direction(x as f32 + su, y as f32 + sv.min(0.5));
                rays.set(lane as usize, &Ray { origin: Vec3A::ZERO, direction, t_min: 1e-3, t_max: f32::INFINITY });
            }
            let active = ((1u32 << lanes) - 1) as u16;
            self.intersect_packet(&rays, active, super::MASK_ALL, &mut hits);
            for lane in 0..lanes as usize {
                let Some(hit) = hits.get(lane) else { continue };
                let seen = self.seen(x, y, hit.t, self.objects[hit.instance as usize].ghost);
                if seen != Seen::Object {
                    continue;
                }
                let surface = self.surface(&hit, rays.get(lane).direction);
                out.mask[place] += weight;
                out.virtual_light[place] += self.direct(&surface, self.object_share_near(tile, x, y, &hit), Vec3A::ONE) * weight;
                self.scatter(&surface, &seed(&surface, place, weight, false), 0, &mut scratch.paths);
            }
        }
        // Weights of a power of two sum exactly; others leave a few roundings.
        out.mask[place] = out.mask[place].min(1.0);
    }

    /// The share of direct light found at the pixel, or at a neighbour that sees the same object.
    fn object_share_near(&self, tile: &Tile, x: u32, y: u32, hit: &Hit) -> Vec3A {
        let (right, bottom) = (tile.x0 + tile.width - 1, tile.y0 + tile.height - 1);
        let mut best = None;
        for ny in y.saturating_sub(1).max(tile.y0)..=(y + 1).min(bottom) {
            for nx in x.saturating_sub(1).max(tile.x0)..=(x + 1).min(right) {
                let pixel = self.pixel(nx, ny);
                if pixel.seen == Seen::Object && pixel.hit.instance == hit.instance {
                    let distance = (pixel.hit.t - hit.t).abs();
                    if best.is_none_or(|(d, _)| distance < d) {
                        best = Some((distance, self.light(nx, ny).object));
                    }
                }
            }
        }
        best.map_or(Vec3A::ONE, |(_, share)| share)
    }

    /// Whether mirror rays leave this surface.
    fn is_specular(&self, surface: &Surface) -> bool {
        let material = &self.materials[surface.material as usize];
        surface.metallic > 0.0 || material.transmission > 0.0 || surface.roughness < 0.5
    }

    /// Reflectance at normal incidence.
    fn f0(&self, surface: &Surface) -> Vec3A {
        let dielectric = Vec3A::splat(f0_of_ior(self.materials[surface.material as usize].ior));
        dielectric.lerp(surface.base_color, surface.metallic)
    }

    /// Emitted, diffused and glossily reflected light of lights, times `throughput`.
    /// `share` of direct light arrives.
    fn direct(&self, surface: &Surface, share: Vec3A, throughput: Vec3A) -> Vec3A {
        let material = &self.materials[surface.material as usize];
        let mut sum = surface.emissive;
        let albedo = surface.base_color * ((1.0 - surface.metallic) * (1.0 - material.transmission));
        let n_dot_v = -surface.incoming.dot(surface.normal);
        let f0 = self.f0(surface);
        // What the boundary reflects cannot also enter and be diffused.
        let entering = Vec3A::ONE - fresnel_schlick(f0, n_dot_v);
        let diffuse = albedo * entering * std::f32::consts::FRAC_1_PI;
        if diffuse != Vec3A::ZERO {
            sum += diffuse * self.surroundings.irradiance(surface.normal);
        }
        let glossy = surface.roughness >= MIRROR_ROUGHNESS;
        if share != Vec3A::ZERO && (glossy || diffuse != Vec3A::ZERO) {
            for light in self.lights {
                let (to_light, e) = light.illuminate(surface.position);
                let n_dot_l = surface.normal.dot(to_light);
                if n_dot_l <= 0.0 {
                    continue;
                }
                let e = e * n_dot_l * share;
                sum += diffuse * e;
                if glossy && n_dot_v > 0.0 {
                    sum += self.highlight(surface, light, to_light, f0, n_dot_v, n_dot_l) * e;
                }
            }
        }
        sum * throughput
    }

    /// Glossy reflection of a light per irradiance on the surface.
    fn highlight(&self, surface: &Surface, light: &CameraLight, to_light: Vec3A, f0: Vec3A, n_dot_v: f32, n_dot_l: f32) -> Vec3A {
        let alpha = surface.roughness * surface.roughness;
        // A light with an extent widens the lobe (Karis 2013, representative point).
        let half_angle = match *light {
            CameraLight::Sphere { center, radius, .. } => {
                radius / (center - surface.position).length().max(radius.max(f32::MIN_POSITIVE))
            }
            CameraLight::Directional { tan_radius, .. } => tan_radius,
        };
        let widened = (alpha + 0.5 * half_angle).min(1.0);
        let energy = (alpha / widened) * (alpha / widened);
        let Some(h) = (to_light - surface.incoming).try_normalize() else { return Vec3A::ZERO };
        let f = fresnel_schlick(f0, to_light.dot(h).max(0.0));
        f * (ggx(n_dot_v, n_dot_l, surface.normal.dot(h).max(0.0), widened) * energy)
    }

    /// Sends the reflected and refracted rays of a path that met `surface` after `depth` bounces.
    fn scatter(&self, surface: &Surface, path: &Path, depth: u32, queue: &mut Vec<Path>) {
        let material = &self.materials[surface.material as usize];
        let n_dot_v = (-surface.incoming.dot(surface.normal)).clamp(0.0, 1.0);
        let mut push = |direction: Vec3A, share: Vec3A, sees_lights: bool| {
            let throughput = path.throughput * share;
            if throughput.max_element() >= MIN_THROUGHPUT && throughput.is_finite() {
                queue.push(Path { origin: surface.leave(direction), direction, throughput, sees_lights, ..*path });
            }
        };
        if material.transmission > 0.0 {
            // Dielectric boundary: both rays (HQ-AR, section 3), by Fresnel's equations.
            let eta = if surface.front || material.thin { material.ior } else { 1.0 / material.ior };
            let r = fresnel_dielectric(n_dot_v, eta);
            // A thin sheet's two faces reflect back and forth: 2R / (1 + R) in all.
            let r = if material.thin { 2.0 * r / (1.0 + r) } else { r };
            push(surface.mirror(), Vec3A::splat(r), true);
            let passing = surface.base_color * ((1.0 - r) * material.transmission);
            if material.thin {
                push(surface.incoming, passing, true);
            } else if let Some(direction) = refract(surface.incoming, surface.normal, eta) {
                // The smooth normal may send a grazing ray back out: then it goes straight on.
                let through = direction.dot(surface.geometric_normal) < 0.0;
                push(if through { direction } else { surface.incoming }, passing, true);
            }
            return;
        }
        let f = fresnel_schlick(self.f0(surface), n_dot_v);
        if surface.roughness < MIRROR_ROUGHNESS {
            push(surface.mirror(), f, true);
            return;
        }
        if f.max_element() * path.throughput.max_element() < MIN_THROUGHPUT {
            return;
        }
        let alpha = surface.roughness * surface.roughness;
        // As many rays as the reflection matters, the full number for a metal at first sight.
        let n = if depth == 0 { (self.settings.glossy_samples as f32 * f.max_element()).ceil().max(1.0) as u32 } else { 1 };
        let seed = u32::from(path.pixel) ^ (surface.position.x.to_bits().rotate_left(8)) ^ surface.position.y.to_bits();
        let (ox, oy) = (uniform(seed, depth, 0), uniform(seed, depth, 1));
        for i in 0..n {
            // A shifted Kronecker sequence: even for any number of samples.
            let u = [(ox + i as f32 * 0.754_877_7).fract(), (oy + i as f32 * 0.569_840_3).fract()];
            if let Some((direction, weight)) = sample_ggx(surface.incoming, surface.normal, alpha, u)
                && direction.dot(surface.geometric_normal) > 0.0
            {
                push(direction, f * (weight / n as f32), false);
            }
        }
    }

    /// Traces every path of the tile one bounce further.
    fn trace_paths(&self, tile: &Tile, depth: u32, out: &mut Shaded, delta: &mut [Vec3A; TILE_PIXELS], scratch: &mut Scratch) {
        let Scratch { paths, next, hits, ghost_rays, outcomes, lit, shadow } = scratch;
        hits.clear();
        ghost_rays.clear();
        next.clear();
        lit.clear();
        for path in paths.iter() {
            let mask = if path.real { crate::accel::MASK_GHOST } else { super::MASK_ALL };
            let ray = Ray { origin: path.origin, direction: path.direction, t_min: 0.0, t_max: f32::INFINITY };
            let hit = self.intersect(&ray, mask);
            // Within the sensor's noise of where it starts, the sheet is not to be trusted: an object
            // standing on a surface starts its rays there.
            let t_min = self.settings.ghost.bias_sigmas * depth_sigma_m(path.origin.z.max(0.0));
            ghost_rays.push(Ray { t_min, t_max: hit.map_or(f32::INFINITY, |hit| hit.t), ..ray });
            hits.push(hit);
        }
        outcomes.clear();
        outcomes.resize(ghost_rays.len(), GhostOutcome::Unknown);
        match self.settings.ghost.traversal {
            Traversal::Pyramid => self.ghost.trace_batch(ghost_rays, outcomes),
            other => {
                for (ray, outcome) in ghost_rays.iter().zip(outcomes.iter_mut()) {
                    *outcome = self.ghost.trace(other, ray);
                }
            }
        }
        out.stats.secondary_rays += paths.len() as u64;
        let mut add = |path: &Path, radiance: Vec3A| {
            let light = path.throughput * radiance;
            let place = usize::from(path.pixel);
            // Only modelled real mirrors send paths from pixels without a mask.
            if out.mask[place] > 0.0 {
                out.virtual_light[place] += light;
            } else if path.real {
                delta[place] -= light;
            } else {
                delta[place] += light;
            }
        };
        for ((path, hit), outcome) in paths.iter().zip(hits.iter()).zip(outcomes.iter()) {
            let ghost_hit = match outcome {
                GhostOutcome::Hit(ghost) => Some(ghost),
                _ => None,
            };
            let t_end = ghost_hit.map(|ghost| ghost.t).or(hit.map(|hit| hit.t)).unwrap_or(f32::INFINITY);
            if path.sees_lights {
                let light = self.lights.iter().filter_map(|light| light.intersect(path.origin, path.direction));
                if let Some((t, radiance)) = light.min_by(|a, b| a.0.total_cmp(&b.0))
                    && t < t_end
                {
                    out.stats.secondary_environment += 1;
                    add(path, radiance);
                    continue;
                }
            }
            if let Some(ghost) = ghost_hit {
                if ghost.from_front {
                    out.stats.secondary_ghost += 1;
                    let color = self.relit_camera(ghost.u, ghost.v);
                    // Without virtual objects the surface is as the camera shows it.
                    add(path, if path.real { self.camera_at(ghost.u, ghost.v) } else { color });
                } else {
                    out.stats.secondary_unknown += 1;
                    add(path, self.surroundings.radiance(path.direction));
                }
            } else if let Some(hit) = hit {
                out.stats.secondary_mesh += 1;
                let surface = self.surface(hit, path.direction);
                if self.objects[hit.instance as usize].ghost
                    && let Some(color) = self.reproject(&surface, path.real)
                {
                    add(path, color);
                    continue;
                }
                let mut path = *path;
                path.throughput *= self.absorption(&surface, hit.t);
                lit.push((surface, path));
            } else {
                match outcome {
                    GhostOutcome::Environment => out.stats.secondary_environment += 1,
                    _ => out.stats.secondary_unknown += 1,
                }
                add(path, self.surroundings.radiance(path.direction));
            }
        }
        for group in lit.chunks(16) {
            let mut points = [ShadowPoint::default(); 16];
            for (point, (surface, path)) in points.iter_mut().zip(group) {
                let pixel = u32::from(path.pixel);
                *point = surface.shadow_point(tile.x0 + pixel % super::tile::TILE, tile.y0 + pixel / super::tile::TILE);
            }
            let needs_light = group.iter().any(|(surface, _)| self.material_needs_light[surface.material as usize]);
            let shares = if needs_light && self.pattern.len() > 0 {
                self.visibility(&mut points[..group.len()], Occluders::ALL, shadow).map(|answer| answer.share)
            } else {
                [Vec3A::ONE; 16]
            };
            for ((surface, path), share) in group.iter().zip(shares) {
                add(path, self.direct(surface, share, Vec3A::ONE));
                if depth < self.settings.max_bounces {
                    self.scatter(surface, path, depth, next);
                } else {
                    // The last bounce takes the surroundings instead of another ray.
                    add(path, self.last_bounce(surface));
                }
            }
        }
        std::mem::swap(paths, next);
    }

    /// What a surface reflects and lets through when no further ray is allowed.
    fn last_bounce(&self, surface: &Surface) -> Vec3A {
        let material = &self.materials[surface.material as usize];
        let f = fresnel_schlick(self.f0(surface), -surface.incoming.dot(surface.normal));
        let through = surface.base_color * (Vec3A::ONE - f) * material.transmission;
        self.surroundings.radiance(surface.mirror()) * f + self.surroundings.radiance(surface.incoming) * through
    }

    /// Beer-Lambert over the way inside the medium whose far side was met.
    fn absorption(&self, surface: &Surface, distance: f32) -> Vec3A {
        let material = &self.materials[surface.material as usize];
        if surface.front || material.transmission == 0.0 || material.thin || !material.attenuation_distance_m.is_finite() {
            return Vec3A::ONE;
        }
        Vec3A::from(material.attenuation_color).powf(distance / material.attenuation_distance_m)
    }

    /// The camera's picture at any position on it, untouched.
    fn camera_at(&self, u: f32, v: f32) -> Vec3A {
        let x = (u.max(0.0) + 0.5) as u32;
        let y = (v.max(0.0) + 0.5) as u32;
        self.camera_color(x.min(self.frame.color.width - 1), y.min(self.frame.color.height - 1))
    }

    /// The camera's colour of a point on a modelled real object, if the camera sees that point.
    fn reproject(&self, surface: &Surface, real: bool) -> Option<Vec3A> {
        let p = surface.position;
        if p.z <= 0.0 {
            return None;
        }
        let (u, v) = self.project(p);
        let (w, h) = (self.frame.color.width as f32, self.frame.color.height as f32);
        if !(u >= -0.5 && v >= -0.5 && u < w - 0.5 && v < h - 0.5) {
            return None;
        }
        // Seen from its other side, or something nearer in between: the camera does not see it.
        if surface.geometric_normal.dot(p) >= 0.0 {
            return None;
        }
        if let Some(z) = self.ghost.depth_at(u, v)
            && p.z > z + self.settings.ghost.bias_sigmas * depth_sigma_m(z)
        {
            return None;
        }
        Some(if real { self.camera_at(u, v) } else { self.relit_camera(u, v) })
    }
}
