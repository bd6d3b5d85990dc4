//! Anti-aliasing: several samples for pixels on outlines, and where neighbours differ much.

use glam::Vec3A;

use crate::accel::{Hit, HitPacket, Ray, RayPacket};
use crate::numerics::{luminance, radical_inverse};
use crate::render::cpu::path::PixelSample;
use crate::render::cpu::primary::seen;
use crate::render::cpu::tile::{LightShare, PrimaryHit, Tile};
use crate::render::prepare::mask::MASK_ALL;
use crate::render::prepare::tile_plan::{TILE, TILE_PIXELS};

use super::direct::{FirstRays, direct, start};
use super::input::{ShadeInput, ShadeTile};
use super::secondary::{PATHS_AT_ONCE, Scratch, trace_to_end};
use super::shaded::Shaded;

/// Depth difference between neighbouring pixels of one object that counts as a silhouette of the object against
/// itself, relative to depth.
const SILHOUETTE_STEP: f32 = 0.02;

/// Whether a pixel of a tile is on the outline of a virtual object.
pub(super) fn is_edge(input: &ShadeInput<'_>, tile: ShadeTile<'_>, dx: u32, dy: u32) -> bool {
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
pub(super) fn refine_contrast(
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
pub(super) fn shade_edge(
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
                FirstRays {
                    glossy: frame.settings.glossy_samples,
                    shared: None,
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
