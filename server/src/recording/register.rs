//! Registration: warps a depth map of another resolution, intrinsics or extrinsics to the colour camera. Input:
//! pixels of the depth camera; output: pixels of the colour camera; both with z in metres.
//!
//! The depth map is treated as a surface: each 2x2 cell of connected neighbours is two triangles. A plane in space is
//! linear in (u, v, 1/z) for any pinhole camera, so triangles are rasterised with 1/z linear in the picture, which is
//! exact, and the nearest surface wins. If a cell is torn (by a depth step, a hole, or the image's border), each of
//! its pixels covers its own quarter of the cell, extrapolated along its surface: a pixel without neighbours still
//! covers its footprint, and a step edge stays where the sensor saw it.
//!
//! Areas that the depth camera does not see are invalid.

use glam::{DMat3, DVec3, Vec3A};

use crate::camera::{Intrinsics, Pose};
use crate::frame::{DepthImage, depth_sigma_m, is_valid_depth};
use crate::ghost::GhostSettings;
use rayon::prelude::*;

/// The depth map as seen by the colour camera. If both cameras are the same, `depth` is returned unchanged, at no
/// cost.
///
/// # Panics
/// If `depth` does not have the size of `depth_camera`.
pub fn register_depth(
    depth: DepthImage,
    depth_camera: &Intrinsics,
    color_from_depth: &Pose,
    color_camera: &Intrinsics,
) -> DepthImage {
    assert_eq!(
        (depth.width, depth.height),
        (depth_camera.width, depth_camera.height),
        "depth and its intrinsics"
    );
    if depth_camera == color_camera && *color_from_depth == Pose::IDENTITY {
        return depth;
    }
    let surface = Surface::new(&depth, depth_camera, color_from_depth, color_camera);
    // Bands of rows are drawn in parallel and merged by the same rule (nearest wins), which does not depend on the
    // order: the result is the same on any number of threads. Cells extend one pixel beyond the border, to include
    // the footprints of the outermost pixels.
    let n_rows = depth.height as i32 + 1;
    // Outside a thread pool, rows are drawn by this thread: rayon would start a pool, and the caller already has
    // other threads that decode or render.
    let n_threads = rayon::current_thread_index().map_or(1, |_| rayon::current_num_threads());
    let n_bands = n_threads.clamp(1, MAX_BANDS) as i32;
    let draw = |band: i32| {
        let mut canvas = Canvas::new(color_camera.width, color_camera.height);
        for y in n_rows * band / n_bands - 1..n_rows * (band + 1) / n_bands - 1 {
            surface.draw_row(y, &mut canvas);
        }
        canvas
    };
    let canvas = match n_bands {
        1 => draw(0),
        _ => (0..n_bands)
            .into_par_iter()
            .map(draw)
            .reduce_with(Canvas::nearest)
            .unwrap_or_else(|| draw(0)),
    };
    let z_m = canvas.w.iter().map(|&w| {
        if w > 0.0 {
            1.0 / w
        } else {
            DepthImage::INVALID
        }
    });
    DepthImage::from_metres(color_camera.width, color_camera.height, z_m.collect())
}

/// Cells larger than this on the colour image, pixels, are dropped: the smallest depth sensors under the largest
/// colour images reach 70. A larger cell is nearly in the camera's plane, or the intrinsics are wrong, and a few
/// pixels could take unbounded time.
const MAX_CELL_PX: f32 = 128.0;

/// Most bands drawn in parallel; each takes the memory of a picture.
const MAX_BANDS: usize = 4;

/// Overlap of a torn cell's quarters with their neighbours, depth pixels. A corner on only one side of a seam is
/// rounded, so the edge of the other side does not pass exactly through it; this overlap is more than the rounding
/// (1e-3 px at [`Intrinsics::MAX_SIDE`]) and less than any sensor resolves.
const SEAM_PX: f32 = 1.0 / 128.0;

/// A depth pixel in the colour camera: u, v in pixels, w = 1/z in 1/m. NaN if invalid.
#[derive(Debug, Clone, Copy)]
struct Vertex {
    u: f32,
    v: f32,
    w: f32,
}

impl Vertex {
    const NONE: Self = Self {
        u: f32::NAN,
        v: f32::NAN,
        w: f32::NAN,
    };
}

