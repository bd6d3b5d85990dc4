//! The thin lens of a frame (Kan and Kaufmann 2012, *Depth of Field Rendering in Augmented Reality*, section
//! 3.1), and the points on it at which rays start.
//!
//! The camera is at the origin, d is a pixel's direction (z = 1), and I = d focus is its point in focus. A ray
//! starts at O' on a disc around the origin and goes to I. Its direction d - O' / focus has z = 1 too, so its
//! parameter is depth, as for primary rays. In the picture it is a straight line in inverse depth w: at w the
//! pinhole camera sees it `f O' (w - 1 / focus)` pixels away from the pixel.

use glam::Vec3A;

use crate::accel::Ray;
use crate::frame::{RgbdFrame, is_valid_depth};
use crate::numerics::{hash, uniform};
use crate::render::settings::LensSettings;

use super::pinhole::{NEAR_M, Pinhole};

/// Number of sample sets; each pixel uses one chosen by its hash, so that noise has no visible pattern.
const N_SETS: usize = 64;

/// The focus is the median depth of the pixels this close to [`LensSettings::focus_px`], so that outliers and
/// holes of the sensor do not change it.
const FOCUS_REACH_PX: i64 = 4;
const FOCUS_PIXELS: usize = (2 * FOCUS_REACH_PX as usize + 1).pow(2);

/// Radius of the circle of confusion, in pixels, below which a surface counts as sharp: the circle is then no
/// wider than the pixel, whose area is sampled in any case.
pub(crate) const SHARP_PX: f32 = 0.5;

/// Position of a sample in the pixel and on the lens.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LensSample {
    /// Offset from the pixel's centre, -0.5..0.5.
    pub(crate) pixel: [f32; 2],
    /// Position on the unit disc.
    pub(crate) lens: [f32; 2],
}

/// A lens and its samples. Buffers are kept as long as the renderer.
#[derive(Debug, Default)]
pub(crate) struct Lens {
    radius_m: f32,
    inverse_focus: f32,
    pinhole: Pinhole,
    n: usize,
    noise_threshold: f32,
    samples: Vec<LensSample>,
}

impl Lens {
    /// Prepares the lens for a frame; false for a pinhole.
    pub(crate) fn update(
        &mut self,
        settings: &LensSettings,
        frame: &RgbdFrame,
        pinhole: Pinhole,
    ) -> bool {
        if settings.radius_m <= 0.0 {
            return false;
        }
        let focus_m = settings
            .focus_px
            .and_then(|at| sensed_around(frame, at))
            .unwrap_or(settings.focus_m);
        self.radius_m = settings.radius_m;
        self.inverse_focus = 1.0 / focus_m;
        self.pinhole = pinhole;
        self.noise_threshold = settings.noise_threshold;
        let n = settings.samples.max(1) as usize;
        if n != self.n {
            self.n = n;
            self.samples.clear();
            self.samples
                .extend((0..N_SETS as u32).flat_map(|set| sample_set(n as u32, set)));
        }
        true
    }

    /// Number of rays in a set of samples.
    pub(crate) fn n(&self) -> usize {
        self.n
    }

    /// See [`LensSettings::noise_threshold`].
    pub(crate) fn noise_threshold(&self) -> f32 {
        self.noise_threshold
    }

    /// The `k`-th set of samples of a pixel: the i-th samples of any two pixels are in the same part of the lens.
    pub(crate) fn samples(&self, x: u32, y: u32, k: usize) -> &[LensSample] {
        let set = (hash(x, y, 0) as usize).wrapping_add(k) % N_SETS;
        &self.samples[set * self.n..][..self.n]
    }

    /// Radius of the circle of confusion at depth `z`, pixels: the largest distance between a pixel and the
    /// points seen there by its rays.
    pub(crate) fn blur_px(&self, z: f32) -> f32 {
        let Pinhole { fx, fy, .. } = self.pinhole;
        fx.max(fy) * self.radius_m * (1.0 / z - self.inverse_focus).abs()
    }

    /// The largest [`Self::blur_px`] for depths from `near` to `far`; it is at one of the ends.
    pub(crate) fn blur_between_px(&self, near: f32, far: f32) -> f32 {
        self.blur_px(near).max(self.blur_px(far))
    }

