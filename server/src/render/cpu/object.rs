//! What of a scene the renderer wants to know at a glance, found once.

use std::sync::Arc;

use glam::{Affine3A, DAffine3, Mat3A, Vec2, Vec3, Vec3A};

use crate::accel::{MASK_GHOST, TlasInstance};
use crate::scene::{
    AlphaMode, Environment, EnvironmentLights, Harmonics, Instance, Light, Material, Mesh, Scene,
    Texture,
};

use super::caustic::throws_caustics;
use super::environment::CoarseMap;
use super::map_levels::MapLevels;
use super::scatter::MIRROR_ROUGHNESS;
use super::shape::{Shape, Use};
use super::{MASK_GLASS, MASK_OPAQUE, MASK_SHADOW, MASK_SHEET, bsdf};

/// An environment map ready for shading: what its lights do not carry.
pub(super) struct MapLight {
    pub(super) map: Environment,
    pub(super) ambient: Harmonics,
    /// The same light, coarse.
    pub(super) coarse: CoarseMap,
    /// What wider and wider lookups see of it.
    pub(super) levels: MapLevels,
    /// Luminance above which its radiance is that of lights taken from it.
    pub(super) threshold: f32,
}

/// An instance with what shading needs to know at a glance.
pub(super) struct Object {
    pub(super) shape: Arc<Shape>,
    pub(super) material: u32,
    pub(super) world_from_object: DAffine3,
    pub(super) ghost: bool,
    pub(super) mask: u8,
    /// Alpha mask: hits are asked whether they count.
    pub(super) filtered: bool,
    /// Whether lights show on it at all (a perfect mirror's do not, but as reflections).
    pub(super) needs_light: bool,
    /// What is left of light that crosses it.
    pub(super) shadow_tint: Vec3A,
    /// Shows ambient light by diffusing it.
    pub(super) diffuses: bool,
    /// What it does with light on the whole.
    pub(super) mean: MeanMaterial,
    /// What its mesh is wanted for, but for shadows.
    pub(super) wanted: Use,
    /// Centre and radius of a ball around the mesh, object space, if it throws caustics.
    pub(super) caustic_ball: Option<(Vec3A, f32)>,
}

/// A material as even over a mesh: what is far off, or only dimly seen, needs no more.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeanMaterial {
    /// Diffuse albedo below the boundary.
    pub(super) diffuse: Vec3A,
    /// Reflectance at normal incidence.
    pub(super) f0: Vec3A,
    /// Share of the light that enters which goes through.
    pub(super) through: Vec3A,
    /// Radiance.
    pub(super) emissive: Vec3A,
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

/// Mean of a texture over the places that a mesh shows of it: its corners, not more than
/// [`MOST_LOOKUPS`] of them.
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

/// An object's place relative to the current camera.
pub(super) struct Placed {
    /// Which of its shape's versions is seen.
    pub(super) version: usize,
    pub(super) camera_from_object: Affine3A,
    /// Inverse transpose of its linear part.
    pub(super) normal_from_object: Mat3A,
    /// -1 if it mirrors.
    pub(super) orientation: f32,
}

impl Placed {
    pub(super) fn new(camera_from_object: Affine3A) -> Self {
        let linear = camera_from_object.matrix3;
        let det = linear.determinant();
        Self {
            version: 0,
            camera_from_object,
            // A singular object is skipped by the tree; its normals are never asked for.
            normal_from_object: if det == 0.0 {
                Mat3A::IDENTITY
            } else {
                linear.inverse().transpose()
            },
            orientation: if det < 0.0 { -1.0 } else { 1.0 },
        }
    }

    /// An object-space ball in camera space: a ball around what becomes of it.
    pub(super) fn ball(&self, (center, radius): (Vec3A, f32)) -> (Vec3A, f32) {
        let linear = self.camera_from_object.matrix3;
        // The largest row sum of A^T A bounds its largest eigenvalue, the square of how far A
        // stretches; for a rotation with a scale per axis it is that.
        let gram = linear.transpose() * linear;
        let rows = gram.x_axis.abs() + gram.y_axis.abs() + gram.z_axis.abs();
        let center = self.camera_from_object.transform_point3a(center);
        (center, radius * rows.max_element().sqrt())
    }
}

