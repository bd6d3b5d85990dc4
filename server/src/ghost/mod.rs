//! The sensed depth map as a surface that rays can hit.
//!
//! Input: depth (metres, camera axes), intrinsics. Output: the nearest contact of rays given in
//! camera space (origin and direction in metres).
//!
//! **Space.** All work is done in (u, v, w) with w = 1/z. The perspective map takes straight
//! lines to straight lines and planes to planes, so a ray is a straight segment, the depth map a
//! height field w(u, v), and the surface exactly the triangle mesh of the depth map.
//!
//! **Surface.** Vertices are pixel centres. Each cell of 2x2 pixels with corners a = (x, y),
//! b = (x+1, y), c = (x, y+1), d = (x+1, y+1) holds two triangles along the diagonal a-d:
//! the upper right one a b d and the lower left one a d c. A triangle exists if its three
//! depths are valid and pairwise connected: their step is below
//! `edge_relative z + edge_sigmas sigma(z)` with z the nearer of the two and sigma the sensor's
//! noise. Triangles are closed: their borders belong to them, and both sides can be hit.
//!
//! **Rays** are clipped in camera space to z >= [`DepthImage::MIN_M`] and to the image's
//! vertices, then projected. Arithmetic that decides is f64.
//!
//! **Outcome**, the same for all exact traversals:
//! - [`GhostOutcome::Hit`]: the nearest contact with `t_min <= t <= t_max`, from either side. A
//!   ray that starts on the surface meets it there: callers start secondary rays at a `t_min`
//!   beyond the sensor's noise.
//! - [`GhostOutcome::Environment`]: the ray never met the surface, was in front of it wherever
//!   it passed over some, and left through the image's border or the camera's plane, or ended
//!   (`t_max`) over the surface. Also every ray that the image never sees.
//! - [`GhostOutcome::Unknown`]: it was behind the surface somewhere (having passed a depth
//!   discontinuity or a hole), or ended, at `t_max` or at infinity, inside the image where
//!   there is no surface. Also every ray that is none: a NaN, an infinite origin or direction, a
//!   direction of zero, an infinite `t_min`, or `t_min > t_max`.
//!
//! Known limit: a hit's `t` saturates at the largest f32.

/// Runs a kernel compiled for the level's instruction set; `None` where there is none but plain
/// code: that of processors older than SSE4.2 (2008) and of the fallback.
macro_rules! vectorize {
    ($level:expr, |$simd:ident| $kernel:expr) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            Level::Avx512($simd) => Some($simd.vectorize(
                #[inline(always)]
                || $kernel,
            )),
            #[cfg(target_arch = "x86_64")]
            Level::Avx2($simd) => Some($simd.vectorize(
                #[inline(always)]
                || $kernel,
            )),
            #[cfg(target_arch = "x86_64")]
            Level::Sse4_2($simd) => Some($simd.vectorize(
                #[inline(always)]
                || $kernel,
            )),
            #[cfg(target_arch = "aarch64")]
            Level::Neon($simd) => Some($simd.vectorize(
                #[inline(always)]
                || $kernel,
            )),
            _ => None,
        }
    };
}

mod batch;
mod beam;
mod bresenham;
mod build;
mod cell;
mod cells;
mod dda;
mod fill;
mod group;
mod lockstep;
mod plane;
mod pyramid;
mod sample_rays;
mod segment;
mod settings;
#[cfg(test)]
mod tests;
mod waiting;
mod walk;

pub use beam::BeamEnd;
pub use fill::{FILL_REACH_PX, FilledDepth};
pub use sample_rays::mixed_rays;
pub use settings::{GhostSettings, HolePolicy, Traversal};

use fearless_simd::{Level, dispatch};

pub(crate) use self::build::Connection;
use self::cell::CellHit;
use self::pyramid::{LevelShape, Node};
use self::segment::{Clipped, End, Frustum, Segment};
use crate::accel::Ray;
use crate::camera::Intrinsics;
use crate::frame::DepthImage;

