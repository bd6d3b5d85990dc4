//! Ray queries of the scene relative to the camera: acceleration structure, alpha masks, and the surface at a
//! hit.

use glam::{Vec2, Vec3, Vec3A, Vec4};

use crate::accel::{Hit, HitPacket, Ray, RayPacket, Tlas};
use crate::numerics::gamma;
use crate::render::checkpoint::Pulse;
use crate::scene::{AlphaMode, Footprint, Material, Mesh, Texture};
use crate::simd::LaneMask;

use super::cone::{RayCone, footprint};
use super::object::Object;
use super::placed::Placed;
use super::surface::Surface;

/// Alpha of a blended surface below which it counts as absent: half an 8-bit step.
const LEAST_ALPHA: f32 = 0.5 / 255.0;

/// The objects that rays can hit. Camera space.
#[derive(Clone, Copy)]
pub(crate) struct SceneQuery<'a> {
    pub(crate) pulse: &'a Pulse<'a>,
    pub(crate) tlas: &'a Tlas,
    pub(crate) objects: &'a [Object],
    pub(crate) placed: &'a [Placed],
    pub(crate) materials: &'a [Material],
    /// Object and level of detail of each instance that casts shadows in place of its object; these follow the
    /// objects' own instances.
    pub(crate) shadow_lods: &'a [(u32, usize)],
    /// Whether some object has an alpha mask or is blended, so that its hits must be checked.
    pub(crate) has_filtered: bool,
}

impl SceneQuery<'_> {
    /// Material of a surface.
    #[inline]
    pub(crate) fn material(&self, surface: &Surface) -> &Material {
        &self.materials[surface.material as usize]
    }

    /// Object and level of detail that an instance of the acceleration structure represents.
    pub(crate) fn object_of(&self, instance: u32) -> (u32, usize) {
        let i = instance as usize;
        match self.placed.get(i) {
            Some(placed) => (instance, placed.lod),
            None => self.shadow_lods[i - self.placed.len()],
        }
    }

    /// Number of triangles of all objects at the frame's levels of detail.
    pub(crate) fn n_triangles(&self) -> u64 {
        let of = |(object, placed): (&Object, &Placed)| {
            object.lods.levels[placed.lod].mesh.triangles.len() as u64
        };
        self.objects.iter().zip(self.placed).map(of).sum()
    }

    /// The first hit of each ray among the objects of its mask, sixteen rays at a time: fastest if neighbours in
    /// the list are close in space.
    pub(crate) fn intersect_all(
        &self,
        rays: &[Ray],
        mask_of: impl Fn(usize) -> u8,
        hits: &mut Vec<Option<Hit>>,
    ) {
        hits.clear();
        let mut packet = RayPacket::default();
        let mut found = HitPacket::default();
        let n = rays.len();
        for rays in rays.chunks(16) {
            if !self.pulse.go_on() {
                hits.resize(n, None);
                return;
            }
            for (lane, ray) in rays.iter().enumerate() {
                packet.set(lane, ray);
            }
            let first = hits.len();
            hits.resize(first + rays.len(), None);
            // Lanes with the same mask are traced together; usually these are all lanes.
            let mut open = (u32::MAX >> (32 - rays.len())) as u16;
            while open != 0 {
                let mask = mask_of(first + open.trailing_zeros() as usize);
                let alike = |&lane: &usize| mask_of(first + lane) == mask;
                let active = LaneMask(open)
                    .into_iter()
                    .filter(alike)
                    .fold(0, |all, lane| all | 1 << lane);
                self.intersect_packet(&packet, active, mask, &mut found);
                for lane in LaneMask(active) {
                    hits[first + lane] = found.get(lane);
                }
                open &= !active;
            }
        }
    }

    pub(crate) fn occluded(&self, ray: &Ray, mask: u8) -> bool {
        if self.has_filtered {
            self.tlas
                .occluded_filtered(ray, mask, &|hit| self.is_solid(hit))
        } else {
            self.tlas.occluded(ray, mask)
        }
    }

    pub(crate) fn intersect_packet(
        &self,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        hits: &mut HitPacket,
    ) {
        if self.has_filtered {
            self.tlas.intersect_packet_filtered(
                rays,
                active,
                mask,
                &|_, hit| self.is_solid(hit),
                hits,
            );
        } else {
            self.tlas.intersect_packet(rays, active, mask, hits);
        }
    }

    pub(crate) fn intersect_packets(
        &self,
        rays: &[RayPacket],
        active: &[u16],
        mask: u8,
        hits: &mut [HitPacket],
    ) {
        if self.has_filtered {
            let solid = |_, hit: &Hit| self.is_solid(hit);
            self.tlas
                .intersect_packets_filtered(rays, active, mask, &solid, hits);
        } else {
            self.tlas.intersect_packets(rays, active, mask, hits);
        }
    }

    pub(crate) fn occluded_packet(&self, rays: &RayPacket, active: u16, mask: u8) -> u16 {
        if self.has_filtered {
            self.tlas
                .occluded_packet_filtered(rays, active, mask, &|_, hit| self.is_solid(hit))
        } else {
            self.tlas.occluded_packet(rays, active, mask)
        }
    }
}

