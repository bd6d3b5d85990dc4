//! A simulated Kinect v1 at the position of the colour camera: exact depth, and the depth that the sensor
//! measures.
//!
//! The sensor triangulates a projected pattern, so its errors are errors of disparity: `d = f b / z`, with noise
//! and a quantum of 1/8 px that both grow as z^2 in depth (Khoshelham and Elberink 2012, equations 7 and 9).
//! Points that the projector does not light, or lights at a grazing angle, or that return too little light, are
//! holes. Edges are displaced by about a pixel (Nguyen, Izadi and Lovell 2012: lateral noise 0.8 px).

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::caster::Hit;
use super::geometry::Geometry;
use super::light::OFFSET_M;
use super::render::{View, gaussian};

/// Focal length of the infrared camera, pixels, at 640x480.
pub(super) const FOCAL_PX: f64 = 580.0;
/// Distance from camera to projector, metres.
pub(super) const BASELINE_M: f64 = 0.075;
/// Steps of disparity per pixel.
pub(super) const STEPS_PER_PX: f64 = 8.0;
/// Standard deviation of measured disparity, steps, including rounding (Khoshelham and Elberink 2012, section
/// 4.2: half a step).
pub(super) const NOISE_STEPS: f64 = 0.5;
/// Range of the sensor, metres.
pub(super) const RANGE_M: std::ops::Range<f64> = 0.5..5.0;
/// The pattern is matched in windows of 9x9 pixels, so the noise of neighbouring pixels is correlated: standard
/// deviation of a Gaussian nearly as wide as that window, pixels.
const WINDOW_PX: f32 = 2.2;
/// Standard deviation of the sideways displacement of an edge, pixels.
const LATERAL_PX: f32 = 0.8;
/// Surfaces seen or lit more obliquely than this return no pattern, degrees; the limit varies by a few degrees
/// from place to place.
const GRAZING_DEG: f64 = 75.0;
const GRAZING_SPREAD_DEG: f64 = 2.0;
/// Least share of the infrared light that must return, per (1 m)^2 of distance.
const MIN_RETURN: f64 = 0.010;
/// Depth units per metre of the written image (TUM).
pub(super) const UNITS_PER_METRE: f64 = 5000.0;

/// Depth at the centre ray of each pixel.
pub(super) struct ExactDepth {
    /// Pixels per row.
    pub(super) width: usize,
    /// Depth z, metres; infinite if the ray hits nothing.
    pub(super) z_m: Vec<f64>,
    hits: Vec<Option<Hit>>,
}

/// Casts the centre ray of every pixel.
pub(super) fn exact_depth(geometry: &Geometry, view: &View) -> ExactDepth {
    let (width, height) = (view.intrinsics.width, view.intrinsics.height);
    let hits: Vec<Option<Hit>> = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let direction = view.ray(f64::from(i % width), f64::from(i / width));
            geometry
                .caster
                .intersect(view.pose.translation, direction, 0.0, f64::INFINITY)
        })
        .collect();
    ExactDepth {
        width: width as usize,
        z_m: hits
            .iter()
            .map(|hit| hit.map_or(f64::INFINITY, |hit| hit.t))
            .collect(),
        hits,
    }
}

/// Depth units; 0 if there is no depth or it is out of range.
pub(super) fn units(z_m: f64) -> u16 {
    let units = (z_m * UNITS_PER_METRE).round();
    if units >= 1.0 && units < f64::from(u16::MAX) {
        units as u16
    } else {
        0
    }
}

/// Standard normal noise that is correlated between neighbours over about `sigma_px`.
fn smooth_noise(
    width: usize,
    height: usize,
    frame: u32,
    dimension: u32,
    sigma_px: f32,
) -> Vec<f32> {
    let white: Vec<f32> = (0..width * height)
        .map(|i| gaussian(i as u32, frame, dimension))
        .collect();
    let reach = (3.0 * sigma_px).ceil() as i64;
    let kernel: Vec<f32> = (-reach..=reach)
        .map(|k| (-0.5 * (k as f32 / sigma_px).powi(2)).exp())
        .collect();
    // Scaled so that the sum over both axes has variance 1.
    let scale = 1.0 / kernel.iter().map(|w| w * w).sum::<f32>().sqrt();
    let pass = |input: &[f32], stride: usize, length: usize| -> Vec<f32> {
        (0..input.len())
            .into_par_iter()
            .map(|i| {
                let at = (i / stride) % length;
                let start = i - at * stride;
                kernel
                    .iter()
                    .enumerate()
                    .map(|(k, w)| {
                        // Wraps around, so that the variance is the same at the borders.
                        let j = (at as i64 + k as i64 - reach).rem_euclid(length as i64);
                        w * input[start + j as usize * stride]
                    })
                    .sum::<f32>()
                    * scale
            })
            .collect()
    };
    pass(&pass(&white, 1, width), width, height)
}

