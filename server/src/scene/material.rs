//! Surface materials, in glTF's terms.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use crate::numerics::linear_from_srgb;

/// How alpha is read (glTF 2.0, 3.9.4).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum AlphaMode {
    /// Alpha is ignored.
    #[default]
    Opaque,
    /// Texels whose alpha is under the cutoff are not there.
    Mask {
        /// 0..=1.
        cutoff: f32,
    },
    /// Alpha is the share of the surface that is there: what lies behind shows through the rest.
    Blend {
        /// Multiplies the alpha of texture and vertex colours, 0..=1.
        opacity: f32,
    },
}

/// An 8-bit texture with repeat wrapping.
#[derive(Debug, Clone)]
pub struct Texture {
    /// Texels per row.
    pub width: u32,
    /// Rows; row 0 is at v = 0.
    pub height: u32,
    /// RGBA texels.
    pub rgba: Vec<[u8; 4]>,
    /// Whether RGB is sRGB-coded (colours) or linear (normals, roughness).
    pub srgb: bool,
}

impl Texture {
    /// Memory held, bytes.
    pub fn bytes(&self) -> u64 {
        size_of_val(self.rgba.as_slice()) as u64
    }

    /// Bilinear lookup with repeat wrapping: linear RGB and alpha, 0..=1.
    pub fn sample(&self, uv: Vec2) -> [f32; 4] {
        let wrap = |x: f32, n: u32| {
            let x = if x.is_finite() { x - x.floor() } else { 0.0 };
            x * n as f32 - 0.5
        };
        let (x, y) = (wrap(uv.x, self.width), wrap(uv.y, self.height));
        let (x0, y0) = (x.floor(), y.floor());
        let (fx, fy) = (x - x0, y - y0);
        let texel = |dx: i64, dy: i64| {
            let tx = (x0 as i64 + dx).rem_euclid(i64::from(self.width)) as usize;
            let ty = (y0 as i64 + dy).rem_euclid(i64::from(self.height)) as usize;
            let [r, g, b, a] = self.rgba[ty * self.width as usize + tx];
            let decode = |c: u8| {
                if self.srgb {
                    linear_from_srgb(c)
                } else {
                    f32::from(c) / 255.0
                }
            };
            [decode(r), decode(g), decode(b), f32::from(a) / 255.0]
        };
        let (a, b, c, d) = (texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1));
        std::array::from_fn(|i| {
            (a[i] * (1.0 - fx) + b[i] * fx) * (1.0 - fy) + (c[i] * (1.0 - fx) + d[i] * fx) * fy
        })
    }
}

/// A surface, after glTF's metallic-roughness model with transmission, ior and volume.
#[derive(Debug, Clone)]
pub struct Material {
    /// For messages.
    pub name: String,
    /// Diffuse albedo of a dielectric, F0 of a metal; linear.
    pub base_color: Vec3,
    /// Multiplies `base_color`; its alpha serves [`Material::alpha`].
    pub base_color_texture: Option<Arc<Texture>>,
    /// Whether a mesh's vertex colours multiply `base_color` too; their alpha serves
    /// [`Material::alpha`].
    pub vertex_colors: bool,
    /// Alpha test.
    pub alpha: AlphaMode,
    /// 0 dielectric, 1 metal.
    pub metallic: f32,
    /// Perceptual roughness, 0 (mirror) to 1; GGX alpha is its square.
    pub roughness: f32,
    /// Multiplies metallic (blue) and roughness (green).
    pub metallic_roughness_texture: Option<Arc<Texture>>,
    /// Emitted radiance, linear.
    pub emissive: Vec3,
    /// Multiplies `emissive`.
    pub emissive_texture: Option<Arc<Texture>>,
    /// Tangent-space normals (needs texture coordinates).
    pub normal_texture: Option<Arc<Texture>>,
    /// Scales the normal map's x and y.
    pub normal_scale: f32,
    /// Share of the light entering the surface that is refracted rather than diffused, 0..=1.
    pub transmission: f32,
    /// Strength of a clear coat of index 1.5 over everything else, 0..=1.
    pub clearcoat: f32,
    /// Perceptual roughness of that coat, 0..=1.
    pub clearcoat_roughness: f32,
    /// Index of refraction against air, >= 1.
    pub ior: f32,
    /// Planar refraction (RT2AR, section IV.D): a thin sheet, the ray leaves in its old medium.
    /// Otherwise volumetric: the medium the ray is in is tracked.
    pub thin: bool,
    /// Colour of white light after `attenuation_distance_m` inside (Beer-Lambert).
    pub attenuation_color: Vec3,
    /// Metres; infinite for a clear medium.
    pub attenuation_distance_m: f32,
}

impl Default for Material {
    /// Mid-grey matte.
    fn default() -> Self {
        Self {
            name: String::new(),
            base_color: Vec3::splat(0.5),
            base_color_texture: None,
            vertex_colors: true,
            alpha: AlphaMode::Opaque,
            metallic: 0.0,
            roughness: 1.0,
            metallic_roughness_texture: None,
            emissive: Vec3::ZERO,
            emissive_texture: None,
            normal_texture: None,
            normal_scale: 1.0,
            transmission: 0.0,
            clearcoat: 0.0,
            clearcoat_roughness: 0.0,
            ior: 1.5,
            thin: false,
            attenuation_color: Vec3::ONE,
            attenuation_distance_m: f32::INFINITY,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn textures_wrap_and_interpolate() {
        let texture = Texture {
            width: 2,
            height: 1,
            rgba: vec![[0, 0, 0, 255], [255, 255, 255, 0]],
            srgb: false,
        };
        // Texel centres lie at (i + 0.5) / n.
        assert_eq!(texture.sample(Vec2::new(0.25, 0.5))[0], 0.0);
        assert_eq!(texture.sample(Vec2::new(0.75, 0.5))[0], 1.0);
        assert_eq!(texture.sample(Vec2::new(0.5, 0.5))[0], 0.5);
        assert_eq!(texture.sample(Vec2::new(-0.25, 0.5))[0], 1.0);
        assert!(
            texture
                .sample(Vec2::new(f32::NAN, f32::INFINITY))
                .iter()
                .all(|c| c.is_finite())
        );
    }
}
