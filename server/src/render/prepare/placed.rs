//! The placement of an object relative to the camera.

use glam::{Affine3A, Mat3A, Vec3A};

/// An object's transform relative to the current camera.
pub(crate) struct Placed {
    /// The visible level of detail.
    pub(crate) lod: usize,
    pub(crate) camera_from_object: Affine3A,
    /// Inverse transpose of its linear part.
    pub(crate) normal_from_object: Mat3A,
    /// -1 for a transform that mirrors, otherwise 1.
    pub(crate) orientation: f32,
}

impl Placed {
    pub(crate) fn new(camera_from_object: Affine3A) -> Self {
        let linear = camera_from_object.matrix3;
        let det = linear.determinant();
        Self {
            lod: 0,
            camera_from_object,
            // The acceleration structure skips objects with a singular transform, so their normals are never
            // used.
            normal_from_object: if det == 0.0 {
                Mat3A::IDENTITY
            } else {
                linear.inverse().transpose()
            },
            orientation: if det < 0.0 { -1.0 } else { 1.0 },
        }
    }

    /// A sphere in camera space around the transformed object-space sphere.
    pub(crate) fn ball(&self, (center, radius): (Vec3A, f32)) -> (Vec3A, f32) {
        let linear = self.camera_from_object.matrix3;
        // The largest row sum of A^T A is a bound on its largest eigenvalue, which is the square of A's largest
        // scale; for a rotation with a scale per axis the bound is exact.
        let gram = linear.transpose() * linear;
        let rows = gram.x_axis.abs() + gram.y_axis.abs() + gram.z_axis.abs();
        let center = self.camera_from_object.transform_point3a(center);
        (center, radius * rows.max_element().sqrt())
    }
}
