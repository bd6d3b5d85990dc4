//! Light from a surface towards its viewer without secondary rays: emission, diffuse reflection, and glossy
//! reflection of lamps.

use glam::Vec3A;

use crate::render::cpu::lighting::Lighting;
use crate::render::cpu::path::{Path, PixelSample, seed};
use crate::render::cpu::photons::light::photon_irradiance;
use crate::render::cpu::scatter::{
    coat, is_broad, reflectance_at_normal, rough_fresnel, scatter_shared, seen_lobe,
};
use crate::render::cpu::tile::LightShare;
use crate::render::prepare::bsdf::{fresnel_schlick, ggx, more_scattered};
use crate::render::prepare::environment::Surroundings;
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::light::CameraLight;
use crate::render::prepare::material::MIRROR_ROUGHNESS;
use crate::render::prepare::surface::Surface;
use crate::scene::Material;

/// Emitted light, and diffuse and glossy reflection of lights, times `throughput`. `share` is the share of direct
/// light that arrives.
pub(crate) fn direct(
    frame: &PreparedFrame<'_>,
    lighting: &Lighting<'_>,
    surface: &Surface,
    share: LightShare,
    throughput: Vec3A,
) -> Vec3A {
    let material = frame.scene.material(surface);
    let surroundings = &lighting.surroundings;
    let mut sum = surface.emissive;
    let albedo = surface.base_color * ((1.0 - surface.metallic) * (1.0 - material.transmission));
    let n_dot_v = -surface.incoming.dot(surface.normal);
    let f0 = reflectance_at_normal(material, surface);
    let lambert = albedo * std::f32::consts::FRAC_1_PI;
    let diffuses = lambert != Vec3A::ZERO;
    if diffuses {
        // Light that the boundary reflects does not enter the surface, so it is not diffused.
        let entering = Vec3A::ONE - rough_fresnel(f0, surface.roughness, n_dot_v);
        let e = ambient_irradiance(surroundings.irradiance(surface.normal), surface, share);
        let e = e + photon_irradiance(lighting.photons, surface);
        sum += lambert * entering * e;
    }
    if is_broad(surface) && material.transmission == 0.0 {
        let f = rough_fresnel(f0, surface.roughness, n_dot_v);
        let towards = (surface.mirror() + surface.normal).normalize_or(surface.normal);
        let e = surroundings.irradiance(towards) * surface.unoccluded;
        let alpha = surface.roughness * surface.roughness;
        let more = more_scattered(f0, n_dot_v, alpha);
        sum += f * more * e * (lobe_albedo(alpha) * std::f32::consts::FRAC_1_PI);
    }
    let glossy = surface.roughness >= MIRROR_ROUGHNESS && material.transmission == 0.0;
    let coat_alpha = material.clearcoat_roughness * material.clearcoat_roughness;
    let coated = material.clearcoat > 0.0 && material.clearcoat_roughness >= MIRROR_ROUGHNESS;
    if share.diffuse != Vec3A::ZERO && (glossy || diffuses || coated) {
        for light in frame.lights {
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
                let lobe = highlight(surface, light, h, alpha, n_dot_v, n_dot_l);
                sum += f * more_scattered(f0, n_dot_v, alpha) * (e * share.gloss * lobe);
            }
            if coated && n_dot_v > 0.0 {
                let f = coat(material, to_light.dot(h).max(0.0));
                let lobe = highlight(surface, light, h, coat_alpha, n_dot_v, n_dot_l);
                sum += e * share.gloss * (lobe * f);
            }
        }
    }
    sum * throughput * ((1.0 - coat(material, n_dot_v)) * surface.opacity)
}

/// Ambient irradiance that arrives, of the irradiance `whole` of the surroundings. Rays find occlusion at the scale
/// of the mesh, and the occlusion texture contains finer occlusion. Both mostly describe the same occlusion, so the
/// smaller irradiance is used, and nothing occludes twice.
fn ambient_irradiance(whole: Vec3A, surface: &Surface, share: LightShare) -> Vec3A {
    let by_texture = whole * surface.unoccluded;
    let by_rays = whole + share.ambient.min(Vec3A::ZERO);
    let sent_back = share.ambient.max(Vec3A::ZERO) * surface.unoccluded;
    (by_rays.min(by_texture) + sent_back).max(Vec3A::ZERO)
}

