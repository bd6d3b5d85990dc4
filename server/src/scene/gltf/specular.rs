//! Converts KHR_materials_pbrSpecularGlossiness to metallic-roughness, as the Khronos glTF group does
//! (`convert-between-workflows` in its repository), by factors or texel by texel.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::super::{Material, Reading, Texture};
use super::format::SpecularGlossiness;
use super::material::unit;
use super::texture::Textures;
use crate::numerics::srgb_from_linear;

/// Reflectance of a dielectric at normal incidence.
const DIELECTRIC: f32 = 0.04;

/// Specular values from here on count as the extension's default of 1, not as a choice (heuristic).
const UNSET: f32 = 0.99;

/// Texels less metallic than this count as non-metallic: their base colour is the diffuse colour.
const HARDLY_METALLIC: f32 = 0.02;

/// Computes base colour, metallic, roughness and their textures from the diffuse colour and from the specular colour
/// with glossiness.
pub(super) fn convert(
    entry: &SpecularGlossiness,
    (diffuse_texture, specular_texture): (Option<Arc<Texture>>, Option<Arc<Texture>>),
    material: &mut Material,
    textures: &mut Textures<'_, '_>,
    at: &str,
) {
    let diffuse = Vec3::from([0, 1, 2].map(|k| unit(entry.diffuse_factor[k])));
    let specular = Vec3::from(entry.specular_factor.map(unit));
    let glossiness = unit(entry.glossiness_factor);
    let Some(specular_texture) = specular_texture else {
        material.base_color_texture = diffuse_texture;
        material.roughness = 1.0 - glossiness;
        if specular.min_element() >= UNSET && diffuse.max_element() > 0.0 {
            material.base_color = diffuse;
            material.metallic = 0.0;
        } else if material.base_color_texture.is_some() && diffuse.max_element() > 0.0 {
            // Metallic is solved for the mean colour of the texture, whose texels are kept.
            let mean = mean_color(material.base_color_texture.as_deref()) * diffuse;
            let (_, metallic) = solve(mean, specular);
            material.base_color = diffuse;
            material.metallic = metallic;
        } else {
            let (base, metallic) = solve(diffuse, specular);
            material.base_color = base;
            material.metallic = metallic;
            // The base colour of a metal is its specular colour.
            material.base_color_texture = None;
        }
        return;
    };
    // The factors are multiplied into the texels.
    material.base_color = Vec3::ONE;
    material.metallic = 1.0;
    material.roughness = 1.0;
    let at_texel = |uv: Vec2| {
        let [r, g, b, alpha] = diffuse_texture
            .as_ref()
            .map_or([1.0; 4], |texture| texture.sample(uv));
        let [sr, sg, sb, gloss] = specular_texture.sample(uv);
        let (base, metallic) = solve(
            Vec3::new(r, g, b) * diffuse,
            Vec3::new(sr, sg, sb) * specular,
        );
        (base, alpha, metallic, 1.0 - gloss * glossiness)
    };
    let code = |x: f32| (255.0 * unit(x)).round() as u8;
    let mut is_metallic = false;
    let surface = paint(&specular_texture, false, |uv| {
        let (_, _, metallic, roughness) = at_texel(uv);
        is_metallic |= metallic > HARDLY_METALLIC;
        [255, code(roughness), code(metallic), 255]
    });
    let surface = textures.keep(surface);
    let base = match (&diffuse_texture, is_metallic) {
        (None, false) => {
            material.base_color = diffuse;
            Ok(None)
        }
        (Some(texture), false) => {
            material.base_color = diffuse;
            Ok(Some(Arc::clone(texture)))
        }
        (texture, true) => {
            let size = texture.as_ref().unwrap_or(&specular_texture);
            let base = paint(size, true, |uv| {
                let (base, alpha, ..) = at_texel(uv);
                let [r, g, b] = base.to_array().map(srgb_from_linear);
                [r, g, b, code(alpha)]
            });
            textures.keep(base).map(Some)
        }
    };
    match (surface, base) {
        (Ok(surface), Ok(base)) => {
            material.metallic_roughness_texture = Some(surface);
            material.base_color_texture = base;
        }
        (Err(problem), _) | (_, Err(problem)) => {
            textures.notes.push(format!(
                "{at}.specularGlossinessTexture left out: {problem}"
            ));
            material.base_color = diffuse;
            material.base_color_texture = diffuse_texture;
            material.metallic = 0.0;
            material.roughness = 1.0 - glossiness;
        }
    }
}

