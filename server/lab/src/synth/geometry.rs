//! The room's geometry for rays and shading: patches with materials, and the sites where irradiance is baked. A
//! rectangle has a grid of sites (a lightmap), a triangle one per corner.

use glam::{DVec3, Vec2, Vec3};

use super::caster::{Caster, Hit};
use super::solid::Builder;
use super::texture::Pattern;

/// How a surface reflects and emits light.
#[derive(Debug, Clone, Copy)]
pub(super) struct Material {
    /// Diffuse colour.
    pub(super) pattern: Pattern,
    /// Fresnel reflectance at normal incidence; 0 for a surface without a specular lobe.
    pub(super) f0: f32,
    /// Width of the specular lobe, radians; 0 is a mirror.
    pub(super) gloss_rad: f32,
    /// Radiance of white, if the pattern emits light instead of reflecting it.
    pub(super) emission: Option<Vec3>,
    /// Whether [`super::light`] samples it as a light; gather rays must then not count it again.
    pub(super) sampled_light: bool,
    /// Diffuse reflectance for the projector's infrared light; `None`: as for red.
    pub(super) infrared: Option<f32>,
}

impl Material {
    /// A matte surface.
    pub(super) fn matte(pattern: Pattern) -> Self {
        Self {
            pattern,
            f0: 0.0,
            gloss_rad: 0.0,
            emission: None,
            sampled_light: false,
            infrared: None,
        }
    }

    /// The same with a specular lobe, as a dielectric (f0 0.04) or metal has.
    pub(super) fn glossy(self, f0: f32, gloss_rad: f32) -> Self {
        Self {
            f0,
            gloss_rad,
            ..self
        }
    }

    /// The same with a given diffuse reflectance in the infrared.
    pub(super) fn infrared(self, share: f32) -> Self {
        Self {
            infrared: Some(share),
            ..self
        }
    }
}

/// A point whose irradiance is baked.
#[derive(Debug, Clone, Copy)]
pub(super) struct Site {
    /// World metres, on the surface.
    pub(super) position: DVec3,
    /// Unit normal, outwards.
    pub(super) normal: DVec3,
}

/// The irradiance sites of a patch.
#[derive(Debug, Clone, Copy)]
pub(super) enum Sites {
    /// Row-major grid over (u, v), ends included.
    Grid {
        /// Index of the first site.
        first: u32,
        /// Sites along u, >= 2.
        columns: u32,
        /// Sites along v, >= 2.
        rows: u32,
    },
    /// Corners of a triangle: origin, origin + e1, origin + e2.
    Corners {
        /// Indices of the sites.
        sites: [u32; 3],
        /// Texture coordinates, 0..=1.
        uv: [Vec2; 3],
        /// Texture coordinates, metres.
        m: [Vec2; 3],
    },
}

/// Shading data of a patch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Facet {
    /// Unit geometric normal.
    pub(super) normal: DVec3,
    /// Index of the material.
    pub(super) material: u16,
    /// Edge lengths, metres.
    pub(super) size_m: Vec2,
    /// Irradiance sites.
    pub(super) sites: Sites,
}

/// A point of a surface, ready for shading.
#[derive(Debug, Clone, Copy)]
pub(super) struct SurfacePoint {
    /// World metres.
    pub(super) position: DVec3,
    /// Unit geometric normal, outwards.
    pub(super) normal: DVec3,
    /// Unit interpolated normal, outwards.
    pub(super) shading_normal: DVec3,
    /// Texture coordinates, 0..=1.
    pub(super) uv: Vec2,
    /// Texture coordinates, metres.
    pub(super) m: Vec2,
    /// Surrounding sites and their interpolation weights.
    pub(super) weights: [(u32, f32); 4],
}

/// Finished geometry.
#[derive(Debug)]
pub(super) struct Geometry {
    /// Ray queries.
    pub(super) caster: Caster,
    /// One per patch.
    pub(super) facets: Vec<Facet>,
    /// All irradiance sites.
    pub(super) sites: Vec<Site>,
    /// Pairs of neighbouring sites.
    pub(super) links: Vec<[u32; 2]>,
    /// Materials.
    pub(super) materials: Vec<Material>,
}

impl Geometry {
    /// Builds the BVH.
    pub(super) fn new(builder: Builder) -> Self {
        Self {
            caster: Caster::new(&builder.patches),
            facets: builder.facets,
            sites: builder.sites,
            links: builder.links,
            materials: builder.materials,
        }
    }

    /// The material of a hit.
    pub(super) fn material(&self, hit: &Hit) -> &Material {
        &self.materials[usize::from(self.facets[hit.patch as usize].material)]
    }

    /// Shading data of a hit at `position`.
    pub(super) fn surface(&self, hit: &Hit, position: DVec3) -> SurfacePoint {
        let facet = &self.facets[hit.patch as usize];
        let (u, v) = (hit.u as f32, hit.v as f32);
        match facet.sites {
            Sites::Grid {
                first,
                columns,
                rows,
            } => {
                let x = u * (columns - 1) as f32;
                let y = v * (rows - 1) as f32;
                let (i, j) = ((x as u32).min(columns - 2), (y as u32).min(rows - 2));
                let (fx, fy) = (x - i as f32, y - j as f32);
                let a = first + j * columns + i;
                SurfacePoint {
                    position,
                    normal: facet.normal,
                    shading_normal: facet.normal,
                    uv: Vec2::new(u, v),
                    m: Vec2::new(u, v) * facet.size_m,
                    weights: [
                        (a, (1.0 - fx) * (1.0 - fy)),
                        (a + 1, fx * (1.0 - fy)),
                        (a + columns, (1.0 - fx) * fy),
                        (a + columns + 1, fx * fy),
                    ],
                }
            }
            Sites::Corners { sites, uv, m } => {
                let w = [1.0 - u - v, u, v];
                let mix = |c: [Vec2; 3]| c[0] * w[0] + c[1] * w[1] + c[2] * w[2];
                let normal = (0..3).fold(DVec3::ZERO, |n, k| {
                    n + self.sites[sites[k] as usize].normal * f64::from(w[k])
                });
                SurfacePoint {
                    position,
                    normal: facet.normal,
                    shading_normal: normal.try_normalize().unwrap_or(facet.normal),
                    uv: mix(uv),
                    m: mix(m),
                    weights: [
                        (sites[0], w[0]),
                        (sites[1], w[1]),
                        (sites[2], w[2]),
                        (sites[0], 0.0),
                    ],
                }
            }
        }
    }
}