impl Object {
    /// Puts it before a camera of focal length `focal_px`, in versions that are off by no more than
    /// `detail_px` pixels: as it is seen, and as it casts shadows on what is real if that is with
    /// another one, with the number of that version.
    pub(super) fn place(
        &self,
        camera_from_object: Affine3A,
        focal_px: f32,
        detail_px: f32,
    ) -> (Placed, TlasInstance, Option<(TlasInstance, usize)>) {
        let mut placed = Placed::new(camera_from_object);
        let version = |wanted| self.shape.version_for(wanted, &placed, focal_px, detail_px);
        let seen = version(self.wanted);
        let instance = |version: usize, mask| TlasInstance {
            blas: self.shape.versions[version].blas.clone(),
            camera_from_object,
            mask,
            filtered: self.filtered,
        };
        let of_shadow = version(Use::Shadow);
        let both = if self.mask != MASK_OPAQUE {
            (instance(seen, self.mask), None)
        } else if of_shadow > seen && !self.filtered {
            let shadow = instance(of_shadow, MASK_SHADOW);
            (instance(seen, MASK_OPAQUE), Some((shadow, of_shadow)))
        } else {
            // What is cut out of a mesh by its texture is looked up in the version that is seen.
            (instance(seen, MASK_OPAQUE | MASK_SHADOW), None)
        };
        placed.version = seen;
        (placed, both.0, both.1)
    }
}

/// A scene's instances; `shapes` and `material_needs_light` are its meshes' and materials'.
pub(super) fn objects(
    scene: &Scene,
    shapes: &[Arc<Shape>],
    material_needs_light: &[bool],
) -> Vec<Object> {
    let has_alpha = |instance: &Instance, material: &Material| {
        let colors = &scene.meshes[instance.mesh as usize].colors;
        material.base_color_texture.is_some() || (material.vertex_colors && !colors.is_empty())
    };
    let object = |instance: &Instance| {
        let material = &scene.materials[instance.material as usize];
        let shape = shapes[instance.mesh as usize].clone();
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
            caustic_ball: shape.ball.filter(|_| throws_caustics(material)),
            shape,
        }
    };
    scene.instances.iter().map(object).collect()
}

/// Whether light that falls on a material directly can be seen: not on a mirror or clear glass.
pub(super) fn needs_light(material: &Material) -> bool {
    let textured = material.metallic_roughness_texture.is_some();
    let diffuse = material.transmission < 1.0 && (material.metallic < 1.0 || textured);
    let glossy = material.roughness >= MIRROR_ROUGHNESS || textured;
    diffuse || material.clearcoat > 0.0 || (glossy && material.transmission == 0.0)
}

/// Whether light goes on through a material, refracted or between what is there of it.
pub(super) fn lets_light_through(material: &Material) -> bool {
    material.transmission > 0.0 || matches!(material.alpha, AlphaMode::Blend { .. })
}

/// Whether light that goes on through a material changes its direction on the way.
pub(super) fn bends_light(material: &Material) -> bool {
    material.transmission > 0.0 && !material.thin
}

/// What is left of light that crosses an object: two crossings of a clear boundary at normal incidence,
/// and the material's own colour; of a blended one also what passes between.
pub(super) fn shadow_tint(material: &Material, mesh: &Mesh) -> Vec3A {
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

/// The scene's lights; a scene with a map and no lights has its brightest parts as lights, and the
/// map's diffuse light is what they leave.
pub(super) fn lights_and_map(scene: &Scene) -> (Vec<Light>, Option<MapLight>) {
    let Some(map) = &scene.environment else {
        return (scene.lights.clone(), None);
    };
    if !scene.lights.is_empty() {
        return (
            scene.lights.clone(),
            Some(MapLight {
                map: map.clone(),
                ambient: map.harmonics(),
                coarse: CoarseMap::new(&map.coarse(f64::INFINITY)),
                levels: MapLevels::new(map, f32::INFINITY),
                threshold: f32::INFINITY,
            }),
        );
    }
    let EnvironmentLights {
        lights,
        ambient,
        threshold,
    } = map.to_lights(Environment::DEFAULT_LIGHTS);
    (
        lights,
        Some(MapLight {
            map: map.clone(),
            ambient,
            coarse: CoarseMap::new(&map.coarse(threshold)),
            levels: MapLevels::new(map, threshold as f32),
            threshold: threshold as f32,
        }),
    )
}
