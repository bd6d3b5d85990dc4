//! What a surface does with light: emits, diffuses, reflects, lets through; and the rays it sends on.

use glam::Vec3A;

use crate::numerics::uniform;

use super::FrameContext;
use super::bsdf::{f0_of_ior, fresnel_dielectric, fresnel_schlick, ggx, refract, sample_ggx};
use super::light::CameraLight;
use super::path::{MIN_THROUGHPUT, Path, seed};
use super::surface::Surface;

/// Roughness under which a surface is traced as a perfect mirror: its GGX lobe is then narrower
/// than a pixel of a curved object's reflection.
pub(super) const MIRROR_ROUGHNESS: f32 = 0.06;

impl FrameContext<'_> {
    /// Whether mirror rays leave this surface.
    pub(super) fn is_specular(&self, surface: &Surface) -> bool {
        let material = &self.materials[surface.material as usize];
        surface.metallic > 0.0 || material.transmission > 0.0 || surface.roughness < 0.5
    }

    /// Reflectance at normal incidence.
    pub(super) fn f0(&self, surface: &Surface) -> Vec3A {
        let dielectric = Vec3A::splat(f0_of_ior(self.materials[surface.material as usize].ior));
        dielectric.lerp(surface.base_color, surface.metallic)
    }

    /// Emitted, diffused and glossily reflected light of lights, times `throughput`.
    /// `share` of direct light arrives.
    pub(super) fn direct(&self, surface: &Surface, share: Vec3A, throughput: Vec3A) -> Vec3A {
        let material = &self.materials[surface.material as usize];
        let mut sum = surface.emissive;
        let albedo =
            surface.base_color * ((1.0 - surface.metallic) * (1.0 - material.transmission));
        let n_dot_v = -surface.incoming.dot(surface.normal);
        let f0 = self.f0(surface);
        // What the boundary reflects cannot also enter and be diffused.
        let entering = Vec3A::ONE - fresnel_schlick(f0, n_dot_v);
        let diffuse = albedo * entering * std::f32::consts::FRAC_1_PI;
        if diffuse != Vec3A::ZERO {
            sum += diffuse * self.surroundings.irradiance(surface.normal);
            sum += diffuse * self.photon_irradiance(surface);
        }
        let glossy = surface.roughness >= MIRROR_ROUGHNESS;
        if share != Vec3A::ZERO && (glossy || diffuse != Vec3A::ZERO) {
            for light in self.lights {
                let (to_light, e) = light.illuminate(surface.position);
                let n_dot_l = surface.normal.dot(to_light);
                if n_dot_l <= 0.0 {
                    continue;
                }
                let e = e * n_dot_l * share;
                sum += diffuse * e;
                if glossy && n_dot_v > 0.0 {
                    sum += self.highlight(surface, light, to_light, f0, n_dot_v, n_dot_l) * e;
                }
            }
        }
        sum * throughput
    }

    /// Glossy reflection of a light per irradiance on the surface.
    pub(super) fn highlight(
        &self,
        surface: &Surface,
        light: &CameraLight,
        to_light: Vec3A,
        f0: Vec3A,
        n_dot_v: f32,
        n_dot_l: f32,
    ) -> Vec3A {
        let alpha = surface.roughness * surface.roughness;
        // A light with an extent widens the lobe (Karis 2013, representative point).
        let half_angle = match *light {
            CameraLight::Sphere { center, radius, .. } => {
                radius
                    / (center - surface.position)
                        .length()
                        .max(radius.max(f32::MIN_POSITIVE))
            }
            CameraLight::Directional { tan_radius, .. } => tan_radius,
        };
        let widened = (alpha + 0.5 * half_angle).min(1.0);
        let energy = (alpha / widened) * (alpha / widened);
        let Some(h) = (to_light - surface.incoming).try_normalize() else {
            return Vec3A::ZERO;
        };
        let f = fresnel_schlick(f0, to_light.dot(h).max(0.0));
        f * (ggx(n_dot_v, n_dot_l, surface.normal.dot(h).max(0.0), widened) * energy)
    }

    /// Sends the first rays from what a primary ray met; where none are allowed, returns what stands
    /// for them.
    pub(super) fn start(
        &self,
        surface: &Surface,
        place: usize,
        weight: f32,
        queue: &mut Vec<Path>,
    ) -> Vec3A {
        if self.settings.max_bounces == 0 {
            return self.last_bounce(surface) * weight;
        }
        let path = seed(surface, place, weight, false);
        self.scatter(surface, &path, 0, self.settings.glossy_samples, queue);
        Vec3A::ZERO
    }

    /// Sends the reflected and refracted rays of a path that met `surface` after `depth` bounces;
    /// `glossy` of them where it reflects all light roughly.
    pub(super) fn scatter(
        &self,
        surface: &Surface,
        path: &Path,
        depth: u32,
        glossy: u32,
        queue: &mut Vec<Path>,
    ) {
        let material = &self.materials[surface.material as usize];
        let n_dot_v = (-surface.incoming.dot(surface.normal)).clamp(0.0, 1.0);
        let mut push = |direction: Vec3A, share: Vec3A, sees_lights: bool| {
            let throughput = path.throughput * share;
            if throughput.max_element() >= MIN_THROUGHPUT && throughput.is_finite() {
                queue.push(Path {
                    origin: surface.leave(direction),
                    direction,
                    throughput,
                    sees_lights,
                    ..*path
                });
            }
        };
        if material.transmission > 0.0 {
            // Dielectric boundary: both rays (HQ-AR, section 3), by Fresnel's equations.
            let eta = if surface.front || material.thin {
                material.ior
            } else {
                1.0 / material.ior
            };
            let r = fresnel_dielectric(n_dot_v, eta);
            // A thin sheet's two faces reflect back and forth: 2R / (1 + R) in all.
            let r = if material.thin {
                2.0 * r / (1.0 + r)
            } else {
                r
            };
            push(surface.mirror(), Vec3A::splat(r), true);
            let passing = surface.base_color * ((1.0 - r) * material.transmission);
            if material.thin {
                push(surface.incoming, passing, true);
            } else if let Some(direction) = refract(surface.incoming, surface.normal, eta) {
                // The smooth normal may send a grazing ray back out: then it goes straight on.
                let through = direction.dot(surface.geometric_normal) < 0.0;
                push(
                    if through { direction } else { surface.incoming },
                    passing,
                    true,
                );
            }
            return;
        }
        let f = fresnel_schlick(self.f0(surface), n_dot_v);
        if surface.roughness < MIRROR_ROUGHNESS {
            push(surface.mirror(), f, true);
            return;
        }
        if f.max_element() * path.throughput.max_element() < MIN_THROUGHPUT {
            return;
        }
        let alpha = surface.roughness * surface.roughness;
        // As many rays as the reflection matters, the full number for a metal.
        let n = if glossy > 1 {
            (glossy as f32 * f.max_element()).ceil().max(1.0) as u32
        } else {
            1
        };
        let seed = u32::from(path.pixel)
            ^ (surface.position.x.to_bits().rotate_left(8))
            ^ surface.position.y.to_bits();
        let (ox, oy) = (uniform(seed, depth, 0), uniform(seed, depth, 1));
        for i in 0..n {
            // A shifted Kronecker sequence: even for any number of samples.
            let u = [
                (ox + i as f32 * 0.754_877_7).fract(),
                (oy + i as f32 * 0.569_840_3).fract(),
            ];
            if let Some((direction, weight)) =
                sample_ggx(surface.incoming, surface.normal, alpha, u)
                && direction.dot(surface.geometric_normal) > 0.0
            {
                push(direction, f * (weight / n as f32), false);
            }
        }
    }

    /// What a surface reflects and lets through when no further ray is allowed.
    pub(super) fn last_bounce(&self, surface: &Surface) -> Vec3A {
        let material = &self.materials[surface.material as usize];
        let f = fresnel_schlick(self.f0(surface), -surface.incoming.dot(surface.normal));
        let through = surface.base_color * (Vec3A::ONE - f) * material.transmission;
        self.surroundings.radiance(surface.mirror()) * f
            + self.surroundings.radiance(surface.incoming) * through
    }

    /// Beer-Lambert over the way inside the medium whose far side was met.
    pub(super) fn absorption(&self, surface: &Surface, distance: f32) -> Vec3A {
        let material = &self.materials[surface.material as usize];
        if surface.front
            || material.transmission == 0.0
            || material.thin
            || !material.attenuation_distance_m.is_finite()
        {
            return Vec3A::ONE;
        }
        Vec3A::from(material.attenuation_color).powf(distance / material.attenuation_distance_m)
    }
}
