//! Materials and textures. A mesh has one set of texture coordinates, so a material's
//! textures must agree on theirs; those that don't are left out with a note.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::super::error::MeshError;
use super::super::{AlphaMode, LoadContext, Material, Texture, texture};
use super::accessor::Data;
use super::container::resolve_uri;
use super::format::{self, MaterialEntry, TextureRef};

/// Brightest emission kept, linear radiance.
const MAX_EMISSION: f32 = 1e6;

/// A material with what its meshes must know.
pub(super) struct Loaded {
    pub(super) material: Material,
    pub(super) mapping: Mapping,
    /// Nothing of it is above the alpha cutoff.
    pub(super) invisible: bool,
}

/// Which texture coordinates are used, and how (KHR_texture_transform).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Mapping {
    /// n of TEXCOORD_n.
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

    /// Scaled, turned counter-clockwise (v points down), moved.
    pub(super) fn apply(&self, uv: Vec2) -> Vec2 {
        let (sin, cos) = self.rotation.sin_cos();
        let uv = uv * self.scale;
        Vec2::new(cos * uv.x + sin * uv.y, cos * uv.y - sin * uv.x) + self.offset
    }
}

/// All materials of the file.
pub(super) fn load(
    context: &LoadContext,
    data: &Data<'_>,
    folder: &Path,
    notes: &mut Vec<String>,
) -> Result<Vec<Loaded>, MeshError> {
    let mut textures = Textures {
        context,
        data,
        folder,
        decoded: HashMap::new(),
        n_texels: 0,
        notes,
    };
    data.root
        .materials
        .iter()
        .enumerate()
        .map(|(i, entry)| convert(i, entry, &mut textures))
        .collect()
}

fn convert(
    i: usize,
    entry: &MaterialEntry,
    textures: &mut Textures<'_, '_>,
) -> Result<Loaded, MeshError> {
    let at = format!("materials[{i}]");
    let pbr = &entry.pbr_metallic_roughness;
    let references = [
        (pbr.base_color_texture.as_ref(), true, "baseColorTexture"),
        (
            pbr.metallic_roughness_texture.as_ref(),
            false,
            "metallicRoughnessTexture",
        ),
        (entry.normal_texture.as_ref(), false, "normalTexture"),
        (entry.emissive_texture.as_ref(), true, "emissiveTexture"),
    ];
    let mapping = references
        .iter()
        .find_map(|(reference, ..)| reference.map(Mapping::of))
        .unwrap_or_default();
    let mut loaded = [const { None }; 4];
    for (slot, (reference, srgb, what)) in loaded.iter_mut().zip(references) {
        let Some(reference) = reference else { continue };
        if Mapping::of(reference) != mapping {
            textures
                .notes
                .push(format!("{at}.{what} left out: it uses other texture coordinates than the material's first texture"));
            continue;
        }
        *slot = textures.get(reference.index, srgb, &format!("{at}.{what}"))?;
    }
    let [
        base_color_texture,
        metallic_roughness_texture,
        normal_texture,
        emissive_texture,
    ] = loaded;
    let [r, g, b, alpha] = pbr.base_color_factor.map(unit);
    let mut material = Material {
        name: entry.name.clone(),
        base_color: Vec3::new(r, g, b),
        base_color_texture,
        metallic: unit(pbr.metallic_factor),
        roughness: unit(pbr.roughness_factor),
        metallic_roughness_texture,
        emissive: emission(entry),
        emissive_texture,
        normal_texture,
        normal_scale: entry
            .normal_texture
            .as_ref()
            .map_or(1.0, |t| t.scale.clamp(-1e3, 1e3)),
        ..Material::default()
    };
    transmission(entry, &at, &mut material, textures.notes);
    let invisible = alpha_mode(entry, alpha, &at, &mut material, textures.notes);
    Ok(Loaded {
        material,
        mapping,
        invisible,
    })
}

