//! Renders the camera's view: colour from the baked light, and exact depth.

use glam::{DVec3, Vec3};

use super::geometry::{Material, SurfacePoint};
use super::light::{OFFSET_M, RoomLight, basis, irradiance};
use super::room::Room;
use ghostlight::camera::{Intrinsics, Pose};
use ghostlight::numerics::{radical_inverse, srgb_from_linear, uniform};

/// Factor from radiance, W/(m2 sr), to the linear value of a pixel, 0..=1.
pub(super) const EXPOSURE: f32 = 0.062;

/// Standard deviation of a pixel's noise at linear value x: `sqrt(READ^2 + SHOT x)`, about one 8-bit code in
/// mid-grey, like a webcam after its own denoising.
const READ_NOISE: f32 = 0.0004;
const SHOT_NOISE: f32 = 2e-6;

/// Brighter samples are clamped to this before they are averaged, so that one glint does not fill a pixel;
/// display white is 1.
const GLINT: f32 = 4.0;

/// The lit room.
pub(super) struct Lit<'a> {
    /// Geometry and lights.
    pub(super) room: &'a Room,
    /// Irradiance per site.
    pub(super) baked: &'a [Vec3],
}

/// A camera pose with intrinsics.
pub(super) struct View {
    /// Of the camera.
    pub(super) intrinsics: Intrinsics,
    /// World from camera.
    pub(super) pose: Pose,
}

impl View {
    /// World direction through pixel (u, v), scaled to depth 1, so that the ray parameter is depth.
    pub(super) fn ray(&self, u: f64, v: f64) -> DVec3 {
        self.pose.rotation * self.intrinsics.unproject(u, v, 1.0)
    }
}

