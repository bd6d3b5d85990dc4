//! Environment maps: decoding, lookup, diffuse irradiance, and reduction to lights.
//!
//! The map is equirectangular; texel centres lie at half-integers of the grid, the middle
//! column looks along -z of the map's axes, columns run to the right, row 0 is straight up.

use std::f64::consts::{PI, TAU};
use std::path::Path;
use std::sync::Arc;

use glam::{DQuat, DVec3, Vec3};

use super::{Environment, LoadContext, openexr, radiance};

/// Largest file, bytes.
const MAX_BYTES: u64 = 512 << 20;

/// Most texels: 8192 x 4096.
const MAX_TEXELS: u64 = 1 << 25;

/// Largest radiance kept: ten times the sun's disc in an outdoor map whose sky is 1, and still far from overflow when
/// squared.
const MAX_RADIANCE: f32 = 1e8;

impl Environment {
    /// Reads a Radiance .hdr or an OpenEXR file. `world_from_map` rotates the map's axes to the world's. The second
    /// result contains notes on unusual content.
    pub fn load(
        path: &Path,
        intensity: f32,
        world_from_map: DQuat,
    ) -> Result<(Self, Vec<String>), String> {
        Self::load_with(&LoadContext::default(), path, intensity, world_from_map)
    }

    /// As [`Environment::load`], within a memory budget.
    pub fn load_with(
        context: &LoadContext,
        path: &Path,
        intensity: f32,
        world_from_map: DQuat,
    ) -> Result<(Self, Vec<String>), String> {
        let bytes = context.read(path, MAX_BYTES)?;
        let loaded = Self::decode_with(context, &bytes, intensity, world_from_map);
        drop(bytes);
        context.close_files();
        loaded
    }

    /// As [`Environment::load`], from memory.
    pub fn decode(
        bytes: &[u8],
        intensity: f32,
        world_from_map: DQuat,
    ) -> Result<(Self, Vec<String>), String> {
        Self::decode_with(&LoadContext::default(), bytes, intensity, world_from_map)
    }

    fn decode_with(
        context: &LoadContext,
        bytes: &[u8],
        intensity: f32,
        world_from_map: DQuat,
    ) -> Result<(Self, Vec<String>), String> {
        let mut scratch = context.scratch("an environment map, while it is decoded");
        let mut reserve = |width: u32, height: u32, working: u64| {
            let n_texels = u64::from(width) * u64::from(height);
            if n_texels == 0 || n_texels > MAX_TEXELS {
                return Err(format!(
                    "expected 1 to {MAX_TEXELS} texels, got {width}x{height}"
                ));
            }
            // Decoded texels and kept texels, three floats each.
            scratch
                .hold(12 * n_texels + working)
                .and_then(|()| context.keep(12 * n_texels, "an environment map"))
                .map_err(|error| error.to_string())
        };
        let picture = if bytes.starts_with(b"#?") {
            radiance::decode(bytes, |width, height| reserve(width, height, 0))
                .map_err(|problem| format!("cannot be decoded as Radiance .hdr: {problem}"))?
        } else if bytes.starts_with(&openexr::MAGIC) {
            openexr::decode(bytes, reserve)?
        } else {
            let got = match image::guess_format(bytes) {
                Ok(format) => format!("a picture in {format:?}, which has no radiance"),
                Err(_) => "something else".to_owned(),
            };
            return Err(format!(
                "expected a map in Radiance .hdr or OpenEXR, got {got}"
            ));
        };
        let (width, height) = (picture.width, picture.height);
        let mut n_clamped = 0usize;
        let radiance: Vec<Vec3> = picture
            .texels
            .iter()
            .map(|decoded| {
                let texel = decoded.map(|c| {
                    // NaN becomes 0.
                    if c > 0.0 { c.min(MAX_RADIANCE) } else { 0.0 }
                });
                n_clamped += usize::from(texel != *decoded);
                Vec3::from(texel) * intensity
            })
            .collect();
        let mut notes = picture.notes;
        if n_clamped > 0 {
            notes.push(format!(
                "{n_clamped} texels were not finite, negative or over {MAX_RADIANCE:e}, and were clamped"
            ));
        }
        if u64::from(width) != 2 * u64::from(height) {
            notes.push(format!(
                "expected a map twice as wide as high, got {width}x{height}"
            ));
        }
        let environment = Self {
            width,
            height,
            radiance: Arc::new(radiance),
            world_from_map,
        };
        Ok((environment, notes))
    }

