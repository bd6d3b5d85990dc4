//! A mesh placed in camera space.

use std::sync::Arc;

use glam::{Affine3A, DMat3, DVec3, Vec3A};

use super::blas::Blas;
use super::ray::Ray;
use super::space::{Columns, SpaceRay, transform_point, transform_vector};

/// A mesh placed in the frame.
#[derive(Debug, Clone)]
pub struct TlasInstance {
    /// The mesh.
    pub blas: Arc<Blas>,
    /// Camera from object space. May mirror and scale non-uniformly; an instance whose transform has no finite
    /// inverse is skipped.
    pub camera_from_object: Affine3A,
    /// [`super::MASK_VIRTUAL`], [`super::MASK_GHOST`]: a ray can hit the instance if the ray's mask shares a bit with
    /// this one.
    pub mask: u8,
    /// Whether hits are passed to a query's filter, for alpha-masked textures.
    pub filtered: bool,
}

#[derive(Debug)]
pub(crate) struct Instance {
    pub(crate) blas: Arc<Blas>,
    /// Centred object space from camera space.
    pub(crate) columns: Columns,
    pub(crate) mask: u8,
    pub(crate) filtered: bool,
    /// AABB in camera space; `None` if no ray can hit the instance.
    pub(crate) bounds: Option<(Vec3A, Vec3A)>,
}

impl Instance {
    /// The ray in the mesh's space; `None` if it cannot hit the mesh.
    #[inline(always)]
    pub(crate) fn enter(&self, ray: &Ray) -> Option<SpaceRay> {
        SpaceRay::new(
            transform_point(&self.columns, ray.origin),
            transform_vector(&self.columns, ray.direction),
            ray.t_min,
            self.blas.extent,
        )
    }
}

/// An instance with its derived transform.
pub(crate) struct Placed {
    pub(crate) columns: Columns,
    pub(crate) bounds: (Vec3A, Vec3A),
    /// Condition number |A| |A^-1| of the transform, maximum norm.
    pub(crate) condition: f64,
}

/// `None` if the mesh is empty or the transform has no finite inverse.
pub(crate) fn place(source: &TlasInstance) -> Option<Placed> {
    let blas = &source.blas;
    if blas.triangles() == 0 {
        return None;
    }
    // In double precision, so that the rounding to f32 is the only error of the inverse.
    let matrix: DMat3 = source.camera_from_object.matrix3.as_dmat3();
    let centre = matrix * blas.centre.as_dvec3() + source.camera_from_object.translation.as_dvec3();
    let determinant = matrix.determinant();
    if determinant == 0.0 || !determinant.is_finite() {
        return None;
    }
    let inverse = matrix.inverse();
    let shift = -(inverse * centre);
    let columns: Columns =
        [inverse.x_axis, inverse.y_axis, inverse.z_axis, shift].map(|c| c.as_vec3a());
    let (low, high) = (blas.low.as_dvec3(), blas.high.as_dvec3());
    let middle = centre + matrix * ((low + high) * 0.5);
    let half = matrix.abs() * ((high - low) * 0.5);
    let outward = |v: DVec3, round: fn(f32) -> f32| {
        Vec3A::new(round(v.x as f32), round(v.y as f32), round(v.z as f32))
    };
    let bounds = (
        outward(middle - half, f32::next_down),
        outward(middle + half, f32::next_up),
    );
    let condition = norm(&matrix) * norm(&inverse);
    let finite = columns.iter().all(|c| c.is_finite())
        && bounds.0.is_finite()
        && bounds.1.is_finite()
        && condition.is_finite();
    finite.then_some(Placed {
        columns,
        bounds,
        condition,
    })
}

/// Maximum norm of a matrix: its largest row sum.
fn norm(matrix: &DMat3) -> f64 {
    let abs = matrix.abs();
    (0..3).map(|i| abs.row(i).element_sum()).fold(0.0, f64::max)
}
