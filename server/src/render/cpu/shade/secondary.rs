//! Traces secondary rays breadth first: all rays of a tile with the same number of bounces together.
//!
//! Each ray ends at a mesh, at the ghost surface, in a light, in the environment, or in unknown space; each kind
//! of end is counted. A hit on the ghost surface shows the camera's colour at its projection, as lit by virtual
//! objects (`wasSpecular` of Kan and Kaufmann 2012).

use glam::Vec3A;

use crate::accel::{Hit, Ray};
use crate::ghost::{GhostHit, GhostOutcome, Traversal};
use crate::render::cpu::path::{Path, mask_of_path};
use crate::render::cpu::scatter::{absorption, scatter};
use crate::render::cpu::shadow::cast::cast_shadows;
use crate::render::cpu::shadow::group::{POINTS_AT_ONCE, ShadowPoint, ShadowScratch};
use crate::render::cpu::tile::{LightShare, Tile};
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::light::CameraLight;
use crate::render::prepare::sensed::Sensed;
use crate::render::prepare::surface::Surface;
use crate::render::prepare::tile_plan::{TILE, TILE_PIXELS};

use super::direct::{direct, last_bounce};
use super::input::ShadeInput;
use super::rough::RoughTile;
use super::shaded::Shaded;

/// Approximate number of paths of a tile that are traced at once: bounds their memory for the largest number of
/// samples. It exceeds the number of paths in a tile with ordinary settings, because the order of summation
/// affects the last bits of a picture.
pub(crate) const PATHS_AT_ONCE: usize = 1 << 15;

/// Rays against the ghost surface between two checkpoints.
const GHOST_RAYS_AT_ONCE: usize = 4096;

/// Sums of the light of a tile's paths, per pixel.
pub(crate) struct Sums<'a> {
    pub(crate) virtual_light: &'a mut [Vec3A; TILE_PIXELS],
    /// The same for every second lens ray.
    pub(crate) odd_light: &'a mut [Vec3A],
    /// The same of shared reflections.
    pub(crate) rough: &'a mut RoughTile,
    /// The change that virtual objects cause on modelled real mirrors, Im - Ir.
    pub(crate) delta: &'a mut [Vec3A; TILE_PIXELS],
}

