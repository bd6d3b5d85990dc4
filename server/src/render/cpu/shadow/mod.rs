//! The shadow stage: the direct light on every real and virtual surface of a tile.

pub(crate) mod cast;
pub(crate) mod group;
mod rays;

use glam::Vec3A;

use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::sensed::Sensed;
use crate::render::settings::ShadowMethod;
use crate::render::stats::FrameStats;

use super::ambient::change::AmbientChanges;
use super::lighting::Lighting;
use super::photons::light::gather_tile;
use super::tile::{LightTile, PixelLight, PrimaryHit, PrimaryTile, Tile};
use cast::cast_shadows;
use group::{Gloss, ShadowPoint, ShadowScratch};

/// Finds the light on every lit surface of the tile at index `slot`.
pub(crate) fn trace_tile(
    frame: &PreparedFrame<'_>,
    lighting: &Lighting<'_>,
    ambient: AmbientChanges<'_>,
    (slot, tile, primary): (usize, &Tile, &PrimaryTile),
    out: &mut LightTile,
    scratch: &mut ShadowScratch,
) {
    out.has_penumbra = false;
    out.is_relit = false;
    out.stats = FrameStats::default();
    out.only_ambient = !tile.sees_objects && tile.lights.is_empty() && !tile.has_photons;
    if out.only_ambient {
        out.is_relit = ambient.any(slot);
        return;
    }
    for (place, light) in out.light.iter_mut().enumerate() {
        *light = PixelLight {
            ghost: ambient.share(slot, place),
            ..PixelLight::default()
        };
    }
    out.is_relit = out.light.iter().any(|light| light.ghost != Vec3A::ONE);
    scratch.stats = FrameStats::default();
    let off = frame.settings.shadows.method == ShadowMethod::Off;
    if (off && !tile.has_photons) || frame.lights.is_empty() || !frame.go_on() {
        return;
    }
    scratch.clear();
    let mut photons = std::mem::take(&mut scratch.photons);
    gather_tile(lighting.photons, frame, tile, &mut photons);
    for (bx, by) in tile.blocks() {
        let pixels = (0..16)
            .map(|lane| (bx + lane % 4, by + lane / 4))
            .filter(|&(dx, dy)| dx < tile.width && dy < tile.height);
        if !tile.lights.is_empty() || tile.has_photons {
            let group = scratch.group(true, tile.lights, tile.glass);
            for (dx, dy) in pixels.clone() {
                let Some(mut point) = ghost_point(&frame.sensed, tile.x0 + dx, tile.y0 + dy) else {
                    continue;
                };
                let place = Tile::index(dx, dy);
                let change = ambient.at(slot, place);
                point.normal = change.normal;
                match photons.at(place) {
                    None => group.push(point),
                    Some((e, normal)) => {
                        point.normal = normal;
                        group.push_lit(point, e);
                    }
                }
                group.set_ambient(change);
            }
            group.coherent = group.is_one_surface(frame.settings.ghost.edge_relative);
        }
        let lit = pixels.filter_map(|(dx, dy)| {
            let pixel = &primary.pixels[Tile::index(dx, dy)];
            // With lens rays, each ray has its own shadow rays.
            let lit = !tile.lens.rays
                && pixel.seen == PrimaryHit::Object
                && frame.scene.objects[pixel.hit.instance as usize].needs_light;
            lit.then(|| {
                let (x, y) = (tile.x0 + dx, tile.y0 + dy);
                ShadowPoint::on_object(&frame.primary_surface(&pixel.hit, x, y), x, y)
            })
        });
        scratch.object_block(lit, frame.settings.ghost.edge_relative);
    }
    scratch.photons = photons;
    cast_shadows(frame, lighting, scratch);
    for group in scratch.groups() {
        // If no lamp's light changes, the share of ambient light is already stored.
        let answered = group.answered().enumerate();
        let asked = answered.filter(|(lane, _)| !group.on_ghost || group.touched & 1 << lane != 0);
        for (_, (point, answer)) in asked {
            let light = &mut out.light[Tile::index(point.x - tile.x0, point.y - tile.y0)];
            if group.on_ghost {
                light.ghost = answer.share;
                out.is_relit |= answer.share != Vec3A::ONE;
                light.ghost_penumbra = answer.penumbra;
            } else {
                light.object = answer.of_object();
                light.object_penumbra = answer.penumbra;
            }
            out.has_penumbra |= answer.penumbra;
        }
    }
    out.stats = scratch.stats;
}

/// The ghost surface at a pixel as a shadow point; `None` in a hole.
fn ghost_point(sensed: &Sensed<'_>, x: u32, y: u32) -> Option<ShadowPoint> {
    let z = sensed.depth_at(x, y);
    if z.is_nan() {
        return None;
    }
    Some(ShadowPoint {
        origin: sensed.direction_at(x, y) * z,
        normal: Vec3A::ZERO,
        gloss: Gloss::default(),
        coarse: false,
        x,
        y,
    })
}