impl Lit<'_> {
    /// Radiance of a surface's diffuse reflection.
    fn diffuse(&self, material: &Material, p: &SurfacePoint) -> Vec3 {
        let colour = material.pattern.colour(p.uv, p.m);
        match material.emission {
            Some(emission) => colour * emission,
            None => colour * irradiance(self.baked, &p.weights) * std::f32::consts::FRAC_1_PI,
        }
    }

    /// Radiance along a mirrored ray; `balls` says whether it includes sphere lights that are not surfaces (on
    /// rough surfaces [`Self::highlights`] counts them).
    fn mirrored(&self, origin: DVec3, direction: DVec3, balls: bool) -> Vec3 {
        let geometry = &self.room.geometry;
        let hit = geometry
            .caster
            .intersect(origin, direction, 0.0, f64::INFINITY);
        let reach = hit.map_or(f64::INFINITY, |hit| hit.t);
        if balls {
            for light in &self.room.lights {
                if let RoomLight::Sphere {
                    centre,
                    radius,
                    intensity,
                    in_room: false,
                    ..
                } = *light
                {
                    let along = (centre - origin).dot(direction);
                    let near2 = (centre - origin).length_squared() - along * along;
                    if along > 0.0 && along < reach && near2 < radius * radius {
                        return intensity / (std::f64::consts::PI * radius * radius) as f32;
                    }
                }
            }
        }
        let Some(hit) = hit else { return Vec3::ZERO };
        let material = geometry.material(&hit);
        let p = geometry.surface(&hit, origin + direction * hit.t);
        self.diffuse(material, &p)
    }

    /// Highlights of sphere lights on a rough surface: a lobe around the mirror direction, widened by the light's
    /// own size with its energy kept (Karis 2013).
    fn highlights(&self, p: &SurfacePoint, normal: DVec3, mirror: DVec3, gloss_rad: f32) -> Vec3 {
        let mut sum = Vec3::ZERO;
        for light in &self.room.lights {
            let RoomLight::Sphere {
                centre,
                radius,
                intensity,
                ..
            } = *light
            else {
                continue;
            };
            let to = centre - p.position;
            let distance = to.length();
            let direction = to / distance;
            let spread = f64::from(gloss_rad).hypot(0.5 * radius / distance);
            let away = direction.angle_between(mirror);
            if away > 4.0 * spread || direction.dot(normal) <= 0.0 {
                continue;
            }
            let origin = p.position + p.normal * OFFSET_M;
            if self
                .room
                .geometry
                .caster
                .occluded(origin, direction, 0.0, distance - radius * 1.02)
            {
                continue;
            }
            let lobe =
                (-0.5 * (away / spread).powi(2)).exp() / (std::f64::consts::TAU * spread * spread);
            sum += intensity * (lobe / (distance * distance)) as f32;
        }
        sum
    }

    /// Radiance along a camera ray.
    ///
    /// `sample` holds the pixel, the sample's index and the number of samples.
    fn radiance(&self, origin: DVec3, direction: DVec3, sample: [u32; 3]) -> Vec3 {
        let geometry = &self.room.geometry;
        let Some(hit) = geometry
            .caster
            .intersect(origin, direction, 0.0, f64::INFINITY)
        else {
            return Vec3::ZERO;
        };
        let material = geometry.material(&hit);
        let p = geometry.surface(&hit, origin + direction * hit.t);
        let diffuse = self.diffuse(material, &p);
        if material.f0 == 0.0 {
            return diffuse;
        }
        let view = direction.normalize_or_zero();
        let normal = if p.shading_normal.dot(view) < 0.0 {
            p.shading_normal
        } else {
            p.normal
        };
        let cos = -normal.dot(view);
        let mirror = view + normal * (2.0 * cos);
        // Schlick's approximation, with a reduced rise at grazing angles on rough surfaces.
        let grazing = (1.0 - 2.5 * material.gloss_rad).max(material.f0);
        let fresnel = material.f0
            + (grazing - material.f0).max(0.0) * (1.0 - cos.clamp(0.0, 1.0) as f32).powi(5);
        let rough = material.gloss_rad > 0.02;
        let mut direction = mirror;
        if material.gloss_rad > 0.0 {
            // A Gaussian lobe (Box and Muller). The samples of a pixel are a Hammersley set, rotated per pixel.
            let [pixel, index, count] = sample;
            let a = (index as f32 + uniform(pixel, 0, index)) / count as f32;
            let turn = uniform(pixel, 1, 0);
            let b = radical_inverse(index) + turn;
            let r = f64::from(material.gloss_rad) * f64::from(-2.0 * (1.0 - a).ln()).sqrt();
            let (s, c) = (std::f64::consts::TAU * f64::from(b)).sin_cos();
            let (x, y) = basis(mirror);
            direction = (mirror + x * (r * c) + y * (r * s)).normalize_or_zero();
        }
        let mut gloss = Vec3::ZERO;
        if direction.dot(p.normal) > 0.0 {
            let seen = self.mirrored(p.position + p.normal * OFFSET_M, direction, !rough);
            gloss += if rough {
                seen.min(Vec3::splat(GLINT / EXPOSURE))
            } else {
                seen
            };
        }
        if rough {
            gloss += self.highlights(&p, normal, mirror, material.gloss_rad);
        }
        diffuse * (1.0 - fresnel) + gloss * fresnel
    }

    /// One row of 8-bit sRGB. `side` is the side of the grid of rays per pixel.
    pub(super) fn color_row(&self, view: &View, row: u32, side: u32, frame: u32) -> Vec<[u8; 3]> {
        let origin = view.pose.translation;
        let width = view.intrinsics.width;
        (0..width)
            .map(|column| {
                let pixel = row * width + column;
                let mut sum = Vec3::ZERO;
                for j in 0..side {
                    for i in 0..side {
                        let inside = |k: u32| (f64::from(k) + 0.5) / f64::from(side) - 0.5;
                        let direction =
                            view.ray(f64::from(column) + inside(i), f64::from(row) + inside(j));
                        // The lobe's samples depend on the pixel, not on the frame: static noise compresses well,
                        // and changing noise would look like a flickering light.
                        let light =
                            self.radiance(origin, direction, [pixel, j * side + i, side * side]);
                        sum += (light * EXPOSURE).min(Vec3::splat(GLINT));
                    }
                }
                let mean = sum / (side * side) as f32;
                let mut code = [0; 3];
                for (channel, code) in code.iter_mut().enumerate() {
                    let x = mean[channel];
                    let dimension = 1_000 + channel as u32 * 2;
                    let noise = gaussian(pixel, frame, dimension)
                        * (READ_NOISE * READ_NOISE + SHOT_NOISE * x.max(0.0)).sqrt();
                    *code = srgb_from_linear(x + noise);
                }
                code
            })
            .collect()
    }
}

/// A standard normal deviate (Box and Muller).
pub(super) fn gaussian(pixel: u32, frame: u32, dimension: u32) -> f32 {
    let (a, b) = (
        1.0 - uniform(pixel, frame, dimension),
        uniform(pixel, frame, dimension + 1),
    );
    (-2.0 * a.ln()).sqrt() * (std::f32::consts::TAU * b).cos()
}
