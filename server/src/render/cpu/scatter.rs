//! Secondary rays of a surface: reflected, refracted and transmitted.

use glam::Vec3A;

use crate::numerics::RandomKey;
use crate::render::prepare::bsdf::{
    f0_of_ior, fresnel_dielectric, fresnel_schlick, more_scattered, reflect, refract, sample_ggx,
    sample_half, shadowing_weight, solid_angle_of_half,
};
use crate::render::prepare::material::{BROAD_ROUGHNESS, MIRROR_ROUGHNESS};
use crate::render::prepare::surface::Surface;
use crate::scene::Material;

use super::path::{MIN_THROUGHPUT, Path};

/// Reflectance of a clear coat of index 1.5 at normal incidence.
const COAT_F0: f32 = 0.04;

/// Sampling information of a secondary ray.
#[derive(Debug, Clone, Copy)]
struct Drawn {
    /// See [`Path::lobe`].
    lobe: f32,
    /// Solid angle of the directions that the ray represents.
    solid_angle: f32,
    /// See [`Path::shared`].
    shared: bool,
}

impl Drawn {
    const MIRROR: Self = Self {
        lobe: 0.0,
        solid_angle: 0.0,
        shared: false,
    };
}

/// Whether the surface sends specular rays.
pub(crate) fn is_specular(material: &Material, surface: &Surface) -> bool {
    surface.metallic > 0.0
        || material.transmission > 0.0
        || material.clearcoat > 0.0
        || surface.roughness < 0.5
}

/// Reflectance at normal incidence.
pub(crate) fn reflectance_at_normal(material: &Material, surface: &Surface) -> Vec3A {
    let dielectric = Vec3A::splat(f0_of_ior(material.ior));
    dielectric.lerp(surface.base_color, surface.metallic)
}

/// Share of light that a clear coat reflects, and that does not reach the surface under it.
pub(crate) fn coat(material: &Material, cosine: f32) -> f32 {
    match material.clearcoat {
        0.0 => 0.0,
        strength => strength * fresnel_schlick(Vec3A::splat(COAT_F0), cosine).x,
    }
}

/// Whether the surface's reflection of the surroundings is computed from their irradiance.
pub(crate) fn is_broad(surface: &Surface) -> bool {
    surface.metallic == 0.0 && surface.roughness >= BROAD_ROUGHNESS
}

/// The rough reflection lobe of a surface without transmission.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RoughLobe {
    /// GGX alpha.
    pub(crate) alpha: f32,
    /// Reflectance at normal incidence.
    f0: Vec3A,
    /// Single-scattering reflectance of the whole lobe, under the coat and with the surface's opacity.
    once: Vec3A,
    /// Factor for multiple scattering between microfacets.
    more: Vec3A,
    /// Share of light that passes the coat, times the surface's opacity.
    under: f32,
}

impl RoughLobe {
    /// `None` if the surface has no such lobe, or one that is not sampled by rays.
    pub(crate) fn of(material: &Material, surface: &Surface) -> Option<Self> {
        let cosine = (-surface.incoming.dot(surface.normal)).clamp(0.0, 1.0);
        let under = surface.opacity * (1.0 - coat(material, cosine));
        let is_rough = surface.roughness >= MIRROR_ROUGHNESS && !is_broad(surface);
        (is_rough && material.transmission == 0.0).then(|| {
            let alpha = surface.roughness * surface.roughness;
            let f0 = reflectance_at_normal(material, surface);
            Self {
                alpha,
                f0,
                once: rough_fresnel(f0, surface.roughness, cosine) * under,
                more: more_scattered(f0, cosine, alpha),
                under,
            }
        })
    }

    /// Total reflectance of the lobe.
    pub(crate) fn reflectance(&self) -> Vec3A {
        (self.once * self.more).max(Vec3A::splat(MIN_THROUGHPUT))
    }

    /// Whether the contribution of the lobe's rays can be visible.
    pub(crate) fn matters(&self) -> bool {
        self.once.max_element() >= MIN_THROUGHPUT
    }

    /// Number of rays for the lobe; `glossy` rays for a metal.
    pub(crate) fn rays(&self, glossy: u32) -> u32 {
        samples_for(glossy, self.once.max_element())
    }
}

/// Sends the reflected and refracted rays of a path that hit `surface` after `depth` bounces; a rough surface that
/// reflects all light sends `glossy` rays.
pub(crate) fn scatter(
    material: &Material,
    surface: &Surface,
    path: &Path,
    depth: u32,
    glossy: u32,
    queue: &mut Vec<Path>,
) {
    scatter_shared(material, surface, path, depth, glossy, None, queue);
}

