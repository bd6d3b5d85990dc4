//! What a surface does with light: emits, diffuses, reflects, lets through; and the rays it sends on.

use glam::Vec3A;

use crate::numerics::uniform;
use crate::scene::Material;

use super::FrameContext;
use super::bsdf::{
    f0_of_ior, fresnel_dielectric, fresnel_schlick, ggx, more_scattered, refract, sample_ggx,
    sample_half, shadowing_weight, solid_angle_of_half,
};
use super::light::CameraLight;
use super::path::{MIN_THROUGHPUT, Path, seed};
use super::surface::{Surface, reflect};

/// Roughness under which a surface is traced as a perfect mirror: its GGX lobe is then narrower
/// than a pixel of a curved object's reflection.
pub(super) const MIRROR_ROUGHNESS: f32 = 0.06;

/// Roughness from which on a dielectric's reflection of its surroundings is taken from their
/// irradiance: it is 4 % of a lobe as wide as a diffuse one, and a ray or two of it would be grain.
const BROAD_ROUGHNESS: f32 = 0.55;

/// Reflectance of a clear coat of index 1.5 at normal incidence.
const COAT_F0: f32 = 0.04;

/// What light reaches a surface: of what it diffuses and of what it mirrors of each lamp the share, and
/// how ambient light differs from that of the surroundings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LightShare {
    pub(super) diffuse: Vec3A,
    pub(super) gloss: Vec3A,
    /// Ambient irradiance beyond that of the surroundings.
    pub(super) ambient: Vec3A,
}

impl LightShare {
    pub(super) const ALL: Self = Self {
        diffuse: Vec3A::ONE,
        gloss: Vec3A::ONE,
        ambient: Vec3A::ZERO,
    };
}

/// How a ray that a surface sends on was drawn.
#[derive(Debug, Clone, Copy)]
struct Drawn {
    /// See [`Path::lobe`].
    lobe: f32,
    /// Of the directions that it stands for.
    solid_angle: f32,
}

impl Drawn {
    const MIRROR: Self = Self {
        lobe: 0.0,
        solid_angle: 0.0,
    };
}

