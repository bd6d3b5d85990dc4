//! The plan of a frame: which tiles virtual objects can affect, and how. Other tiles are copied.

use glam::Vec3A;

use crate::accel::Tlas;
use crate::camera::Intrinsics;
use crate::frame::DepthImage;
use crate::render::checkpoint::Pulse;

use super::lens::Lens;
use super::light::CameraLight;
use super::mask::{MASK_SHADOW, MASK_TRANSMISSIVE};
use super::occluder::Occluders;
use super::pinhole::Pinhole;

/// Side of a tile, pixels.
pub(crate) const TILE: u32 = 16;
/// Pixels of a whole tile.
pub(crate) const TILE_PIXELS: usize = (TILE * TILE) as usize;

/// A mesh's camera-space bounds, and the pixels that they cover.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ObjectBounds {
    /// Pixels x0..x1, y0..y1, clipped to the picture; empty if it is out of view.
    pixels: [u32; 4],
    /// Largest radius of its circle of confusion, pixels; 0 for a pinhole.
    blur_px: f32,
    far_m: f32,
}

impl ObjectBounds {
    /// The bounds of an AABB in camera space. Conservative: an AABB that reaches behind the camera covers the
    /// whole picture.
    pub(crate) fn new(
        low: Vec3A,
        high: Vec3A,
        intrinsics: &Intrinsics,
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
            // One more pixel on each side, for sub-pixel samples and for neighbours of outlines. Every lens ray
            // hits a point within its circle of confusion.
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

/// A set of the scene's lights: bit i is the i-th light, the last bit all further ones.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct LightSet(u64);

impl LightSet {
    pub(crate) const ALL: Self = Self(u64::MAX);

    pub(crate) fn is_empty(self) -> bool {
        self.0 == 0
    }

    pub(crate) fn contains(self, light: usize) -> bool {
        self.0 & Self::bit(light) != 0
    }

    fn insert(&mut self, light: usize) {
        self.0 |= Self::bit(light);
    }

    fn bit(light: usize) -> u64 {
        1 << light.min(63)
    }
}

/// Inputs that determine which tiles are affected.
pub(crate) struct Reach<'a> {
    pub(crate) pulse: &'a Pulse<'a>,
    /// Depth per pixel, NaN in holes.
    pub(crate) depth: &'a [f32],
    /// Size of the picture, pixels.
    pub(crate) size: [u32; 2],
    pub(crate) pinhole: Pinhole,
    pub(crate) objects: &'a [ObjectBounds],
    pub(crate) tlas: &'a Tlas,
    pub(crate) lights: &'a [CameraLight],
    /// `None` if ambient light does not change.
    pub(crate) occluders: Option<&'a Occluders>,
    /// Whether to leave out tiles that are proven to be lit; see [`crate::render::ShadowSettings::skip_proven`].
    pub(crate) skip_proven: bool,
    /// `None` for a pinhole.
    pub(crate) lens: Option<&'a Lens>,
}

/// The effect of a lens on a tile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LensPlan {
    /// Pixels need lens rays: a virtual object, or a real surface in front of one, may be blurred there.
    pub(crate) rays: bool,
    /// Pixels take the light of real surfaces from the points that their lens rays hit: a shadow or caustic may
    /// be blurred there.
    pub(crate) gathers: bool,
    /// Range of depths at which the lens rays of its pixels hit the ghost surface, metres; `near` is above `far`
    /// if there is none.
    pub(crate) near: f32,
    pub(crate) far: f32,
}

impl Default for LensPlan {
    fn default() -> Self {
        Self {
            rays: false,
            gathers: false,
            near: f32::INFINITY,
            far: f32::NEG_INFINITY,
        }
    }
}

/// What may affect a tile.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct TilePlan {
    pub(crate) sees_objects: bool,
    pub(crate) lights: LightSet,
    pub(crate) glass: LightSet,
    pub(crate) has_photons: bool,
    pub(crate) has_ambient: bool,
    /// Range of depths of its own part of the ghost surface, metres; `near` is above `far` in a hole.
    pub(crate) near: f32,
    pub(crate) far: f32,
    /// Largest blur and largest depth of the objects that overlap it.
    pub(crate) object_blur_px: f32,
    pub(crate) object_far_m: f32,
    pub(crate) lens: LensPlan,
}

impl Reach<'_> {
    /// The plan of a tile of pixels x0..x1, y0..y1, without its photons and lens.
    pub(crate) fn plan(&self, [x0, y0, x1, y1]: [u32; 4]) -> TilePlan {
        let mut plan = TilePlan::default();
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
                // A thousand lights with thousands of objects take milliseconds.
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

    /// Range of depths of the ghost surface in a tile; the first is larger in a hole.
    fn depth_range(&self, x0: u32, y0: u32, x1: u32, y1: u32) -> (f32, f32) {
        let (mut near, mut far) = (f32::INFINITY, f32::NEG_INFINITY);
        for y in y0..y1 {
            let row = (y * self.size[0]) as usize;
            for &z in &self.depth[row + x0 as usize..row + x1 as usize] {
                // Both keep the accumulator if z is NaN, that is, invalid.
                near = near.min(z);
                far = far.max(z);
            }
        }
        (near, far)
    }

    /// A sphere around the part of the ghost surface in a tile.
    fn ghost_ball(&self, [x0, y0, x1, y1]: [u32; 4], near: f32, far: f32) -> (Vec3A, f32) {
        let (mut low, mut high) = (Vec3A::splat(f32::INFINITY), Vec3A::splat(f32::NEG_INFINITY));
        for (u, v) in [(x0, y0), (x1 - 1, y0), (x0, y1 - 1), (x1 - 1, y1 - 1)] {
            let d = self.pinhole.ray_direction(u as f32, v as f32);
            for z in [near, far] {
                low = low.min(d * z);
                high = high.max(d * z);
            }
        }
        ((low + high) * 0.5, (high - low).length() * 0.5)
    }
}

/// Record of the pixel at (dx, dy) within a tile.
#[inline]
pub(crate) fn pixel_index(dx: u32, dy: u32) -> usize {
    (dy * TILE + dx) as usize
}

/// Maps pixels to the tiles that hold their records.
#[derive(Debug, Clone, Default)]
pub(crate) struct TileGrid {
    pub(crate) columns: u32,
    pub(crate) rows: u32,
    /// Index in the list of active tiles, or `u32::MAX`.
    slots: Vec<u32>,
}

impl TileGrid {
    pub(crate) fn reset(&mut self, width: u32, height: u32) {
        self.columns = width.div_ceil(TILE);
        self.rows = height.div_ceil(TILE);
        self.slots.clear();
        self.slots
            .resize((self.columns * self.rows) as usize, u32::MAX);
    }

    pub(crate) fn set(&mut self, column: u32, row: u32, slot: usize) {
        self.slots[(row * self.columns + column) as usize] = slot as u32;
    }

    /// Index of a tile in the list of active tiles.
    #[inline]
    pub(crate) fn slot(&self, column: u32, row: u32) -> Option<usize> {
        let slot = self.slots[(row * self.columns + column) as usize];
        (slot != u32::MAX).then_some(slot as usize)
    }

    /// Active tile and record index of a pixel.
    #[inline]
    pub(crate) fn locate(&self, x: u32, y: u32) -> Option<(usize, usize)> {
        self.slot(x / TILE, y / TILE)
            .map(|slot| (slot, pixel_index(x % TILE, y % TILE)))
    }
}