/// The depth map as a surface seen by the colour camera.
struct Surface<'a> {
    depth: &'a DepthImage,
    /// Largest depth step from each pixel to a farther neighbour that counts as connected, metres.
    tolerance_m: Vec<f32>,
    vertices: Vec<Vertex>,
    map: PixelMap,
}

/// Maps (u, v, z) of the depth camera to (u, v, 1/z) of the colour camera.
struct PixelMap {
    u: Vec3A,
    v: Vec3A,
    one: Vec3A,
    offset: Vec3A,
}

impl PixelMap {
    fn new(depth: &Intrinsics, color_from_depth: &Pose, color: &Intrinsics) -> Self {
        let projection = |k: &Intrinsics| {
            DMat3::from_cols(
                DVec3::new(k.fx, 0.0, 0.0),
                DVec3::new(0.0, k.fy, 0.0),
                DVec3::new(k.cx, k.cy, 1.0),
            )
        };
        let to_pixels = projection(color);
        let m =
            to_pixels * DMat3::from_quat(color_from_depth.rotation) * projection(depth).inverse();
        Self {
            u: m.x_axis.as_vec3a(),
            v: m.y_axis.as_vec3a(),
            one: m.z_axis.as_vec3a(),
            offset: (to_pixels * color_from_depth.translation).as_vec3a(),
        }
    }

    #[inline]
    fn apply(&self, u: f32, v: f32, z: f32) -> Vertex {
        let q = (self.u * u + self.v * v + self.one) * z + self.offset;
        if q.z > 0.0 {
            let w = 1.0 / q.z;
            Vertex {
                u: q.x * w,
                v: q.y * w,
                w,
            }
        } else {
            Vertex::NONE
        }
    }
}

impl<'a> Surface<'a> {
    fn new(
        depth: &'a DepthImage,
        depth_camera: &Intrinsics,
        color_from_depth: &Pose,
        color_camera: &Intrinsics,
    ) -> Self {
        let settings = GhostSettings::default();
        let map = PixelMap::new(depth_camera, color_from_depth, color_camera);
        let tolerance =
            |&z: &f32| settings.edge_relative * z + settings.edge_sigmas * depth_sigma_m(z);
        let rows = depth.z_m.chunks_exact(depth.width as usize).enumerate();
        let vertices = rows.flat_map(|(y, row)| {
            let map = &map;
            row.iter().enumerate().map(move |(x, &z)| {
                if is_valid_depth(z) {
                    map.apply(x as f32, y as f32, z)
                } else {
                    Vertex::NONE
                }
            })
        });
        Self {
            vertices: vertices.collect(),
            tolerance_m: depth.z_m.iter().map(tolerance).collect(),
            depth,
            map,
        }
    }

    /// Index of a pixel, if it is in the image.
    #[inline]
    fn index(&self, x: i32, y: i32) -> Option<usize> {
        let inside =
            (0..self.depth.width as i32).contains(&x) && (0..self.depth.height as i32).contains(&y);
        inside.then(|| y as usize * self.depth.width as usize + x as usize)
    }

    /// Whether two neighbours are on the same surface. False if either is invalid.
    #[inline]
    fn connected(&self, a: usize, b: usize) -> bool {
        let (za, zb) = (self.depth.z_m[a], self.depth.z_m[b]);
        let nearer = if za < zb { a } else { b };
        (za - zb).abs() < self.tolerance_m[nearer]
    }

    /// Draws the cells between the rows y and y + 1; one of the rows may be outside the image.
    fn draw_row(&self, y: i32, canvas: &mut Canvas) {
        let last = self.depth.width as i32 - 1;
        self.draw_quarters(-1, y, [false; 4], canvas);
        self.draw_quarters(last, y, [false; 4], canvas);
        if y < 0 || y + 1 >= self.depth.height as i32 {
            for x in 0..last {
                self.draw_quarters(x, y, [false; 4], canvas);
            }
            return;
        }
        for x in 0..last {
            let a = y as usize * self.depth.width as usize + x as usize;
            let (b, c) = (a + 1, a + self.depth.width as usize);
            let d = c + 1;
            let diagonal = self.connected(a, d);
            let upper = diagonal && self.connected(a, b) && self.connected(b, d);
            let lower = diagonal && self.connected(a, c) && self.connected(c, d);
            let [va, vb, vc, vd] = [a, b, c, d].map(|i| self.vertices[i]);
            match (upper, lower) {
                (true, true) => canvas.draw_cell(va, vb, vc, vd),
                (true, false) => canvas.draw_triangle(va, vb, vd),
                (false, true) => canvas.draw_triangle(va, vd, vc),
                (false, false) => {}
            }
            if !(upper && lower) {
                self.draw_quarters(x, y, [false, upper, lower, false], canvas);
            }
        }
    }