impl FrameContext<'_> {
    /// Whether mirror rays leave this surface.
    pub(super) fn is_specular(&self, surface: &Surface) -> bool {
        let material = &self.materials[surface.material as usize];
        surface.metallic > 0.0
            || material.transmission > 0.0
            || material.clearcoat > 0.0
            || surface.roughness < 0.5
    }

    /// Reflectance at normal incidence.
    pub(super) fn f0(&self, surface: &Surface) -> Vec3A {
        let dielectric = Vec3A::splat(f0_of_ior(self.materials[surface.material as usize].ior));
        dielectric.lerp(surface.base_color, surface.metallic)
    }

    /// Share of light that a clear coat reflects, and so keeps from what is under it.
    fn coat(&self, surface: &Surface, cosine: f32) -> f32 {
        let material = &self.materials[surface.material as usize];
        match material.clearcoat {
            0.0 => 0.0,
            strength => strength * fresnel_schlick(Vec3A::splat(COAT_F0), cosine).x,
        }
    }

    /// Whether its reflection of the surroundings is taken from their irradiance.
    fn is_broad(&self, surface: &Surface) -> bool {
        surface.metallic == 0.0 && surface.roughness >= BROAD_ROUGHNESS
    }

    /// Emitted, diffused and glossily reflected light of lights, times `throughput`.
    /// `share` of direct light arrives.
    pub(super) fn direct(&self, surface: &Surface, share: LightShare, throughput: Vec3A) -> Vec3A {
        let material = &self.materials[surface.material as usize];
        let mut sum = surface.emissive;
        let albedo =
            surface.base_color * ((1.0 - surface.metallic) * (1.0 - material.transmission));
        let n_dot_v = -surface.incoming.dot(surface.normal);
        let f0 = self.f0(surface);
        let lambert = albedo * std::f32::consts::FRAC_1_PI;
        let diffuses = lambert != Vec3A::ZERO;
        if diffuses {
            // What the boundary reflects cannot also enter and be diffused.
            let entering = Vec3A::ONE - rough_fresnel(f0, surface.roughness, n_dot_v);
            let mut e = self.surroundings.irradiance(surface.normal) + share.ambient;
            e = e.max(Vec3A::ZERO) + self.photon_irradiance(surface);
            sum += lambert * entering * e;
        }
        if self.is_broad(surface) && material.transmission == 0.0 {
            let f = rough_fresnel(f0, surface.roughness, n_dot_v);
            let towards = (surface.mirror() + surface.normal).normalize_or(surface.normal);
            let e = self.surroundings.irradiance(towards);
            let alpha = surface.roughness * surface.roughness;
            let more = more_scattered(f0, n_dot_v, alpha);
            sum += f * more * e * (lobe_albedo(alpha) * std::f32::consts::FRAC_1_PI);
        }
        let glossy = surface.roughness >= MIRROR_ROUGHNESS && material.transmission == 0.0;
        let coat_alpha = material.clearcoat_roughness * material.clearcoat_roughness;
        let coated = material.clearcoat > 0.0 && material.clearcoat_roughness >= MIRROR_ROUGHNESS;
        if share.diffuse != Vec3A::ZERO && (glossy || diffuses || coated) {
            for light in self.lights {
                let (to_light, e) = light.illuminate(surface.position);
                let n_dot_l = surface.normal.dot(to_light);
                if n_dot_l <= 0.0 {
                    continue;
                }
                let e = e * n_dot_l;
                let Some(h) = (to_light - surface.incoming).try_normalize() else {
                    continue;
                };
                let f = fresnel_schlick(f0, to_light.dot(h).max(0.0));
                sum += lambert * (Vec3A::ONE - f) * e * share.diffuse;
                let alpha = surface.roughness * surface.roughness;
                let by_rays = light.is_seen_by_rays(surface.position, seen_lobe(f0, alpha));
                if glossy && n_dot_v > 0.0 && !by_rays {
                    let lobe = self.highlight(surface, light, h, alpha, n_dot_v, n_dot_l);
                    sum += f * more_scattered(f0, n_dot_v, alpha) * (e * share.gloss * lobe);
                }
                if coated && n_dot_v > 0.0 {
                    let f = self.coat(surface, to_light.dot(h).max(0.0));
                    let lobe = self.highlight(surface, light, h, coat_alpha, n_dot_v, n_dot_l);
                    sum += e * share.gloss * (lobe * f);
                }
            }
        }
        sum * throughput * ((1.0 - self.coat(surface, n_dot_v)) * surface.opacity)
    }

    /// Glossy reflection of a light per irradiance on the surface, without Fresnel; `h` is the unit
    /// vector between the directions to it and to the viewer.
    pub(super) fn highlight(
        &self,
        surface: &Surface,
        light: &CameraLight,
        h: Vec3A,
        alpha: f32,
        n_dot_v: f32,
        n_dot_l: f32,
    ) -> f32 {
        let widened = light.widened_alpha(surface.position, alpha);
        ggx(n_dot_v, n_dot_l, surface.normal.dot(h).max(0.0), widened)
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
        let mut push = |direction: Vec3A, share: Vec3A, drawn: Drawn| {
            let throughput = path.throughput * share;
            if throughput.max_element() >= MIN_THROUGHPUT && throughput.is_finite() {
                queue.push(Path {
                    origin: surface.leave(direction),
                    direction,
                    throughput,
                    cone: surface.cone.scattered(drawn.solid_angle),
                    lobe: drawn.lobe,
                    ..*path
                });
            }
        };
        if surface.opacity < 1.0 {
            push(
                surface.incoming,
                Vec3A::splat(1.0 - surface.opacity),
                Drawn {
                    lobe: path.lobe,
                    solid_angle: 0.0,
                },
            );
        }
        let samples = Samples::new(surface, path, depth);
        let coat = self.coat(surface, n_dot_v) * surface.opacity;
        if coat > 0.0 {
            let rough = material.clearcoat_roughness;
            if rough < MIRROR_ROUGHNESS {
                push(surface.mirror(), Vec3A::splat(coat), Drawn::MIRROR);
            } else {
                let n = samples_for(glossy, coat);
                for i in 0..n {
                    let drawn = sample_ggx(
                        surface.incoming,
                        surface.normal,
                        rough * rough,
                        samples.at(i),
                    );
                    if let Some(r) = drawn.filter(|r| surface.is_outside(r.direction)) {
                        push(
                            r.direction,
                            Vec3A::splat(coat * r.weight / n as f32),
                            Drawn {
                                lobe: f32::INFINITY,
                                solid_angle: r.solid_angle / n as f32,
                            },
                        );
                    }
                }
            }
        }
        let under = surface.opacity - coat;
        if material.transmission > 0.0 {
            self.transmit(surface, n_dot_v, under, glossy, &samples, &mut push);
            return;
        }
        let f0 = self.f0(surface);
        if surface.roughness < MIRROR_ROUGHNESS {
            push(
                surface.mirror(),
                fresnel_schlick(f0, n_dot_v) * under,
                Drawn::MIRROR,
            );
            return;
        }
        if self.is_broad(surface) {
            return;
        }
        let f = rough_fresnel(f0, surface.roughness, n_dot_v) * under;
        if f.max_element() * path.throughput.max_element() < MIN_THROUGHPUT {
            return;
        }
        let alpha = surface.roughness * surface.roughness;
        let n = samples_for(glossy, f.max_element());
        let more = more_scattered(f0, n_dot_v, alpha);
        let lobe = seen_lobe(f0, alpha);
        for i in 0..n {
            let drawn = sample_ggx(surface.incoming, surface.normal, alpha, samples.at(i));
            if let Some(r) = drawn.filter(|r| surface.is_outside(r.direction)) {
                let f = fresnel_schlick(f0, r.h_dot_v) * more * under;
                let share = f * (r.weight / n as f32);
                let solid_angle = r.solid_angle / n as f32;
                push(r.direction, share, Drawn { lobe, solid_angle });
            }
        }
    }

    /// Both rays of a dielectric boundary (HQ-AR, section 3) by Fresnel's equations, at its own normal
    /// or, where it is rough, at those of its microfacets (Walter et al. 2007).
    fn transmit(
        &self,
        surface: &Surface,
        n_dot_v: f32,
        under: f32,
        glossy: u32,
        samples: &Samples,
        push: &mut impl FnMut(Vec3A, Vec3A, Drawn),
    ) {
        let material = &self.materials[surface.material as usize];
        let eta = if surface.front || material.thin {
            material.ior
        } else {
            1.0 / material.ior
        };
        let reflectance = |cosine: f32| {
            let r = fresnel_dielectric(cosine, eta);
            // A thin sheet's two faces reflect back and forth: 2R / (1 + R) in all.
            if material.thin {
                2.0 * r / (1.0 + r)
            } else {
                r
            }
        };
        let passing = surface.base_color * (material.transmission * under);
        if surface.roughness < MIRROR_ROUGHNESS {
            let r = reflectance(n_dot_v);
            push(surface.mirror(), Vec3A::splat(r * under), Drawn::MIRROR);
            if material.thin {
                push(surface.incoming, passing * (1.0 - r), Drawn::MIRROR);
            } else if let Some(direction) = refract(surface.incoming, surface.normal, eta) {
                // The smooth normal may send a grazing ray back out: then it goes straight on.
                let through = direction.dot(surface.geometric_normal) < 0.0;
                let direction = if through { direction } else { surface.incoming };
                push(direction, passing * (1.0 - r), Drawn::MIRROR);
            }
            return;
        }
        let alpha = surface.roughness * surface.roughness;
        let rough = |solid_angle| Drawn {
            lobe: alpha,
            solid_angle,
        };
        let n = samples_for(glossy, 1.0);
        // Both lobes of a sheet together lose nothing; what is refracted loses less than what is
        // reflected, and turns back inside again and again.
        let more = match material.thin {
            true => more_scattered(Vec3A::ONE, n_dot_v, alpha).x,
            false => 1.0,
        };
        for i in 0..n {
            let Some(h) = sample_half(surface.incoming, surface.normal, alpha, samples.at(i))
            else {
                continue;
            };
            let r = reflectance(-surface.incoming.dot(h));
            let weight = |direction: Vec3A| {
                let cosine = direction.dot(surface.normal).abs();
                shadowing_weight(n_dot_v, cosine, alpha) * more / n as f32
            };
            let h_dot_v = -surface.incoming.dot(h);
            let of_half = solid_angle_of_half(n_dot_v, surface.normal.dot(h), h_dot_v, alpha);
            let of_half = of_half / n as f32;
            let of_reflected = 4.0 * h_dot_v * of_half;
            let reflected = reflect(surface.incoming, h);
            if surface.is_outside(reflected) {
                let share = r * under * weight(reflected);
                push(reflected, Vec3A::splat(share), rough(of_reflected));
            }
            // A thin sheet scatters what passes as much as it does what it reflects, straight ahead.
            let through = if material.thin {
                let mirrored = reflect(surface.incoming, h);
                Some(mirrored - surface.normal * (2.0 * mirrored.dot(surface.normal)))
            } else {
                refract(surface.incoming, h, eta)
            };
            if let Some(direction) = through.filter(|d| d.dot(surface.geometric_normal) < 0.0) {
                let share = passing * ((1.0 - r) * weight(direction));
                // What is refracted turns less than its normal does.
                let turn = 1.0 - 1.0 / eta;
                let solid_angle = if material.thin {
                    of_reflected
                } else {
                    turn * turn * of_half
                };
                push(direction, share, rough(solid_angle));
            }
        }
    }

    /// What a surface reflects and lets through when no further ray is allowed: its surroundings, the
    /// rougher the more blurred.
    pub(super) fn last_bounce(&self, surface: &Surface) -> Vec3A {
        let material = &self.materials[surface.material as usize];
        let cosine = -surface.incoming.dot(surface.normal);
        let f = rough_fresnel(self.f0(surface), surface.roughness, cosine);
        let blurred = |direction: Vec3A| {
            let sharp = self.surroundings.radiance(direction);
            if surface.roughness < MIRROR_ROUGHNESS {
                return sharp;
            }
            let even = self.surroundings.irradiance(direction) * std::f32::consts::FRAC_1_PI;
            self.surroundings
                .radiance_without_lamps(direction, 2.0 * surface.roughness * surface.roughness)
                .lerp(even, surface.roughness.min(1.0))
        };
        let behind = self.surroundings.radiance(surface.incoming);
        let mut sum = Vec3A::ZERO;
        if !self.is_broad(surface) || material.transmission > 0.0 {
            sum += blurred(surface.mirror()) * f;
        }
        if material.transmission > 0.0 {
            let through = surface.base_color * (Vec3A::ONE - f) * material.transmission;
            sum += blurred(surface.incoming) * through;
        }
        let coat = self.coat(surface, cosine);
        if coat > 0.0 {
            sum = sum * (1.0 - coat) + blurred(surface.mirror()) * coat;
        }
        sum * surface.opacity + behind * (1.0 - surface.opacity)
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

/// Whether rough reflections or refractions may leave a material.
pub(super) fn scatters_roughly(material: &Material) -> bool {
    let textured = material.metallic_roughness_texture.is_some();
    textured
        || (material.roughness >= MIRROR_ROUGHNESS
            && (material.metallic > 0.0
                || material.transmission > 0.0
                || material.roughness < BROAD_ROUGHNESS))
        || (material.clearcoat > 0.0 && material.clearcoat_roughness >= MIRROR_ROUGHNESS)
}

/// Reflectance of a rough surface on the whole: its lobe's microfacets do not all graze where the
/// surface does (Lagarde 2011's fit to Schlick's formula).
fn rough_fresnel(f0: Vec3A, roughness: f32, cosine: f32) -> Vec3A {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    let m2 = m * m;
    let grazing = Vec3A::splat(1.0 - roughness).max(f0);
    f0 + (grazing - f0) * (m2 * m2 * m)
}

/// The lobe by which a rough surface's rays see lamps: a dielectric sends too few for that.
fn seen_lobe(f0: Vec3A, alpha: f32) -> f32 {
    if f0.max_element() >= 0.5 {
        alpha
    } else {
        f32::INFINITY
    }
}

/// Share of light that a GGX lobe without Fresnel reflects, over all directions: what microfacets hide
/// of each other is lost. Within 0.04 of the integral; see this file's tests.
fn lobe_albedo(alpha: f32) -> f32 {
    1.0 - 0.6 * alpha
}

/// As many rays as a reflection of reflectance `f` matters, the full number for a metal.
fn samples_for(glossy: u32, f: f32) -> u32 {
    if glossy > 1 {
        (glossy as f32 * f).ceil().max(1.0) as u32
    } else {
        1
    }
}

/// Points of the unit square for a surface's rays: a shifted Kronecker sequence, even for any number.
struct Samples {
    first: [f32; 2],
}

impl Samples {
    fn new(surface: &Surface, path: &Path, depth: u32) -> Self {
        let seed = u32::from(path.pixel)
            ^ (surface.position.x.to_bits().rotate_left(8))
            ^ surface.position.y.to_bits();
        Self {
            first: [uniform(seed, depth, 0), uniform(seed, depth, 1)],
        }
    }

    fn at(&self, i: u32) -> [f32; 2] {
        [
            (self.first[0] + i as f32 * 0.754_877_7).fract(),
            (self.first[1] + i as f32 * 0.569_840_3).fract(),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean over directions of view, weighted by their cosine, of what a lobe reflects in a furnace.
    fn reflected(alpha: f32) -> f32 {
        let n = 64;
        let (mut sum, mut weights) = (0.0, 0.0);
        for k in 0..n {
            let cosine = (k as f32 + 0.5) / n as f32;
            let incoming = Vec3A::new((1.0 - cosine * cosine).sqrt(), 0.0, -cosine);
            for i in 0..256 {
                let u = [(i as f32 + 0.5) / 256.0, (i as f32 * 0.618_034) % 1.0];
                let drawn = sample_ggx(incoming, Vec3A::Z, alpha, u);
                sum += cosine * drawn.map_or(0.0, |r| r.weight);
                weights += cosine;
            }
        }
        sum / weights
    }

    #[test]
    fn the_albedo_of_a_lobe_follows_its_integral() {
        for alpha in [0.01, 0.1, 0.3, 0.5, 0.7, 1.0] {
            let (fit, exact) = (lobe_albedo(alpha), reflected(alpha));
            assert!((fit - exact).abs() < 0.04, "{alpha}: {fit} {exact}");
        }
    }

    #[test]
    fn fresnel_of_a_rough_surface_is_that_of_a_smooth_one_head_on() {
        for roughness in [0.0, 0.3, 1.0] {
            let f = rough_fresnel(Vec3A::splat(0.04), roughness, 1.0);
            assert_eq!(f, Vec3A::splat(0.04));
        }
        assert_eq!(rough_fresnel(Vec3A::splat(0.04), 0.0, 0.0), Vec3A::ONE);
        assert_eq!(
            rough_fresnel(Vec3A::splat(0.04), 1.0, 0.0),
            Vec3A::splat(0.04)
        );
    }
}
