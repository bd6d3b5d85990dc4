//! Radiance from outside the camera's view.
//!
//! If the scene has an environment map, this is the map. Otherwise it is estimated from the camera's own picture,
//! so that a mirror shows the room's colours instead of black: the blurred picture is mapped onto the hemisphere
//! in front of the camera and mirrored to the one behind it. A heuristic: colours are plausible, positions are
//! not.

use glam::{DVec3, Mat3A, Vec3A};

use crate::frame::ColorImage;
use crate::numerics::linear_from_srgb;
use crate::render::threads::Workers;
use crate::scene::{Environment, Harmonics, basis};

use super::map_levels::{MapLevels, dimmed, direction_of, middle, square_of};

/// The camera's picture reduced to a few cells, and its irradiance.
#[derive(Debug, Clone, Default)]
pub(crate) struct CameraEnvironment {
    cells: Vec<Vec3A>,
    harmonics: Harmonics,
}

impl CameraEnvironment {
    const WIDTH: usize = 64;
    const HEIGHT: usize = 48;

    /// Computes the cells of a new picture; rows in parallel.
    pub(crate) fn rebuild(&mut self, color: &ColorImage, workers: Workers<'_>) {
        let (w, h) = (color.width as usize, color.height as usize);
        self.cells.resize(Self::WIDTH * Self::HEIGHT, Vec3A::ZERO);
        let rows = self.cells.chunks_mut(Self::WIDTH).enumerate();
        workers.for_each(rows, |(cy, cells)| {
            let y0 = cy * h / Self::HEIGHT;
            let y1 = ((cy + 1) * h / Self::HEIGHT).clamp(y0 + 1, h.max(y0 + 1));
            for (cx, cell) in cells.iter_mut().enumerate() {
                let x0 = cx * w / Self::WIDTH;
                let x1 = ((cx + 1) * w / Self::WIDTH).clamp(x0 + 1, w.max(x0 + 1));
                // Reads every second pixel of every second row, which is enough for the mean of a cell.
                let mut sum = Vec3A::ZERO;
                for y in (y0..y1).step_by(2) {
                    let row = &color.rgba[y * w + x0..y * w + x1];
                    for &[r, g, b, _] in row.iter().step_by(2) {
                        sum += Vec3A::new(
                            linear_from_srgb(r),
                            linear_from_srgb(g),
                            linear_from_srgb(b),
                        );
                    }
                }
                let n = (x1 - x0).div_ceil(2) * (y1 - y0).div_ceil(2);
                *cell = sum / n as f32;
            }
        });
        self.harmonics = project(|d| self.lookup(d));
    }

    /// Radiance from a unit direction in camera space.
    pub(crate) fn lookup(&self, direction: Vec3A) -> Vec3A {
        // Orthographic mapping: the unit disc of (x, y) covers both hemispheres without a seam.
        let x = (direction.x * 0.5 + 0.5) * (Self::WIDTH - 1) as f32;
        let y = (direction.y * 0.5 + 0.5) * (Self::HEIGHT - 1) as f32;
        let x = x.clamp(0.0, (Self::WIDTH - 1) as f32);
        let y = y.clamp(0.0, (Self::HEIGHT - 1) as f32);
        let (x0, y0) = (
            (x as usize).min(Self::WIDTH - 2),
            (y as usize).min(Self::HEIGHT - 2),
        );
        let (fx, fy) = (x - x0 as f32, y - y0 as f32);
        let at = |dx: usize, dy: usize| self.cells[(y0 + dy) * Self::WIDTH + x0 + dx];
        at(0, 0)
            .lerp(at(1, 0), fx)
            .lerp(at(0, 1).lerp(at(1, 1), fx), fy)
    }
}

/// Radiance by direction, on the faces of an octahedron as in [`super::map_levels`].
#[derive(Debug, Clone)]
pub(crate) struct CoarseMap {
    texels: Vec<Vec3A>,
}

impl CoarseMap {
    /// Texels per side: about the resolution of its source.
    const SIDE: usize = 48;

    /// Computed from a map that is smooth already.
    pub(crate) fn new(map: &Environment) -> Self {
        let at = |i: usize| middle(i, Self::SIDE);
        let texel = |i: usize| {
            let direction = direction_of(at(i % Self::SIDE), at(i / Self::SIDE));
            map.lookup(direction.into()).into()
        };
        Self {
            texels: (0..Self::SIDE * Self::SIDE).map(texel).collect(),
        }
    }

    /// Radiance from a direction of any length, world axes.
    pub(crate) fn lookup(&self, d: Vec3A) -> Vec3A {
        let (x, y) = square_of(d);
        // NaN becomes 0.
        let cell = |x: f32| ((x + 1.0) * (0.5 * Self::SIDE as f32)) as usize;
        let (x, y) = (cell(x).min(Self::SIDE - 1), cell(y).min(Self::SIDE - 1));
        self.texels[y * Self::SIDE + x]
    }
}

