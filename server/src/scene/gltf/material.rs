//! Materials and textures. A mesh has one set of texture coordinates, so all textures of a material must use the same
//! set; textures with another set are left out with a note.

use std::collections::HashSet;
use std::path::Path;

use glam::{Vec2, Vec3};

use super::super::{AlphaMode, Material};
use super::accessor::Data;
use super::format::{self, MaterialEntry, TextureRef};
use super::specular;
use super::texture::Textures;

/// Largest emission kept, linear radiance.
const MAX_EMISSION: f32 = 1e6;

/// A material, and its changes to the meshes that use it.
pub(super) struct Loaded {
    pub(super) material: Material,
    pub(super) mapping: Mapping,
    /// Nothing of the surface is above the alpha cutoff.
    pub(super) invisible: bool,
}

/// Which set of texture coordinates is used, and its transform (KHR_texture_transform).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Mapping {
    /// The n in TEXCOORD_n.
    pub(super) set: u32,
    offset: Vec2,
    rotation: f32,
    scale: Vec2,
}

impl Default for Mapping {
    fn default() -> Self {
        Self {
            set: 0,
            offset: Vec2::ZERO,
            rotation: 0.0,
            scale: Vec2::ONE,
        }
    }
}

impl Mapping {
    fn of(reference: &TextureRef) -> Self {
        let transform = reference.extensions.transform.clone().unwrap_or_default();
        Self {
            set: transform.tex_coord.unwrap_or(reference.tex_coord),
            offset: Vec2::from(transform.offset),
            rotation: transform.rotation,
            scale: Vec2::from(transform.scale),
        }
    }

    pub(super) fn bits(&self) -> [u32; 5] {
        [
            self.offset.x,
            self.offset.y,
            self.rotation,
            self.scale.x,
            self.scale.y,
        ]
        .map(f32::to_bits)
    }

    /// Scales, then rotates counter-clockwise (v points down), then moves.
    pub(super) fn apply(&self, uv: Vec2) -> Vec2 {
        let (sin, cos) = self.rotation.sin_cos();
        let uv = uv * self.scale;
        Vec2::new(cos * uv.x + sin * uv.y, cos * uv.y - sin * uv.x) + self.offset
    }
}

/// Loads all materials of the file. One more is added if there are vertex colours without a material.
pub(super) fn load(data: &Data<'_>, folder: &Path, notes: &mut Vec<String>) -> Vec<Loaded> {
    let mut textures = Textures::new(data, folder, notes);
    // Materials of surfaces whose vertex colours have an alpha; `None` stands for surfaces without a material.
    let mut translucent = HashSet::new();
    let mut has_colors_alone = false;
    for primitive in data.root.meshes.iter().flat_map(|mesh| &mesh.primitives) {
        let Some(&colors) = primitive.attributes.get("COLOR_0") else {
            continue;
        };
        let accessor = data.root.accessors.get(colors);
        if accessor.is_some_and(|accessor| accessor.kind == "VEC4") {
            translucent.extend(primitive.material);
        }
        has_colors_alone |= primitive
            .material
            .is_none_or(|index| index >= data.root.materials.len());
    }
    let mut materials: Vec<Loaded> = data
        .root
        .materials
        .iter()
        .enumerate()
        .map(|(i, entry)| convert(i, entry, translucent.contains(&i), &mut textures))
        .collect();
    if has_colors_alone {
        materials.push(Loaded {
            material: Material {
                name: "vertex colours".to_owned(),
                base_color: Vec3::ONE,
                ..Material::default()
            },
            mapping: Mapping::default(),
            invisible: false,
        });
    }
    materials
}

fn convert(
    i: usize,
    entry: &MaterialEntry,
    has_vertex_alpha: bool,
    textures: &mut Textures<'_, '_>,
) -> Loaded {
    let at = format!("materials[{i}]");
    let pbr = &entry.pbr_metallic_roughness;
    let specular = entry.extensions.specular_glossiness.as_ref();
    let base = match specular {
        Some(specular) => (specular.diffuse_texture.as_ref(), true, "diffuseTexture"),
        None => (pbr.base_color_texture.as_ref(), true, "baseColorTexture"),
    };
    let surface = match specular {
        // Its colours are sRGB-coded, its glossiness (alpha) is linear.
        Some(specular) => (
            specular.specular_glossiness_texture.as_ref(),
            true,
            "specularGlossinessTexture",
        ),
        None => (
            pbr.metallic_roughness_texture.as_ref(),
            false,
            "metallicRoughnessTexture",
        ),
    };
    let references = [
        base,
        surface,
        (entry.normal_texture.as_ref(), false, "normalTexture"),
        (entry.emissive_texture.as_ref(), true, "emissiveTexture"),
        (entry.occlusion_texture.as_ref(), false, "occlusionTexture"),
    ];
    let mut mapping = None;
    let mut loaded = [const { None }; 5];
    for (slot, (reference, srgb, what)) in loaded.iter_mut().zip(references) {
        let Some(reference) = reference else { continue };
        if mapping.is_some_and(|mapping| mapping != Mapping::of(reference)) {
            textures
                .notes
                .push(format!("{at}.{what} left out: it uses other texture coordinates than the material's first texture"));
            continue;
        }
        *slot = textures.get(reference.index, srgb, &format!("{at}.{what}"));
        if slot.is_some() {
            mapping.get_or_insert(Mapping::of(reference));
        }
    }
    let [
        base_texture,
        surface_texture,
        normal_texture,
        emissive_texture,
        occlusion_texture,
    ] = loaded;
    let [r, g, b, alpha] = match specular {
        Some(specular) => specular.diffuse_factor.map(unit),
        None => pbr.base_color_factor.map(unit),
    };
    let mut material = Material {
        name: entry.name.clone(),
        base_color: Vec3::new(r, g, b),
        metallic: unit(pbr.metallic_factor),
        roughness: unit(pbr.roughness_factor),
        emissive: emission(entry),
        emissive_texture,
        occlusion_texture,
        occlusion_strength: entry
            .occlusion_texture
            .as_ref()
            .map_or(1.0, |t| unit(t.strength)),
        normal_texture,
        normal_scale: entry
            .normal_texture
            .as_ref()
            .map_or(1.0, |t| t.scale.clamp(-1e3, 1e3)),
        ..Material::default()
    };
    match specular {
        Some(specular) => {
            let texture = (base_texture, surface_texture);
            specular::convert(specular, texture, &mut material, textures, &at);
        }
        None => {
            material.base_color_texture = base_texture;
            material.metallic_roughness_texture = surface_texture;
        }
    }
    transmission(entry, &at, &mut material, textures.notes);
    clearcoat(entry, &at, &mut material, textures.notes);
    let alpha = Alpha {
        factor: alpha,
        varies: material.base_color_texture.is_some() || has_vertex_alpha,
    };
    let invisible = alpha_mode(entry, alpha, &at, &mut material, textures.notes);
    Loaded {
        material,
        mapping: mapping.unwrap_or_default(),
        invisible,
    }
}

