//! Secondary rays, breadth first: all rays of a tile that have bounced equally often together.
//!
//! Each ends as a hit on a mesh, a hit on the ghost surface, in a light, in the environment, or where
//! nothing is known; each end is counted. A ghost hit shows the camera's colour found by reprojection,
//! as virtual objects light it (`wasSpecular` of Kan and Kaufmann 2012).

use glam::Vec3A;

use crate::accel::{Hit, MASK_GHOST, Ray};
use crate::ghost::{GhostHit, GhostOutcome};
use crate::numerics::linear_from_srgb;
use crate::render::Traversal;

use super::FrameContext;
use super::cone::RayCone;
use super::light::CameraLight;
use super::scatter::LightShare;
use super::shade::Shaded;
use super::shadow_group::{POINTS_AT_ONCE, ShadowPoint, ShadowScratch};
use super::surface::Surface;
use super::tile::{TILE, TILE_PIXELS, Tile};

/// Paths that carry less than this share of light end: at radiance 1 that is a quarter of the
/// smallest 8-bit step in linear light (1 / (255 * 12.92)).
pub(super) const MIN_THROUGHPUT: f32 = 1.0 / (4.0 * 255.0 * 12.92);

/// Paths of a tile that are followed at once, about: bounds what they take with the most samples
/// allowed. More than a tile has with any ordinary settings, for the order of the sums shows in the last
/// bits of a picture.
pub(super) const PATHS_AT_ONCE: usize = 1 << 15;

/// Rays that the ghost surface is asked about between two checkpoints.
const GHOST_RAYS_AT_ONCE: usize = 4096;

/// A secondary ray under way.
#[derive(Debug, Clone, Copy)]
pub(super) struct Path {
    pub(super) origin: Vec3A,
    /// Unit length.
    pub(super) direction: Vec3A,
    pub(super) throughput: Vec3A,
    /// Where it starts.
    pub(super) cone: RayCone,
    pub(super) pixel: u16,
    /// GGX alpha of the lobe that it was drawn from, 0 of a mirror, infinite if it is to see no lamp:
    /// [`CameraLight::is_seen_by_rays`] tells which it sees. The shading model shows the others.
    pub(super) lobe: f32,
    /// Meets only what is real, and counts negative: the Ir of a modelled real mirror.
    pub(super) real: bool,
    /// Comes from a modelled real mirror: what it brings changes the camera's pixel.
    pub(super) of_mirror: bool,
    /// Which of its pixel's lens rays it comes from.
    pub(super) sample: u16,
}

/// What a path may meet: everything, or what is real only.
pub(super) fn mask_of_path(real: bool) -> u8 {
    if real { MASK_GHOST } else { super::MASK_ALL }
}

/// The path state at a primary hit, before it scatters.
pub(super) fn seed(surface: &Surface, place: usize, weight: f32, real: bool) -> Path {
    Path {
        origin: surface.position,
        direction: surface.incoming,
        throughput: Vec3A::splat(weight),
        cone: surface.cone,
        pixel: place as u16,
        lobe: 0.0,
        real,
        of_mirror: false,
        sample: 0,
    }
}

/// The two paths that a modelled real mirror sends: what they differ by is what virtual things
/// change in it.
pub(super) fn mirror_seeds(surface: &Surface, place: usize, weight: f32) -> [Path; 2] {
    [false, true].map(|real| Path {
        of_mirror: true,
        ..seed(surface, place, weight, real)
    })
}

/// Where the light of a tile's paths is summed up, per pixel.
pub(super) struct Sums<'a> {
    pub(super) virtual_light: &'a mut [Vec3A; TILE_PIXELS],
    /// The same of every second lens ray.
    pub(super) odd_light: &'a mut [Vec3A],
    /// The change that virtual objects cause on modelled real mirrors, Im - Ir.
    pub(super) delta: &'a mut [Vec3A; TILE_PIXELS],
}

