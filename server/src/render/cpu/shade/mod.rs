//! Shading, secondary rays and compositing of one tile.
//!
//! Every pixel gets `If = M Im + (1 - M)(Ic + Im - Ir)` (Kan and Kaufmann 2012), averaged over its
//! samples. On the real surface the diffuse albedo is estimated from the camera's pixel and the
//! modelled irradiance, `rho = pi Ic / Er`; then Ir is Ic itself and Ic + Im - Ir = Ic Em / Er, the
//! camera's pixel times the share of light that virtual objects leave.
//!
//! A contribution is a sum over paths, so their order inside a tile is fixed and the picture does
//! not depend on threads.

mod direct;
pub(crate) mod input;
mod lens;
mod lens_walk;
pub(crate) mod secondary;
pub(crate) mod shaded;

use glam::Vec3A;

use crate::accel::{Hit, HitPacket, Ray, RayPacket};
use crate::numerics::{luminance, radical_inverse, srgb_from_linear};
use crate::render::prepare::mask::MASK_ALL;
use crate::render::prepare::tile_plan::{TILE, TILE_PIXELS};
use crate::render::stats::FrameStats;

use super::light_field::LightField;
use super::path::{PixelSample, mirror_seeds};
use super::primary::seen;
use super::scatter::{is_specular, scatter};
use super::tile::{LightShare, LightTile, PrimaryHit, Tile};
use direct::{direct, start};
use input::{ShadeInput, ShadeTile};
use lens::trace_lens;
use secondary::{PATHS_AT_ONCE, Scratch, trace_to_end};
use shaded::Shaded;

/// Depth difference between neighbouring pixels of one object that counts as a silhouette of the object against
/// itself, relative to depth.
const SILHOUETTE_STEP: f32 = 0.02;

/// Shades one tile.
pub(crate) fn shade_tile(
    input: &ShadeInput<'_>,
    this: ShadeTile<'_>,
    lit: &LightTile,
    out: &mut Shaded,
    scratch: &mut Scratch,
) {
    let (frame, tile) = (input.frame, this.tile);
    if !out.blank {
        out.virtual_light.fill(Vec3A::ZERO);
        out.mask.fill(0.0);
        out.blank = true;
    }
    out.touched.fill(false);
    out.shares.clear();
    out.peak = 0.0;
    out.stats = lit.stats;
    let lens = frame.lens.filter(|_| tile.lens.rays || tile.lens.gathers);
    if !tile.sees_objects && !lit.is_relit && lens.is_none() {
        // The plan expected virtual objects to affect this tile, but they do not: the camera's pixels stay.
        out.stats.traced_pixels += u64::from(tile.width * tile.height);
        return;
    }
    if lit.only_ambient && lens.is_none() {
        shade_relit(input, this, out);
        return;
    }
    out.blank = false;
    scratch.paths.clear();
    scratch.shadow.stats = FrameStats::default();

    // The change that virtual objects cause on modelled real mirrors, Im - Ir, per pixel.
    let mut delta = [Vec3A::ZERO; TILE_PIXELS];
    let mut any_delta = false;
    if let Some(lens) = lens {
        trace_lens(input, lens, tile, out, &mut delta, scratch);
        any_delta = frame.has_ghost_objects;
    }
    let through_lens = lens.is_some() && tile.lens.rays;
    // Block by block, because secondary rays of neighbours are traced together.
    let pixels = tile
        .blocks()
        .flat_map(|(bx, by)| (0..16).map(move |i| (bx + i % 4, by + i / 4)));
    let inside = |&(dx, dy): &(u32, u32)| !through_lens && dx < tile.width && dy < tile.height;
    for (i, (dx, dy)) in pixels.filter(inside).enumerate() {
        if !input.go_on_at(i) {
            return;
        }
        if scratch.paths.len() > PATHS_AT_ONCE {
            trace_to_end(input, tile, out, &mut delta, scratch);
        }
        let place = Tile::index(dx, dy);
        let (x, y) = (tile.x0 + dx, tile.y0 + dy);
        let pixel = this.primary.pixels[place];
        let light = input.light.at(x, y);
        let whole = PixelSample {
            place,
            weight: 1.0,
            random: frame.random(x, y, 0),
        };
        if tile.sees_objects && frame.settings.edge_samples > 1 && is_edge(input, this, dx, dy) {
            shade_edge(input, this, x, y, place, out, scratch);
        } else {
            match pixel.seen {
                PrimaryHit::Camera => {}
                PrimaryHit::Object => {
                    let surface = frame.primary_surface(&pixel.hit, x, y);
                    out.mask[place] = 1.0;
                    out.virtual_light[place] +=
                        direct(frame, &input.lighting, &surface, light.object, Vec3A::ONE);
                    out.virtual_light[place] +=
                        start(frame, &input.lighting, &surface, whole, &mut scratch.paths);
                }
                PrimaryHit::GhostObject => {
                    let surface = frame.primary_surface(&pixel.hit, x, y);
                    let material = frame.scene.material(&surface);
                    if is_specular(material, &surface) {
                        any_delta = true;
                        let glossy = frame.settings.glossy_samples;
                        for path in mirror_seeds(&surface, whole) {
                            scatter(material, &surface, &path, 0, glossy, &mut scratch.paths);
                        }
                    }
                }
            }
        }
    }
    trace_to_end(input, tile, out, &mut delta, scratch);
    if !through_lens
        && tile.sees_objects
        && frame.settings.edge_samples > 1
        && refine_contrast(input, this, out, &mut delta, scratch)
    {
        trace_to_end(input, tile, out, &mut delta, scratch);
    }
    if !frame.go_on() {
        return;
    }
    out.stats.add(&scratch.shadow.stats);

    for dy in 0..tile.height {
        for dx in 0..tile.width {
            let place = Tile::index(dx, dy);
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            let share = real_share(&input.light, out, x, y, place);
            let mask = out.mask[place];
            let relit = share != Vec3A::ONE;
            let changed = any_delta && delta[place] != Vec3A::ZERO;
            if mask == 0.0 && !relit && !changed {
                continue;
            }
            out.touched[place] = true;
            let camera = frame.sensed.color_at(x, y);
            // Real mirrors: `delta` already has Im - Ir with the sign and weight of each ray.
            let background = camera * share * (1.0 - mask) + delta[place];
            out.color[place] = out.virtual_light[place] + background.max(Vec3A::ZERO);
            out.bytes[place] = out.color[place].to_array().map(srgb_from_linear);
            out.peak = out.peak.max(luminance(out.virtual_light[place]));
            let real_depth = frame.sensed.depth_at(x, y);
            out.stats.virtual_pixels += u64::from(mask > 0.0);
            out.stats.unmeasured_pixels += u64::from(mask > 0.0 && real_depth.is_nan());
            out.stats.relit_pixels += u64::from(relit && mask < 1.0);
        }
    }
    out.stats.traced_pixels += u64::from(tile.width * tile.height);
}