/// Alpha of a material.
#[derive(Clone, Copy)]
struct Alpha {
    factor: f32,
    /// Whether a texture or vertex colours multiply alpha.
    varies: bool,
}

pub(super) fn unit(x: f32) -> f32 {
    x.clamp(0.0, 1.0)
}

fn emission(entry: &MaterialEntry) -> Vec3 {
    let strength = entry
        .extensions
        .emissive_strength
        .as_ref()
        .map_or(1.0, |e| e.emissive_strength.clamp(0.0, MAX_EMISSION));
    Vec3::from(entry.emissive_factor.map(unit)) * strength
}

fn transmission(entry: &MaterialEntry, at: &str, material: &mut Material, notes: &mut Vec<String>) {
    let extensions = &entry.extensions;
    if let Some(ior) = &extensions.ior {
        if ior.ior >= 1.0 {
            material.ior = ior.ior.min(5.0);
        } else {
            notes.push(format!("{at}: ior {} is taken as 1", ior.ior));
            material.ior = 1.0;
        }
    }
    if let Some(transmission) = &extensions.transmission {
        material.transmission = unit(transmission.transmission_factor);
        // Without a volume, or with a volume of no thickness, the surface is a thin wall.
        material.thin = true;
        if transmission.transmission_texture.is_some() {
            notes.push(format!(
                "{at}: its transmission texture is left out, the factor stays"
            ));
        }
    }
    if let Some(volume) = &extensions.volume {
        material.thin = volume.thickness_factor <= 0.0;
        material.attenuation_color = Vec3::from(volume.attenuation_color.map(unit));
        if volume.attenuation_distance > 0.0 {
            material.attenuation_distance_m = volume.attenuation_distance;
        }
    }
}

fn clearcoat(entry: &MaterialEntry, at: &str, material: &mut Material, notes: &mut Vec<String>) {
    let Some(coat) = &entry.extensions.clearcoat else {
        return;
    };
    material.clearcoat = unit(coat.clearcoat_factor);
    material.clearcoat_roughness = unit(coat.clearcoat_roughness_factor);
    let left_out = [
        (&coat.clearcoat_texture, "strength"),
        (&coat.clearcoat_roughness_texture, "roughness"),
        (&coat.clearcoat_normal_texture, "normal"),
    ];
    for (_, what) in left_out.iter().filter(|(texture, _)| texture.is_some()) {
        notes.push(format!(
            "{at}: its clear coat's {what} texture is left out, the factor stays"
        ));
    }
}

/// Sets the alpha mode; true if the surface is completely invisible.
fn alpha_mode(
    entry: &MaterialEntry,
    alpha: Alpha,
    at: &str,
    material: &mut Material,
    notes: &mut Vec<String>,
) -> bool {
    let Alpha {
        factor: alpha,
        varies,
    } = alpha;
    let cutoff = match entry.alpha_mode {
        format::AlphaMode::Opaque => return false,
        format::AlphaMode::Mask => unit(entry.alpha_cutoff.unwrap_or(0.5)),
        format::AlphaMode::Blend if !varies => {
            if alpha < 1.0 {
                material.alpha = AlphaMode::Blend {
                    opacity: unit(alpha),
                };
            }
            return alpha <= 0.0;
        }
        format::AlphaMode::Blend => {
            material.alpha = AlphaMode::Blend {
                opacity: unit(alpha),
            };
            return alpha <= 0.0;
        }
    };
    if alpha < cutoff {
        notes.push(format!(
            "{at}: alpha {alpha} is under the cutoff {cutoff}: its surfaces are left out"
        ));
        return true;
    }
    // Dividing the cutoff by the factor is equivalent to multiplying the texture by it.
    if varies && alpha > 0.0 {
        material.alpha = AlphaMode::Mask {
            cutoff: cutoff / alpha,
        };
    }
    false
}