/// Depth of a noisy, quantised disparity; `deviate` is a standard normal number, `level`
/// multiplies noise and quantum.
fn triangulate(z_m: f64, deviate: f64, level: f64) -> f64 {
    if level == 0.0 {
        return z_m;
    }
    let steps_at_1m = FOCAL_PX * BASELINE_M * STEPS_PER_PX / level;
    // Rounding alone adds 1/12 of a squared step.
    let sigma = (NOISE_STEPS * NOISE_STEPS - 1.0 / 12.0).sqrt();
    let steps = (steps_at_1m / z_m + sigma * deviate).round();
    if steps >= 1.0 {
        steps_at_1m / steps
    } else {
        f64::INFINITY
    }
}

/// The measured depth, in depth units; 0 is a hole.
pub(super) fn sense(geometry: &Geometry, view: &View, exact: &ExactDepth, frame: u32) -> Vec<u16> {
    let sensed = sense_at(geometry, view, exact, frame, 1.0);
    sensed.into_iter().map(units).collect()
}

/// The depth that a sensor with `level` times the noise measures, metres; infinite is a hole. The holes do not
/// depend on the level.
pub(super) fn sense_at(
    geometry: &Geometry,
    view: &View,
    exact: &ExactDepth,
    frame: u32,
    level: f64,
) -> Vec<f64> {
    let width = exact.width;
    let height = exact.z_m.len() / width;
    let field = |dimension: u32, sigma: f32| smooth_noise(width, height, frame, dimension, sigma);
    let axial = field(20, WINDOW_PX);
    let (shift_u, shift_v) = (field(30, 2.0), field(40, 2.0));
    let patchy = field(50, 3.0);
    let eye = view.pose.translation;
    // The projector is to the right of the camera, in the camera's own view.
    let projector = eye + view.pose.rotation * (DVec3::X * BASELINE_M);
    (0..exact.z_m.len())
        .into_par_iter()
        .map(|i| {
            let (u, v) = (i % width, i / width);
            let moved = |at: usize, by: f32, n: usize| {
                (at as f32 + by * (LATERAL_PX * level as f32))
                    .round()
                    .clamp(0.0, (n - 1) as f32) as usize
            };
            let other = moved(v, shift_v[i], height) * width + moved(u, shift_u[i], width);
            // Only edges are displaced: within one surface the pattern is read at its place.
            let jump = (exact.z_m[other] - exact.z_m[i]).abs();
            let from = if jump > 0.02 * exact.z_m[i] { other } else { i };
            let Some(hit) = exact.hits[from] else {
                return f64::INFINITY;
            };
            let z = exact.z_m[from];
            if !RANGE_M.contains(&z) {
                return f64::INFINITY;
            }
            let direction = view.ray((from % width) as f64, (from / width) as f64);
            let point = eye + direction * z;
            let p = geometry.surface(&hit, point);
            let normal = if hit.back { -p.normal } else { p.normal };
            let to_eye = (eye - point).normalize_or_zero();
            let to_projector = projector - point;
            let cos_eye = normal.dot(to_eye);
            let cos_light = normal.dot(to_projector.normalize_or_zero());
            let limit = (GRAZING_DEG + GRAZING_SPREAD_DEG * f64::from(patchy[i])).to_radians();
            if cos_eye.min(cos_light) < limit.cos() {
                return f64::INFINITY;
            }
            // The projector does not light this point: its ray is blocked.
            let start = point + normal * OFFSET_M;
            if geometry.caster.occluded(start, projector - start, 0.0, 1.0) {
                return f64::INFINITY;
            }
            let material = geometry.material(&hit);
            let share = match material.infrared {
                Some(share) => f64::from(share),
                None => {
                    // Dyes that look dark are lighter in the near infrared.
                    let Vec3 { x: red, .. } = material.pattern.colour(p.uv, p.m);
                    0.15 + 0.7 * f64::from(red)
                }
            };
            let back = share * cos_light / to_projector.length_squared();
            if back < MIN_RETURN * (1.0 + 0.35 * f64::from(patchy[i])) {
                return f64::INFINITY;
            }
            let measured = triangulate(z, f64::from(axial[i]), level);
            if RANGE_M.contains(&measured) {
                measured
            } else {
                f64::INFINITY
            }
        })
        .collect()
}
