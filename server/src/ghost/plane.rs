//! Local planes of the ghost surface.
//!
//! Planes are fitted in (u, v, w), where a plane in space stays a plane: the fit is exact on
//! planes at any slant, and w's noise (`sigma / z^2`) is nearly constant within a window.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, dispatch, f32x16, mask32x16};
use glam::{DVec3, Vec3A};

use super::connection::Connection;
use super::settings::GhostSettings;
use super::surface::GhostSurface;
use crate::camera::Intrinsics;
use crate::frame::{DepthImage, depth_sigma_m, is_valid_depth};

/// Target standard deviation of a normal's slope (0.05 rad is 3 degrees): wider windows round off edges, narrower
/// ones show the sensor's noise. Heuristic.
const SLOPE_SIGMA: f64 = 0.05;

/// Bounds of a normal's window, pixels.
const RADIUS_MAX: usize = 6;

/// Largest radius of [`DepthPlanes::at`], pixels.
const PLANE_RADIUS_MAX: usize = 64;

/// Most refits to the better half of the points; a few are usually enough.
const REFITS: usize = 20;

/// Points with residuals beyond this many standard deviations are not on the plane.
const TRIM_SIGMAS: f64 = 3.0;

/// Ratio of the standard deviation of a normal distribution to its median absolute deviation.
const SIGMA_PER_MAD: f64 = 1.4826;

/// w = a + b du + c dv around a pixel.
#[derive(Debug, Clone, Copy)]
struct Plane {
    a: f64,
    b: f64,
    c: f64,
}

/// Sums of a least-squares fit.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    n: f64,
    x: f64,
    y: f64,
    w: f64,
    xx: f64,
    xy: f64,
    yy: f64,
    xw: f64,
    yw: f64,
}

impl Sums {
    #[inline(always)]
    fn add(&mut self, x: f64, y: f64, w: f64) {
        self.n += 1.0;
        self.x += x;
        self.y += y;
        self.w += w;
        self.xx += x * x;
        self.xy += x * y;
        self.yy += y * y;
        self.xw += x * w;
        self.yw += y * w;
    }

    /// The plane, unless the points are collinear.
    fn solve(&self) -> Option<Plane> {
        let (mx, my, mw) = (self.x / self.n, self.y / self.n, self.w / self.n);
        let xx = self.xx - self.n * mx * mx;
        let yy = self.yy - self.n * my * my;
        let xy = self.xy - self.n * mx * my;
        let xw = self.xw - self.n * mx * mw;
        let yw = self.yw - self.n * my * mw;
        let det = xx * yy - xy * xy;
        // Three pixels that are not collinear span det = 1/3; integer sums are exact.
        if self.n < 3.0 || det < 0.25 {
            return None;
        }
        let b = (xw * yy - yw * xy) / det;
        let c = (yw * xx - xw * xy) / det;
        Some(Plane {
            a: mw - b * mx - c * my,
            b,
            c,
        })
    }
}

impl Plane {
    /// Distance of a point (du, dv, w) from the plane, along w.
    fn residual(&self, &(dx, dy, w): &(f64, f64, f64)) -> f64 {
        (w - self.a - self.b * dx - self.c * dy).abs()
    }

    /// The unit normal in camera axes that faces the camera, of a plane around pixel (x, y): in
    /// space, `w = n . dir` is the plane `n . p = 1`, with `dir = ((u - cx)/fx, (v - cy)/fy, 1)`.
    fn normal(&self, k: &Intrinsics, x: f64, y: f64) -> Option<Vec3A> {
        let away = DVec3::new(
            self.b * k.fx,
            self.c * k.fy,
            self.a + self.b * (k.cx - x) + self.c * (k.cy - y),
        );
        (-away).try_normalize().map(|n| n.as_vec3a())
    }
}

