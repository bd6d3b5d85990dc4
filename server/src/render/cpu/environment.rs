//! Radiance from outside of what the camera sees.
//!
//! With an environment map in the scene it is the map. Without one it is guessed from the camera's
//! own picture, so that a mirror shows something with the room's colours instead of a void: the
//! picture, blurred, is laid over the hemisphere before the camera and mirrored to the one behind
//! it. A heuristic: colours are plausible, places are not.

use glam::{Mat3A, Vec3A};

use crate::frame::ColorImage;
use crate::numerics::linear_from_srgb;
use crate::scene::Environment;

/// The camera picture reduced to a few cells, and its irradiance.
#[derive(Debug, Clone, Default)]
pub(super) struct CameraEnvironment {
    cells: Vec<Vec3A>,
    irradiance: [Vec3A; 9],
}

impl CameraEnvironment {
    const WIDTH: usize = 64;
    const HEIGHT: usize = 48;

    /// Takes the colours of a new picture.
    pub(super) fn rebuild(&mut self, color: &ColorImage) {
        self.cells.clear();
        let (w, h) = (color.width as usize, color.height as usize);
        for cy in 0..Self::HEIGHT {
            let y0 = cy * h / Self::HEIGHT;
            let y1 = ((cy + 1) * h / Self::HEIGHT).clamp(y0 + 1, h.max(y0 + 1));
            for cx in 0..Self::WIDTH {
                let x0 = cx * w / Self::WIDTH;
                let x1 = ((cx + 1) * w / Self::WIDTH).clamp(x0 + 1, w.max(x0 + 1));
                let mut sum = Vec3A::ZERO;
                for y in y0..y1 {
                    for &[r, g, b, _] in &color.rgba[y * w + x0..y * w + x1] {
                        sum += Vec3A::new(linear_from_srgb(r), linear_from_srgb(g), linear_from_srgb(b));
                    }
                }
                self.cells.push(sum / ((x1 - x0) * (y1 - y0)) as f32);
            }
        }
        self.irradiance = irradiance_coefficients(|d| self.lookup(d));
    }

    /// Radiance from a unit direction in camera space.
    pub(super) fn lookup(&self, direction: Vec3A) -> Vec3A {
        // Orthographic: the unit disc of (x, y) covers both hemispheres without a seam.
        let x = (direction.x * 0.5 + 0.5) * (Self::WIDTH - 1) as f32;
        let y = (direction.y * 0.5 + 0.5) * (Self::HEIGHT - 1) as f32;
        let x = x.clamp(0.0, (Self::WIDTH - 1) as f32);
        let y = y.clamp(0.0, (Self::HEIGHT - 1) as f32);
        let (x0, y0) = ((x as usize).min(Self::WIDTH - 2), (y as usize).min(Self::HEIGHT - 2));
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let at = |dx: usize, dy: usize| self.cells[(y0 + dy) * Self::WIDTH + x0 + dx];
        at(0, 0).lerp(at(1, 0), fx).lerp(at(0, 1).lerp(at(1, 1), fx), fy)
    }
}

/// Where secondary rays that leave the sensed scene get their radiance.
#[derive(Clone, Copy)]
pub(super) enum Surroundings<'a> {
    /// Guessed from the camera's picture.
    Camera(&'a CameraEnvironment),
    /// The scene's map.
    Map {
        map: &'a Environment,
        world_from_camera: Mat3A,
        /// Irradiance coefficients, in map axes' world space; what lights taken from the map
        /// carry is already left out.
        irradiance: &'a [Vec3A; 9],
    },
}

impl Surroundings<'_> {
    /// Radiance from a unit direction in camera space.
    pub(super) fn radiance(&self, direction: Vec3A) -> Vec3A {
        match self {
            Self::Camera(camera) => camera.lookup(direction),
            Self::Map { map, world_from_camera, .. } => map.lookup((*world_from_camera * direction).into()).into(),
        }
    }

    /// Irradiance on a surface with unit normal `n`, camera space.
    pub(super) fn irradiance(&self, n: Vec3A) -> Vec3A {
        match self {
            Self::Camera(camera) => evaluate_irradiance(&camera.irradiance, n),
            Self::Map { world_from_camera, irradiance, .. } => evaluate_irradiance(irradiance, *world_from_camera * n),
        }
    }
}