/// Where a ray met the ghost surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GhostHit {
    /// Parameter of the ray, in units of its direction.
    pub t: f32,
    /// Pixel position of the contact (pixel centres are integers).
    pub u: f32,
    /// Pixel position of the contact.
    pub v: f32,
    /// The ray came from the free side, the camera's. From behind, the camera's picture shows
    /// the other side of what was met.
    pub from_front: bool,
}

/// How a ray ended; see the module's documentation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum GhostOutcome {
    /// On the surface.
    Hit(GhostHit),
    /// Out of what the camera sees, through free space only.
    Environment,
    /// Where the camera knows nothing.
    Unknown,
}

/// What a traversal found.
#[derive(Debug, Clone, Copy)]
struct Contact {
    hit: Option<CellHit>,
    /// Cell of the hit, for ties.
    cell: usize,
    /// The segment was behind some triangle.
    behind: bool,
}

impl Contact {
    const NONE: Self = Self {
        hit: None,
        cell: 0,
        behind: false,
    };
}

/// A depth map as a surface. Buffers are kept between frames: rebuilding at the same size
/// allocates nothing.
#[derive(Debug)]
pub struct GhostSurface {
    level: Level,
    intrinsics: Intrinsics,
    frustum: Frustum,
    connection: Connection,
    /// Cells per row and column: one less than vertices.
    cells_x: usize,
    cells_y: usize,
    /// Larger side of the image, pixels.
    side: f32,
    /// Vertices per row in memory, padded with invalid ones.
    stride: usize,
    /// Blocks of sixteen cells per row.
    blocks: usize,
    /// Depth per vertex, NaN where invalid.
    z: Vec<f32>,
    /// 1/z per vertex, NaN where invalid.
    w: Vec<f32>,
    /// Per block of sixteen cells: which have their upper right, which their lower left
    /// triangle.
    exists: Vec<[u16; 2]>,
    levels: Vec<LevelShape>,
    nodes: Vec<Node>,
}

impl Default for GhostSurface {
    fn default() -> Self {
        Self::new()
    }
}

impl GhostSurface {
    /// A surface of a single pixel without a measurement, until [`Self::rebuild`].
    pub fn new() -> Self {
        let intrinsics = Intrinsics {
            fx: 1.0,
            fy: 1.0,
            cx: 0.0,
            cy: 0.0,
            width: 1,
            height: 1,
        };
        let mut surface = Self {
            level: Level::new(),
            intrinsics,
            frustum: Frustum::new(&intrinsics),
            connection: Connection::default(),
            cells_x: 0,
            cells_y: 0,
            side: 1.0,
            stride: 0,
            blocks: 0,
            z: Vec::new(),
            w: Vec::new(),
            exists: Vec::new(),
            levels: Vec::new(),
            nodes: Vec::new(),
        };
        surface.resize(1, 1);
        surface
    }

    /// Takes over a depth map: connectivity and pyramid. `intrinsics` are those of the depth
    /// image, whose size they must have.
    ///
    /// # Panics
    /// If depth and intrinsics differ in size.
    pub fn rebuild(
        &mut self,
        depth: &DepthImage,
        intrinsics: &Intrinsics,
        settings: &GhostSettings,
    ) {
        assert_eq!(
            (depth.width, depth.height),
            (intrinsics.width, intrinsics.height),
            "ghost surface: size of depth against intrinsics"
        );
        self.intrinsics = *intrinsics;
        self.frustum = Frustum::new(intrinsics);
        self.connection = Connection::new(settings);
        self.resize(depth.width as usize, depth.height as usize);
        dispatch!(self.level, simd => self.fill(simd, depth));
    }

    /// Vertices per row.
    pub fn width(&self) -> u32 {
        self.intrinsics.width
    }

    /// Rows of vertices.
    pub fn height(&self) -> u32 {
        self.intrinsics.height
    }

    /// Of the depth image.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Inverse depth at a vertex, 1/m; `None` where nothing was measured or outside.
    #[inline]
    pub fn w(&self, x: u32, y: u32) -> Option<f32> {
        if x >= self.width() || y >= self.height() {
            return None;
        }
        let w = self.w[y as usize * self.stride + x as usize];
        (!w.is_nan()).then_some(w)
    }

