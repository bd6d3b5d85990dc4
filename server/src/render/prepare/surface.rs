//! The surface at a mesh hit: position, normals and material, in camera space.

use glam::Vec3A;

use super::bsdf::reflect;
use super::cone::RayCone;

/// A mesh surface as a ray meets it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Surface {
    /// Camera space, metres.
    pub(crate) position: Vec3A,
    /// Bound on the error of `position` along the normal, metres: rays leave from outside it.
    pub(crate) error: f32,
    /// Unit, of the triangle, towards the side the ray came from.
    pub(crate) geometric_normal: Vec3A,
    /// Unit, interpolated and normal-mapped, towards the side the ray came from.
    pub(crate) normal: Vec3A,
    /// Whether the ray met the outside.
    pub(crate) front: bool,
    /// Unit direction of the ray.
    pub(crate) incoming: Vec3A,
    /// Of the ray, here.
    pub(crate) cone: RayCone,
    pub(crate) instance: u32,
    pub(crate) material: u32,
    pub(crate) base_color: Vec3A,
    pub(crate) metallic: f32,
    pub(crate) roughness: f32,
    pub(crate) emissive: Vec3A,
    /// Share of ambient light that the material's occlusion texture lets through.
    pub(crate) unoccluded: f32,
    /// Share of it that is there; what lies behind shows through the rest.
    pub(crate) opacity: f32,
}

impl Surface {
    /// Where a ray towards `direction` starts so that it cannot meet this surface again.
    pub(crate) fn leave(&self, direction: Vec3A) -> Vec3A {
        let side = if direction.dot(self.geometric_normal) < 0.0 {
            -self.error
        } else {
            self.error
        };
        self.position + self.geometric_normal * side
    }

    /// Whether a direction leads away from it on the side that the ray came from.
    pub(crate) fn is_outside(&self, direction: Vec3A) -> bool {
        direction.dot(self.geometric_normal) > 0.0
    }

    /// The mirror direction; about the triangle's own normal where the smooth one would send
    /// the ray into the surface.
    pub(crate) fn mirror(&self) -> Vec3A {
        let r = reflect(self.incoming, self.normal);
        if r.dot(self.geometric_normal) > 0.0 {
            r
        } else {
            reflect(self.incoming, self.geometric_normal)
        }
    }
}