/// As [`scatter`], but sends `shared` rays for the rough reflection, which are shared with other pixels.
pub(crate) fn scatter_shared(
    material: &Material,
    surface: &Surface,
    path: &Path,
    depth: u32,
    glossy: u32,
    shared: Option<u32>,
    queue: &mut Vec<Path>,
) {
    let n_dot_v = (-surface.incoming.dot(surface.normal)).clamp(0.0, 1.0);
    let mut n_rays = 0;
    let mut push = |direction: Vec3A, share: Vec3A, drawn: Drawn| {
        let throughput = path.throughput * share;
        n_rays += 1;
        if throughput.max_element() >= MIN_THROUGHPUT && throughput.is_finite() {
            queue.push(Path {
                origin: surface.leave(direction),
                direction,
                throughput,
                cone: surface.cone.scattered(drawn.solid_angle),
                lobe: drawn.lobe,
                shared: path.shared || drawn.shared,
                random: path.random.child(depth, n_rays),
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
                ..Drawn::MIRROR
            },
        );
    }
    let samples = Samples::new(path.random, depth);
    let coat = coat(material, n_dot_v) * surface.opacity;
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
                            shared: false,
                        },
                    );
                }
            }
        }
    }
    let under = surface.opacity - coat;
    if material.transmission > 0.0 {
        transmit(
            material, surface, n_dot_v, under, glossy, &samples, &mut push,
        );
        return;
    }
    let f0 = reflectance_at_normal(material, surface);
    if surface.roughness < MIRROR_ROUGHNESS {
        push(
            surface.mirror(),
            fresnel_schlick(f0, n_dot_v) * under,
            Drawn::MIRROR,
        );
        return;
    }
    let Some(lobe) = RoughLobe::of(material, surface) else {
        return;
    };
    if lobe.once.max_element() * path.throughput.max_element() < MIN_THROUGHPUT {
        return;
    }
    let n = shared.unwrap_or_else(|| lobe.rays(glossy));
    let seen = seen_lobe(lobe.f0, lobe.alpha);
    for i in 0..n {
        let drawn = sample_ggx(surface.incoming, surface.normal, lobe.alpha, samples.at(i));
        if let Some(r) = drawn.filter(|r| surface.is_outside(r.direction)) {
            let f = fresnel_schlick(lobe.f0, r.h_dot_v) * lobe.more * lobe.under;
            let share = f * (r.weight / n as f32);
            let drawn = Drawn {
                lobe: seen,
                solid_angle: r.solid_angle / n as f32,
                shared: shared.is_some(),
            };
            push(r.direction, share, drawn);
        }
    }
}

/// Reflected and refracted rays of a dielectric boundary (HQ-AR, section 3) by the Fresnel equations, with the
/// surface normal or, if the surface is rough, with the normals of its microfacets (Walter et al. 2007).
fn transmit(
    material: &Material,
    surface: &Surface,
    n_dot_v: f32,
    under: f32,
    glossy: u32,
    samples: &Samples,
    push: &mut impl FnMut(Vec3A, Vec3A, Drawn),
) {
    let eta = if surface.front || material.thin {
        material.ior
    } else {
        1.0 / material.ior
    };
    let reflectance = |cosine: f32| {
        let r = fresnel_dielectric(cosine, eta);
        // Light is reflected back and forth between the two faces of a thin sheet: 2R / (1 + R) in total.
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
            // With the interpolated normal a grazing ray may be refracted back out: then it continues straight on.
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
        shared: false,
    };
    let n = samples_for(glossy, 1.0);
    // The two lobes of a thin sheet together lose no energy. For a volume there is no correction: refraction loses
    // less than reflection, and light is reflected inside repeatedly.
    let more = match material.thin {
        true => more_scattered(Vec3A::ONE, n_dot_v, alpha).x,
        false => 1.0,
    };
    for i in 0..n {
        let Some(h) = sample_half(surface.incoming, surface.normal, alpha, samples.at(i)) else {
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
        // A thin sheet scatters transmitted light like reflected light, but around the straight direction.
        let through = if material.thin {
            let mirrored = reflect(surface.incoming, h);
            Some(mirrored - surface.normal * (2.0 * mirrored.dot(surface.normal)))
        } else {
            refract(surface.incoming, h, eta)
        };
        if let Some(direction) = through.filter(|d| d.dot(surface.geometric_normal) < 0.0) {
            let share = passing * ((1.0 - r) * weight(direction));
            // A refracted direction changes less than the microfacet normal.
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

/// Beer-Lambert absorption along the ray's segment inside the medium.
pub(crate) fn absorption(material: &Material, surface: &Surface, distance: f32) -> Vec3A {
    if surface.front
        || material.transmission == 0.0
        || material.thin
        || !material.attenuation_distance_m.is_finite()
    {
        return Vec3A::ONE;
    }
    Vec3A::from(material.attenuation_color).powf(distance / material.attenuation_distance_m)
}

/// Reflectance of a rough surface as a whole: at grazing view directions not all microfacets of its lobe are seen at
/// grazing angles (Lagarde 2011's fit to Schlick's formula).
pub(crate) fn rough_fresnel(f0: Vec3A, roughness: f32, cosine: f32) -> Vec3A {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    let m2 = m * m;
    let grazing = Vec3A::splat(1.0 - roughness).max(f0);
    f0 + (grazing - f0) * (m2 * m2 * m)
}

/// Width of the lobe with which a rough surface's rays hit lamps; infinite for a dielectric, which sends too few rays
/// for that.
pub(crate) fn seen_lobe(f0: Vec3A, alpha: f32) -> f32 {
    if f0.max_element() >= 0.5 {
        alpha
    } else {
        f32::INFINITY
    }
}

/// Number of rays in proportion to the reflectance `f`, the full number for a metal.
fn samples_for(glossy: u32, f: f32) -> u32 {
    if glossy > 1 {
        (glossy as f32 * f).ceil().max(1.0) as u32
    } else {
        1
    }
}

/// Sample points in the unit square for a surface's rays: a shifted Kronecker sequence, which is evenly distributed
/// for any number of points.
struct Samples {
    first: [f32; 2],
}

impl Samples {
    fn new(random: RandomKey, bounce: u32) -> Self {
        Self {
            first: [random.uniform(bounce, 0), random.uniform(bounce, 1)],
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
