//! Conservative occlusion tests between a set of points and a light, one query for all of them.
//!
//! A negative answer is a proof, a positive one is not. This allows the traversal to compare bounding spheres of
//! boxes, eight at a time, and to stop at the first leaf that it cannot exclude.

use fearless_simd::{Level, Simd, f32x8, prelude::*};
use glam::Vec3A;

use crate::accel::blas::Blas;
use crate::accel::build::layout::{self, Cell, LEAF, NONE};
use crate::accel::instance::Instance;
use crate::accel::space::{transform_point, transform_vector};
use crate::accel::tlas::{STACK, Tlas};
use crate::numerics::gamma;
use crate::simd::vectorize;

/// The hull of two balls, or of a ball and a cone of directions: a union of balls whose centre
/// `from + t axis` and radius `radius + t growth` move linearly over `0 <= t <= t_end`.
#[derive(Debug, Clone, Copy)]
pub struct Shaft {
    from: Vec3A,
    axis: Vec3A,
    radius: f32,
    growth: f32,
    t_end: f32,
    /// `|axis|^2 - growth^2`, the quadratic coefficient of the squared distance; positive unless one end contains the
    /// other.
    spread: f32,
}

impl Shaft {
    /// All segments from one ball to another, both included. Metres, camera space.
    pub fn between(from: (Vec3A, f32), to: (Vec3A, f32)) -> Self {
        Self::new(from, to.0 - from.0, to.1 - from.1, 1.0)
    }

    /// All rays from a ball in directions within `tan_angle` of the unit vector `towards`.
    pub fn towards(from: (Vec3A, f32), towards: Vec3A, tan_angle: f32) -> Self {
        Self::new(from, towards, tan_angle, f32::INFINITY)
    }

    fn new((from, radius): (Vec3A, f32), axis: Vec3A, growth: f32, t_end: f32) -> Self {
        Self {
            from,
            axis,
            radius,
            growth,
            t_end,
            spread: axis.length_squared() - growth * growth,
        }
    }

    /// The shaft in an instance's object space, or a larger shaft that contains it.
    fn enter(&self, instance: &Instance, pad: f32) -> Self {
        // Upper bound on the scale of the transform, from the products of its columns (Gershgorin).
        let [x, y, z, _] = &instance.columns;
        let longest = x
            .length_squared()
            .max(y.length_squared())
            .max(z.length_squared());
        let skew = x.dot(*y).abs().max(y.dot(*z).abs()).max(z.dot(*x).abs());
        let stretch = (longest + 2.0 * skew).sqrt() * (1.0 + gamma(16));
        Self::new(
            (
                transform_point(&instance.columns, self.from),
                (self.radius + pad) * stretch,
            ),
            transform_vector(&instance.columns, self.axis),
            self.growth * stretch,
            self.t_end,
        )
    }

    /// Whether a ball may touch the shaft: `|a - t d|^2 <= (r + t k)^2` for some t, a quadratic whose minimum over
    /// the interval decides. Never false if the ball touches the shaft; false for NaN.
    #[inline(always)]
    fn meets(&self, center: Vec3A, ball: f32) -> bool {
        // A shaft without sides, where one end contains the other: nothing can be excluded.
        if self.spread <= 0.0 {
            return true;
        }
        let a = center - self.from;
        let r = self.radius + ball;
        let (aa, rr) = (a.length_squared(), r * r);
        let b = a.dot(self.axis) + r * self.growth;
        let t = (b / self.spread).max(0.0).min(self.t_end);
        // Each term carries at most eight roundings of numbers up to `aa + rr`.
        (self.spread * t - 2.0 * b) * t + (aa - rr) <= gamma(16) * (aa + rr)
    }
}

/// The bounding sphere of a box, grown by the rounding of its centre and radius.
#[inline(always)]
fn ball_of(low: Vec3A, high: Vec3A) -> (Vec3A, f32) {
    let center = (low + high) * 0.5;
    let radius = (high - low).length() * 0.5;
    (
        center,
        radius * (1.0 + gamma(8)) + gamma(4) * center.abs().max_element(),
    )
}