/// Interpolates a per-vertex attribute.
fn interpolate<T: Copy + std::ops::Mul<f32, Output = T> + std::ops::Add<Output = T>>(
    values: &[T],
    [a, b, c]: [u32; 3],
    hit: &Hit,
) -> T {
    values[a as usize] * (1.0 - hit.u - hit.v)
        + values[b as usize] * hit.u
        + values[c as usize] * hit.v
}

impl SceneQuery<'_> {
    /// The mesh of an instance at the frame's level of detail.
    fn mesh(&self, instance: u32) -> &Mesh {
        let instance = instance as usize;
        &self.objects[instance].lods.levels[self.placed[instance].lod].mesh
    }

    /// The object that a ray hit, in its visible level or in the one that casts its shadow, and the unit normal
    /// at the hit on the side from which the ray came.
    pub(crate) fn facing(&self, hit: &Hit, direction: Vec3A) -> (&Object, Vec3A) {
        let (instance, lod) = self.object_of(hit.instance);
        let object = &self.objects[instance as usize];
        let placed = &self.placed[instance as usize];
        let mesh = &object.lods.levels[lod].mesh;
        let corners = mesh.triangles[hit.triangle as usize];
        let [a, b, c] = corners.map(|i| Vec3A::from(mesh.positions[i as usize]));
        let flat = (b - a).cross(c - a) * placed.orientation;
        let local = if mesh.normals.is_empty() {
            flat
        } else {
            Vec3A::from(interpolate::<Vec3>(&mesh.normals, corners, hit))
        };
        let normal = (placed.normal_from_object * local)
            .try_normalize()
            .unwrap_or(-direction);
        let away = normal.dot(direction) > 0.0;
        (object, if away { -normal } else { normal })
    }

    /// The surface hit by a ray of direction `direction`, with the ray's width from `cone`.
    pub(crate) fn surface(&self, hit: &Hit, direction: Vec3A, cone: RayCone) -> Surface {
        let object = &self.objects[hit.instance as usize];
        let placed = &self.placed[hit.instance as usize];
        let mesh = self.mesh(hit.instance);
        let corners = mesh.triangles[hit.triangle as usize];
        let [a, b, c] = corners.map(|i| Vec3A::from(mesh.positions[i as usize]));
        let local = a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v;
        let position = placed.camera_from_object.transform_point3a(local);
        let incoming = direction.try_normalize().unwrap_or(Vec3A::Z);

        // Interpolation has 5 roundings of the corners' size, the transform 4 of its terms' size (each matrix
        // entry is itself rounded once). The barycentrics have the rounding of the intersection, which stays
        // within the triangle's plane. Woop's shear adds about as much again: 32 covers the sum with some margin.
        let size = a.abs().max(b.abs()).max(c.abs());
        let m = &placed.camera_from_object;
        let reach = m.matrix3.x_axis.abs() * size.x
            + m.matrix3.y_axis.abs() * size.y
            + m.matrix3.z_axis.abs() * size.z
            + m.translation.abs();
        let error = gamma(32) * reach.max_element();

        let flat = placed.normal_from_object * (b - a).cross(c - a);
        let flat = (flat * placed.orientation)
            .try_normalize()
            .unwrap_or(-incoming);
        let front = incoming.dot(flat) < 0.0;
        let geometric_normal = if front { flat } else { -flat };

        let material = &self.materials[object.material as usize];
        let uv = if mesh.uvs.is_empty() {
            Vec2::ZERO
        } else {
            interpolate(&mesh.uvs, corners, hit)
        };
        // Not needed for a material without textures.
        let footprint = if mesh.uvs.is_empty() || !is_textured(material) {
            Footprint::default()
        } else {
            let [ta, tb, tc] = corners.map(|i| mesh.uvs[i as usize]);
            let edges =
                [b - a, c - a].map(|edge| placed.camera_from_object.transform_vector3a(edge));
            footprint(cone.width, incoming, flat, edges, [tb - ta, tc - ta])
        };
        let place = TexturePlace { uv, footprint };
        let mut normal = if mesh.normals.is_empty() {
            flat
        } else {
            let n: Vec3 = interpolate(&mesh.normals, corners, hit);
            (placed.normal_from_object * Vec3A::from(n))
                .try_normalize()
                .unwrap_or(flat)
        };
        if let (Some(texture), false) = (&material.normal_texture, mesh.uvs.is_empty()) {
            let [x, y, z, _] = place.of(texture);
            let [ta, tb, tc] = corners.map(|i| mesh.uvs[i as usize]);
            if let Some((tangent, bitangent)) = tangents([a, b, c], [ta, tb, tc]) {
                let t = placed.camera_from_object.transform_vector3a(tangent);
                let t = (t - normal * t.dot(normal)).try_normalize();
                if let Some(t) = t {
                    let world_b = placed.camera_from_object.transform_vector3a(bitangent);
                    let bi = normal.cross(t);
                    let bi = if bi.dot(world_b) < 0.0 { -bi } else { bi };
                    let (x, y) = (
                        (2.0 * x - 1.0) * material.normal_scale,
                        (2.0 * y - 1.0) * material.normal_scale,
                    );
                    normal = (t * x - bi * y + normal * (2.0 * z - 1.0))
                        .try_normalize()
                        .unwrap_or(normal);
                }
            }
        }
        // Facing the viewer, like the geometric normal.
        let normal = if normal.dot(geometric_normal) < 0.0 {
            -normal
        } else {
            normal
        };

        let mut surface = Surface {
            position,
            error,
            geometric_normal,
            normal,
            front,
            incoming,
            cone,
            instance: hit.instance,
            material: object.material,
            base_color: material.base_color.into(),
            metallic: material.metallic,
            roughness: material.roughness,
            emissive: material.emissive.into(),
            unoccluded: 1.0,
            opacity: match material.alpha {
                AlphaMode::Blend { opacity } => opacity * self.alpha(hit),
                _ => 1.0,
            },
        };
        surface.apply_textures(material, &place);
        if !mesh.colors.is_empty() && material.vertex_colors {
            let color: Vec4 = interpolate(&mesh.colors, corners, hit);
            surface.base_color *= Vec3A::from_vec4(color);
        }
        surface
    }

    /// Whether a hit on a surface with an alpha mask, or on a blended surface, counts.
    pub(crate) fn is_solid(&self, hit: &Hit) -> bool {
        let object = &self.objects[hit.instance as usize];
        match self.materials[object.material as usize].alpha {
            AlphaMode::Opaque => true,
            AlphaMode::Mask { cutoff } => self.alpha(hit) >= cutoff,
            AlphaMode::Blend { .. } => self.alpha(hit) >= LEAST_ALPHA,
        }
    }

    /// Alpha of texture and vertex colours at a hit.
    fn alpha(&self, hit: &Hit) -> f32 {
        let object = &self.objects[hit.instance as usize];
        let material = &self.materials[object.material as usize];
        let mesh = self.mesh(hit.instance);
        let corners = mesh.triangles[hit.triangle as usize];
        let mut alpha = 1.0;
        if let (Some(texture), false) = (&material.base_color_texture, mesh.uvs.is_empty()) {
            alpha = texture.sample(interpolate(&mesh.uvs, corners, hit))[3];
        }
        if !mesh.colors.is_empty() && material.vertex_colors {
            alpha *= interpolate::<Vec4>(&mesh.colors, corners, hit).w;
        }
        alpha
    }
}

