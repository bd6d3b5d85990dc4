//! RT2AR's mean filter over penumbra pixels (section IV.E), kept within one surface.

use glam::Vec3A;

use super::FrameContext;
use super::scatter::LightShare;
use super::tile::{PixelLight, Seen, TILE_PIXELS, Tile};

/// Filters the light of one tile into `out` if it has any penumbra; pixels outside that are copied.
pub(super) fn filter_tile(
    ctx: &FrameContext<'_>,
    tile: &Tile,
    out: &mut [PixelLight; TILE_PIXELS],
) {
    let radius = ctx.settings.shadows.filter_radius_px;
    if !tile.has_penumbra || !ctx.go_on() {
        return;
    }
    *out = *tile.light;
    for dy in 0..tile.height {
        for dx in 0..tile.width {
            let place = Tile::index(dx, dy);
            let light = tile.light[place];
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            if light.ghost_penumbra {
                out[place].ghost = ctx.mean_ghost_share(x, y, radius);
            }
            if light.object_penumbra {
                out[place].object = ctx.mean_object_share(x, y, radius);
            }
        }
    }
}

impl FrameContext<'_> {
    fn window(&self, x: u32, y: u32, radius: u32) -> impl Iterator<Item = (u32, u32)> + use<> {
        let (right, bottom) = (self.frame.color.width - 1, self.frame.color.height - 1);
        let columns = x.saturating_sub(radius)..=(x + radius).min(right);
        (y.saturating_sub(radius)..=(y + radius).min(bottom))
            .flat_map(move |ny| columns.clone().map(move |nx| (nx, ny)))
    }

    fn mean_ghost_share(&self, x: u32, y: u32, radius: u32) -> Vec3A {
        let z = |x: u32, y: u32| self.occlusion_depth[(y * self.frame.color.width + x) as usize];
        let here = z(x, y);
        let mut sum = Vec3A::ZERO;
        let mut n = 0.0;
        for (nx, ny) in self.window(x, y, radius) {
            // Same surface: the depth step that would tear the ghost surface, per pixel apart. False
            // in a hole.
            let step = self.settings.ghost.edge_relative * radius as f32 * here;
            if (z(nx, ny) - here).abs() >= step || z(nx, ny).is_nan() {
                continue;
            }
            if let Some(light) = self.raw_light(nx, ny) {
                sum += light.ghost;
                n += 1.0;
            }
        }
        if n > 0.0 { sum / n } else { Vec3A::ONE }
    }

    fn mean_object_share(&self, x: u32, y: u32, radius: u32) -> LightShare {
        let here = self.pixel(x, y);
        let mut sum = [Vec3A::ZERO; 2];
        let mut n = 0.0;
        for (nx, ny) in self.window(x, y, radius) {
            let there = self.pixel(nx, ny);
            if there.seen == Seen::Object
                && there.hit.instance == here.hit.instance
                && let Some(light) = self.raw_light(nx, ny)
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
}