    /// Draws the quarters of a torn cell that belong to its pixels, except the `covered` ones.
    #[inline(never)]
    fn draw_quarters(&self, x: i32, y: i32, covered: [bool; 4], canvas: &mut Canvas) {
        let corners = [(0, 0), (1, 0), (0, 1), (1, 1)];
        for ((dx, dy), covered) in corners.into_iter().zip(covered) {
            let (px, py) = (x + dx, y + dy);
            let Some(i) = self.index(px, py) else {
                continue;
            };
            let z = self.depth.z_m[i];
            if covered || !is_valid_depth(z) {
                continue;
            }
            let w = 1.0 / z;
            // From the pixel to the cell's centre, slightly extended at both ends.
            let sign_u = (1 - 2 * dx) as f32;
            let sign_v = (1 - 2 * dy) as f32;
            let (gu, gv) = (self.slope(px, py, 1, 0), self.slope(px, py, 0, 1));
            let at = |su: f32, sv: f32| {
                let (su, sv) = (su * sign_u, sv * sign_v);
                self.map.apply(
                    px as f32 + su,
                    py as f32 + sv,
                    1.0 / (w + gu * su + gv * sv),
                )
            };
            let (inner, outer) = (-SEAM_PX, 0.5 + SEAM_PX);
            let (center, middle) = (at(inner, inner), at(outer, outer));
            let (side_u, side_v) = (at(outer, inner), at(inner, outer));
            // Keeps the orientation of the two triangles for every quarter.
            let (first, second) = if sign_u * sign_v > 0.0 {
                (side_u, side_v)
            } else {
                (side_v, side_u)
            };
            canvas.draw_triangle(center, first, second);
            canvas.draw_triangle(middle, second, first);
        }
    }

    /// Change of 1/z per pixel along an axis, from connected neighbours; 0 without any.
    fn slope(&self, x: i32, y: i32, dx: i32, dy: i32) -> f32 {
        let Some(here) = self.index(x, y) else {
            return 0.0;
        };
        let w = |i: usize| 1.0 / self.depth.z_m[i];
        let neighbour = |sign: i32| {
            self.index(x + sign * dx, y + sign * dy)
                .filter(|&i| self.connected(here, i))
                .map(w)
        };
        match (neighbour(-1), neighbour(1)) {
            (Some(before), Some(after)) => (after - before) * 0.5,
            (Some(before), None) => w(here) - before,
            (None, Some(after)) => after - w(here),
            (None, None) => 0.0,
        }
    }
}

/// The picture of w = 1/z in the colour camera; 0 for pixels that were not drawn.
struct Canvas {
    width: i32,
    height: i32,
    w: Vec<f32>,
}

impl Canvas {
    fn new(width: u32, height: u32) -> Self {
        Self {
            width: width as i32,
            height: height as i32,
            w: vec![0.0; width as usize * height as usize],
        }
    }

    /// The nearer value of two canvases at each pixel.
    fn nearest(mut self, other: Self) -> Self {
        for (mine, theirs) in self.w.iter_mut().zip(other.w) {
            *mine = mine.max(theirs);
        }
        self
    }