    /// The ray of a sample of pixel (x, y); its parameter is depth.
    pub(crate) fn ray(&self, x: u32, y: u32, sample: &LensSample) -> Ray {
        let [u, v] = sample.pixel;
        let [lens_x, lens_y] = sample.lens;
        let origin = Vec3A::new(lens_x, lens_y, 0.0) * self.radius_m;
        Ray {
            origin,
            direction: self.pinhole.ray_direction(x as f32 + u, y as f32 + v)
                - origin * self.inverse_focus,
            t_min: NEAR_M,
            t_max: f32::INFINITY,
        }
    }

    /// Where the pinhole camera sees that ray: at inverse depth w it is at `start + step w`, in pixels.
    pub(crate) fn track(&self, x: u32, y: u32, sample: &LensSample) -> Track {
        let Pinhole { fx, fy, .. } = self.pinhole;
        let [u, v] = sample.pixel;
        let step = [
            fx * self.radius_m * sample.lens[0],
            fy * self.radius_m * sample.lens[1],
        ];
        Track {
            start: [
                x as f32 + u - step[0] * self.inverse_focus,
                y as f32 + v - step[1] * self.inverse_focus,
            ],
            step,
        }
    }
}

/// A lens ray in the picture: a straight line in inverse depth.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Track {
    /// Pixel position at infinity.
    pub(crate) start: [f32; 2],
    /// Pixels per unit of inverse depth.
    pub(crate) step: [f32; 2],
}

/// Median of the valid depths around a pixel; `None` if there are none, or outside the picture.
fn sensed_around(frame: &RgbdFrame, [u, v]: [f32; 2]) -> Option<f32> {
    let (width, height) = (i64::from(frame.depth.width), i64::from(frame.depth.height));
    // The casts saturate; whether the pixel is inside is checked below.
    let (x, y) = (u.round() as i64, v.round() as i64);
    if !(0..width).contains(&x) || !(0..height).contains(&y) {
        return None;
    }
    let mut depths = [0.0; FOCUS_PIXELS];
    let mut n = 0;
    for y in (y - FOCUS_REACH_PX).max(0)..(y + FOCUS_REACH_PX + 1).min(height) {
        for x in (x - FOCUS_REACH_PX).max(0)..(x + FOCUS_REACH_PX + 1).min(width) {
            let z = frame.depth.z_m[(y * width + x) as usize];
            if is_valid_depth(z) {
                depths[n] = z;
                n += 1;
            }
        }
    }
    let depths = &mut depths[..n];
    depths.sort_unstable_by(f32::total_cmp);
    depths.get(n / 2).copied()
}

/// `n` samples, stratified and jittered over the lens and over the pixel (Mitchell 1996): each of n equal parts
/// of the lens, and of the pixel, has one. Which part of the pixel is combined with which part of the lens is
/// random for each set.
fn sample_set(n: u32, set: u32) -> impl Iterator<Item = LensSample> {
    let mut partner: Vec<u32> = (0..n).collect();
    for i in (1..n).rev() {
        let j = hash(set, i, 4) % (i + 1);
        partner.swap(i as usize, j as usize);
    }
    (0..n).zip(partner).map(move |(i, partner)| {
        let jitter = |dimension| uniform(set, i, dimension);
        let [u, v] = part(n, partner, [jitter(0), jitter(1)]);
        LensSample {
            pixel: [u - 0.5, v - 0.5],
            lens: disc_from_square(part(n, i, [jitter(2), jitter(3)])),
        }
    })
}

/// A point in the `i`-th of `n` parts of the unit square, which have equal areas: rows of nearly square cells.
fn part(n: u32, i: u32, [a, b]: [f32; 2]) -> [f32; 2] {
    let rows = (n as f32).sqrt().round().max(1.0) as u32;
    let begin = |row: u32| row * n / rows;
    let row = (0..rows).rev().find(|&row| begin(row) <= i).unwrap_or(0);
    let (first, next) = (begin(row), begin(row + 1));
    let columns = (next - first) as f32;
    [
        ((i - first) as f32 + a) / columns,
        (first as f32 + b * columns) / n as f32,
    ]
}