/// Shades a tile in which only the ambient light of real surfaces changes.
fn shade_relit(
    input: &ShadeInput<'_>,
    ShadeTile { slot, tile, .. }: ShadeTile<'_>,
    out: &mut Shaded,
) {
    let frame = input.frame;
    let ambient = input.light.surfaces.raw.ambient;
    if !frame.go_on() {
        return;
    }
    for dy in 0..tile.height {
        for dx in 0..tile.width {
            let place = Tile::index(dx, dy);
            let share = ambient.share(slot, place);
            if share == Vec3A::ONE {
                continue;
            }
            out.touched[place] = true;
            out.color[place] = frame.sensed.color_at(tile.x0 + dx, tile.y0 + dy) * share;
            out.bytes[place] = out.color[place].to_array().map(srgb_from_linear);
            out.stats.relit_pixels += 1;
        }
    }
    out.stats.traced_pixels += u64::from(tile.width * tile.height);
}

/// The share of light that virtual objects leave on real surfaces in a pixel.
pub(crate) fn real_share(
    light: &LightField<'_>,
    out: &Shaded,
    x: u32,
    y: u32,
    place: usize,
) -> Vec3A {
    let through_lens = out.shares.get(place).copied();
    through_lens.unwrap_or_else(|| light.at(x, y).ghost)
}

/// Whether a pixel of a tile is on the outline of a virtual object.
fn is_edge(input: &ShadeInput<'_>, tile: ShadeTile<'_>, dx: u32, dy: u32) -> bool {
    let (x, y) = (tile.tile.x0 + dx, tile.tile.y0 + dy);
    let (right, bottom) = input.frame.sensed.last();
    let place = Tile::index(dx, dy);
    let here = &tile.primary.pixels[place];
    let inside = |there: usize| tile.primary.pixels[there];
    let neighbours = [
        (x > 0).then(|| match dx {
            0 => input.primary.at(x - 1, y),
            _ => inside(place - 1),
        }),
        (x < right).then(|| match tile.tile.width - dx {
            1 => input.primary.at(x + 1, y),
            _ => inside(place + 1),
        }),
        (y > 0).then(|| match dy {
            0 => input.primary.at(x, y - 1),
            _ => inside(place - TILE as usize),
        }),
        (y < bottom).then(|| match tile.tile.height - dy {
            1 => input.primary.at(x, y + 1),
            _ => inside(place + TILE as usize),
        }),
    ];
    neighbours.into_iter().flatten().any(|there| {
        let any_object = here.seen == PrimaryHit::Object || there.seen == PrimaryHit::Object;
        any_object
            && (here.seen != there.seen
                || here.hit.instance != there.hit.instance
                || (here.hit.t - there.hit.t).abs() > SILHOUETTE_STEP * here.hit.t.min(there.hit.t))
    })
}