    /// Depth at a pixel position, metres: on the surface where there is a triangle, otherwise
    /// that of the pixel the position lies in, if it was measured.
    pub fn depth_at(&self, u: f32, v: f32) -> Option<f32> {
        if let Some(w) = self.triangle_at(f64::from(u), f64::from(v)) {
            return Some((1.0 / w) as f32);
        }
        let (x, y) = ((u + 0.5).floor(), (v + 0.5).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < self.width() as f32 && y < self.height() as f32;
        if !inside {
            return None;
        }
        let z = self.z[y as usize * self.stride + x as usize];
        (!z.is_nan()).then_some(z)
    }

    /// Which triangles a cell has: upper right, lower left.
    #[inline(always)]
    fn triangles(&self, i: usize, j: usize) -> (bool, bool) {
        let [upper, lower] = self.exists[j * self.blocks + i / 16];
        (upper >> (i % 16) & 1 != 0, lower >> (i % 16) & 1 != 0)
    }

    /// Where a ray ends.
    pub fn trace(&self, traversal: Traversal, ray: &Ray) -> GhostOutcome {
        self.trace_with(ray, |segment| match traversal {
            Traversal::BresenhamNearest => self.first_contact_bresenham(segment, false),
            Traversal::Bresenham => self.first_contact_bresenham(segment, true),
            Traversal::Dda => self.first_contact_dda(segment),
            Traversal::Pyramid => self.first_contact_pyramid_single(self.level, segment, false),
        })
    }

    /// [`Self::trace`] by the pyramid for many rays, the fastest way.
    ///
    /// # Panics
    /// If there are fewer places in `out` than rays.
    pub fn trace_batch(&self, rays: &[Ray], out: &mut [GhostOutcome]) {
        assert!(out.len() >= rays.len(), "ghost rays: one outcome each");
        if !self.trace_rays(rays, out) {
            for (ray, out) in rays.iter().zip(out) {
                *out = self.trace(Traversal::Pyramid, ray);
            }
        }
    }

    /// Whether the ray meets the surface with `t_min <= t <= t_max`, from either side.
    pub fn occluded(&self, ray: &Ray) -> bool {
        match self.frustum.clip(ray) {
            Clipped::Inside(segment) => self
                .first_contact_pyramid_single(self.level, &segment, true)
                .hit
                .is_some(),
            Clipped::Invalid | Clipped::Outside => false,
        }
    }

    /// [`Self::occluded`] for many rays.
    ///
    /// # Panics
    /// If there are fewer places in `out` than rays.
    pub fn occluded_batch(&self, rays: &[Ray], out: &mut [bool]) {
        assert!(out.len() >= rays.len(), "ghost rays: one answer each");
        if !self.occlude_rays(rays, out) {
            for (ray, out) in rays.iter().zip(out) {
                *out = self.occluded(ray);
            }
        }
    }

    /// Clips, traverses, and says what the result means.
    #[inline(always)]
    fn trace_with(&self, ray: &Ray, traverse: impl FnOnce(&Segment) -> Contact) -> GhostOutcome {
        let segment = match self.frustum.clip(ray) {
            Clipped::Invalid => return GhostOutcome::Unknown,
            Clipped::Outside => return GhostOutcome::Environment,
            Clipped::Inside(segment) => segment,
        };
        self.outcome(&segment, &traverse(&segment))
    }

    /// What a traversal's result means.
    #[inline(always)]
    fn outcome(&self, segment: &Segment, contact: &Contact) -> GhostOutcome {
        if let Some(hit) = contact.hit {
            return GhostOutcome::Hit(GhostHit {
                // A zero is +0, whichever way it came about.
                t: segment.t(hit.s).min(f64::from(f32::MAX)) as f32 + 0.0,
                u: (segment.u + hit.s * segment.du) as f32,
                v: (segment.v + hit.s * segment.dv) as f32,
                from_front: hit.from_front,
            });
        }
        let unknown = contact.behind
            || (segment.end == End::Inside
                && !self.covered(segment.u + segment.du, segment.v + segment.dv));
        if unknown {
            GhostOutcome::Unknown
        } else {
            GhostOutcome::Environment
        }
    }
}