impl Sums<'_> {
    /// Adds the light of a path.
    pub(crate) fn add(&mut self, path: &Path, radiance: Vec3A) {
        let light = path.throughput * radiance;
        let place = usize::from(path.pixel);
        if path.shared {
            self.rough.add_light(place, light);
        } else if !path.of_mirror {
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
pub(crate) struct Scratch {
    pub(crate) paths: Vec<Path>,
    next: Vec<Path>,
    hits: Vec<Option<Hit>>,
    ghost_rays: Vec<Ray>,
    outcomes: Vec<GhostOutcome>,
    lit: Vec<(Surface, Path)>,
    /// Hits of lens rays, packets of neighbours one after the other.
    pub(crate) lens_hits: Vec<(Surface, Path)>,
    /// See [`Sums::odd_light`]; empty until there are lens rays.
    pub(crate) odd_light: Vec<Vec3A>,
    /// Pixels of one sample, and what they see.
    pub(crate) seen: Vec<(usize, Surface)>,
    pub(crate) rough: RoughTile,
    pub(crate) shadow: ShadowScratch,
}

/// Traces every path of the tile to its end.
pub(crate) fn trace_to_end(
    input: &ShadeInput<'_>,
    tile: &Tile,
    out: &mut Shaded,
    delta: &mut [Vec3A; TILE_PIXELS],
    scratch: &mut Scratch,
) {
    let frame = input.frame;
    for depth in 1..=frame.settings.max_bounces {
        if scratch.paths.is_empty() || !frame.go_on() {
            break;
        }
        trace_paths(input, tile, depth, out, delta, scratch);
    }
    scratch.paths.clear();
}

/// Traces every path of the tile by one bounce.
fn trace_paths(
    input: &ShadeInput<'_>,
    tile: &Tile,
    depth: u32,
    out: &mut Shaded,
    delta: &mut [Vec3A; TILE_PIXELS],
    scratch: &mut Scratch,
) {
    let frame = input.frame;
    let Scratch {
        paths,
        next,
        hits,
        ghost_rays,
        outcomes,
        lit,
        odd_light,
        rough,
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
    frame
        .scene
        .intersect_all(ghost_rays, |i| mask_of_path(paths[i].real), hits);
    for (ray, hit) in ghost_rays.iter_mut().zip(hits.iter()) {
        ray.t_min = frame.sensed.lift(ray.origin);
        ray.t_max = hit.map_or(f32::INFINITY, |hit| hit.t);
    }
    outcomes.clear();
    outcomes.resize(ghost_rays.len(), GhostOutcome::Unknown);
    let parts = ghost_rays.chunks(GHOST_RAYS_AT_ONCE);
    for (rays, outcomes) in parts.zip(outcomes.chunks_mut(GHOST_RAYS_AT_ONCE)) {
        if !frame.go_on() {
            return;
        }
        match frame.settings.ghost.traversal {
            Traversal::Pyramid => frame.sensed.ghost.trace_batch(rays, outcomes),
            other => {
                for (ray, outcome) in rays.iter().zip(outcomes) {
                    *outcome = frame.sensed.ghost.trace(other, ray);
                }
            }
        }
    }
    out.stats.secondary_rays += paths.len() as u64;
    let mut sums = Sums {
        virtual_light: &mut out.virtual_light,
        odd_light,
        rough,
        delta,
    };
    let met = paths.iter().zip(hits.iter()).zip(outcomes.iter());
    for (i, ((path, hit), outcome)) in met.enumerate() {
        if i.is_multiple_of(64) && !frame.go_on() {
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
        if depth == 1 && path.shared {
            sums.rough.add_length(usize::from(path.pixel), t_end);
        }
        if path.lobe.is_finite() {
            let seen = |light: &&CameraLight| light.is_seen_by_rays(path.origin, path.lobe);
            let light = frame
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
                sums.add(path, camera_seen_by(input, path, ghost));
            } else {
                out.stats.secondary_unknown += 1;
                sums.add(path, radiance_around(input, path));
            }
        } else if let Some(hit) = hit {
            out.stats.secondary_mesh += 1;
            let surface = frame
                .scene
                .surface(hit, path.direction, path.cone.after(hit.t));
            if frame.scene.objects[hit.instance as usize].ghost
                && let Some(color) = reproject(input, &surface, path.real)
            {
                sums.add(path, color);
                continue;
            }
            let mut path = *path;
            path.throughput *= absorption(frame.scene.material(&surface), &surface, hit.t);
            lit.push((surface, path));
        } else {
            match outcome {
                GhostOutcome::Environment => out.stats.secondary_environment += 1,
                _ => out.stats.secondary_unknown += 1,
            }
            sums.add(path, radiance_around(input, path));
        }
    }
    light_hits(input, tile, depth, lit, shadow, next, &mut sums);
    std::mem::swap(paths, next);
}

/// Radiance of a path that hits the ghost surface: the camera's picture there, as lit by virtual objects, or
/// unchanged for a path without them.
fn camera_seen_by(input: &ShadeInput<'_>, path: &Path, ghost: &GhostHit) -> Vec3A {
    let frame = input.frame;
    let (u, v) = (ghost.u, ghost.v);
    let z = (path.origin + path.direction * ghost.t).z;
    let width_px = path.cone.at(ghost.t) * frame.sensed.pinhole.fx.abs() / z;
    // A mirror shows the picture at full resolution. False for NaN.
    if let Some(levels) = input.lighting.camera_levels
        && path.lobe != 0.0
        && width_px > 2.0
    {
        let camera = levels.lookup(u, v, width_px);
        if path.real {
            return camera;
        }
        let (right, bottom) = frame.sensed.last();
        let nearest = |x: f32, last: u32| ((x + 0.5).max(0.0) as u32).min(last);
        let (x, y) = (nearest(u, right), nearest(v, bottom));
        return camera * input.light.at(x, y).ghost;
    }
    if path.real {
        camera_at(&frame.sensed, u, v)
    } else {
        relit_camera(input, u, v)
    }
}

/// Radiance of a path that hits nothing. Lamps extracted from an environment map are visible to mirrors only:
/// rough reflections show them as highlights.
fn radiance_around(input: &ShadeInput<'_>, path: &Path) -> Vec3A {
    if path.lobe == 0.0 {
        input.lighting.surroundings.radiance(path.direction)
    } else {
        input
            .lighting
            .surroundings
            .radiance_without_lamps(path.direction, path.cone.spread)
    }
}

/// Shades the hits of paths after `depth` bounces, each with its own shadow rays, and scatters the paths. A lens
/// ray's depth is 0, and the hits of its packet are a block of neighbours.
pub(crate) fn light_hits(
    input: &ShadeInput<'_>,
    tile: &Tile,
    depth: u32,
    hits: &[(Surface, Path)],
    shadow: &mut ShadowScratch,
    next: &mut Vec<Path>,
    sums: &mut Sums<'_>,
) {
    let frame = input.frame;
    for lit in hits.chunks(POINTS_AT_ONCE) {
        shadow.clear();
        if depth == 0 {
            for block in lit.chunk_by(|(_, a), (_, b)| a.sample == b.sample) {
                shadow.object_block(
                    asked_points(frame, tile, block),
                    frame.settings.ghost.edge_relative,
                );
            }
        } else {
            shadow.object_points(asked_points(frame, tile, lit));
        }
        cast_shadows(frame, &input.lighting, shadow);
        let mut answers = shadow.groups().iter().flat_map(|group| group.answered());
        for (i, (surface, path)) in lit.iter().enumerate() {
            if !input.go_on_at(i) {
                return;
            }
            let material = frame.scene.material(surface);
            let answer = asks_for_light(frame, surface)
                .then(|| answers.next())
                .flatten();
            let share = answer.map_or(LightShare::ALL, |(_, answer)| answer.of_object());
            sums.add(
                path,
                direct(frame, &input.lighting, surface, share, Vec3A::ONE),
            );
            if depth < frame.settings.max_bounces {
                let glossy = glossy_rays(frame, depth);
                scatter(material, surface, path, depth, glossy, next);
            } else {
                // The last bounce uses the surroundings instead of another ray.
                sums.add(
                    path,
                    last_bounce(material, &input.lighting.surroundings, surface),
                );
            }
        }
    }
}

/// Whether lamps are visible on a surface and may be occluded there.
fn asks_for_light(frame: &PreparedFrame<'_>, surface: &Surface) -> bool {
    frame.light_samples.len() > 0 && frame.material_needs_light[surface.material as usize]
}

/// The hits that need shadow rays, as points for the shadow stage.
fn asked_points<'h>(
    frame: &'h PreparedFrame<'_>,
    tile: &'h Tile,
    hits: &'h [(Surface, Path)],
) -> impl Iterator<Item = ShadowPoint> + 'h {
    let asking = hits.iter().filter(|hit| asks_for_light(frame, &hit.0));
    asking.map(|(surface, path)| {
        let (pixel, sample) = (u32::from(path.pixel), u32::from(path.sample));
        // The lens rays of a pixel use different samples of a light: together they cover it.
        let (x, y) = (tile.x0 + pixel % TILE, tile.y0 + pixel / TILE);
        ShadowPoint {
            coarse: path.lobe != 0.0,
            ..ShadowPoint::on_object(surface, x + sample, y + sample / 4)
        }
    })
}

/// Number of rays for a rough reflection of a metal after `depth` bounces of a path. The lens rays of a pixel
/// share those of its first bounce.
pub(crate) fn glossy_rays(frame: &PreparedFrame<'_>, depth: u32) -> u32 {
    match frame.lens {
        Some(lens) if depth == 0 => frame.settings.glossy_samples.div_ceil(lens.n() as u32),
        _ => 1,
    }
}

/// The camera's colour at a point of a modelled real object, if the camera sees that point.
fn reproject(input: &ShadeInput<'_>, surface: &Surface, real: bool) -> Option<Vec3A> {
    let frame = input.frame;
    let p = surface.position;
    if p.z <= 0.0 {
        return None;
    }
    let (u, v) = frame.sensed.pinhole.project(p);
    let [w, h] = frame.sensed.size().map(|n| n as f32);
    if !(u >= -0.5 && v >= -0.5 && u < w - 0.5 && v < h - 0.5) {
        return None;
    }
    // If the camera is on the other side, or a nearer surface is in between, the camera does not see the point.
    if surface.geometric_normal.dot(p) >= 0.0 {
        return None;
    }
    if let Some(z) = frame.sensed.ghost.depth_at(u, v)
        && p.z > z + frame.sensed.lift(Vec3A::Z * z)
    {
        return None;
    }
    Some(if real {
        camera_at(&frame.sensed, u, v)
    } else {
        relit_camera(input, u, v)
    })
}

/// The camera's picture at any position, unchanged: exactly equal to [`relit_camera`] where virtual objects do
/// not change the light, so that the two cancel.
fn camera_at(sensed: &Sensed<'_>, u: f32, v: f32) -> Vec3A {
    sensed.interpolate(u, v, |x, y| sensed.color_at(x, y))
}

/// The camera's picture at any position, as lit by virtual objects.
fn relit_camera(input: &ShadeInput<'_>, u: f32, v: f32) -> Vec3A {
    input.light.surfaces.relit_camera(&input.frame.sensed, u, v)
}