/// Anti-aliasing by image gradient (RT2AR, section III.A): virtual pixels that differ much from a neighbour, as
/// in strongly curved reflections, are shaded again with several samples.
fn refine_contrast(
    input: &ShadeInput<'_>,
    tile: ShadeTile<'_>,
    out: &mut Shaded,
    delta: &mut [Vec3A; TILE_PIXELS],
    scratch: &mut Scratch,
) -> bool {
    let mut refine = [false; TILE_PIXELS];
    // Approximate displayed brightness: a square root for the transfer curve.
    let shown = |place: usize| luminance(out.virtual_light[place]).clamp(0.0, 1.0).sqrt();
    let whole = |place: usize| out.mask[place] == 1.0;
    for dy in 0..tile.tile.height {
        for dx in 0..tile.tile.width {
            let here = Tile::index(dx, dy);
            for (nx, ny) in [(dx + 1, dy), (dx, dy + 1)] {
                if nx >= tile.tile.width || ny >= tile.tile.height {
                    continue;
                }
                let there = Tile::index(nx, ny);
                if whole(here)
                    && whole(there)
                    && (shown(here) - shown(there)).abs() > input.frame.settings.edge_contrast
                {
                    refine[here] = true;
                    refine[there] = true;
                }
            }
        }
    }
    for dy in 0..tile.tile.height {
        for dx in 0..tile.tile.width {
            let place = Tile::index(dx, dy);
            let (x, y) = (tile.tile.x0 + dx, tile.tile.y0 + dy);
            // Pixels on outlines already have several samples.
            if refine[place] && !is_edge(input, tile, dx, dy) {
                if scratch.paths.len() > PATHS_AT_ONCE {
                    trace_to_end(input, tile.tile, out, delta, scratch);
                }
                out.mask[place] = 0.0;
                out.virtual_light[place] = Vec3A::ZERO;
                shade_edge(input, tile, x, y, place, out, scratch);
            }
        }
    }
    !scratch.paths.is_empty()
}

/// Several samples for a pixel on an outline, stratified over its area.
fn shade_edge(
    input: &ShadeInput<'_>,
    tile: ShadeTile<'_>,
    x: u32,
    y: u32,
    place: usize,
    out: &mut Shaded,
    scratch: &mut Scratch,
) {
    let frame = input.frame;
    let n = input.frame.settings.edge_samples;
    let weight = 1.0 / n as f32;
    let mut rays = RayPacket::default();
    let mut hits = HitPacket::default();
    for first in (0..n).step_by(16) {
        let lanes = (n - first).min(16);
        for lane in 0..lanes {
            // Hammersley points: one in each row and column of an n x n grid.
            let i = first + lane;
            let su = (i as f32 + 0.5) * weight - 0.5;
            let sv = radical_inverse(i) + 0.5 * weight - 0.5;
            let direction = frame
                .sensed
                .pinhole
                .ray_direction(x as f32 + su, y as f32 + sv.min(0.5));
            rays.set(
                lane as usize,
                &Ray {
                    origin: Vec3A::ZERO,
                    direction,
                    t_min: 1e-3,
                    t_max: f32::INFINITY,
                },
            );
        }
        let active = ((1u32 << lanes) - 1) as u16;
        frame
            .scene
            .intersect_packet(&rays, active, MASK_ALL, &mut hits);
        for lane in 0..lanes as usize {
            if !input.go_on_at(lane) {
                return;
            }
            let Some(hit) = hits.get(lane) else { continue };
            let ghost = frame.scene.objects[hit.instance as usize].ghost;
            let seen = seen(&frame.sensed, x, y, hit.t, ghost);
            if seen != PrimaryHit::Object {
                continue;
            }
            let cone = frame.sensed.pinhole.pixel_cone(hit.t).share(n);
            let surface = frame.scene.surface(&hit, rays.get(lane).direction, cone);
            out.mask[place] += weight;
            out.virtual_light[place] += direct(
                frame,
                &input.lighting,
                &surface,
                object_share_near(input, tile, x, y, &hit),
                Vec3A::ONE,
            ) * weight;
            out.virtual_light[place] += start(
                frame,
                &input.lighting,
                &surface,
                PixelSample {
                    place,
                    weight,
                    random: frame.random(x, y, first + lane as u32),
                },
                &mut scratch.paths,
            );
        }
    }
    // The sum of weights is exact if they are powers of two; otherwise it has a few roundings.
    out.mask[place] = out.mask[place].min(1.0);
}

/// The share of direct light at the pixel, or at a neighbour that shows the same object.
fn object_share_near(
    input: &ShadeInput<'_>,
    tile: ShadeTile<'_>,
    x: u32,
    y: u32,
    hit: &Hit,
) -> LightShare {
    let (right, bottom) = (
        tile.tile.x0 + tile.tile.width - 1,
        tile.tile.y0 + tile.tile.height - 1,
    );
    let mut best = None;
    for ny in y.saturating_sub(1).max(tile.tile.y0)..=(y + 1).min(bottom) {
        for nx in x.saturating_sub(1).max(tile.tile.x0)..=(x + 1).min(right) {
            let pixel = input.primary.at(nx, ny);
            if pixel.seen == PrimaryHit::Object && pixel.hit.instance == hit.instance {
                let distance = (pixel.hit.t - hit.t).abs();
                if best.is_none_or(|(d, _)| distance < d) {
                    best = Some((distance, input.light.at(nx, ny).object));
                }
            }
        }
    }
    best.map_or(LightShare::ALL, |(_, share)| share)
}
