//! RT2AR's mean filter over penumbra pixels (section IV.E), kept within one surface.

use glam::Vec3A;

use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::sensed::Sensed;
use crate::render::prepare::tile_plan::TILE_PIXELS;

use super::light_field::RawLight;
use super::tile::{LightShare, LightTile, PixelLight, PrimaryHit, PrimaryPixels, Tile};

/// Filters the light of a tile into `out` if it has any penumbra; pixels outside of penumbra are copied.
pub(crate) fn filter_tile(
    frame: &PreparedFrame<'_>,
    primary: PrimaryPixels<'_>,
    raw: RawLight<'_>,
    (tile, lit): (&Tile, &LightTile),
    out: &mut [PixelLight; TILE_PIXELS],
) {
    let radius = frame.settings.shadows.filter_radius_px;
    if !lit.has_penumbra || !frame.go_on() {
        return;
    }
    *out = *lit.light;
    for dy in 0..tile.height {
        for dx in 0..tile.width {
            let place = Tile::index(dx, dy);
            let light = lit.light[place];
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            if light.ghost_penumbra {
                out[place].ghost = mean_ghost_share(&frame.sensed, raw, x, y, radius);
            }
            if light.object_penumbra {
                out[place].object = mean_object_share(&frame.sensed, primary, raw, x, y, radius);
            }
        }
    }
}

/// Pixels of the picture within `radius` along each axis.
fn window(
    sensed: &Sensed<'_>,
    x: u32,
    y: u32,
    radius: u32,
) -> impl Iterator<Item = (u32, u32)> + use<> {
    let (right, bottom) = sensed.last();
    let columns = x.saturating_sub(radius)..=(x + radius).min(right);
    (y.saturating_sub(radius)..=(y + radius).min(bottom))
        .flat_map(move |ny| columns.clone().map(move |nx| (nx, ny)))
}

fn mean_ghost_share(sensed: &Sensed<'_>, raw: RawLight<'_>, x: u32, y: u32, radius: u32) -> Vec3A {
    let here = sensed.depth_at(x, y);
    let mut sum = Vec3A::ZERO;
    let mut n = 0.0;
    for (nx, ny) in window(sensed, x, y, radius) {
        // The same surface: the depth step at which the ghost surface has an edge, times the distance in pixels.
        // False in a hole.
        let step = sensed.settings.edge_relative * radius as f32 * here;
        let there = sensed.depth_at(nx, ny);
        if (there - here).abs() >= step || there.is_nan() {
            continue;
        }
        if let Some(light) = raw.at(nx, ny) {
            sum += light.ghost;
            n += 1.0;
        }
    }
    if n > 0.0 { sum / n } else { Vec3A::ONE }
}

fn mean_object_share(
    sensed: &Sensed<'_>,
    primary: PrimaryPixels<'_>,
    raw: RawLight<'_>,
    x: u32,
    y: u32,
    radius: u32,
) -> LightShare {
    let here = primary.at(x, y);
    let mut sum = [Vec3A::ZERO; 2];
    let mut n = 0.0;
    for (nx, ny) in window(sensed, x, y, radius) {
        let there = primary.at(nx, ny);
        if there.seen == PrimaryHit::Object
            && there.hit.instance == here.hit.instance
            && let Some(light) = raw.at(nx, ny)
        {
            sum[0] += light.object.diffuse;
            sum[1] += light.object.gloss;
            n += 1.0;
        }
    }
    if n == 0.0 {
        return LightShare::ALL;
    }
    LightShare {
        diffuse: sum[0] / n,
        gloss: sum[1] / n,
        ambient: Vec3A::ZERO,
    }
}