impl Tlas {
    /// Whether the shaft may touch any triangle of an instance that shares a bit with `mask`. False is certain: no
    /// ray inside the shaft, as traced by the kernels, hits such a triangle.
    pub fn may_intersect(&self, shaft: &Shaft, mask: u8) -> bool {
        if self.tree.nodes.is_empty() {
            return false;
        }
        let reach = shaft.from.abs().max_element() + shaft.radius + self.extent;
        let pad = self.pad * reach;
        let padded = Shaft {
            radius: shaft.radius + pad,
            ..*shaft
        };
        let mut stack = [0_u32; STACK];
        let mut height = 1;
        while height > 0 {
            height -= 1;
            let node = &self.tree.nodes[stack[height] as usize];
            let (center, radius) = ball_of(node.low, node.high);
            if !padded.meets(center, radius) {
                continue;
            }
            if node.count == 0 {
                stack[height] = node.first + 1;
                stack[height + 1] = node.first;
                height += 2;
                continue;
            }
            let leaf = node.first as usize..(node.first + node.count) as usize;
            for &index in &self.tree.order[leaf] {
                let instance = &self.instances[index as usize];
                let Some((low, high)) = instance.bounds.filter(|_| instance.mask & mask != 0)
                else {
                    continue;
                };
                let (center, radius) = ball_of(low, high);
                if padded.meets(center, radius) {
                    let inside = shaft.enter(instance, pad);
                    if may_touch(self.level(), &instance.blas, &inside) {
                        return true;
                    }
                }
            }
        }
        false
    }
}

/// Whether the shaft may touch a triangle of one mesh.
fn may_touch(level: Level, blas: &Blas, shaft: &Shaft) -> bool {
    vectorize!(level, |simd| walk(simd, blas, shaft)).unwrap_or_else(|| walk_plain(blas, shaft))
}

/// Traverses the eight-wide BVH to the first leaf that the shaft may touch.
#[inline(always)]
fn walk<S: Simd>(simd: S, blas: &Blas, shaft: &Shaft) -> bool {
    if shaft.spread <= 0.0 {
        return !blas.cells.is_empty();
    }
    let splat = |x: f32| f32x8::splat(simd, x);
    descend(blas, |children| {
        let plane = |axis: usize, side: usize| f32x8::load_array_ref(simd, &children[axis][side]);
        let half = splat(0.5);
        let (lx, ly, lz) = (plane(0, 0), plane(1, 0), plane(2, 0));
        let (hx, hy, hz) = (plane(0, 1), plane(1, 1), plane(2, 1));
        let (cx, cy, cz) = ((lx + hx) * half, (ly + hy) * half, (lz + hz) * half);
        let (sx, sy, sz) = (hx - lx, hy - ly, hz - lz);
        let size = ((sx * sx + sy * sy) + sz * sz).sqrt() * half;
        let largest = cx.abs().max(cy.abs()).max(cz.abs());
        let r = splat(shaft.radius) + (size * splat(1.0 + gamma(8)) + largest * splat(gamma(4)));
        let (ax, ay, az) = (
            cx - splat(shaft.from.x),
            cy - splat(shaft.from.y),
            cz - splat(shaft.from.z),
        );
        let aa = (ax * ax + ay * ay) + az * az;
        let rr = r * r;
        let along =
            (ax * splat(shaft.axis.x) + ay * splat(shaft.axis.y)) + az * splat(shaft.axis.z);
        let b = along + r * splat(shaft.growth);
        let t = (b / splat(shaft.spread))
            .max(splat(0.0))
            .min(splat(shaft.t_end));
        let least = (splat(shaft.spread) * t - (b + b)) * t + (aa - rr);
        least.simd_le(splat(gamma(16)) * (aa + rr)).to_bitmask() as u8
    })
}

/// [`walk`] in scalar code.
fn walk_plain(blas: &Blas, shaft: &Shaft) -> bool {
    descend(blas, |children| {
        (0..8).fold(0, |bits, child| {
            let corner = |side: usize| {
                Vec3A::from_array(std::array::from_fn(|axis| children[axis][side][child]))
            };
            let (center, radius) = ball_of(corner(0), corner(1));
            bits | u8::from(shaft.meets(center, radius)) << child
        })
    })
}

/// Traverses the children whose bit is set in the result of `touched`; returns whether a leaf was reached.
#[inline(always)]
fn descend(blas: &Blas, touched: impl Fn(&[[[f32; 8]; 2]; 3]) -> u8) -> bool {
    if blas.cells.is_empty() {
        return false;
    }
    let cells: &[Cell] = &blas.cells;
    let mut stack = [0_u32; layout::STACK];
    let mut height = 1;
    while height > 0 {
        height -= 1;
        let node = layout::node(cells, stack[height]);
        let mut bits = touched(&node.planes);
        while bits != 0 {
            let child = node.children[bits.trailing_zeros() as usize & 7];
            bits &= bits - 1;
            if child == NONE {
                continue;
            }
            if child & LEAF != 0 {
                return true;
            }
            stack[height] = child;
            height += 1;
        }
    }
    false
}
