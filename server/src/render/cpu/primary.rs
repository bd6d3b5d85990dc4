//! What each pixel of an active tile sees: the nearest of meshes and ghost surface
//! (RT2AR, section IV.A). Primary rays have direction z = 1, so their parameter is depth and
//! compares with the depth map directly.

use glam::Vec3A;

use crate::accel::{HitPacket, Ray, RayPacket};
use crate::frame::depth_sigma_m;
use crate::render::HolePolicy;

use super::FrameContext;
use super::tile::{NO_HIT, Pixel, Seen, Tile};

/// Nearest distance at which primary rays see a mesh, metres.
pub(super) const NEAR_M: f32 = 1e-3;

/// Fills `tile.pixels`.
pub(super) fn trace_tile(ctx: &FrameContext<'_>, tile: &mut Tile) {
    if tile.shows_objects {
        tile.pixels.fill(Pixel::default());
    }
    tile.shows_objects = tile.sees_objects;
    if !tile.sees_objects {
        return;
    }
    let mut rays = [RayPacket::default(); 4];
    let mut hits = [HitPacket::default(); 4];
    // Quarters of 8x8 pixels, of four 4x4 blocks: as near together as 64 rays get.
    for quarter in 0..4 {
        let (qx, qy) = (quarter % 2 * 8, quarter / 2 * 8);
        if qx >= tile.width || qy >= tile.height {
            continue;
        }
        if !ctx.go_on() {
            return;
        }
        let pixel = |block: u32, lane: u32| {
            let (bx, by) = (qx + block % 2 * 4, qy + block / 2 * 4);
            (bx + lane % 4, by + lane / 4)
        };
        let mut active = [0_u16; 4];
        for block in 0..4 {
            for lane in 0..16 {
                let (dx, dy) = pixel(block, lane);
                rays[block as usize].set(
                    lane as usize,
                    &Ray {
                        origin: Vec3A::ZERO,
                        direction: ctx.ray_direction((tile.x0 + dx) as f32, (tile.y0 + dy) as f32),
                        t_min: NEAR_M,
                        t_max: f32::INFINITY,
                    },
                );
                if dx < tile.width && dy < tile.height {
                    active[block as usize] |= 1 << lane;
                }
            }
        }
        ctx.intersect_packets(&rays, &active, super::MASK_ALL, &mut hits);
        for block in 0..4 {
            for lane in 0..16 {
                // Lanes that are not active have no hit.
                let Some(hit) = hits[block as usize].get(lane as usize) else {
                    continue;
                };
                let (dx, dy) = pixel(block, lane);
                let seen = ctx.seen(
                    tile.x0 + dx,
                    tile.y0 + dy,
                    hit.t,
                    ctx.objects[hit.instance as usize].ghost,
                );
                tile.pixels[Tile::index(dx, dy)] = Pixel {
                    seen,
                    hit: if seen == Seen::Camera { NO_HIT } else { hit },
                };
            }
        }
    }
}

impl FrameContext<'_> {
    /// What a primary ray through pixel (x, y) shows, given a mesh at depth `z`.
    pub(super) fn seen(&self, x: u32, y: u32, z: f32, ghost_object: bool) -> Seen {
        let index = y as usize * self.frame.color.width as usize + x as usize;
        let real = self.occlusion_depth[index];
        let in_front = if real.is_nan() {
            // Under `Fill` a NaN is left only where no measurement is in reach: nothing is known to be
            // in front there, and an object must not blink out with the sensor.
            self.settings.ghost.holes != HolePolicy::ShowReal
        } else {
            // The sensor is not sure to better than its noise: within it, the object wins, so
            // that its foot on a real surface is not eaten by noise.
            z <= real + self.settings.ghost.occlusion_sigmas * depth_sigma_m(real)
        };
        match (in_front, ghost_object) {
            (false, _) => Seen::Camera,
            (true, false) => Seen::Object,
            (true, true) => Seen::GhostObject,
        }
    }
}
