//! Which tiles of a frame anything virtual can influence. The others are copied.

use glam::Vec3A;
use rayon::prelude::*;

use crate::accel::Tlas;
use crate::frame::DepthImage;

use super::MASK_VIRTUAL_ANY;
use super::light::CameraLight;
use super::photon::PhotonMap;
use super::tile::{TILE, Tile, TileGrid};

/// A mesh's camera-space bounds, and what of the picture they cover.
#[derive(Debug, Clone, Copy)]
pub(super) struct ObjectBounds {
    /// Pixels x0..x1, y0..y1, clipped to the picture; empty if out of view.
    pixels: [u32; 4],
}

impl ObjectBounds {
    /// From a box in camera space. Conservative: a box that reaches behind the camera covers all.
    pub(super) fn new(low: Vec3A, high: Vec3A, intrinsics: &crate::camera::Intrinsics) -> Self {
        let (width, height) = (intrinsics.width, intrinsics.height);
        let near = DepthImage::MIN_M;
        let pixels = if high.z <= 0.0 {
            [0; 4]
        } else if low.z < near {
            [0, width, 0, height]
        } else {
            let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            for corner in 0..8 {
                let pick = |axis: usize| {
                    f64::from(if corner >> axis & 1 == 0 {
                        low[axis]
                    } else {
                        high[axis]
                    })
                };
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
        Self { pixels }
    }

    fn covers(&self, x0: u32, y0: u32, x1: u32, y1: u32) -> bool {
        let [px0, px1, py0, py1] = self.pixels;
        px0 < x1 && x0 < px1 && py0 < y1 && y0 < py1
    }
}

/// Some of the scene's lights: bit i stands for the i-th, the last bit for all from there on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct LightSet(u64);

impl LightSet {
    pub(super) const ALL: Self = Self(u64::MAX);

    pub(super) fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(super) fn contains(self, light: usize) -> bool {
        self.0 & Self::bit(light) != 0
    }

    fn insert(&mut self, light: usize) {
        self.0 |= Self::bit(light);
    }

    fn bit(light: usize) -> u64 {
        1 << light.min(63)
    }
}

/// What decides which tiles matter.
pub(super) struct Reach<'a> {
    /// Depth per pixel, NaN in holes.
    pub(super) depth: &'a [f32],
    /// Of the picture, pixels.
    pub(super) size: [u32; 2],
    /// fx, fy, cx, cy.
    pub(super) pinhole: [f32; 4],
    pub(super) objects: &'a [ObjectBounds],
    pub(super) tlas: &'a Tlas,
    pub(super) lights: &'a [CameraLight],
    pub(super) photons: Option<&'a PhotonMap>,
    /// Leave out tiles whose light is proven; see [`crate::render::ShadowSettings::skip_proven`].
    pub(super) skip_proven: bool,
}

/// What may happen to a tile.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TilePlan {
    sees_objects: bool,
    lights: LightSet,
    has_photons: bool,
}

/// The tiles to be traced, at the front of `tiles`; returns how many. `tiles` grows to the largest
/// number ever needed and is reused, as is `plans`.
pub(super) fn plan_tiles(
    reach: &Reach<'_>,
    pool: &rayon::ThreadPool,
    plans: &mut Vec<TilePlan>,
    grid: &mut TileGrid,
    tiles: &mut Vec<Tile>,
) -> usize {
    let [width, height] = reach.size;
    grid.reset(width, height);
    let columns = grid.columns as usize;
    plans.clear();
    plans.resize(columns * grid.rows as usize, TilePlan::default());
    let bounds = |column: u32, row: u32| {
        let (x0, y0) = (column * TILE, row * TILE);
        [x0, y0, (x0 + TILE).min(width), (y0 + TILE).min(height)]
    };
    if !plans.is_empty() {
        pool.install(|| {
            plans
                .par_chunks_mut(columns)
                .enumerate()
                .for_each(|(row, plans)| {
                    for (column, plan) in plans.iter_mut().enumerate() {
                        *plan = reach.plan(bounds(column as u32, row as u32));
                    }
                });
        });
    }
    let mut n = 0;
    for row in 0..grid.rows {
        for column in 0..grid.columns {
            let plan = plans[row as usize * columns + column as usize];
            if !plan.sees_objects && plan.lights.is_empty() && !plan.has_photons {
                continue;
            }
            if n == tiles.len() {
                tiles.push(Tile::new());
            }
            let [x0, y0, x1, y1] = bounds(column, row);
            let tile = &mut tiles[n];
            (tile.x0, tile.y0) = (x0, y0);
            (tile.width, tile.height) = (x1 - x0, y1 - y0);
            (tile.sees_objects, tile.lights) = (plan.sees_objects, plan.lights);
            tile.has_photons = plan.has_photons;
            grid.set(column, row, n);
            n += 1;
        }
    }
    n
}

impl Reach<'_> {
    fn plan(&self, [x0, y0, x1, y1]: [u32; 4]) -> TilePlan {
        let mut plan = TilePlan {
            sees_objects: self
                .objects
                .iter()
                .any(|object| object.covers(x0, y0, x1, y1)),
            lights: LightSet::default(),
            has_photons: self
                .photons
                .is_some_and(|photons| photons.reaches(x0 / TILE, y0 / TILE)),
        };
        if let Some(ball) = self.ghost_ball(x0, y0, x1, y1) {
            for (l, light) in self.lights.iter().enumerate() {
                if !self.skip_proven || self.tlas.may_meet(&light.shaft(ball), MASK_VIRTUAL_ANY) {
                    plan.lights.insert(l);
                }
            }
        }
        plan
    }

    /// A ball around the part of the ghost surface that a tile sees; `None` in a hole.
    fn ghost_ball(&self, x0: u32, y0: u32, x1: u32, y1: u32) -> Option<(Vec3A, f32)> {
        let (mut near, mut far) = (f32::INFINITY, f32::NEG_INFINITY);
        for y in y0..y1 {
            let row = (y * self.size[0]) as usize;
            for &z in &self.depth[row + x0 as usize..row + x1 as usize] {
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
            let d = super::ray_direction(self.pinhole, u as f32, v as f32);
            for z in [near, far] {
                low = low.min(d * z);
                high = high.max(d * z);
            }
        }
        Some(((low + high) * 0.5, (high - low).length() * 0.5))
    }
}
