//! Input of the path tracer: patches with materials, lights, and uniform radiance from the surroundings.

use std::sync::Arc;

use glam::{DAffine3, DVec2, DVec3, Vec3};

use super::bsdf::Reflectance;
use super::tree::{Patch, Tree};
use ghostlight::scene;

/// A colour as a function of a facet's [`Facet::paint`] number and the position (u, v) on its patch.
pub type Paint = Arc<dyn Fn(u32, DVec2) -> DVec3 + Send + Sync>;

/// A colour over a surface.
#[derive(Clone)]
pub enum Colour {
    /// A constant colour.
    Flat(DVec3),
    /// A colour that depends on the position.
    Painted(Paint),
}

impl Colour {
    pub(super) fn at(&self, facet: &Facet, place: DVec2) -> DVec3 {
        match self {
            Self::Flat(colour) => *colour,
            Self::Painted(paint) => paint(facet.paint, place),
        }
    }
}

/// A surface's material.
#[derive(Clone)]
pub struct Material {
    /// Multiplies [`Reflectance::base`].
    pub colour: Colour,
    /// Reflectance without the colour.
    pub reflectance: Reflectance,
    /// Radiance emitted on its outside.
    pub emission: Option<Colour>,
    /// Share of light that remains after a metre inside, per channel (Beer-Lambert).
    pub kept_per_metre: DVec3,
    /// Whether a mesh's vertex colours replace `colour`.
    pub vertex_colours: bool,
}

impl Material {
    /// A Lambertian material, without gloss.
    pub fn matte(albedo: DVec3) -> Self {
        Self {
            colour: Colour::Flat(DVec3::ONE),
            reflectance: Reflectance {
                base: albedo,
                diffuse: 1.0,
                f0: DVec3::ZERO,
                f90: 0.0,
                alpha: 0.0,
                transmission: 0.0,
                ior: 1.0,
                thin: false,
            },
            emission: None,
            kept_per_metre: DVec3::ONE,
            vertex_colours: false,
        }
    }

    /// A material of the scene format; textures are ignored.
    pub fn of_scene(material: &scene::Material) -> Self {
        let base = material.base_color.as_dvec3();
        let (ior, metallic) = (f64::from(material.ior), f64::from(material.metallic));
        let dielectric = ((ior - 1.0) / (ior + 1.0)).powi(2);
        let distance = f64::from(material.attenuation_distance_m);
        Self {
            colour: Colour::Flat(DVec3::ONE),
            reflectance: Reflectance {
                base,
                diffuse: 1.0 - metallic,
                f0: DVec3::splat(dielectric).lerp(base, metallic),
                f90: 1.0,
                alpha: f64::from(material.roughness).powi(2),
                transmission: f64::from(material.transmission),
                ior,
                thin: material.thin,
            },
            emission: (material.emissive != Vec3::ZERO)
                .then(|| Colour::Flat(material.emissive.as_dvec3())),
            kept_per_metre: material.attenuation_color.as_dvec3().powf(1.0 / distance),
            vertex_colours: material.vertex_colors,
        }
    }
}

/// Material and shading data of a patch.
#[derive(Debug, Clone, Copy)]
pub struct Facet {
    /// Index into [`World::materials`].
    pub material: usize,
    /// Unit normals at origin, origin + e1, origin + e2, for smooth shading.
    pub normals: Option<[DVec3; 3]>,
    /// Argument for the material's [`Paint`].
    pub paint: u32,
    /// Identifies the object it belongs to, for the caller.
    pub thing: u32,
}

/// A light for light sampling.
#[derive(Debug, Clone, Copy)]
pub enum Light {
    /// A sphere with uniform emission. It is visible to rays that have bounced but not to camera rays, and blocks the
    /// light of others.
    Ball {
        /// Position, metres.
        centre: DVec3,
        /// Radius, metres, > 0.
        radius: f64,
        /// Radiance, W/(m2 sr).
        radiance: DVec3,
    },
    /// A patch whose material emits.
    Patch {
        /// Index of the patch.
        patch: usize,
    },
}

/// The complete input of a rendering.
#[derive(Clone, Default)]
pub struct World {
    /// Surfaces.
    pub patches: Vec<Patch>,
    /// One per patch.
    pub facets: Vec<Facet>,
    /// Materials.
    pub materials: Vec<Material>,
    /// Lights. A patch that emits without being listed here still illuminates, with more noise.
    pub lights: Vec<Light>,
    /// Radiance of rays without a hit.
    pub surroundings: DVec3,
}

impl World {
    /// Adds a mesh; each triangle gets the number `thing`. Normals are transformed by the inverse transpose.
    pub fn add_mesh(
        &mut self,
        mesh: &scene::Mesh,
        world_from_mesh: DAffine3,
        mut material: Material,
        thing: u32,
    ) {
        let turned = world_from_mesh.matrix3.inverse().transpose();
        let mirrored = world_from_mesh.matrix3.determinant() < 0.0;
        // A mirrored mesh keeps its outside if the order of the corners is reversed.
        let corners_of = move |[a, b, c]: [u32; 3]| {
            let [a, b, c] = [a, b, c].map(|i| i as usize);
            if mirrored { [a, c, b] } else { [a, b, c] }
        };
        let coloured = material.vertex_colours && !mesh.colors.is_empty();
        if coloured {
            let of = |i: usize| mesh.colors[i].truncate().as_dvec3();
            let colours: Vec<[DVec3; 3]> = mesh
                .triangles
                .iter()
                .map(|&triangle| corners_of(triangle).map(of))
                .collect();
            material.colour = Colour::Painted(Arc::new(move |paint, place| {
                let [a, b, c] = colours[paint as usize];
                a * (1.0 - place.x - place.y) + b * place.x + c * place.y
            }));
        }
        self.materials.push(material);
        let material = self.materials.len() - 1;
        for (paint, &triangle) in mesh.triangles.iter().enumerate() {
            let corners = corners_of(triangle);
            let [p, q, r] =
                corners.map(|i| world_from_mesh.transform_point3(mesh.positions[i].as_dvec3()));
            let normals = (!mesh.normals.is_empty()).then(|| {
                corners.map(|i| (turned * mesh.normals[i].as_dvec3()).normalize_or_zero())
            });
            self.patches.push(Patch {
                origin: p,
                e1: q - p,
                e2: r - p,
                triangle: true,
            });
            self.facets.push(Facet {
                material,
                normals,
                paint: if coloured { paint as u32 } else { 0 },
                thing,
            });
        }
    }

    /// Adds a single patch, and returns its index.
    pub fn add_patch(&mut self, patch: Patch, material: Material, thing: u32) -> usize {
        self.materials.push(material);
        self.patches.push(patch);
        self.facets.push(Facet {
            material: self.materials.len() - 1,
            normals: None,
            paint: 0,
            thing,
        });
        self.patches.len() - 1
    }

    /// Prepares the world for ray tracing.
    pub fn tracer(&self) -> super::Tracer<'_> {
        let mut light_of_patch = vec![None; self.patches.len()];
        for (k, light) in self.lights.iter().enumerate() {
            if let Light::Patch { patch } = *light {
                light_of_patch[patch] = Some(k);
            }
        }
        super::Tracer {
            world: self,
            tree: Tree::new(self.patches.clone()),
            light_of_patch,
        }
    }
}