fn fit<'a>(points: impl Iterator<Item = &'a (f64, f64, f64)>) -> Option<Plane> {
    let mut sums = Sums::default();
    for &(dx, dy, w) in points {
        sums.add(dx, dy, w);
    }
    sums.solve()
}

/// Fits a plane to the points within `distance` of a given plane.
fn fit_within(points: &[(f64, f64, f64)], plane: &Plane, distance: f64) -> Option<Plane> {
    fit(points
        .iter()
        .filter(|point| plane.residual(point) <= distance))
}

impl GhostSurface {
    /// Normal of the surface at a vertex: unit length, camera axes, facing the camera. Fitted over the pixels
    /// connected to the vertex in a window that grows with the sensor's noise; `None` if there is no measurement
    /// or no two neighbours span a plane.
    pub fn normal_at(&self, x: u32, y: u32) -> Option<Vec3A> {
        let z = 1.0 / self.w(x, y)?;
        let radius = self.normal_radius(z);
        let (column, row) = (x as usize, y as usize);
        let whole = dispatch!(self.level, simd => self.whole_window(simd, column, row, radius));
        let plane = whole.or_else(|| self.connected_window(column, row, radius))?;
        plane.normal(&self.intrinsics, f64::from(x), f64::from(y))
    }

    /// A fit to the pixels of a window that are connected to its centre.
    fn connected_window(&self, x: usize, y: usize, radius: usize) -> Option<Plane> {
        let mut sums = Sums::default();
        self.for_connected::<{ (2 * RADIUS_MAX + 1) * (2 * RADIUS_MAX + 1) }>(
            x,
            y,
            radius,
            |dx, dy, w| sums.add(dx, dy, w),
        );
        sums.solve()
    }

    /// [`Self::connected_window`] for windows in which all pixels are obviously connected, as in most; `None` if
    /// that is not obvious, or if the window reaches beyond the image's border.
    #[inline(always)]
    fn whole_window<S: Simd>(&self, simd: S, x: usize, y: usize, radius: usize) -> Option<Plane> {
        let (width, height) = (self.width() as usize, self.height() as usize);
        let inside = x >= radius && y >= radius && x + radius < width && y + radius < height;
        let side = 2 * radius + 1;
        if !inside || side >= f32x16::<S>::LEN {
            return None;
        }
        let at = |dy: usize| (y - radius + dy) * self.stride + x - radius;
        let load = |values: &[f32], at: usize| f32x16::from_slice(simd, &values[at..at + 16]);
        let lanes = |n: usize| mask32x16::from_bitmask(simd, (1 << n) - 1);
        let (all, pairs) = (lanes(side), lanes(side - 1));
        let (mut least, mut step) = (f32::INFINITY, f32x16::splat(simd, 0.0));
        let mut nearest = f32x16::splat(simd, f32::INFINITY);
        let mut valid = all;
        let mut above = load(&self.z, at(0));
        for dy in 0..side {
            let here = load(&self.z, at(dy));
            let right = load(&self.z, at(dy) + 1);
            // A difference from or to a hole is a NaN, which a maximum ignores.
            valid &= here.simd_eq(here);
            let down = all.select((here - above).abs(), step);
            let along = pairs.select((right - here).abs(), step);
            step = step.max(down).max(along);
            nearest = nearest.min(here);
            above = here;
        }
        if (all & valid).to_bitmask() != all.to_bitmask() {
            return None;
        }
        let (step, nearest) = (step.to_array(), nearest.to_array());
        for &z in &nearest[..side] {
            least = least.min(z);
        }
        let step = step.into_iter().fold(0.0, f32::max);
        // Half of the allowed step in each direction: two of them make the diagonal step.
        if step >= 0.5 * self.connection.least_step(least) {
            return None;
        }
        // Relative to the centre's w: the rounding of the sums is then relative to the variation of w.
        let w = self.w[y * self.stride + x];
        let mut sums = f32x16::splat(simd, 0.0);
        let mut moments = f32x16::splat(simd, 0.0);
        for dy in 0..side {
            let off = load(&self.w, at(dy)) - f32x16::splat(simd, w);
            sums += off;
            moments += off * f32x16::splat(simd, dy as f32 - radius as f32);
        }
        let (sums, moments) = (sums.to_array(), moments.to_array());
        let (mut total, mut along_x, mut along_y) = (0.0, 0.0, 0.0);
        for (lane, (&sum, &moment)) in sums.iter().zip(&moments).enumerate().take(side) {
            total += f64::from(sum);
            along_x += (lane as f64 - radius as f64) * f64::from(sum);
            along_y += f64::from(moment);
        }
        let (r, n) = (radius as f64, side as f64);
        let squares = n * (r * (r + 1.0) * n / 3.0);
        Some(Plane {
            a: f64::from(w) + total / (n * n),
            b: along_x / squares,
            c: along_y / squares,
        })
    }

