//! What each pixel of an active tile sees: the nearest of meshes and ghost surface
//! (RT2AR, section IV.A). Primary rays have direction z = 1, so their parameter is depth and
//! compares with the depth map directly.

use crate::accel::{HitPacket, RayPacket};
use crate::frame::depth_sigma_m;
use crate::render::HolePolicy;

use super::FrameContext;
use super::tile::{NO_HIT, Pixel, Seen, Tile};

/// Nearest distance at which primary rays see a mesh, metres.
pub(super) const NEAR_M: f32 = 1e-3;

/// Fills `tile.pixels`.
pub(super) fn trace_tile(ctx: &FrameContext<'_>, tile: &mut Tile) {
    tile.pixels.fill(Pixel::default());
    if !tile.sees_objects {
        return;
    }
    let mut rays = RayPacket::default();
    let mut hits = HitPacket::default();
    for (bx, by) in tile.blocks() {
        let mut active = 0u16;
        for lane in 0..16u32 {
            let (dx, dy) = (bx + lane % 4, by + lane / 4);
            let d = ctx.ray_direction((tile.x0 + dx) as f32, (tile.y0 + dy) as f32);
            rays.set(
                lane as usize,
                &crate::accel::Ray {
                    origin: glam::Vec3A::ZERO,
                    direction: d,
                    t_min: NEAR_M,
                    t_max: f32::INFINITY,
                },
            );
            if dx < tile.width && dy < tile.height {
                active |= 1 << lane;
            }
        }
        ctx.intersect_packet(&rays, active, super::MASK_ALL, &mut hits);
        for lane in 0..16u32 {
            let hit = if active & (1 << lane) == 0 {
                None
            } else {
                hits.get(lane as usize)
            };
            let Some(hit) = hit else { continue };
            let (dx, dy) = (bx + lane % 4, by + lane / 4);
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

impl FrameContext<'_> {
    /// What a primary ray through pixel (x, y) shows, given a mesh at depth `z`.
    pub(super) fn seen(&self, x: u32, y: u32, z: f32, ghost_object: bool) -> Seen {
        let index = y as usize * self.frame.color.width as usize + x as usize;
        let real = self.occlusion_depth[index];
        let in_front = if real.is_nan() {
            self.settings.ghost.holes == HolePolicy::ShowVirtual
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