/// Maps the unit square to the unit disc, preserving areas, and squares approximately (Shirley and Chiu 1997).
fn disc_from_square([a, b]: [f32; 2]) -> [f32; 2] {
    use std::f32::consts::{FRAC_PI_2, FRAC_PI_4};
    let (x, y) = (2.0 * a - 1.0, 2.0 * b - 1.0);
    if x == 0.0 && y == 0.0 {
        return [0.0; 2];
    }
    let (radius, angle) = if x.abs() > y.abs() {
        (x, FRAC_PI_4 * (y / x))
    } else {
        (y, FRAC_PI_2 - FRAC_PI_4 * (x / y))
    };
    [radius * angle.cos(), radius * angle.sin()]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every part of pixel and lens has one sample, for any number of samples.
    #[test]
    fn samples_share_pixel_and_lens_out() {
        for n in [1, 2, 7, 25, 49, 256] {
            for set in [0, 63] {
                let samples: Vec<LensSample> = sample_set(n, set).collect();
                assert_eq!(samples.len(), n as usize);
                let mut seen = vec![false; n as usize];
                for sample in &samples {
                    let [u, v] = sample.pixel.map(|c| c + 0.5);
                    assert!(
                        (0.0..1.0).contains(&u) && (0.0..1.0).contains(&v),
                        "{sample:?}"
                    );
                    let i = (0..n).find(|&i| {
                        let ([u0, v0], [u1, v1]) = (part(n, i, [0.0; 2]), part(n, i, [1.0; 2]));
                        (u0..u1).contains(&u) && (v0..v1).contains(&v)
                    });
                    // Rounding may move a sample at a border into the neighbouring part.
                    if let Some(i) = i {
                        seen[i as usize] = true;
                    }
                    assert!(sample.lens[0].hypot(sample.lens[1]) <= 1.0 + 1e-6);
                }
                assert!(seen.iter().filter(|&&seen| !seen).count() <= n as usize / 50);
            }
        }
        // For a uniform disc of radius 1 the mean of x^2 is 1/4, and half of the disc is within sqrt(1/2): within
        // three standard deviations of 1600 samples, even if they were not stratified.
        let all: Vec<[f32; 2]> = (0..N_SETS as u32)
            .flat_map(|set| sample_set(25, set))
            .map(|sample| sample.lens)
            .collect();
        let mean =
            |f: fn([f32; 2]) -> f32| all.iter().map(|&p| f(p)).sum::<f32>() / all.len() as f32;
        assert!((mean(|[x, _]| x * x) - 0.25).abs() < 3.0 * 0.25 / 40.0);
        assert!((mean(|[_, y]| y * y) - 0.25).abs() < 3.0 * 0.25 / 40.0);
        let inner = mean(|[x, y]| if x * x + y * y < 0.5 { 1.0 } else { 0.0 });
        assert!((inner - 0.5).abs() < 3.0 * 0.5 / 40.0);
    }

    #[test]
    fn a_track_is_where_the_camera_sees_the_ray() {
        let lens = Lens {
            radius_m: 0.02,
            inverse_focus: 1.0 / 1.3,
            pinhole: Pinhole {
                fx: 500.0,
                fy: 510.0,
                cx: 320.0,
                cy: 240.0,
            },
            n: 1,
            noise_threshold: 1.0,
            samples: Vec::new(),
        };
        let sample = LensSample {
            pixel: [0.2, -0.4],
            lens: [0.6, -0.7],
        };
        let (ray, track) = (lens.ray(400, 100, &sample), lens.track(400, 100, &sample));
        for z in [0.5, 1.3, 4.0] {
            let p = ray.origin + ray.direction * z;
            let (u, v) = lens.pinhole.project(p);
            let at = |k: usize| track.start[k] + track.step[k] / z;
            // A few roundings of numbers up to 640.
            assert!((at(0) - u).abs() < 3e-4 && (at(1) - v).abs() < 3e-4, "{z}");
            let distance = (u - 400.2).hypot(v - 99.6);
            assert!(distance <= lens.blur_px(z) + 3e-4);
        }
    }
}