    /// Radiance arriving from a direction (world axes, any length), bilinear.
    pub fn lookup(&self, direction_world: Vec3) -> Vec3 {
        let d = self.world_from_map.as_quat().conjugate() * direction_world;
        let Some(d) = d.try_normalize() else {
            return Vec3::ZERO;
        };
        let u = 0.5 + d.x.atan2(-d.z) / std::f32::consts::TAU;
        let v = d.y.clamp(-1.0, 1.0).acos() / std::f32::consts::PI;
        let x = u * self.width as f32 - 0.5;
        let y = v * self.height as f32 - 0.5;
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let texel = |dx: i64, dy: i64| {
            let tx = (x0 as i64 + dx).rem_euclid(i64::from(self.width)) as usize;
            let ty = (y0 as i64 + dy).clamp(0, i64::from(self.height) - 1) as usize;
            self.radiance[ty * self.width as usize + tx]
        };
        let top = texel(0, 0).lerp(texel(1, 0), fx);
        let bottom = texel(0, 1).lerp(texel(1, 1), fx);
        top.lerp(bottom, fy)
    }

    /// Mean radiance over the sphere.
    pub fn mean_radiance(&self) -> Vec3 {
        let mut sum = DVec3::ZERO;
        for row in 0..self.height {
            let row_sum: DVec3 = self.row(row).iter().map(|l| l.as_dvec3()).sum();
            sum += row_sum * self.solid_angle(row);
        }
        (sum / (4.0 * PI)).as_vec3()
    }

    /// The map's spherical harmonics up to order 2. Takes one pass over the map, so compute it once per scene.
    pub fn harmonics(&self) -> Harmonics {
        self.harmonics_of(|radiance| radiance)
    }

    /// Texels of one row.
    pub(super) fn row(&self, row: u32) -> &[Vec3] {
        let width = self.width as usize;
        &self.radiance[row as usize * width..][..width]
    }

    /// Solid angle of one texel of a row, steradians; exact.
    pub(super) fn solid_angle(&self, row: u32) -> f64 {
        let edge = |row: u32| (PI * f64::from(row) / f64::from(self.height)).cos();
        TAU / f64::from(self.width) * (edge(row) - edge(row + 1))
    }

    /// Direction of a texel's centre, world axes.
    pub(super) fn direction(&self, column: u32, row: u32) -> DVec3 {
        let phi = TAU * ((f64::from(column) + 0.5) / f64::from(self.width) - 0.5);
        let theta = PI * (f64::from(row) + 0.5) / f64::from(self.height);
        let d = DVec3::new(
            theta.sin() * phi.sin(),
            theta.cos(),
            -theta.sin() * phi.cos(),
        );
        self.world_from_map * d
    }

    /// Spherical harmonics of a function of the map's radiance.
    pub(super) fn harmonics_of(&self, mut f: impl FnMut(DVec3) -> DVec3) -> Harmonics {
        let mut coefficients = [DVec3::ZERO; 9];
        for row in 0..self.height {
            let solid_angle = self.solid_angle(row);
            for (column, radiance) in self.row(row).iter().enumerate() {
                let flux = f(radiance.as_dvec3()) * solid_angle;
                let basis = basis(self.direction(column as u32, row));
                for (sum, y) in coefficients.iter_mut().zip(basis) {
                    *sum += flux * y;
                }
            }
        }
        Harmonics {
            coefficients: coefficients.map(|c| c.as_vec3()),
        }
    }
}

