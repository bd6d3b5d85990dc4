//! The ghost surface's data, and queries at a pixel position.

use fearless_simd::Level;

use super::connection::Connection;
use super::node::{LevelShape, Node};
use super::traverse::segment::Frustum;
use crate::camera::Intrinsics;
use crate::frame::DepthImage;

/// Cells processed at once.
pub(crate) const LANES: usize = 16;

/// A depth map as a surface. Buffers are kept between frames: rebuilding for the same image size allocates
/// nothing.
#[derive(Debug)]
pub struct GhostSurface {
    pub(crate) level: Level,
    pub(crate) intrinsics: Intrinsics,
    pub(crate) frustum: Frustum,
    pub(crate) connection: Connection,
    /// Cells per row and column: one less than vertices.
    pub(crate) cells_x: usize,
    pub(crate) cells_y: usize,
    /// Larger side of the image, pixels.
    pub(crate) side: f32,
    /// Vertices per row in memory, padded with invalid ones.
    pub(crate) stride: usize,
    /// Blocks of sixteen cells per row.
    pub(crate) blocks: usize,
    /// Depth per vertex, NaN where invalid.
    pub(crate) z: Vec<f32>,
    /// 1/z per vertex, NaN where invalid.
    pub(crate) w: Vec<f32>,
    /// Bits for each block of sixteen cells: cells with an upper right triangle, cells with a lower left one.
    pub(crate) exists: Vec<[u16; 2]>,
    pub(crate) levels: Vec<LevelShape>,
    pub(crate) nodes: Vec<Node>,
}

impl Default for GhostSurface {
    fn default() -> Self {
        Self::new()
    }
}

impl GhostSurface {
    /// A surface of a single pixel without a measurement; call [`Self::rebuild`] to fill it.
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

    /// Vertices per row.
    pub fn width(&self) -> u32 {
        self.intrinsics.width
    }

    /// Rows of vertices.
    pub fn height(&self) -> u32 {
        self.intrinsics.height
    }

    /// Intrinsics of the depth image.
    pub fn intrinsics(&self) -> &Intrinsics {
        &self.intrinsics
    }

    /// Inverse depth at a vertex, 1/m; `None` if it was not measured or is outside.
    #[inline]
    pub fn w(&self, x: u32, y: u32) -> Option<f32> {
        if x >= self.width() || y >= self.height() {
            return None;
        }
        let w = self.w[y as usize * self.stride + x as usize];
        (!w.is_nan()).then_some(w)
    }

    /// Depth at a pixel position, metres: of the surface if there is a triangle, otherwise of the nearest pixel,
    /// if it was measured.
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

    /// Whether a cell has its upper right and its lower left triangle.
    #[inline(always)]
    pub(crate) fn triangles(&self, i: usize, j: usize) -> (bool, bool) {
        let [upper, lower] = self.exists[j * self.blocks + i / 16];
        (upper >> (i % 16) & 1 != 0, lower >> (i % 16) & 1 != 0)
    }

    /// Resizes every buffer for an image; allocates nothing if the size is the same as before.
    pub(crate) fn resize(&mut self, width: usize, height: usize) {
        self.cells_x = width.saturating_sub(1);
        self.cells_y = height.saturating_sub(1);
        self.side = width.max(height) as f32;
        // A load of sixteen lanes that starts one vertex to the right of any block stays inside the row.
        let blocks = self.cells_x.div_ceil(LANES);
        self.blocks = blocks;
        self.stride = (blocks + 1) * LANES;
        self.z.resize(self.stride * height, DepthImage::INVALID);
        self.w.resize(self.stride * height, DepthImage::INVALID);
        self.exists.resize(blocks * self.cells_y, [0; 2]);
        self.levels.clear();
        let (mut columns, mut rows) = (self.cells_x, self.cells_y);
        let mut offset = 0;
        while columns > 0 && rows > 0 {
            let first = self.levels.is_empty();
            let cells_high = rows;
            columns = columns.div_ceil(4);
            rows = cells_high.div_ceil(4);
            let stride = if first { blocks * (LANES / 4) } else { columns };
            self.levels.push(LevelShape {
                offset,
                stride,
                rows,
                columns,
            });
            offset += stride * rows;
            if columns == 1 && rows == 1 {
                break;
            }
        }
        self.nodes.resize(offset, Node::OUTSIDE);
    }

    /// Whether there is a triangle at a pixel position (borders included).
    pub(crate) fn covered(&self, u: f64, v: f64) -> bool {
        self.triangle_at(u, v).is_some()
    }

    /// Inverse depth of the surface at a pixel position, if there is a triangle.
    pub(crate) fn triangle_at(&self, u: f64, v: f64) -> Option<f64> {
        if self.cells_x == 0 || self.cells_y == 0 {
            return None;
        }
        let inside = u >= 0.0 && v >= 0.0 && u <= self.cells_x as f64 && v <= self.cells_y as f64;
        if !inside {
            return None;
        }
        // A position on a grid line belongs to the cells on both sides.
        let candidates = |x: f64, n: usize| {
            let high = (x as usize).min(n - 1);
            let low = if x == x.floor() && x >= 1.0 {
                x as usize - 1
            } else {
                high
            };
            low.min(high)..=high
        };
        for j in candidates(v, self.cells_y) {
            for i in candidates(u, self.cells_x) {
                let (upper, lower) = self.triangles(i, j);
                let (fu, fv) = (u - i as f64, v - j as f64);
                let w = |x: usize, y: usize| 1.0 / f64::from(self.z[y * self.stride + x]);
                if upper && fu >= fv {
                    let (a, b, d) = (w(i, j), w(i + 1, j), w(i + 1, j + 1));
                    return Some(a + fu * (b - a) + fv * (d - b));
                }
                if lower && fu <= fv {
                    let (a, c, d) = (w(i, j), w(i, j + 1), w(i + 1, j + 1));
                    return Some(a + fu * (d - c) + fv * (c - a));
                }
            }
        }
        None
    }
}