/// Texture coordinates of a hit and the ray's footprint there.
struct TexturePlace {
    uv: Vec2,
    footprint: Footprint,
}

impl TexturePlace {
    fn of(&self, texture: &Texture) -> [f32; 4] {
        texture.sample_over(self.uv, &self.footprint)
    }
}

fn is_textured(material: &Material) -> bool {
    material.base_color_texture.is_some()
        || material.metallic_roughness_texture.is_some()
        || material.emissive_texture.is_some()
        || material.occlusion_texture.is_some()
        || material.normal_texture.is_some()
}

impl Surface {
    fn apply_textures(&mut self, material: &Material, place: &TexturePlace) {
        if let Some(texture) = &material.base_color_texture {
            let [r, g, b, _] = place.of(texture);
            self.base_color *= Vec3A::new(r, g, b);
        }
        if let Some(texture) = &material.metallic_roughness_texture {
            let [_, roughness, metallic, _] = place.of(texture);
            self.roughness *= roughness;
            self.metallic *= metallic;
        }
        if let Some(texture) = &material.emissive_texture {
            let [r, g, b, _] = place.of(texture);
            self.emissive *= Vec3A::new(r, g, b);
        }
        if let Some(texture) = &material.occlusion_texture {
            let [share, ..] = place.of(texture);
            self.unoccluded = 1.0 + material.occlusion_strength * (share - 1.0);
        }
    }
}

/// Object-space directions in which texture u and v increase over a triangle.
fn tangents([a, b, c]: [Vec3A; 3], [ta, tb, tc]: [Vec2; 3]) -> Option<(Vec3A, Vec3A)> {
    let (e1, e2) = (b - a, c - a);
    let (d1, d2) = (tb - ta, tc - ta);
    let det = d1.perp_dot(d2);
    if det == 0.0 {
        return None;
    }
    let tangent = (e1 * d2.y - e2 * d1.y) / det;
    let bitangent = (e2 * d1.x - e1 * d2.x) / det;
    (tangent.is_finite() && bitangent.is_finite()).then_some((tangent, bitangent))
}