/// Glossy reflection of a light per irradiance on the surface, without Fresnel; `h` is the half vector of the
/// directions to the light and to the viewer, unit length.
fn highlight(
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

/// Numbers of a path's first rays, which estimate rough reflections.
#[derive(Debug, Clone, Copy)]
pub(crate) struct FirstRays {
    /// Rays for the reflection of a metal.
    pub(crate) glossy: u32,
    /// Rays for a reflection that is shared with other pixels.
    pub(crate) shared: Option<u32>,
}

/// Sends the first secondary rays from a primary hit; if no bounces are allowed, returns a replacement for their
/// radiance.
pub(crate) fn start(
    frame: &PreparedFrame<'_>,
    lighting: &Lighting<'_>,
    surface: &Surface,
    sample: PixelSample,
    FirstRays { glossy, shared }: FirstRays,
    queue: &mut Vec<Path>,
) -> Vec3A {
    let material = frame.scene.material(surface);
    if frame.settings.max_bounces == 0 {
        return last_bounce(material, &lighting.surroundings, surface) * sample.weight;
    }
    let path = seed(surface, sample, false);
    scatter_shared(material, surface, &path, 0, glossy, shared, queue);
    Vec3A::ZERO
}

/// Reflection and transmission of a surface if no further ray is allowed: a lookup of the surroundings, blurred
/// according to roughness.
pub(crate) fn last_bounce(
    material: &Material,
    surroundings: &Surroundings<'_>,
    surface: &Surface,
) -> Vec3A {
    let cosine = -surface.incoming.dot(surface.normal);
    let f = rough_fresnel(
        reflectance_at_normal(material, surface),
        surface.roughness,
        cosine,
    );
    let blurred = |direction: Vec3A| {
        let sharp = surroundings.radiance(direction);
        if surface.roughness < MIRROR_ROUGHNESS {
            return sharp;
        }
        let even = surroundings.irradiance(direction) * std::f32::consts::FRAC_1_PI;
        surroundings
            .radiance_without_lamps(direction, 2.0 * surface.roughness * surface.roughness)
            .lerp(even, surface.roughness.min(1.0))
    };
    let behind = surroundings.radiance(surface.incoming);
    let mut sum = Vec3A::ZERO;
    if !is_broad(surface) || material.transmission > 0.0 {
        sum += blurred(surface.mirror()) * f;
    }
    if material.transmission > 0.0 {
        let through = surface.base_color * (Vec3A::ONE - f) * material.transmission;
        sum += blurred(surface.incoming) * through;
    }
    let coat = coat(material, cosine);
    if coat > 0.0 {
        sum = sum * (1.0 - coat) + blurred(surface.mirror()) * coat;
    }
    sum * surface.opacity + behind * (1.0 - surface.opacity)
}

/// Directional albedo of a GGX lobe without Fresnel: light that other microfacets block is lost. Within 0.04 of the
/// integral; see this file's tests.
fn lobe_albedo(alpha: f32) -> f32 {
    1.0 - 0.6 * alpha
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::prepare::bsdf::sample_ggx;
    use crate::render::prepare::cone::RayCone;

    /// Mean reflectance of a lobe in a furnace, over view directions weighted by their cosine.
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
    fn what_keeps_ambient_light_away_counts_once_and_only_where_it_is() {
        let e = |unoccluded: f32, ambient: f32| {
            let surface = Surface {
                position: Vec3A::Z,
                error: 0.0,
                geometric_normal: -Vec3A::Z,
                normal: -Vec3A::Z,
                front: true,
                incoming: Vec3A::Z,
                cone: RayCone::default(),
                instance: 0,
                material: 0,
                base_color: Vec3A::ONE,
                metallic: 0.0,
                roughness: 1.0,
                emissive: Vec3A::ZERO,
                unoccluded,
                opacity: 1.0,
            };
            let share = LightShare {
                ambient: Vec3A::splat(ambient),
                ..LightShare::ALL
            };
            ambient_irradiance(Vec3A::splat(2.0), &surface, share).x
        };
        assert_eq!(e(1.0, 0.0), 2.0);
        assert_eq!((e(1.0, -0.5), e(1.0, 0.5)), (1.5, 2.5));
        assert_eq!((e(0.5, -0.5), e(0.5, -1.5)), (1.0, 0.5));
        assert_eq!((e(0.5, 0.5), e(0.0, 0.5)), (1.25, 0.0));
        assert_eq!(e(1.0, -3.0), 0.0);
    }

    #[test]
    fn the_albedo_of_a_lobe_follows_its_integral() {
        for alpha in [0.01, 0.1, 0.3, 0.5, 0.7, 1.0] {
            let (fit, exact) = (lobe_albedo(alpha), reflected(alpha));
            assert!((fit - exact).abs() < 0.04, "{alpha}: {fit} {exact}");
        }
    }
}
