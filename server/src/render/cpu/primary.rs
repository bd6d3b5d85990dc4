//! The primary stage: the surface that each pixel of an active tile shows, which is the nearest of meshes and
//! ghost surface (RT2AR, section IV.A). Primary rays have direction z = 1, so their parameter is depth and can be
//! compared directly with the depth map.

use glam::Vec3A;

use crate::accel::{HitPacket, Ray, RayPacket};
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::mask::MASK_ALL;
use crate::render::prepare::pinhole::NEAR_M;
use crate::render::prepare::sensed::Sensed;

use super::tile::{NO_HIT, Pixel, PrimaryHit, PrimaryTile, Tile};

/// Finds the surfaces that the pixels of a tile show.
pub(crate) fn trace_tile(frame: &PreparedFrame<'_>, tile: &Tile, out: &mut PrimaryTile) {
    if out.shows_objects {
        out.pixels.fill(Pixel::default());
    }
    out.shows_objects = tile.sees_objects;
    if !tile.sees_objects {
        return;
    }
    let mut rays = [RayPacket::default(); 4];
    let mut hits = [HitPacket::default(); 4];
    // Quarters of 8x8 pixels, each four 4x4 blocks: the most coherent groups of 64 rays.
    for quarter in 0..4 {
        let (qx, qy) = (quarter % 2 * 8, quarter / 2 * 8);
        if qx >= tile.width || qy >= tile.height {
            continue;
        }
        if !frame.go_on() {
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
                        direction: frame.sensed.direction_at(tile.x0 + dx, tile.y0 + dy),
                        t_min: NEAR_M,
                        t_max: f32::INFINITY,
                    },
                );
                if dx < tile.width && dy < tile.height {
                    active[block as usize] |= 1 << lane;
                }
            }
        }
        frame
            .scene
            .intersect_packets(&rays, &active, MASK_ALL, &mut hits);
        for block in 0..4 {
            for lane in 0..16 {
                // Inactive lanes have no hit.
                let Some(hit) = hits[block as usize].get(lane as usize) else {
                    continue;
                };
                let (dx, dy) = pixel(block, lane);
                let seen = seen(
                    &frame.sensed,
                    tile.x0 + dx,
                    tile.y0 + dy,
                    hit.t,
                    frame.scene.objects[hit.instance as usize].ghost,
                );
                out.pixels[Tile::index(dx, dy)] = Pixel {
                    seen,
                    hit: if seen == PrimaryHit::Camera {
                        NO_HIT
                    } else {
                        hit
                    },
                };
            }
        }
    }
}

/// What the ray through pixel (x, y) shows if it hits a mesh at depth `z`.
pub(crate) fn seen(sensed: &Sensed<'_>, x: u32, y: u32, z: f32, ghost_object: bool) -> PrimaryHit {
    match (sensed.shows(x, y, z), ghost_object) {
        (false, _) => PrimaryHit::Camera,
        (true, false) => PrimaryHit::Object,
        (true, true) => PrimaryHit::GhostObject,
    }
}
