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
mod edges;
pub(crate) mod input;
mod lens;
mod lens_walk;
pub(crate) mod rough;
pub(crate) mod secondary;
pub(crate) mod shaded;

use glam::Vec3A;

use crate::numerics::{luminance, srgb_from_linear};
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::surface::Surface;
use crate::render::prepare::tile_plan::{TILE, TILE_PIXELS};
use crate::render::stats::FrameStats;

use super::light_field::LightField;
use super::path::{PixelSample, mirror_seeds};
use super::scatter::{RoughLobe, is_specular, scatter};
use super::tile::{LightTile, PrimaryHit, Tile};
use direct::{FirstRays, direct, start};
use edges::{is_edge, refine_contrast, shade_edge};
use input::{ShadeInput, ShadeTile};
use lens::trace_lens;
use rough::{RoughPixels, RoughTile};
use secondary::{PATHS_AT_ONCE, Scratch, trace_to_end};
use shaded::Shaded;

/// Shades one tile but for what its pixels share with others: [`finish_tile`] does that.
pub(crate) fn shade_tile(
    input: &ShadeInput<'_>,
    this: ShadeTile<'_>,
    lit: &LightTile,
    (out, rough): (&mut Shaded, &mut RoughTile),
    scratch: &mut Scratch,
) {
    let (frame, tile) = (input.frame, this.tile);
    out.traced = false;
    rough.clear();
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
    out.traced = true;
    scratch.paths.clear();
    scratch.shadow.stats = FrameStats::default();
    // A frame that was given up may have left something.
    scratch.seen.clear();
    scratch.rough.clear();
    std::mem::swap(rough, &mut scratch.rough);

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
                    note_lobe(frame, place, &surface, &mut scratch.rough);
                    scratch.seen.push((place, surface));
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
    start_seen(input, tile, out, &mut delta, scratch);
    trace_to_end(input, tile, out, &mut delta, scratch);
    std::mem::swap(rough, &mut scratch.rough);
    out.stats.add(&scratch.shadow.stats);
    out.delta.clear();
    if any_delta {
        out.delta.extend(delta);
    }
}

/// Finishes a tile: reflections shared with the pixels around, anti-aliasing by contrast, and the
/// composite.
pub(crate) fn finish_tile(
    input: &ShadeInput<'_>,
    this: ShadeTile<'_>,
    rough: RoughPixels<'_>,
    out: &mut Shaded,
    scratch: &mut Scratch,
) {
    let (frame, tile) = (input.frame, this.tile);
    if !out.traced {
        return;
    }
    for (i, (place, light)) in rough.gather(this.slot, (tile.x0, tile.y0)).enumerate() {
        if !input.go_on_at(i) {
            return;
        }
        out.virtual_light[place] += light;
    }
    let any_delta = !out.delta.is_empty();
    let mut delta = [Vec3A::ZERO; TILE_PIXELS];
    if any_delta {
        delta.copy_from_slice(&out.delta);
    }
    let through_lens = frame.lens.is_some() && tile.lens.rays;
    scratch.paths.clear();
    scratch.shadow.stats = FrameStats::default();
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

/// Lets the rough reflection of a pixel be shared with its neighbours, if settings say so.
fn note_lobe(frame: &PreparedFrame<'_>, place: usize, surface: &Surface, rough: &mut RoughTile) {
    let settings = frame.settings;
    if settings.glossy_sharing == 0.0 || settings.max_bounces == 0 {
        return;
    }
    let lobe = RoughLobe::of(frame.scene.material(surface), surface);
    if let Some(lobe) = lobe.filter(RoughLobe::matters) {
        let alone = lobe.rays(settings.glossy_samples);
        // What a single ray estimates is faint.
        if alone > 1 {
            rough.add(place, surface, &lobe, settings.glossy_sharing, alone);
        }
    }
}

/// Sends the first rays of the pixels that see an object by themselves.
fn start_seen(
    input: &ShadeInput<'_>,
    tile: &Tile,
    out: &mut Shaded,
    delta: &mut [Vec3A; TILE_PIXELS],
    scratch: &mut Scratch,
) {
    let frame = input.frame;
    scratch.rough.plan();
    let mut seen = std::mem::take(&mut scratch.seen);
    for (i, (place, surface)) in seen.drain(..).enumerate() {
        if !input.go_on_at(i) {
            break;
        }
        if scratch.paths.len() > PATHS_AT_ONCE {
            trace_to_end(input, tile, out, delta, scratch);
        }
        let (x, y) = (tile.x0 + place as u32 % TILE, tile.y0 + place as u32 / TILE);
        let whole = PixelSample {
            place,
            weight: 1.0,
            random: frame.random(x, y, 0),
        };
        let rays = FirstRays {
            glossy: frame.settings.glossy_samples,
            shared: scratch.rough.rays(place),
        };
        out.virtual_light[place] += start(
            frame,
            &input.lighting,
            &surface,
            whole,
            rays,
            &mut scratch.paths,
        );
    }
    scratch.seen = seen;
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