/// Creates a texture of the same size as another.
fn paint(size: &Texture, srgb: bool, mut texel: impl FnMut(Vec2) -> [u8; 4]) -> Texture {
    let (width, height) = (size.width, size.height);
    let scale = Vec2::new(width as f32, height as f32);
    let rgba = (0..height)
        .flat_map(|y| (0..width).map(move |x| Vec2::new(x as f32 + 0.5, y as f32 + 0.5)))
        .map(|centre| texel(centre / scale))
        .collect();
    let wrap = size.reading.wrap;
    Texture::read_as(width, height, rgba, Reading { srgb, wrap })
}

/// Mean of a grid of texels, linear.
fn mean_color(texture: Option<&Texture>) -> Vec3 {
    const SIDE: u8 = 16;
    let Some(texture) = texture else {
        return Vec3::ONE;
    };
    let place = |i: u8| (f32::from(i) + 0.5) / f32::from(SIDE);
    let sum: Vec3 = (0..SIDE)
        .flat_map(|y| (0..SIDE).map(move |x| Vec2::new(place(x), place(y))))
        .map(|uv| {
            let [r, g, b, _] = texture.sample(uv);
            Vec3::new(r, g, b)
        })
        .sum();
    sum / f32::from(SIDE).powi(2)
}

/// Base colour and metallic for a diffuse and a specular colour.
fn solve(diffuse: Vec3, specular: Vec3) -> (Vec3, f32) {
    let one_minus_strength = 1.0 - specular.max_element();
    let metallic = metallic(
        brightness(diffuse),
        brightness(specular),
        one_minus_strength,
    );
    let rest = (1.0 - metallic).max(1e-6);
    let from_diffuse = diffuse * (one_minus_strength / (1.0 - DIELECTRIC) / rest);
    let from_specular = (specular - DIELECTRIC * (1.0 - metallic)) / metallic.max(1e-6);
    let base = from_diffuse.lerp(from_specular, metallic * metallic);
    (base.clamp(Vec3::ZERO, Vec3::ONE), metallic)
}

/// Perceived brightness (HSP colour model).
fn brightness(color: Vec3) -> f32 {
    Vec3::new(0.299, 0.587, 0.114).dot(color * color).sqrt()
}

fn metallic(diffuse: f32, specular: f32, one_minus_strength: f32) -> f32 {
    if specular < DIELECTRIC {
        return 0.0;
    }
    let a = DIELECTRIC;
    let b = diffuse * one_minus_strength / (1.0 - DIELECTRIC) + specular - 2.0 * DIELECTRIC;
    let c = DIELECTRIC - specular;
    let root = (b * b - 4.0 * a * c).max(0.0).sqrt();
    unit((root - b) / (2.0 * a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn metals_and_dielectrics_are_told_apart() {
        let gold = Vec3::new(1.0, 0.77, 0.34);
        let (base, metallic) = solve(Vec3::ZERO, gold);
        assert!(metallic > 0.99, "{metallic}");
        assert!((base - gold).length() < 0.02, "{base}");
        let red = Vec3::new(0.8, 0.1, 0.1);
        let (base, metallic) = solve(red, Vec3::splat(DIELECTRIC));
        assert!(metallic < 1e-3, "{metallic}");
        assert!((base - red).length() < 1e-3, "{base}");
        assert_eq!(solve(red, Vec3::ZERO).1, 0.0);
    }
}
