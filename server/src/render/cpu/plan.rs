//! Which tiles of a frame anything virtual can influence. The others are copied.

use glam::Vec3A;
use rayon::prelude::*;

use crate::accel::Tlas;
use crate::frame::DepthImage;
use crate::render::checkpoint::Pulse;

use super::ambient::Occluders;
use super::lens::Lens;
use super::lens_plan::{LensPlan, plan_lens};
use super::light::CameraLight;
use super::photon::PhotonMap;
use super::tile::{TILE, Tile, TileGrid};
use super::{MASK_SHADOW, MASK_TRANSMISSIVE};

/// A mesh's camera-space bounds, and what of the picture they cover.
#[derive(Debug, Clone, Copy)]
pub(super) struct ObjectBounds {
    /// Pixels x0..x1, y0..y1, clipped to the picture; empty if out of view.
    pixels: [u32; 4],
    /// Largest radius of its circle of confusion, pixels; 0 for a pinhole.
    blur_px: f32,
    far_m: f32,
}

impl ObjectBounds {
    /// From a box in camera space. Conservative: a box that reaches behind the camera covers all.
    pub(super) fn new(
        low: Vec3A,
        high: Vec3A,
        intrinsics: &crate::camera::Intrinsics,
        lens: Option<&Lens>,
    ) -> Self {
        let (width, height) = (intrinsics.width, intrinsics.height);
        let near = DepthImage::MIN_M;
        let blur_px = lens.map_or(0.0, |lens| lens.blur_between_px(low.z.max(near), high.z));
        let blur = f64::from(blur_px);
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
            // A pixel more on each side: sub-pixel samples and outline neighbours. Every ray of the
            // lens meets a point within its circle of confusion.
            let clip = |x: f64, n: u32| x.clamp(0.0, f64::from(n)) as u32;
            [
                clip((lo[0] - blur).floor() - 1.0, width),
                clip((hi[0] + blur).ceil() + 2.0, width),
                clip((lo[1] - blur).floor() - 1.0, height),
                clip((hi[1] + blur).ceil() + 2.0, height),
            ]
        };
        Self {
            pixels,
            blur_px,
            far_m: high.z,
        }
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
    pub(super) pulse: &'a Pulse<'a>,
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
    /// `None` if ambient light is left as it is.
    pub(super) occluders: Option<&'a Occluders>,
    /// Leave out tiles whose light is proven; see [`crate::render::ShadowSettings::skip_proven`].
    pub(super) skip_proven: bool,
    /// `None` for a pinhole.
    pub(super) lens: Option<&'a Lens>,
}

/// What may happen to a tile.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct TilePlan {
    pub(super) sees_objects: bool,
    pub(super) lights: LightSet,
    glass: LightSet,
    pub(super) has_photons: bool,
    pub(super) has_ambient: bool,
    /// Depths of its own part of the ghost surface, metres; `near` above `far` in a hole.
    pub(super) near: f32,
    pub(super) far: f32,
    /// Largest blur and farthest depth of the objects that it sees.
    pub(super) object_blur_px: f32,
    pub(super) object_far_m: f32,
    pub(super) lens: LensPlan,
}

/// The tiles to be traced, at the front of `tiles`; returns how many, none of a frame that is given up. `tiles` grows to the largest
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
                        if !reach.pulse.go_on() {
                            return;
                        }
                        *plan = reach.plan(bounds(column as u32, row as u32));
                    }
                });
        });
    }
    if let Some(lens) = reach.lens {
        plan_lens(lens, grid, plans, reach.pulse);
    }
    let mut n = 0;
    for row in 0..grid.rows {
        // New tiles take time as well.
        if !reach.pulse.go_on() {
            return 0;
        }
        for column in 0..grid.columns {
            let plan = plans[row as usize * columns + column as usize];
            let reached = plan.sees_objects || plan.has_photons || plan.lens.gathers;
            let reached = reached || plan.has_ambient;
            if !reached && plan.lights.is_empty() {
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
            tile.glass = plan.glass;
            tile.has_photons = plan.has_photons;
            tile.has_ambient = plan.has_ambient;
            tile.lens = plan.lens;
            grid.set(column, row, n);
            n += 1;
        }
    }
    n
}

impl Reach<'_> {
    fn plan(&self, [x0, y0, x1, y1]: [u32; 4]) -> TilePlan {
        let mut plan = TilePlan {
            has_photons: self
                .photons
                .is_some_and(|photons| photons.reaches(x0 / TILE, y0 / TILE)),
            ..TilePlan::default()
        };
        for object in self.objects {
            if object.covers(x0, y0, x1, y1) {
                plan.sees_objects = true;
                plan.object_blur_px = plan.object_blur_px.max(object.blur_px);
                plan.object_far_m = plan.object_far_m.max(object.far_m);
            }
        }
        (plan.near, plan.far) = self.depth_range(x0, y0, x1, y1);
        if plan.near <= plan.far {
            let ball = self.ghost_ball([x0, y0, x1, y1], plan.near, plan.far);
            plan.has_ambient = self
                .occluders
                .is_some_and(|occluders| occluders.reach(ball));
            for (l, light) in self.lights.iter().enumerate() {
                // A thousand lights over thousands of objects take milliseconds.
                if l.is_multiple_of(16) && !self.pulse.go_on() {
                    return plan;
                }
                let shaft = light.shaft(ball);
                let meets = |mask| !self.skip_proven || self.tlas.may_intersect(&shaft, mask);
                if meets(MASK_TRANSMISSIVE) {
                    plan.glass.insert(l);
                    plan.lights.insert(l);
                } else if meets(MASK_SHADOW) {
                    plan.lights.insert(l);
                }
            }
        }
        plan
    }

    /// Depths of the part of the ghost surface that a tile sees; the first is larger in a hole.
    fn depth_range(&self, x0: u32, y0: u32, x1: u32, y1: u32) -> (f32, f32) {
        let (mut near, mut far) = (f32::INFINITY, f32::NEG_INFINITY);
        for y in y0..y1 {
            let row = (y * self.size[0]) as usize;
            for &z in &self.depth[row + x0 as usize..row + x1 as usize] {
                // Both leave their accumulator alone where z is invalid, a NaN.
                near = near.min(z);
                far = far.max(z);
            }
        }
        (near, far)
    }

    /// A ball around the part of the ghost surface that a tile sees.
    fn ghost_ball(&self, [x0, y0, x1, y1]: [u32; 4], near: f32, far: f32) -> (Vec3A, f32) {
        let (mut low, mut high) = (Vec3A::splat(f32::INFINITY), Vec3A::splat(f32::NEG_INFINITY));
        for (u, v) in [(x0, y0), (x1 - 1, y0), (x0, y1 - 1), (x1 - 1, y1 - 1)] {
            let d = super::ray_direction(self.pinhole, u as f32, v as f32);
            for z in [near, far] {
                low = low.min(d * z);
                high = high.max(d * z);
            }
        }
        ((low + high) * 0.5, (high - low).length() * 0.5)
    }
}
