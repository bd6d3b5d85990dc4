//! Which tiles of a frame anything virtual can influence. The others are copied.

use glam::Vec3A;

use crate::frame::DepthImage;

use super::light::CameraLight;
use super::tile::{TILE, Tile, TileGrid};

/// A mesh's camera-space bounds, and what of the picture they cover.
#[derive(Debug, Clone, Copy)]
pub(super) struct ObjectBounds {
    pub(super) center: Vec3A,
    pub(super) radius: f32,
    /// Pixels x0..x1, y0..y1, clipped to the picture; empty if out of view.
    pixels: [u32; 4],
    /// Modelled ghosts show the camera's pixel and cause no change by themselves.
    pub(super) ghost: bool,
}

impl ObjectBounds {
    /// From a box in camera space. Conservative: a box that reaches behind the camera covers all.
    pub(super) fn new(low: Vec3A, high: Vec3A, ghost: bool, intrinsics: &crate::camera::Intrinsics) -> Self {
        let (width, height) = (intrinsics.width, intrinsics.height);
        let center = (low + high) * 0.5;
        let radius = (high - low).length() * 0.5;
        let near = DepthImage::MIN_M;
        let pixels = if high.z <= 0.0 {
            [0; 4]
        } else if low.z < near {
            [0, width, 0, height]
        } else {
            let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            for corner in 0..8 {
                let pick = |axis: usize| f64::from(if corner >> axis & 1 == 0 { low[axis] } else { high[axis] });
                let (u, v) = intrinsics.project(glam::DVec3::new(pick(0), pick(1), pick(2)));
                lo = [lo[0].min(u), lo[1].min(v)];
                hi = [hi[0].max(u), hi[1].max(v)];
            }
            // A pixel more on each side: sub-pixel samples and outline neighbours.
            let clip = |x: f64, n: u32| x.clamp(0.0, f64::from(n)) as u32;
            [
                clip(lo[0].floor() - 1.0, width),
                clip(hi[0].ceil() + 2.0, width),
                clip(lo[1].floor() - 1.0, height),
                clip(hi[1].ceil() + 2.0, height),
            ]
        };
        Self { center, radius, pixels, ghost }
    }

    fn covers(&self, x0: u32, y0: u32, x1: u32, y1: u32) -> bool {
        let [px0, px1, py0, py1] = self.pixels;
        px0 < x1 && x0 < px1 && py0 < y1 && y0 < py1
    }
}

/// The tiles to be traced, at the front of `tiles`; returns how many. `tiles` grows to the largest
/// number ever needed and is reused.
pub(super) fn plan_tiles(
    depth: &DepthImage,
    ray_direction: impl Fn(f32, f32) -> Vec3A,
    objects: &[ObjectBounds],
    lights: &[CameraLight],
    grid: &mut TileGrid,
    tiles: &mut Vec<Tile>,
) -> usize {
    let (width, height) = (depth.width, depth.height);
    grid.reset(width, height);
    let mut n = 0;
    if objects.iter().all(|object| object.ghost) {
        return 0;
    }
    for row in 0..grid.rows {
        for column in 0..grid.columns {
            let (x0, y0) = (column * TILE, row * TILE);
            let (x1, y1) = ((x0 + TILE).min(width), (y0 + TILE).min(height));
            let sees_objects = objects.iter().any(|object| object.covers(x0, y0, x1, y1));
            let shadow_lights = match ghost_ball(depth, &ray_direction, x0, y0, x1, y1) {
                Some((center, radius)) => shadow_mask(center, radius, objects, lights),
                None => 0,
            };
            if !sees_objects && shadow_lights == 0 {
                continue;
            }
            if n == tiles.len() {
                tiles.push(Tile::new());
            }
            let tile = &mut tiles[n];
            (tile.x0, tile.y0) = (x0, y0);
            (tile.width, tile.height) = (x1 - x0, y1 - y0);
            tile.sees_objects = sees_objects;
            tile.shadow_lights = shadow_lights;
            grid.set(column, row, n);
            n += 1;
        }
    }
    n
}

/// Lights that something virtual may block from a ball. Bit 63 stands for every light from the
/// 64th on.
fn shadow_mask(center: Vec3A, radius: f32, objects: &[ObjectBounds], lights: &[CameraLight]) -> u64 {
    let mut mask = 0;
    for (l, light) in lights.iter().enumerate() {
        let bit = 1u64 << l.min(63);
        if mask & bit == 0
            && objects
                .iter()
                .any(|object| !object.ghost && light.may_be_blocked(center, radius, object.center, object.radius))
        {
            mask |= bit;
        }
    }
    mask
}

/// A ball around the part of the ghost surface that a tile sees; `None` in a hole.
fn ghost_ball(
    depth: &DepthImage,
    ray_direction: &impl Fn(f32, f32) -> Vec3A,
    x0: u32,
    y0: u32,
    x1: u32,
    y1: u32,
) -> Option<(Vec3A, f32)> {
    let (mut near, mut far) = (f32::INFINITY, f32::NEG_INFINITY);
    for y in y0..y1 {
        let row = (y * depth.width) as usize;
        for &z in &depth.z_m[row + x0 as usize..row + x1 as usize] {
            // Both leave their accumulator alone where z is invalid, a NaN.
            near = near.min(z);
            far = far.max(z);
        }
    }
    if near > far {
        return None;
    }
    let (mut low, mut high) = (Vec3A::splat(f32::INFINITY), Vec3A::splat(f32::NEG_INFINITY));
    for (u, v) in [(x0, y0), (x1 - 1, y0), (x0, y1 - 1), (x1 - 1, y1 - 1)] {
        let d = ray_direction(u as f32, v as f32);
        for z in [near, far] {
            low = low.min(d * z);
            high = high.max(d * z);
        }
    }
    Some(((low + high) * 0.5, (high - low).length() * 0.5))
}
