//! The rays that a surface sends on: reflected, refracted and let through.

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

/// How a ray that a surface sends on was drawn.
#[derive(Debug, Clone, Copy)]
struct Drawn {
    /// See [`Path::lobe`].
    lobe: f32,
    /// Of the directions that it stands for.
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

/// Whether mirror rays leave this surface.
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

/// Share of light that a clear coat reflects, and so keeps from what is under it.
pub(crate) fn coat(material: &Material, cosine: f32) -> f32 {
    match material.clearcoat {
        0.0 => 0.0,
        strength => strength * fresnel_schlick(Vec3A::splat(COAT_F0), cosine).x,
    }
}

/// Whether its reflection of the surroundings is taken from their irradiance.
pub(crate) fn is_broad(surface: &Surface) -> bool {
    surface.metallic == 0.0 && surface.roughness >= BROAD_ROUGHNESS
}

/// The rough reflection of a surface that lets nothing through.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RoughLobe {
    /// GGX alpha.
    pub(crate) alpha: f32,
    /// Reflectance at normal incidence.
    f0: Vec3A,
    /// Reflectance of the whole lobe under what covers it, for light scattered once.
    once: Vec3A,
    /// Factor for light that facets reflect to and fro.
    more: Vec3A,
    /// Share of light that what covers it lets through.
    under: f32,
}

impl RoughLobe {
    /// `None` if the surface has no such lobe, or one for which no rays are sent.
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

    /// Share of light that it reflects in all.
    pub(crate) fn reflectance(&self) -> Vec3A {
        (self.once * self.more).max(Vec3A::splat(MIN_THROUGHPUT))
    }

    /// Whether a ray of it could be seen.
    pub(crate) fn matters(&self) -> bool {
        self.once.max_element() >= MIN_THROUGHPUT
    }

    /// Rays that estimate it, `glossy` of them for a metal.
    pub(crate) fn rays(&self, glossy: u32) -> u32 {
        samples_for(glossy, self.once.max_element())
    }
}

/// Sends the reflected and refracted rays of a path that met `surface` after `depth` bounces;
/// `glossy` of them where it reflects all light roughly.
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

/// [`scatter`] that sends `shared` rays of the rough reflection, to be shared with other pixels.
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

/// Both rays of a dielectric boundary (HQ-AR, section 3) by Fresnel's equations, at its own normal
/// or, where it is rough, at those of its microfacets (Walter et al. 2007).
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
        shared: false,
    };
    let n = samples_for(glossy, 1.0);
    // Both lobes of a sheet together lose nothing; what is refracted loses less than what is
    // reflected, and turns back inside again and again.
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

/// Beer-Lambert over the way inside the medium whose far side was met.
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

/// Reflectance of a rough surface on the whole: its lobe's microfacets do not all graze where the
/// surface does (Lagarde 2011's fit to Schlick's formula).
pub(crate) fn rough_fresnel(f0: Vec3A, roughness: f32, cosine: f32) -> Vec3A {
    let m = (1.0 - cosine).clamp(0.0, 1.0);
    let m2 = m * m;
    let grazing = Vec3A::splat(1.0 - roughness).max(f0);
    f0 + (grazing - f0) * (m2 * m2 * m)
}

/// The lobe by which a rough surface's rays see lamps: a dielectric sends too few for that.
pub(crate) fn seen_lobe(f0: Vec3A, alpha: f32) -> f32 {
    if f0.max_element() >= 0.5 {
        alpha
    } else {
        f32::INFINITY
    }
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
