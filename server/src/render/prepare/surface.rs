//! The surface at a mesh hit: position, normals and material, in camera space.

use glam::Vec3A;

use super::bsdf::reflect;
use super::cone::RayCone;

/// The surface of a mesh where a ray hits it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surface {
    /// Camera space, metres.
    pub(crate) position: Vec3A,
    /// Bound on the error of `position` along the normal, metres: rays start outside of it.
    pub(crate) error: f32,
    /// Unit geometric normal of the triangle, towards the side from which the ray came.
    pub(crate) geometric_normal: Vec3A,
    /// Unit shading normal, interpolated and normal-mapped, towards the side from which the ray came.
    pub(crate) normal: Vec3A,
    /// Whether the ray hit the outside.
    pub(crate) front: bool,
    /// Unit direction of the ray.
    pub(crate) incoming: Vec3A,
    /// Cone of the ray at the hit.
    pub(crate) cone: RayCone,
    pub(crate) instance: u32,
    pub(crate) material: u32,
    pub(crate) base_color: Vec3A,
    pub(crate) metallic: f32,
    pub(crate) roughness: f32,
    pub(crate) emissive: Vec3A,
    /// Share of ambient light that the material's occlusion texture lets pass.
    pub(crate) unoccluded: f32,
    /// Coverage of the surface; surfaces behind it are visible through the rest.
    pub(crate) opacity: f32,
}

impl Surface {
    /// Origin of a ray towards `direction` that cannot hit this surface again.
    pub(crate) fn leave(&self, direction: Vec3A) -> Vec3A {
        let side = if direction.dot(self.geometric_normal) < 0.0 {
            -self.error
        } else {
            self.error
        };
        self.position + self.geometric_normal * side
    }

    /// Whether a direction points away from the surface on the side from which the ray came.
    pub(crate) fn is_outside(&self, direction: Vec3A) -> bool {
        direction.dot(self.geometric_normal) > 0.0
    }

    /// The mirror direction; about the geometric normal if the shading normal would send the ray into the
    /// surface.
    pub(crate) fn mirror(&self) -> Vec3A {
        let r = reflect(self.incoming, self.normal);
        if r.dot(self.geometric_normal) > 0.0 {
            r
        } else {
            reflect(self.incoming, self.geometric_normal)
        }
    }
}
