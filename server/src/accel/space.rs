//! A ray prepared for a BVH: cleaned, transformed to object space, with its padded slabs.

use glam::{BVec3A, Vec3A};

use crate::numerics::UNIT_ROUNDOFF;

/// Padding of a box for a ray, relative to `m = |origin| + |box|` (largest components).
///
/// A vertex `p` moved to the ray's space has x' = fl(fl(p_x - o_x) - fl(S_x fl(p_z - o_z))),
/// where S_x = fl(d_x / d_z) is at most 1 in size. With unit roundoff u the three roundings of
/// the product cost 3 u m, those of the two differences u m and 2 u m: it is off by at most 6 u m. The triangle
/// test is exact for the moved vertices, so a ray that it accepts passes within 6 u m (per axis)
/// of a true point of the triangle. The slab test adds one rounding of `origin + pad` (u m), one
/// of the difference (u m), one of 1/d and one of the product (2 u m). Sum 10 u m;
/// 16 leaves room for the second-order terms, for `m` being rounded itself, and costs nothing measurable.
pub const PAD: f32 = 16.0 * UNIT_ROUNDOFF;

/// Directions whose largest component is outside this range hit nothing: squares and reciprocals of values inside it
/// stay far from overflow and from denormal numbers.
pub(crate) const DIRECTION_RANGE: std::ops::RangeInclusive<f32> = 1e-18..=1e18;

/// Direction components that are smaller than this, relative to the largest one, are replaced by this value: over the
/// length of any ray this shifts it by 1e-15 of the length, less than any padding, and the reciprocal stays finite.
pub(crate) const FLATTEST: f32 = 1e-15;

/// Object-from-camera transform: columns x, y, z and translation, with the mesh's centre as the origin of object
/// space.
pub(crate) type Columns = [Vec3A; 4];

/// Transforms a point; all kernels use this order of operations.
#[inline(always)]
pub(crate) fn transform_point(columns: &Columns, p: Vec3A) -> Vec3A {
    (columns[0] * p.x + columns[1] * p.y) + (columns[2] * p.z + columns[3])
}

/// Transforms a direction.
#[inline(always)]
pub(crate) fn transform_vector(columns: &Columns, v: Vec3A) -> Vec3A {
    (columns[0] * v.x + columns[1] * v.y) + columns[2] * v.z
}

/// A ray prepared for slab tests.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Slabs {
    /// Reciprocal direction, never infinite.
    pub(crate) inv: Vec3A,
    /// Origin moved so that subtracting it from the near plane also pads the box.
    pub(crate) near_origin: Vec3A,
    /// The same, for the far plane.
    pub(crate) far_origin: Vec3A,
    /// Whether the direction is negative, per axis.
    pub(crate) negative: BVec3A,
    pub(crate) t_min: f32,
}

/// A ray in the space of a mesh.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SpaceRay {
    pub(crate) slabs: Slabs,
    pub(crate) origin: [f32; 3],
    /// Axes, reordered so that the direction's largest component is last.
    pub(crate) axes: [usize; 3],
    /// Woop's shear: d_x / d_z, d_y / d_z, 1 / d_z in those axes.
    pub(crate) shear: [f32; 3],
}

/// The axis of the largest component; ties go to the lowest axis.
#[inline(always)]
pub(crate) fn largest_axis(size: [f32; 3]) -> usize {
    if size[0] >= size[1] && size[0] >= size[2] {
        0
    } else if size[1] >= size[2] {
        1
    } else {
        2
    }
}

/// Whether a ray can hit anything: it is finite and its direction's size is in range. `direction` contains no -0.0.
#[inline(always)]
fn is_usable(origin: Vec3A, direction: Vec3A) -> bool {
    // A NaN is outside every range, or fails `is_finite`.
    DIRECTION_RANGE.contains(&direction.abs().max_element())
        && direction.is_finite()
        && origin.is_finite()
}

impl Slabs {
    /// `None` if the ray can hit nothing. The padding is `pad * (|origin| + extent)`; `extent` is the largest
    /// coordinate of any box.
    #[inline(always)]
    pub(crate) fn new(
        origin: Vec3A,
        direction: Vec3A,
        t_min: f32,
        pad: f32,
        extent: f32,
    ) -> Option<Self> {
        // -0.0 + 0.0 is +0.0: a ray along an axis always has the same signs.
        let direction = direction + Vec3A::ZERO;
        if !is_usable(origin, direction) {
            return None;
        }
        let size = direction.abs();
        let flattest = size.max_element() * FLATTEST;
        let pad = Vec3A::splat(pad * (origin.abs().max_element() + extent));
        let negative = direction.cmplt(Vec3A::ZERO);
        let size = size.max(Vec3A::splat(flattest));
        let (low, high) = (origin + pad, origin - pad);
        Some(Self {
            inv: Vec3A::ONE / Vec3A::select(negative, -size, size),
            near_origin: Vec3A::select(negative, high, low),
            far_origin: Vec3A::select(negative, low, high),
            negative,
            t_min,
        })
    }

    /// Entry into and exit from a padded box; the ray crosses the box if entry <= exit.
    #[inline(always)]
    pub(crate) fn cross(&self, low: Vec3A, high: Vec3A) -> (f32, f32) {
        let near = (Vec3A::select(self.negative, high, low) - self.near_origin) * self.inv;
        let far = (Vec3A::select(self.negative, low, high) - self.far_origin) * self.inv;
        (near.max_element(), far.min_element())
    }
}

impl SpaceRay {
    /// `None` if the ray can hit nothing; see [`Slabs::new`].
    #[inline(always)]
    pub(crate) fn new(origin: Vec3A, direction: Vec3A, t_min: f32, extent: f32) -> Option<Self> {
        let slabs = Slabs::new(origin, direction, t_min, PAD, extent)?;
        let direction = (direction + Vec3A::ZERO).to_array();
        let kz = largest_axis([direction[0].abs(), direction[1].abs(), direction[2].abs()]);
        let kx = (kz + 1) % 3;
        let ky = (kx + 1) % 3;
        let along = Vec3A::splat(direction[kz]);
        Some(Self {
            slabs,
            origin: origin.to_array(),
            axes: [kx, ky, kz],
            shear: (Vec3A::new(direction[kx], direction[ky], 1.0) / along).to_array(),
        })
    }
}
