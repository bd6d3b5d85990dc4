//! Properties of a scene's objects that the renderer needs often, computed once.

use std::sync::Arc;

use glam::{Affine3A, DAffine3, Vec2, Vec3, Vec3A};

use crate::accel::{MASK_GHOST, TlasInstance};
use crate::scene::{AlphaMode, Instance, Material, Mesh, Scene, Texture};

use super::bsdf;
use super::mask::{MASK_GLASS, MASK_OPAQUE, MASK_SHADOW, MASK_SHEET, MASK_TRANSMISSIVE};
use super::material::{bends_light, lets_light_through, throws_caustics};
use super::mesh_lods::{MeshLods, Use};
use super::placed::Placed;

/// An instance with properties for shading.
pub(crate) struct Object {
    pub(crate) lods: Arc<MeshLods>,
    pub(crate) material: u32,
    pub(crate) world_from_object: DAffine3,
    pub(crate) ghost: bool,
    pub(crate) mask: u8,
    /// Whether hits must be checked against alpha.
    pub(crate) filtered: bool,
    /// Whether direct light is visible on it (lamps in a perfect mirror are reflections instead).
    pub(crate) needs_light: bool,
    /// Share of light that remains after crossing the object.
    pub(crate) shadow_tint: Vec3A,
    /// Whether it has a diffuse reflection of ambient light.
    pub(crate) diffuses: bool,
    /// Its material, averaged over the mesh.
    pub(crate) mean: MeanMaterial,
    /// The use for which its level of detail is selected, except for shadows.
    pub(crate) wanted: Use,
    /// Bounding sphere of the mesh: centre and radius, object space; only if it causes caustics.
    pub(crate) caustic_ball: Option<(Vec3A, f32)>,
}

/// A material averaged over a mesh, for objects that are far away or dimly lit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MeanMaterial {
    /// Diffuse albedo below the specular boundary.
    pub(crate) diffuse: Vec3A,
    /// Reflectance at normal incidence.
    pub(crate) f0: Vec3A,
    /// Share of the entering light that is transmitted.
    pub(crate) through: Vec3A,
    /// Radiance.
    pub(crate) emissive: Vec3A,
}

impl MeanMaterial {
    fn new(material: &Material, mesh: &Mesh) -> Self {
        let of = |texture: &Option<Arc<Texture>>| {
            let texture = texture.as_ref().filter(|_| !mesh.uvs.is_empty());
            texture.map_or([1.0; 4], |texture| mean_where_used(texture, mesh))
        };
        let rgb = |[r, g, b, _]: [f32; 4]| Vec3::new(r, g, b);
        let mut base = material.base_color * rgb(of(&material.base_color_texture));
        if material.vertex_colors && !mesh.colors.is_empty() {
            let sum: Vec3 = mesh.colors.iter().map(|color| color.truncate()).sum();
            base *= sum / mesh.colors.len() as f32;
        }
        let base = Vec3A::from(base);
        let metallic = material.metallic * of(&material.metallic_roughness_texture)[2];
        let dielectric = Vec3A::splat(bsdf::f0_of_ior(material.ior));
        Self {
            diffuse: base * ((1.0 - metallic) * (1.0 - material.transmission)),
            f0: dielectric.lerp(base, metallic),
            through: base * ((1.0 - metallic) * material.transmission),
            emissive: Vec3A::from(material.emissive * rgb(of(&material.emissive_texture))),
        }
    }
}

/// Mean of a texture over the parts that a mesh shows: at its corners, at most [`MOST_LOOKUPS`] of them.
fn mean_where_used(texture: &Texture, mesh: &Mesh) -> [f32; 4] {
    const MOST_LOOKUPS: usize = 4096;
    let step = mesh.triangles.len().div_ceil(MOST_LOOKUPS).max(1);
    let mut sum = [0.0_f64; 4];
    let mut n = 0.0_f64;
    for corners in mesh.triangles.iter().step_by(step) {
        let middle = corners.map(|i| mesh.uvs[i as usize]).iter().sum::<Vec2>() / 3.0;
        for (sum, x) in sum.iter_mut().zip(texture.sample(middle)) {
            *sum += f64::from(x);
        }
        n += 1.0;
    }
    sum.map(|sum| (sum / n.max(1.0)) as f32)
}