/// Real spherical harmonics of order 0 to 2 at a unit direction, in the order
/// (0,0) (1,-1) (1,0) (1,1) (2,-2) (2,-1) (2,0) (2,1) (2,2).
pub(crate) fn basis(d: DVec3) -> [f64; 9] {
    let DVec3 { x, y, z } = d;
    let k0 = (1.0 / (4.0 * PI)).sqrt();
    let k1 = (3.0 / (4.0 * PI)).sqrt();
    let k2 = (15.0 / (4.0 * PI)).sqrt();
    [
        k0,
        k1 * y,
        k1 * z,
        k1 * x,
        k2 * x * y,
        k2 * y * z,
        k2 / 12f64.sqrt() * (3.0 * z * z - 1.0),
        k2 * x * z,
        k2 / 2.0 * (x * x - y * y),
    ]
}

/// Radiance over the sphere as spherical harmonics of order 2: enough for the irradiance of
/// diffuse surfaces to about 1 % on average (Ramamoorthi and Hanrahan 2001, "An Efficient
/// Representation for Irradiance Environment Maps").
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Harmonics {
    /// Per channel, world axes.
    pub coefficients: [Vec3; 9],
}

impl Harmonics {
    /// Irradiance on a surface with the given unit normal (world axes); never negative.
    pub fn irradiance(&self, normal_world: Vec3) -> Vec3 {
        // Harmonics of the clamped cosine (their equations 8 and 9).
        const A: [f64; 3] = [PI, 2.0 * PI / 3.0, PI / 4.0];
        const ORDER: [usize; 9] = [0, 1, 1, 1, 2, 2, 2, 2, 2];
        let basis = basis(normal_world.as_dvec3());
        let sum: DVec3 = (0..9)
            .map(|i| self.coefficients[i].as_dvec3() * (A[ORDER[i]] * basis[i]))
            .sum();
        sum.max(DVec3::ZERO).as_vec3()
    }

    /// Mean radiance over the sphere.
    pub fn mean_radiance(&self) -> Vec3 {
        self.coefficients[0] * (1.0 / (4.0 * PI)).sqrt() as f32
    }

    /// Integral of radiance times direction over the sphere: net flux, per channel.
    pub fn net_flux(&self) -> [DVec3; 3] {
        let k1 = (3.0 / (4.0 * PI)).sqrt();
        let [_, y, z, x, ..] = self.coefficients.map(|c| c.as_dvec3());
        std::array::from_fn(|c| DVec3::new(x[c], y[c], z[c]) / k1)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A map painted by a function of direction.
    pub(in super::super) fn painted(
        height: u32,
        world_from_map: DQuat,
        paint: impl Fn(DVec3) -> Vec3,
    ) -> Environment {
        let mut environment = Environment {
            width: 2 * height,
            height,
            radiance: Arc::new(Vec::new()),
            world_from_map,
        };
        let mut texels = Vec::new();
        for row in 0..height {
            for column in 0..2 * height {
                texels.push(paint(environment.direction(column, row)));
            }
        }
        environment.radiance = Arc::new(texels);
        environment
    }

    /// Irradiance as a sum over every texel.
    pub(in super::super) fn brute_force(environment: &Environment, normal: DVec3) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for row in 0..environment.height {
            for (column, radiance) in environment.row(row).iter().enumerate() {
                let cosine = environment
                    .direction(column as u32, row)
                    .dot(normal)
                    .max(0.0);
                sum += radiance.as_dvec3() * (cosine * environment.solid_angle(row));
            }
        }
        sum
    }

    pub(in super::super) fn directions() -> impl Iterator<Item = DVec3> {
        (0..40).map(|i| {
            // Points spread over the sphere along a spiral.
            let y = 1.0 - (f64::from(i) + 0.5) / 20.0;
            let phi = f64::from(i) * 2.399_963;
            let r = (1.0 - y * y).sqrt();
            DVec3::new(r * phi.cos(), y, r * phi.sin())
        })
    }