    /// Draws both triangles of a whole cell, (a, b, d) and (a, d, c), in one pass: the side of the diagonal
    /// determines the triangle that can contain a pixel.
    #[inline]
    fn draw_cell(&mut self, a: Vertex, b: Vertex, c: Vertex, d: Vertex) {
        let (u0, u1) = (
            a.u.min(b.u).min(c.u.min(d.u)),
            a.u.max(b.u).max(c.u.max(d.u)),
        );
        let (v0, v1) = (
            a.v.min(b.v).min(c.v.min(d.v)),
            a.v.max(b.v).max(c.v.max(d.v)),
        );
        let (x0, x1) = (first_center(u0), last_center(u1, self.width));
        let (y0, y1) = (first_center(v0), last_center(v1, self.height));
        if x0 > x1 || y0 > y1 {
            return;
        }
        // Also false for a missing vertex, whose area is NaN.
        let small = u1 - u0 <= MAX_CELL_PX && v1 - v0 <= MAX_CELL_PX;
        if !(small && edge(a, b, d.u, d.v) > 0.0 && edge(a, d, c.u, c.v) > 0.0) {
            // The cell is folded when seen from the colour camera: each triangle is drawn on its own.
            self.draw_triangle(a, b, d);
            self.draw_triangle(a, d, c);
            return;
        }
        for y in y0..=y1 {
            let row = y as usize * self.width as usize;
            for x in x0..=x1 {
                let (u, v) = (x as f32, y as f32);
                let side = edge(d, a, u, v);
                let (other, ea, ed) = if side >= 0.0 {
                    (b, edge(b, d, u, v), edge(a, b, u, v))
                } else {
                    (c, edge(d, c, u, v), edge(c, a, u, v))
                };
                if ea >= 0.0 && ed >= 0.0 {
                    self.keep_nearest(row + x as usize, [(ea, a), (side.abs(), other), (ed, d)]);
                }
            }
        }
    }

    /// Interpolates w at a pixel with the weights of three corners. Dividing by the sum of the weights keeps it
    /// between the corners' values despite rounding.
    #[inline]
    fn keep_nearest(&mut self, pixel: usize, [a, b, c]: [(f32, Vertex); 3]) {
        let sum = a.0 + b.0 + c.0;
        let w = (a.0 * a.1.w + b.0 * b.1.w + c.0 * c.1.w) / sum;
        // Also false for a sum of 0, if a pixel coincides with three corners.
        if w > self.w[pixel] {
            self.w[pixel] = w;
        }
    }

    /// Draws a triangle that is clockwise on the screen; other triangles are seen from behind, which sensors cannot
    /// measure. Pixel centres on an edge are inside, so neighbours leave no gap.
    #[inline]
    fn draw_triangle(&mut self, a: Vertex, b: Vertex, c: Vertex) {
        let (u0, u1) = (a.u.min(b.u).min(c.u), a.u.max(b.u).max(c.u));
        let (v0, v1) = (a.v.min(b.v).min(c.v), a.v.max(b.v).max(c.v));
        let (x0, x1) = (first_center(u0), last_center(u1, self.width));
        let (y0, y1) = (first_center(v0), last_center(v1, self.height));
        if x0 > x1 || y0 > y1 {
            return;
        }
        // Also false for a missing vertex, whose area is NaN.
        if !(edge(a, b, c.u, c.v) > 0.0 && u1 - u0 <= MAX_CELL_PX && v1 - v0 <= MAX_CELL_PX) {
            return;
        }
        for y in y0..=y1 {
            let row = y as usize * self.width as usize;
            for x in x0..=x1 {
                let (u, v) = (x as f32, y as f32);
                let (ea, eb, ec) = (edge(b, c, u, v), edge(c, a, u, v), edge(a, b, u, v));
                if ea >= 0.0 && eb >= 0.0 && ec >= 0.0 {
                    self.keep_nearest(row + x as usize, [(ea, a), (eb, b), (ec, c)]);
                }
            }
        }
    }
}

/// Twice the signed area of (a, b, p): exactly the negative of that of (b, a, p), so triangles that share an edge
/// agree on the side of every pixel.
#[inline]
fn edge(a: Vertex, b: Vertex, u: f32, v: f32) -> f32 {
    (a.u - u) * (b.v - v) - (a.v - v) * (b.u - u)
}

/// The first pixel centre >= `from`, at least 0; the largest number if there is none. (`ceil` is a function call on
/// the portable baseline.)
#[inline]
fn first_center(from: f32) -> i32 {
    let from = from.max(0.0);
    let whole = from as i32;
    whole.saturating_add(i32::from((whole as f32) < from))
}

/// The last pixel centre <= `to`, below `end`; -1 if there is none.
#[inline]
fn last_center(to: f32, end: i32) -> i32 {
    if to < 0.0 {
        -1
    } else {
        (to as i32).min(end - 1)
    }
}

#[cfg(test)]
mod tests;
