//! An object before the camera.

use glam::{Affine3A, Mat3A, Vec3A};

/// An object's place relative to the current camera.
pub(crate) struct Placed {
    /// The level of detail that is seen.
    pub(crate) lod: usize,
    pub(crate) camera_from_object: Affine3A,
    /// Inverse transpose of its linear part.
    pub(crate) normal_from_object: Mat3A,
    /// -1 if it mirrors.
    pub(crate) orientation: f32,
}

impl Placed {
    pub(crate) fn new(camera_from_object: Affine3A) -> Self {
        let linear = camera_from_object.matrix3;
        let det = linear.determinant();
        Self {
            lod: 0,
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
    pub(crate) fn ball(&self, (center, radius): (Vec3A, f32)) -> (Vec3A, f32) {
        let linear = self.camera_from_object.matrix3;
        // The largest row sum of A^T A bounds its largest eigenvalue, the square of how far A
        // stretches; for a rotation with a scale per axis it is that.
        let gram = linear.transpose() * linear;
        let rows = gram.x_axis.abs() + gram.y_axis.abs() + gram.z_axis.abs();
        let center = self.camera_from_object.transform_point3a(center);
        (center, radius * rows.max_element().sqrt())
    }
}