    /// Window radius at depth z. In a window of radius r the slope's standard deviation is `sigma / (pixel sqrt(n
    /// r (r+1) / 3))` with n = (2r+1)^2, at most `sigma / (pixel 1.15 r^2)`; `pixel` is the size of a pixel on
    /// the surface, z / f.
    fn normal_radius(&self, z: f32) -> usize {
        let pixel_m = f64::from(z) / self.intrinsics.fx.max(self.intrinsics.fy);
        let sigma = f64::from(depth_sigma_m(z));
        let radius = (sigma / (pixel_m * 1.15 * SLOPE_SIGMA)).sqrt().ceil();
        (radius as usize).clamp(1, RADIUS_MAX)
    }

    /// Visits the pixels of a window that are connected to its centre: a pixel is, if its neighbour one step
    /// nearer to the centre is and the two are connected. `AREA` is at least that of the window.
    #[inline(always)]
    fn for_connected<const AREA: usize>(
        &self,
        x: usize,
        y: usize,
        radius: usize,
        mut visit: impl FnMut(f64, f64, f64),
    ) {
        let mut reached = [false; AREA];
        let z = |x: usize, y: usize| self.z[y * self.stride + x];
        let size = (self.width(), self.height());
        spread(
            z,
            size,
            self.connection,
            (x, y),
            radius,
            &mut reached,
            &mut visit,
        );
    }
}

/// Local planes of a depth map, without building its [`GhostSurface`]: a fit reads only the pixels of its window.
#[derive(Debug, Clone, Copy)]
pub struct DepthPlanes<'a> {
    depth: &'a DepthImage,
    intrinsics: &'a Intrinsics,
    connection: Connection,
}

impl<'a> DepthPlanes<'a> {
    /// For a depth map with the intrinsics of its camera; `settings` say which pixels are connected.
    pub fn new(
        depth: &'a DepthImage,
        intrinsics: &'a Intrinsics,
        settings: &GhostSettings,
    ) -> Self {
        Self {
            depth,
            intrinsics,
            connection: Connection::new(settings),
        }
    }

    /// Depth of a pixel of the image, NaN if it was not measured.
    fn z(&self, x: usize, y: usize) -> f32 {
        let z = self.depth.z_m[y * self.depth.width as usize + x];
        // The field is public, so its values are checked here.
        if is_valid_depth(z) {
            z
        } else {
            DepthImage::INVALID
        }
    }

