//! A ray as a tree sees it: cleaned, carried into object space, with its padded slabs.

use crate::numerics::UNIT_ROUNDOFF;

/// Widening of a box for a ray, relative to `m = |origin| + |box|` (largest components).
///
/// A vertex `p` moved to the ray's space has x' = fl(fl(p_x - o_x) - fl(S_x fl(p_z - o_z))),
/// where S_x = fl(d_x / d_z) is at most 1 in size. With unit roundoff u the three roundings of
/// the product cost 3 u m, those of the two differences u m and 2 u m: it is off by at most 6 u m. The triangle
/// test is exact for the moved vertices, so a ray that it accepts passes within 6 u m (per axis)
/// of a true point of the triangle. The slab test adds one rounding of `origin + pad` (u m), one
/// of the difference (u m), one of 1/d and one of the product (2 u m). Sum 10 u m;
/// 16 leaves room for the second-order terms, for `m` being rounded itself, and costs nothing measurable.
pub(super) const PAD: f32 = 16.0 * UNIT_ROUNDOFF;

/// Directions outside this range (largest component) hit nothing: squares and reciprocals of
/// anything inside it stay far from overflow and from denormal numbers.
const DIRECTION_RANGE: std::ops::RangeInclusive<f32> = 1e-18..=1e18;

/// A component this much smaller than the largest one is treated as if it were this small: over
/// the length of any ray it moves by 1e-15 of that length, under every pad, and its reciprocal stays finite.
pub(super) const FLATTEST: f32 = 1e-15;

/// Object-from-camera transform as rows, with the mesh's centre as origin.
pub(super) type Rows = [[f32; 4]; 3];

/// `row . (v, w)`; the one order of operations that all kernels use.
#[inline(always)]
pub(super) fn transform_row(row: &[f32; 4], v: [f32; 3]) -> f32 {
    (row[0] * v[0] + row[1] * v[1]) + (row[2] * v[2] + row[3])
}

/// [`transform_row`] without translation.
#[inline(always)]
pub(super) fn rotate_row(row: &[f32; 4], v: [f32; 3]) -> f32 {
    (row[0] * v[0] + row[1] * v[1]) + row[2] * v[2]
}

/// A ray in the space of a tree.
#[derive(Debug, Clone, Copy)]
pub(super) struct SpaceRay {
    /// Origin.
    pub(super) origin: [f32; 3],
    /// Reciprocal direction, never infinite.
    pub(super) inv: [f32; 3],
    /// Origin moved so that subtracting it from the near plane also pads the box.
    pub(super) near_origin: [f32; 3],
    /// The same for the far plane.
    pub(super) far_origin: [f32; 3],
    /// 1 where the ray runs towards smaller coordinates.
    pub(super) negative: [usize; 3],
    /// Axes: the direction's largest component last.
    pub(super) axes: [usize; 3],
    /// Woop's shear: d_x / d_z, d_y / d_z, 1 / d_z in those axes.
    pub(super) shear: [f32; 3],
    pub(super) t_min: f32,
}

/// The axis of the largest component; the lowest axis wins a tie.
#[inline(always)]
pub(super) fn largest_axis(size: [f32; 3]) -> usize {
    if size[0] >= size[1] && size[0] >= size[2] {
        0
    } else if size[1] >= size[2] {
        1
    } else {
        2
    }
}

impl SpaceRay {
    /// `None` if the ray hits nothing. `pad` and `extent` (the largest coordinate of any box)
    /// give the widening: `pad * (|origin| + extent)`.
    #[inline(always)]
    pub(super) fn new(
        origin: [f32; 3],
        direction: [f32; 3],
        t_min: f32,
        pad: f32,
        extent: f32,
    ) -> Option<Self> {
        // -0.0 + 0.0 is +0.0: a ray along an axis has one set of signs, however it was made.
        let direction = direction.map(|d| d + 0.0);
        let size = direction.map(f32::abs);
        let kz = largest_axis(size);
        // A NaN is in no range; NaN in a component that is not the largest fails `is_finite`.
        if !DIRECTION_RANGE.contains(&size[kz])
            || !(direction.iter().chain(&origin).all(|x| x.is_finite()))
        {
            return None;
        }
        let kx = (kz + 1) % 3;
        let ky = (kx + 1) % 3;
        let flattest = size[kz] * FLATTEST;
        let pad = pad * (origin[0].abs().max(origin[1].abs()).max(origin[2].abs()) + extent);
        let mut ray = Self {
            origin,
            inv: [0.0; 3],
            near_origin: [0.0; 3],
            far_origin: [0.0; 3],
            negative: [0; 3],
            axes: [kx, ky, kz],
            shear: [
                direction[kx] / direction[kz],
                direction[ky] / direction[kz],
                1.0 / direction[kz],
            ],
            t_min,
        };
        for axis in 0..3 {
            let negative = direction[axis] < 0.0;
            let size = size[axis].max(flattest);
            let (low, high) = (origin[axis] + pad, origin[axis] - pad);
            ray.inv[axis] = 1.0 / if negative { -size } else { size };
            ray.negative[axis] = usize::from(negative);
            (ray.near_origin[axis], ray.far_origin[axis]) =
                if negative { (high, low) } else { (low, high) };
        }
        Some(ray)
    }

    /// Entry into and exit from a padded box; it is crossed if entry <= exit.
    #[inline(always)]
    pub(super) fn slabs(&self, low: [f32; 3], high: [f32; 3]) -> (f32, f32) {
        let mut near = [0.0; 3];
        let mut far = [0.0; 3];
        for axis in 0..3 {
            let planes = [low[axis], high[axis]];
            near[axis] = (planes[self.negative[axis]] - self.near_origin[axis]) * self.inv[axis];
            far[axis] = (planes[1 - self.negative[axis]] - self.far_origin[axis]) * self.inv[axis];
        }
        (
            near[0].max(near[1]).max(near[2]),
            far[0].min(far[1]).min(far[2]),
        )
    }
}