impl Sums<'_> {
    /// Adds the light that a path brings.
    pub(super) fn add(&mut self, path: &Path, radiance: Vec3A) {
        let light = path.throughput * radiance;
        let place = usize::from(path.pixel);
        if !path.of_mirror {
            if path.sample.is_multiple_of(2) {
                self.virtual_light[place] += light;
            } else {
                self.odd_light[place] += light;
            }
        } else if path.real {
            self.delta[place] -= light;
        } else {
            self.delta[place] += light;
        }
    }
}

/// Buffers of a thread.
#[derive(Default)]
pub(super) struct Scratch {
    pub(super) paths: Vec<Path>,
    next: Vec<Path>,
    hits: Vec<Option<Hit>>,
    ghost_rays: Vec<Ray>,
    outcomes: Vec<GhostOutcome>,
    lit: Vec<(Surface, Path)>,
    /// What lens rays met, packets of neighbours one after the other.
    pub(super) lens_hits: Vec<(Surface, Path)>,
    /// See [`Sums::odd_light`]; empty until a lens has rays.
    pub(super) odd_light: Vec<Vec3A>,
    pub(super) shadow: ShadowScratch,
}

impl FrameContext<'_> {
    /// Follows every path of the tile to its end.
    pub(super) fn trace_to_end(
        &self,
        tile: &Tile,
        out: &mut Shaded,
        delta: &mut [Vec3A; TILE_PIXELS],
        scratch: &mut Scratch,
    ) {
        for depth in 1..=self.settings.max_bounces {
            if scratch.paths.is_empty() || !self.go_on() {
                break;
            }
            self.trace_paths(tile, depth, out, delta, scratch);
        }
        scratch.paths.clear();
    }

    /// Traces every path of the tile one bounce further.
    pub(super) fn trace_paths(
        &self,
        tile: &Tile,
        depth: u32,
        out: &mut Shaded,
        delta: &mut [Vec3A; TILE_PIXELS],
        scratch: &mut Scratch,
    ) {
        let Scratch {
            paths,
            next,
            hits,
            ghost_rays,
            outcomes,
            lit,
            odd_light,
            shadow,
            ..
        } = scratch;
        ghost_rays.clear();
        next.clear();
        lit.clear();
        ghost_rays.extend(paths.iter().map(|path| Ray {
            origin: path.origin,
            direction: path.direction,
            t_min: 0.0,
            t_max: f32::INFINITY,
        }));
        self.intersect_all(ghost_rays, |i| mask_of_path(paths[i].real), hits);
        for (ray, hit) in ghost_rays.iter_mut().zip(hits.iter()) {
            ray.t_min = self.lift(ray.origin);
            ray.t_max = hit.map_or(f32::INFINITY, |hit| hit.t);
        }
        outcomes.clear();
        outcomes.resize(ghost_rays.len(), GhostOutcome::Unknown);
        let parts = ghost_rays.chunks(GHOST_RAYS_AT_ONCE);
        for (rays, outcomes) in parts.zip(outcomes.chunks_mut(GHOST_RAYS_AT_ONCE)) {
            if !self.go_on() {
                return;
            }
            match self.settings.ghost.traversal {
                Traversal::Pyramid => self.ghost.trace_batch(rays, outcomes),
                other => {
                    for (ray, outcome) in rays.iter().zip(outcomes) {
                        *outcome = self.ghost.trace(other, ray);
                    }
                }
            }
        }
        out.stats.secondary_rays += paths.len() as u64;
        let mut sums = Sums {
            virtual_light: &mut out.virtual_light,
            odd_light,
            delta,
        };
        let met = paths.iter().zip(hits.iter()).zip(outcomes.iter());
        for (i, ((path, hit), outcome)) in met.enumerate() {
            if i.is_multiple_of(64) && !self.go_on() {
                return;
            }
            let ghost_hit = match outcome {
                GhostOutcome::Hit(ghost) => Some(ghost),
                _ => None,
            };
            let t_end = ghost_hit
                .map(|ghost| ghost.t)
                .or(hit.map(|hit| hit.t))
                .unwrap_or(f32::INFINITY);
            if path.lobe.is_finite() {
                let seen = |light: &&CameraLight| light.is_seen_by_rays(path.origin, path.lobe);
                let light = self
                    .lights
                    .iter()
                    .filter(seen)
                    .filter_map(|light| light.intersect(path.origin, path.direction));
                if let Some((t, radiance)) = light.min_by(|a, b| a.0.total_cmp(&b.0))
                    && t < t_end
                {
                    out.stats.secondary_environment += 1;
                    sums.add(path, radiance);
                    continue;
                }
            }
            if let Some(ghost) = ghost_hit {
                if ghost.from_front {
                    out.stats.secondary_ghost += 1;
                    sums.add(path, self.camera_seen_by(path, ghost));
                } else {
                    out.stats.secondary_unknown += 1;
                    sums.add(path, self.radiance_around(path));
                }
            } else if let Some(hit) = hit {
                out.stats.secondary_mesh += 1;
                let surface = self.surface(hit, path.direction, path.cone.after(hit.t));
                if self.objects[hit.instance as usize].ghost
                    && let Some(color) = self.reproject(&surface, path.real)
                {
                    sums.add(path, color);
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
                sums.add(path, self.radiance_around(path));
            }
        }
        self.light_hits(tile, depth, lit, shadow, next, &mut sums);
        std::mem::swap(paths, next);
    }

    /// What a path that meets the ghost surface brings: the camera's picture there, as virtual objects
    /// light it; without them as it is.
    fn camera_seen_by(&self, path: &Path, ghost: &GhostHit) -> Vec3A {
        let (u, v) = (ghost.u, ghost.v);
        let z = (path.origin + path.direction * ghost.t).z;
        let width_px = path.cone.at(ghost.t) * self.pinhole[0].abs() / z;
        // A mirror's is sharp, as it was seen. False for a NaN.
        if let Some(levels) = self.camera_levels
            && path.lobe != 0.0
            && width_px > 2.0
        {
            let camera = levels.lookup(u, v, width_px);
            if path.real {
                return camera;
            }
            let (right, bottom) = (self.frame.color.width - 1, self.frame.color.height - 1);
            let nearest = |x: f32, last: u32| ((x + 0.5).max(0.0) as u32).min(last);
            let (x, y) = (nearest(u, right), nearest(v, bottom));
            return camera * self.light(x, y).ghost;
        }
        if path.real {
            self.camera_at(u, v)
        } else {
            self.relit_camera(u, v)
        }
    }

    /// What a path that meets nothing brings. Lamps that a map was taken apart into are seen by mirrors
    /// only: rough reflections have their highlights.
    fn radiance_around(&self, path: &Path) -> Vec3A {
        if path.lobe == 0.0 {
            self.surroundings.radiance(path.direction)
        } else {
            self.surroundings
                .radiance_without_lamps(path.direction, path.cone.spread)
        }
    }

    /// Shades what paths have met after `depth` bounces, each with shadows of its own, and sends them
    /// on. A lens ray's depth is 0, and what its packet met is a block of neighbours.
    pub(super) fn light_hits(
        &self,
        tile: &Tile,
        depth: u32,
        hits: &[(Surface, Path)],
        shadow: &mut ShadowScratch,
        next: &mut Vec<Path>,
        sums: &mut Sums<'_>,
    ) {
        for lit in hits.chunks(POINTS_AT_ONCE) {
            shadow.clear();
            if depth == 0 {
                for block in lit.chunk_by(|(_, a), (_, b)| a.sample == b.sample) {
                    shadow.object_block(
                        self.asked_points(tile, block),
                        self.settings.ghost.edge_relative,
                    );
                }
            } else {
                shadow.object_points(self.asked_points(tile, lit));
            }
            self.cast_shadows(shadow);
            let mut answers = shadow.groups().iter().flat_map(|group| group.answered());
            for (i, (surface, path)) in lit.iter().enumerate() {
                if !self.go_on_at(i) {
                    return;
                }
                let answer = self
                    .asks_for_light(surface)
                    .then(|| answers.next())
                    .flatten();
                let share = answer.map_or(LightShare::ALL, |(_, answer)| answer.of_object());
                sums.add(path, self.direct(surface, share, Vec3A::ONE));
                if depth < self.settings.max_bounces {
                    self.scatter(surface, path, depth, self.glossy_rays(depth), next);
                } else {
                    // The last bounce takes the surroundings instead of another ray.
                    sums.add(path, self.last_bounce(surface));
                }
            }
        }
    }

    /// Whether what lights a surface shows, and may be kept from it.
    fn asks_for_light(&self, surface: &Surface) -> bool {
        self.pattern.len() > 0 && self.material_needs_light[surface.material as usize]
    }

    /// Those of the hits that ask, as the shadow stage wants them.
    fn asked_points<'h>(
        &'h self,
        tile: &'h Tile,
        hits: &'h [(Surface, Path)],
    ) -> impl Iterator<Item = ShadowPoint> + 'h {
        let asking = hits.iter().filter(|hit| self.asks_for_light(&hit.0));
        asking.map(|(surface, path)| {
            let (pixel, sample) = (u32::from(path.pixel), u32::from(path.sample));
            // A pixel's lens rays aim at different places of a light: together they cover it.
            let (x, y) = (tile.x0 + pixel % TILE, tile.y0 + pixel / TILE);
            ShadowPoint {
                coarse: path.lobe != 0.0,
                ..surface.shadow_point(x + sample, y + sample / 4)
            }
        })
    }

    /// Rays that estimate a metal's rough reflection after `depth` bounces of a path. A pixel's lens
    /// rays share those of its first one.
    pub(super) fn glossy_rays(&self, depth: u32) -> u32 {
        match self.lens {
            Some(lens) if depth == 0 => self.settings.glossy_samples.div_ceil(lens.n() as u32),
            _ => 1,
        }
    }

    /// The camera's picture at any position on it, as virtual objects light it.
    pub(super) fn relit_camera(&self, u: f32, v: f32) -> Vec3A {
        self.interpolate(u, v, |x, y| {
            self.camera_color(x, y) * self.light(x, y).ghost
        })
    }

    /// The camera's picture at any position on it, untouched: where nothing virtual changes the light
    /// exactly what [`Self::relit_camera`] is, so that the two cancel.
    pub(super) fn camera_at(&self, u: f32, v: f32) -> Vec3A {
        self.interpolate(u, v, |x, y| self.camera_color(x, y))
    }

    /// Bilinear.
    fn interpolate(&self, u: f32, v: f32, at: impl Fn(u32, u32) -> Vec3A) -> Vec3A {
        let (right, bottom) = (self.frame.color.width - 1, self.frame.color.height - 1);
        let u = u.clamp(0.0, right as f32);
        let v = v.clamp(0.0, bottom as f32);
        let (x0, y0) = (u as u32, v as u32);
        let (fx, fy) = (u - x0 as f32, v - y0 as f32);
        let (x1, y1) = ((x0 + 1).min(right), (y0 + 1).min(bottom));
        at(x0, y0)
            .lerp(at(x1, y0), fx)
            .lerp(at(x0, y1).lerp(at(x1, y1), fx), fy)
    }

    /// The camera's colour of a point on a modelled real object, if the camera sees that point.
    pub(super) fn reproject(&self, surface: &Surface, real: bool) -> Option<Vec3A> {
        let p = surface.position;
        if p.z <= 0.0 {
            return None;
        }
        let (u, v) = self.project(p);
        let (w, h) = (
            self.frame.color.width as f32,
            self.frame.color.height as f32,
        );
        if !(u >= -0.5 && v >= -0.5 && u < w - 0.5 && v < h - 0.5) {
            return None;
        }
        // Seen from its other side, or something nearer in between: the camera does not see it.
        if surface.geometric_normal.dot(p) >= 0.0 {
            return None;
        }
        if let Some(z) = self.ghost.depth_at(u, v)
            && p.z > z + self.lift(Vec3A::Z * z)
        {
            return None;
        }
        Some(if real {
            self.camera_at(u, v)
        } else {
            self.relit_camera(u, v)
        })
    }

    /// The camera's pixel in linear light.
    pub(super) fn camera_color(&self, x: u32, y: u32) -> Vec3A {
        let [r, g, b, _] =
            self.frame.color.rgba[y as usize * self.frame.color.width as usize + x as usize];
        Vec3A::new(
            linear_from_srgb(r),
            linear_from_srgb(g),
            linear_from_srgb(b),
        )
    }
}