/// The source of radiance for secondary rays that leave the sensed scene.
#[derive(Clone, Copy)]
pub(crate) enum Surroundings<'a> {
    /// Estimated from the camera's picture.
    Camera(&'a CameraEnvironment),
    /// The scene's environment map.
    Map {
        map: &'a Environment,
        world_from_camera: Mat3A,
        /// World axes; without the light of lamps extracted from the map.
        ambient: &'a Harmonics,
        /// The same light by direction, at a coarse resolution.
        coarse: &'a CoarseMap,
        /// Levels of the map for filtered look-ups.
        levels: &'a MapLevels,
        /// Luminance above which radiance belongs to lamps extracted from the map.
        threshold: f32,
    },
}

impl Surroundings<'_> {
    /// Radiance from a unit direction in camera space.
    pub(crate) fn radiance(&self, direction: Vec3A) -> Vec3A {
        match self {
            Self::Camera(camera) => camera.lookup(direction),
            Self::Map {
                map,
                world_from_camera,
                ..
            } => map.lookup((*world_from_camera * direction).into()).into(),
        }
    }

    /// Mean radiance over `angle` radians around a unit direction in camera space, without lamps extracted from
    /// the map. The estimate from the camera is already blurred.
    pub(crate) fn radiance_without_lamps(&self, direction: Vec3A, angle: f32) -> Vec3A {
        match *self {
            Self::Camera(camera) => camera.lookup(direction),
            Self::Map {
                map,
                levels,
                world_from_camera,
                threshold,
                ..
            } => {
                let direction = world_from_camera * direction;
                let sharp = || dimmed(map.lookup(direction.into()).into(), threshold);
                levels.lookup(direction, angle, sharp)
            }
        }
    }

    /// Radiance without lamps from a unit direction in camera space; coarse.
    pub(crate) fn ambient_radiance(&self, direction: Vec3A) -> Vec3A {
        match self {
            Self::Camera(camera) => camera.lookup(direction),
            Self::Map {
                coarse,
                world_from_camera,
                ..
            } => coarse.lookup(*world_from_camera * direction),
        }
    }

    /// Irradiance on a surface with unit normal `n`, camera space.
    pub(crate) fn irradiance(&self, n: Vec3A) -> Vec3A {
        match self {
            Self::Camera(camera) => camera.harmonics.irradiance(n.into()).into(),
            Self::Map {
                world_from_camera,
                ambient,
                ..
            } => ambient.irradiance((*world_from_camera * n).into()).into(),
        }
    }
}

/// Spherical harmonics of radiance given by direction, from uniform samples of the sphere; sufficient for smooth
/// radiance.
fn project(radiance: impl Fn(Vec3A) -> Vec3A) -> Harmonics {
    const ROWS: usize = 64;
    const COLUMNS: usize = 32;
    let mut sums = [DVec3::ZERO; 9];
    for row in 0..ROWS {
        // Equal steps of height have equal areas on the sphere.
        let z = 1.0 - (row as f32 + 0.5) * (2.0 / ROWS as f32);
        let r = (1.0 - z * z).sqrt();
        for column in 0..COLUMNS {
            let phi = (column as f32 + 0.5) * (std::f32::consts::TAU / COLUMNS as f32);
            let d = Vec3A::new(r * phi.cos(), r * phi.sin(), z);
            let l = radiance(d).as_dvec3();
            for (sum, y) in sums.iter_mut().zip(basis(d.as_dvec3())) {
                *sum += l * y;
            }
        }
    }
    let solid_angle = 4.0 * std::f64::consts::PI / (ROWS * COLUMNS) as f64;
    Harmonics {
        coefficients: sums.map(|sum| (sum * solid_angle).as_vec3()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::threads::with_workers;

    #[test]
    fn an_even_picture_is_an_even_world() {
        let mut environment = CameraEnvironment::default();
        for (w, h) in [(640, 480), (1, 1), (65, 49), (7, 100)] {
            let color = ColorImage::filled(w, h, [188, 188, 188, 255]);
            with_workers(2, |workers| environment.rebuild(&color, workers));
            let level = linear_from_srgb(188);
            for d in [
                Vec3A::X,
                -Vec3A::Y,
                Vec3A::Z,
                -Vec3A::Z,
                Vec3A::splat(0.577),
            ] {
                assert!((environment.lookup(d).x - level).abs() < 1e-5);
                // A furnace: irradiance is pi times radiance for every normal.
                let e = Surroundings::Camera(&environment).irradiance(d).x;
                assert!(
                    (e - std::f32::consts::PI * level).abs() < 2e-3,
                    "{w}x{h} {d}: {e}"
                );
            }
        }
    }

    #[test]
    fn irradiance_of_a_clamped_cosine_matches_its_integral() {
        // Radiance max(0, z) seen by a surface facing z: integral of cos^2 over the hemisphere, 2 pi / 3.
        let harmonics = project(|d| Vec3A::splat(d.z.max(0.0)));
        let e = harmonics.irradiance(glam::Vec3::Z).x;
        assert!((e - 2.0 * std::f32::consts::PI / 3.0).abs() < 0.03, "{e}");
        assert!(harmonics.irradiance(-glam::Vec3::Z).x < 0.05);
    }
}