    /// The plane that fits the surface around pixel position (u, v): its point on the pixel's ray (camera axes,
    /// metres) and its unit normal facing the camera. Robust: pixels that are not on the plane (objects on it,
    /// noise spikes) are removed in refits. `None` if there is no measurement within `radius_px`, or if the
    /// measured pixels span no plane.
    pub fn at(&self, u: f32, v: f32, radius_px: u32) -> Option<(Vec3A, Vec3A)> {
        let radius = (radius_px as usize).clamp(1, PLANE_RADIUS_MAX);
        let (x, y) = self.nearest_measured(u, v, radius)?;
        let mut points = Vec::new();
        let side = 2 * radius + 1;
        let mut reached = vec![false; side * side];
        spread(
            |x, y| self.z(x, y),
            (self.depth.width, self.depth.height),
            self.connection,
            (x, y),
            radius,
            &mut reached,
            &mut |dx, dy, w| points.push((dx, dy, w)),
        );
        let mut plane = fit(points.iter())?;
        let mut residuals = Vec::with_capacity(points.len());
        // Least trimmed squares: refitting to the half of the points nearest to the last plane never increases
        // that half's error (Rousseeuw and Van Driessen 1999, C-steps).
        let mut bound = f64::INFINITY;
        for _ in 0..REFITS {
            residuals.clear();
            residuals.extend(points.iter().map(|point| plane.residual(point)));
            let middle = residuals.len() / 2;
            let (_, &mut median, _) = residuals.select_nth_unstable_by(middle, f64::total_cmp);
            if median >= bound {
                break;
            }
            bound = median;
            plane = fit_within(&points, &plane, median)?;
        }
        // Then a fit to all points that agree with it; rounding of depths to f32 keeps the bound above zero.
        let bound = TRIM_SIGMAS * SIGMA_PER_MAD * bound + f64::from(f32::EPSILON) * plane.a.abs();
        plane = fit_within(&points, &plane, bound)?;
        let (du, dv) = (f64::from(u) - x as f64, f64::from(v) - y as f64);
        let w = plane.a + plane.b * du + plane.c * dv;
        if w <= 0.0 {
            return None;
        }
        let point = self
            .intrinsics
            .unproject(f64::from(u), f64::from(v), 1.0 / w);
        let normal = plane.normal(self.intrinsics, x as f64, y as f64)?;
        Some((point.as_vec3a(), normal))
    }

    /// The measured pixel nearest to a position, within a radius.
    fn nearest_measured(&self, u: f32, v: f32, radius: usize) -> Option<(usize, usize)> {
        let (width, height) = (self.depth.width, self.depth.height);
        let (x, y) = ((u + 0.5).floor(), (v + 0.5).floor());
        let inside = x >= 0.0 && y >= 0.0 && x < width as f32 && y < height as f32;
        if !inside {
            return None;
        }
        let (x, y) = (x as usize, y as usize);
        let columns = x.saturating_sub(radius)..=(x + radius).min(width as usize - 1);
        let rows = y.saturating_sub(radius)..=(y + radius).min(height as usize - 1);
        rows.flat_map(|j| columns.clone().map(move |i| (i, j)))
            .filter(|&(i, j)| !self.z(i, j).is_nan())
            .map(|(i, j)| ((i as f32 - u).powi(2) + (j as f32 - v).powi(2), i, j))
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, i, j)| (i, j))
    }
}

/// Visits the pixels of a window that are connected to its centre pixel, with their offset and inverse depth: a
/// pixel is connected if its neighbour one step nearer to the centre is and the two are connected. `z` is the
/// depth of a pixel; `reached` has space for the window.
#[inline(always)]
fn spread(
    z: impl Fn(usize, usize) -> f32,
    (width, height): (u32, u32),
    connection: Connection,
    (x, y): (usize, usize),
    radius: usize,
    reached: &mut [bool],
    visit: &mut impl FnMut(f64, f64, f64),
) {
    let side = 2 * radius + 1;
    let (width, height) = (width as i32, height as i32);
    let (x, y, r) = (x as i32, y as i32, radius as i32);
    let slot = |dx: i32, dy: i32| (dy + r) as usize * side + (dx + r) as usize;
    let depth = |dx: i32, dy: i32| z((x + dx) as usize, (y + dy) as usize);
    reached[slot(0, 0)] = true;
    visit(0.0, 0.0, 1.0 / f64::from(depth(0, 0)));
    for ring in 1..=r {
        for dy in -ring..=ring {
            // Whole rows at the top and bottom of the ring, two pixels in the rows between.
            let step = if dy.abs() == ring { 1 } else { 2 * ring };
            for dx in (-ring..=ring).step_by(step as usize) {
                let (i, j) = (x + dx, y + dy);
                if i < 0 || j < 0 || i >= width || j >= height {
                    continue;
                }
                let (inner_x, inner_y) = (toward_zero(dx, ring), toward_zero(dy, ring));
                let z = depth(dx, dy);
                if reached[slot(inner_x, inner_y)] && connection.joins(z, depth(inner_x, inner_y)) {
                    reached[slot(dx, dy)] = true;
                    visit(f64::from(dx), f64::from(dy), 1.0 / f64::from(z));
                }
            }
        }
    }
}