/// Real spherical harmonics up to order 2 at a unit direction.
fn harmonics(d: Vec3A) -> [f32; 9] {
    let [x, y, z] = d.to_array();
    [
        0.282_095,
        0.488_603 * y,
        0.488_603 * z,
        0.488_603 * x,
        1.092_548 * x * y,
        1.092_548 * y * z,
        0.315_392 * (3.0 * z * z - 1.0),
        1.092_548 * x * z,
        0.546_274 * (x * x - y * y),
    ]
}

/// Projects radiance to order 2 and convolves it with the cosine lobe
/// (Ramamoorthi and Hanrahan 2001: factors pi, 2 pi / 3, pi / 4).
pub(super) fn irradiance_coefficients(radiance: impl Fn(Vec3A) -> Vec3A) -> [Vec3A; 9] {
    const ROWS: usize = 16;
    const COLUMNS: usize = 32;
    let mut coefficients = [Vec3A::ZERO; 9];
    for row in 0..ROWS {
        // Equal steps of height are equal areas on the sphere.
        let z = 1.0 - (row as f32 + 0.5) * (2.0 / ROWS as f32);
        let r = (1.0 - z * z).sqrt();
        for column in 0..COLUMNS {
            let phi = (column as f32 + 0.5) * (std::f32::consts::TAU / COLUMNS as f32);
            let d = Vec3A::new(r * phi.cos(), r * phi.sin(), z);
            let l = radiance(d);
            for (c, h) in coefficients.iter_mut().zip(harmonics(d)) {
                *c += l * h;
            }
        }
    }
    let solid_angle = 4.0 * std::f32::consts::PI / (ROWS * COLUMNS) as f32;
    let lobe = |i: usize| match i {
        0 => std::f32::consts::PI,
        1..=3 => 2.0 * std::f32::consts::PI / 3.0,
        _ => std::f32::consts::FRAC_PI_4,
    };
    std::array::from_fn(|i| coefficients[i] * (solid_angle * lobe(i)))
}

fn evaluate_irradiance(coefficients: &[Vec3A; 9], n: Vec3A) -> Vec3A {
    let mut sum = Vec3A::ZERO;
    for (c, h) in coefficients.iter().zip(harmonics(n)) {
        sum += *c * h;
    }
    // Order 2 rings below zero opposite a strong source.
    sum.max(Vec3A::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_even_picture_is_an_even_world() {
        let mut environment = CameraEnvironment::default();
        for (w, h) in [(640, 480), (1, 1), (65, 49), (7, 100)] {
            environment.rebuild(&ColorImage::filled(w, h, [188, 188, 188, 255]));
            let level = linear_from_srgb(188);
            for d in [Vec3A::X, -Vec3A::Y, Vec3A::Z, -Vec3A::Z, Vec3A::splat(0.577)] {
                assert!((environment.lookup(d).x - level).abs() < 1e-5);
                // A furnace: irradiance is pi times radiance whichever way one faces.
                let e = Surroundings::Camera(&environment).irradiance(d).x;
                assert!((e - std::f32::consts::PI * level).abs() < 2e-3, "{w}x{h} {d}: {e}");
            }
        }
    }

    #[test]
    fn irradiance_of_a_clamped_cosine_matches_its_integral() {
        // Radiance max(0, z) seen by a surface facing z: integral of cos^2 over the hemisphere, 2 pi / 3.
        let c = irradiance_coefficients(|d| Vec3A::splat(d.z.max(0.0)));
        let e = evaluate_irradiance(&c, Vec3A::Z).x;
        assert!((e - 2.0 * std::f32::consts::PI / 3.0).abs() < 0.03, "{e}");
        assert!(evaluate_irradiance(&c, -Vec3A::Z).x < 0.05);
    }
}