    #[test]
    fn axes_are_as_documented() {
        let environment = painted(64, DQuat::IDENTITY, |d| d.as_vec3());
        for d in directions() {
            // The painted function is linear, so bilinear lookup is off only by the curvature of the texel grid.
            let error = environment.lookup(d.as_vec3() * 3.0) - d.as_vec3();
            assert!(error.length() < 2e-3, "{d}: {error}");
        }
        assert_eq!(
            environment.direction(63, 0).y,
            environment.direction(0, 0).y
        );
        assert!(
            environment.direction(63, 31).z < -0.99,
            "the middle looks along -z"
        );
        assert!(
            environment.direction(96, 31).x > 0.99,
            "columns run to the right"
        );
        let turned = painted(64, DQuat::from_rotation_x(1.0), |d| d.as_vec3());
        assert!((turned.lookup(Vec3::Y) - Vec3::Y).length() < 2e-3);
        assert_eq!(turned.lookup(Vec3::ZERO), Vec3::ZERO);
        assert!(turned.lookup(Vec3::NAN).is_finite());
    }

    #[test]
    fn solid_angles_fill_the_sphere() {
        let environment = painted(32, DQuat::IDENTITY, |_| Vec3::new(1.0, 2.0, 0.0));
        assert!((environment.mean_radiance() - Vec3::new(1.0, 2.0, 0.0)).length() < 1e-6);
        let mean = environment.harmonics().mean_radiance();
        assert!((mean - Vec3::new(1.0, 2.0, 0.0)).length() < 1e-5);
    }

    #[test]
    fn harmonics_are_exact_for_what_they_can_hold() {
        // A function that is quadratic in the direction is represented exactly; the remaining error is that of the
        // sums.
        let environment = painted(64, DQuat::from_rotation_z(0.4), |d| {
            Vec3::new(
                (1.0 + 0.5 * d.x) as f32,
                (1.0 + 0.3 * d.y * d.z) as f32,
                (d.x * d.x) as f32,
            )
        });
        let harmonics = environment.harmonics();
        for normal in directions() {
            let exact = brute_force(&environment, normal);
            let error = harmonics.irradiance(normal.as_vec3()).as_dvec3() - exact;
            assert!(error.length() < 5e-3 * exact.length(), "{normal}: {error}");
        }
    }

    #[test]
    fn harmonics_are_near_for_a_room_with_a_window() {
        let environment = painted(64, DQuat::IDENTITY, |d| {
            let window = d.dot(DVec3::new(0.6, 0.64, 0.48)) > 0.9;
            Vec3::splat(if window { 8.0 } else { 0.5 + 0.3 * d.y as f32 })
        });
        let harmonics = environment.harmonics();
        let mean = environment.mean_radiance().x * std::f32::consts::PI;
        let mut worst = 0.0f32;
        for normal in directions() {
            let exact = brute_force(&environment, normal).x as f32;
            worst = worst.max((harmonics.irradiance(normal.as_vec3()).x - exact).abs() / mean);
        }
        // The paper's bound for any lighting is 9 % of the mean at worst for a far light.
        assert!(worst < 0.12, "{worst}");
    }

    #[test]
    fn hdr_bytes_are_decoded_and_damage_is_an_error() {
        let mut bytes = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n".to_vec();
        bytes.extend([128, 64, 0, 129, 255, 255, 255, 255]);
        let (environment, notes) = Environment::decode(&bytes, 2.0, DQuat::IDENTITY).unwrap();
        assert_eq!((environment.width, environment.height), (2, 1));
        assert_eq!(environment.radiance[0], Vec3::new(2.0, 1.0, 0.0));
        assert_eq!(environment.radiance[1], Vec3::splat(2.0 * MAX_RADIANCE));
        assert!(notes[0].starts_with("1 texels"), "{notes:?}");
        for n in 0..bytes.len() {
            assert!(
                Environment::decode(&bytes[..n], 1.0, DQuat::IDENTITY).is_err(),
                "{n}"
            );
        }
        let huge = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 99999 +X 99999\n";
        let error = Environment::decode(huge, 1.0, DQuat::IDENTITY).unwrap_err();
        assert!(error.contains("99999x99999"), "{error}");
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(tail in prop::collection::vec(any::<u8>(), 0..300), headed: bool) {
            let mut bytes = Vec::new();
            if headed {
                bytes.extend(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 8 +X 16\n");
            }
            bytes.extend(tail);
            let _ = Environment::decode(&bytes, 1.0, DQuat::IDENTITY);
        }
    }
}