/// One step towards the centre, on the axes on which the offset is on the ring.
fn toward_zero(offset: i32, ring: i32) -> i32 {
    if offset.abs() == ring {
        offset - offset.signum()
    } else {
        offset
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::{gamma, uniform};
    use fearless_simd::{Fallback, Level};

    /// Waves with a step and holes in them, and noise.
    fn waves() -> GhostSurface {
        let (width, height) = (96, 64);
        let z_m = (0..width * height)
            .map(|pixel| {
                let (x, y) = ((pixel % width) as f32, (pixel / width) as f32);
                let hole = uniform(pixel, 1, 0) < 0.002;
                let step = if x > 50.0 { 0.4 } else { 0.0 };
                let wave = 0.05 * (0.2 * x).sin() + 0.004 * y;
                let noise = 0.004 * (uniform(pixel, 0, 0) - 0.5);
                if hole { 0.0 } else { 1.2 + wave + step + noise }
            })
            .collect();
        let intrinsics = Intrinsics::new(300.0, 300.0, 47.5, 31.5, width, height).unwrap();
        let depth = DepthImage::from_metres(width, height, z_m);
        let mut surface = GhostSurface::new();
        surface.rebuild(&depth, &intrinsics, &GhostSettings::default());
        surface
    }

    #[test]
    fn a_whole_window_is_fitted_as_a_connected_one() {
        let surface = waves();
        let (mut whole, mut connected) = (0, 0);
        for (x, y, radius) in (0..96)
            .flat_map(|x| (0..64).map(move |y| (x, y)))
            .flat_map(|(x, y)| (1..=RADIUS_MAX).map(move |radius| (x, y, radius)))
        {
            if surface.w(x as u32, y as u32).is_none() {
                continue;
            }
            let plain = surface.whole_window(Fallback::new(), x, y, radius);
            let best = dispatch!(Level::new(), simd => surface.whole_window(simd, x, y, radius));
            let bits = |plane: Option<Plane>| plane.map(|p| [p.a, p.b, p.c].map(f64::to_bits));
            assert_eq!(bits(plain), bits(best), "{x} {y} {radius}");
            let Some(fast) = best else {
                connected += 1;
                continue;
            };
            whole += 1;
            let slow = surface.connected_window(x, y, radius).unwrap();
            // The window has n = 2r + 1 pixels a side, all w are within a factor of two of the centre's, u is one
            // rounding. Storing each w loses w u of it: 3 u w / n of a slope. The sums of n by n differences from
            // the centre's w lose n u of their largest: 3 u w of a slope along rows, 6 u w along columns, whose
            // terms are products. Twice that, for the factor of two.
            let w = f64::from(surface.w(x as u32, y as u32).unwrap());
            let bound = f64::from(gamma(20)) * w;
            for (a, b) in [(fast.a, slow.a), (fast.b, slow.b), (fast.c, slow.c)] {
                assert!((a - b).abs() <= bound, "{x} {y} {radius}: {a} {b}");
            }
        }
        // Both kinds of window occur.
        assert!(whole > 5000 && connected > 5000, "{whole} {connected}");
    }
}