impl Object {
    /// Places the object relative to a camera of focal length `focal_px`, in levels of detail whose error is at
    /// most `lod_error_px` pixels. Returns the placement, the visible instance and, if shadows on real surfaces
    /// use another level, the instance that casts them with its level.
    pub(crate) fn place(
        &self,
        camera_from_object: Affine3A,
        focal_px: f32,
        lod_error_px: f32,
    ) -> (Placed, TlasInstance, Option<(TlasInstance, usize)>) {
        let mut placed = Placed::new(camera_from_object);
        let lod = |wanted| self.lods.lod_for(wanted, &placed, focal_px, lod_error_px);
        let seen = lod(self.wanted);
        let instance = |lod: usize, mask| TlasInstance {
            blas: self.lods.levels[lod].blas.clone(),
            camera_from_object,
            mask,
            filtered: self.filtered,
        };
        let of_shadow = lod(Use::Shadow);
        let both = if self.mask != MASK_OPAQUE {
            (instance(seen, self.mask), None)
        } else if of_shadow > seen && !self.filtered {
            let shadow = instance(of_shadow, MASK_SHADOW);
            (instance(seen, MASK_OPAQUE), Some((shadow, of_shadow)))
        } else {
            // The alpha mask is looked up in the visible level.
            (instance(seen, MASK_OPAQUE | MASK_SHADOW), None)
        };
        placed.lod = seen;
        (placed, both.0, both.1)
    }
}

/// A scene's instances; `lods` and `material_needs_light` are its meshes' and materials'.
pub(crate) fn objects(
    scene: &Scene,
    lods: &[Arc<MeshLods>],
    material_needs_light: &[bool],
) -> Vec<Object> {
    let has_alpha = |instance: &Instance, material: &Material| {
        let colors = &scene.meshes[instance.mesh as usize].colors;
        material.base_color_texture.is_some() || (material.vertex_colors && !colors.is_empty())
    };
    let object = |instance: &Instance| {
        let material = &scene.materials[instance.material as usize];
        let lods = lods[instance.mesh as usize].clone();
        Object {
            material: instance.material,
            world_from_object: instance.world_from_object,
            ghost: instance.ghost,
            mask: if instance.ghost {
                MASK_GHOST
            } else if bends_light(material) {
                MASK_GLASS
            } else if lets_light_through(material) {
                MASK_SHEET
            } else {
                MASK_OPAQUE
            },
            filtered: material.alpha != AlphaMode::Opaque && has_alpha(instance, material),
            needs_light: material_needs_light[instance.material as usize],
            shadow_tint: shadow_tint(material, &scene.meshes[instance.mesh as usize]),
            diffuses: (material.metallic < 1.0 || material.metallic_roughness_texture.is_some())
                && material.transmission < 1.0,
            mean: MeanMaterial::new(material, &scene.meshes[instance.mesh as usize]),
            wanted: if throws_caustics(material) {
                Use::Specular
            } else {
                Use::Matte
            },
            caustic_ball: lods.ball.filter(|_| throws_caustics(material)),
            lods,
        }
    };
    scene.instances.iter().map(object).collect()
}

/// Share of light that remains after crossing an object: two crossings of a clear boundary at normal incidence,
/// and the material's own colour; for a blended material also the light that passes between.
pub(crate) fn shadow_tint(material: &Material, mesh: &Mesh) -> Vec3A {
    let enters = 1.0 - bsdf::f0_of_ior(material.ior);
    let through = Vec3A::from(material.base_color) * (material.transmission * enters * enters);
    match material.alpha {
        AlphaMode::Blend { opacity } => {
            let texture = material.base_color_texture.as_ref();
            let texture = texture.filter(|_| !mesh.uvs.is_empty());
            let alpha = texture.map_or(1.0, |texture| mean_where_used(texture, mesh)[3]);
            through.lerp(Vec3A::ONE, 1.0 - opacity * alpha)
        }
        _ => through,
    }
}

/// Which objects transmit light, and whether shadow rays need to know which one they hit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Transmissive {
    /// No object transmits light.
    None,
    /// All transmissive objects share one tint, that of this object, so shadow rays need only any-hit.
    SameTint(u32),
    /// Several tints: a shadow ray needs the nearest hit.
    Mixed,
}

impl Transmissive {
    pub(crate) fn of(objects: &[Object]) -> Self {
        let mut transmissive = (0..)
            .zip(objects)
            .filter(|(_, object)| object.mask & MASK_TRANSMISSIVE != 0);
        let Some((first, object)) = transmissive.next() else {
            return Self::None;
        };
        if transmissive.all(|(_, other)| other.shadow_tint == object.shadow_tint) {
            Self::SameTint(first)
        } else {
            Self::Mixed
        }
    }
}