fn unit(x: f32) -> f32 {
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
        // Without a volume, or one without thickness, the surface is a thin wall.
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

/// Sets how alpha is read; true if nothing of the surface is left.
fn alpha_mode(
    entry: &MaterialEntry,
    alpha: f32,
    at: &str,
    material: &mut Material,
    notes: &mut Vec<String>,
) -> bool {
    let cutoff = match entry.alpha_mode {
        format::AlphaMode::Opaque => return false,
        format::AlphaMode::Mask => unit(entry.alpha_cutoff.unwrap_or(0.5)),
        format::AlphaMode::Blend if material.base_color_texture.is_none() => {
            // An even veil is glass rather than a mask.
            if alpha < 1.0 && material.transmission == 0.0 {
                material.transmission = 1.0 - alpha;
                material.thin = true;
                notes.push(format!(
                    "{at}: blending is rendered as a thin sheet that lets {:.0} % through",
                    100.0 * (1.0 - alpha)
                ));
            }
            return false;
        }
        format::AlphaMode::Blend => {
            notes.push(format!("{at}: blending is rendered as a mask"));
            0.5
        }
    };
    if alpha < cutoff {
        notes.push(format!(
            "{at}: alpha {alpha} is under the cutoff {cutoff}: its surfaces are left out"
        ));
        return true;
    }
    // The factor multiplies the texture's alpha; dividing the cutoff says the same.
    if material.base_color_texture.is_some() && alpha > 0.0 {
        material.alpha = AlphaMode::Mask {
            cutoff: cutoff / alpha,
        };
    }
    false
}

struct Textures<'a, 'n> {
    context: &'a LoadContext,
    data: &'a Data<'a>,
    folder: &'a Path,
    decoded: HashMap<(usize, bool), Arc<Texture>>,
    n_texels: u64,
    notes: &'n mut Vec<String>,
}

impl Textures<'_, '_> {
    fn get(
        &mut self,
        index: usize,
        srgb: bool,
        at: &str,
    ) -> Result<Option<Arc<Texture>>, MeshError> {
        let root = self.data.root;
        let fail = |problem: String| MeshError::at(self.data.file, at, problem);
        let entry = root.textures.get(index).ok_or_else(|| {
            fail(format!(
                "index: expected less than the {} textures, got {index}",
                root.textures.len()
            ))
        })?;
        let Some(source) = entry.source else {
            self.notes.push(format!(
                "{at} left out: its image is in a format other than PNG or JPEG"
            ));
            return Ok(None);
        };
        if let Some(known) = self.decoded.get(&(source, srgb)) {
            return Ok(Some(Arc::clone(known)));
        }
        let image = root.images.get(source).ok_or_else(|| {
            fail(format!(
                "textures[{index}].source: expected less than the {} images, got {source}",
                root.images.len()
            ))
        })?;
        let texture = match (&image.uri, image.buffer_view) {
            (_, Some(view)) => self.context.texture(self.data.view(view, at)?, srgb),
            (Some(uri), None) => resolve_uri(self.context, uri, self.folder, texture::MAX_BYTES)
                .and_then(|bytes| self.context.texture(&bytes, srgb)),
            (None, None) => Err("expected a uri or a bufferView, got neither".to_owned()),
        }
        .map_err(|problem| fail(format!("images[{source}]: {problem}")))?;
        self.n_texels += u64::from(texture.width) * u64::from(texture.height);
        if self.n_texels > texture::MAX_TEXELS_IN_ALL {
            return Err(fail(format!(
                "expected at most {} texels in all, got more",
                texture::MAX_TEXELS_IN_ALL
            )));
        }
        self.note_wrapping(entry.sampler, at);
        self.decoded.insert((source, srgb), Arc::clone(&texture));
        Ok(Some(texture))
    }

    fn note_wrapping(&mut self, sampler: Option<usize>, at: &str) {
        let Some(sampler) = sampler.and_then(|i| self.data.root.samplers.get(i)) else {
            return;
        };
        let repeats = |wrap: Option<u32>| wrap.is_none_or(|w| w == 10_497);
        if !repeats(sampler.wrap_s) || !repeats(sampler.wrap_t) {
            self.notes.push(format!(
                "{at}: the texture repeats instead of being clamped or mirrored"
            ));
        }
    }
}
