//! Decides for a whole beam, all rays from some points to a light, whether they miss the depth surface.
//!
//! The rays are in the convex hull of their starts and the light. The cross-section of the hull at the share s of
//! the way is `(1 - s) A + s B`, so its extent across a plane is at most `(1 - s) h(A) + s h(B)`, where h is the
//! extent of each end alone. This is linear in s. A tile of the pyramid is bounded by planes: four through its
//! border and the camera's centre, and two of constant depth. Each plane gives an interval of s. If the
//! intersection of these intervals is empty, the hull does not touch the tile. This is the slab test for a convex
//! set instead of a ray.
//!
//! "Unoccluded" is a proof for every ray of the beam. "Not unoccluded" proves nothing, because a traversal may
//! give up. All extents are rounded outward.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, dispatch, f32x16, u32x16};
use glam::Vec3A;

use crate::frame::DepthImage;
use crate::ghost::node::{MAX_LEVELS, Node};
use crate::ghost::surface::GhostSurface;
use crate::numerics::gamma;

/// The end of a beam.
#[derive(Debug, Clone, Copy)]
pub enum BeamEnd {
    /// A sphere: centre and radius, metres, camera space.
    Ball(Vec3A, f32),
    /// At infinity: a unit vector, and the tangent of the largest angle to it.
    Towards(Vec3A, f32),
}

/// Most nodes that a traversal visits before it gives up: as many as a few rays of the beam would visit.
const MOST_NODES: u32 = 48;

/// Most entries of the stack: all children of one node per level but the one being visited.
const STACK: usize = 15 * (MAX_LEVELS + 1) + 1;

/// A beam in the form needed for tests against the planes of tiles.
#[derive(Debug, Clone, Copy)]
struct Beam {
    /// Least and largest pixel position and depth of its starts, rounded outward.
    u: [f32; 2],
    v: [f32; 2],
    z: [f32; 2],
    /// The centre of its end: fx x + cx z, fy y + cy z.
    end_u: f32,
    end_v: f32,
    end_z: f32,
    /// Extent of the end across the planes through borders of columns and rows, padded.
    reach_u: f32,
    reach_v: f32,
    /// Smallest and largest depth of its end, rounded outward.
    depth: [f32; 2],
    parallel: bool,
}

impl Beam {
    /// `None` if a start is at or behind the camera's plane, where it has no pixel position.
    fn new(surface: &GhostSurface, starts: &[Vec3A], radius: f32, end: BeamEnd) -> Option<Self> {
        let k = &surface.intrinsics;
        let (fx, fy, cx, cy) = (k.fx as f32, k.fy as f32, k.cx as f32, k.cy as f32);
        let none = [f32::INFINITY, f32::NEG_INFINITY];
        let (mut u, mut v, mut z) = (none, none, none);
        let widen = |range: &mut [f32; 2], low: f32, high: f32| {
            *range = [range[0].min(low), range[1].max(high)];
        };
        for &p in starts {
            let (near, far) = (p.z - radius, p.z + radius);
            if !(near > DepthImage::MIN_M && p.is_finite()) {
                return None;
            }
            let low = |x: f32, f: f32| (f * (x - radius) / near).min(f * (x - radius) / far);
            let high = |x: f32, f: f32| (f * (x + radius) / near).max(f * (x + radius) / far);
            widen(&mut u, low(p.x, fx) + cx, high(p.x, fx) + cx);
            widen(&mut v, low(p.y, fy) + cy, high(p.y, fy) + cy);
            widen(&mut z, near, far);
        }
        if z[0] > z[1] {
            return None;
        }
        let (center, radius, parallel) = match end {
            BeamEnd::Ball(center, radius) => (center, radius, false),
            BeamEnd::Towards(direction, tangent) => (direction, tangent, true),
        };
        // Borders are within the image. Positions have an error of at most eight roundings of numbers up to those
        // of the start, the centre and the image. So has the sum for the end's planes. A ray that is given by its
        // start and a step from there has an error of two roundings of its start at its end.
        let side = surface.side;
        let outward = |[low, high]: [f32; 2], c: f32| {
            let pad = gamma(16) * (low.abs().max(high.abs()) + 2.0 * c.abs() + side);
            [low - pad, high + pad]
        };
        let reach = |f: f32, c: f32, x: f32, starts: [f32; 2]| {
            let across = f.hypot(c.abs() + side);
            let widest = starts[0].abs().max(starts[1].abs()) + 2.0 * c.abs() + side;
            let size = f * x.abs() + (c.abs() + side) * center.z.abs() + widest * z[1];
            radius * across * (1.0 + gamma(16)) + gamma(16) * size
        };
        let pad = gamma(16) * (center.z.abs() + radius + z[1]);
        Some(Self {
            u: outward(u, cx),
            v: outward(v, cy),
            z: [z[0] * (1.0 - gamma(16)), z[1] * (1.0 + gamma(16))],
            end_u: fx * center.x + cx * center.z,
            end_v: fy * center.y + cy * center.z,
            end_z: center.z,
            reach_u: reach(fx, cx, center.x, u),
            reach_v: reach(fy, cy, center.y, v),
            depth: [center.z - radius - pad, center.z + radius + pad],
            parallel,
        })
    }

    /// The children of a node that the beam may touch, as bits. `x`, `y`: the node's first column and row of
    /// cells; `size`: cells per side of a child; `last`: the image's last column and row.
    #[inline(always)]
    fn test<S: Simd>(
        &self,
        simd: S,
        node: &Node,
        [x, y]: [f32; 2],
        size: f32,
        last: [f32; 2],
    ) -> u32 {
        let splat = |x: f32| f32x16::splat(simd, x);
        let zero = splat(0.0);
        let (low, high) = Node::bounds(u32x16::load_array_ref(simd, &node.0));
        let columns = f32x16::load_array_ref(simd, &COLUMN) * splat(size) + splat(x);
        let rows = f32x16::load_array_ref(simd, &ROW) * splat(size) + splat(y);
        let (right, bottom) = (
            (columns + splat(size)).min(splat(last[0])),
            (rows + splat(size)).min(splat(last[1])),
        );
        let (z_near, z_far) = (splat(self.z[0]), splat(self.z[1]));
        // A start is `offset` pixels beyond a border; times its depth this is its distance from the plane.
        macro_rules! across {
            ($offset:expr) => {{
                let offset = $offset;
                offset.simd_gt(zero).select(z_far * offset, z_near * offset)
            }};
        }
        let (end_z, reach_u, reach_v) =
            (splat(self.end_z), splat(self.reach_u), splat(self.reach_v));
        let (end_u, end_v) = (splat(self.end_u), splat(self.end_v));
        // Depths are multiplied by the tile's inverse depths, which avoids a division; the constant term is then
        // one.
        let constant = splat(if self.parallel { 0.0 } else { 1.0 });
        let (less, more) = (splat(1.0 - gamma(16)), splat(1.0 + gamma(16)));
        let planes = [
            (
                across!(splat(self.u[1]) - columns),
                (end_u - columns * end_z) + reach_u,
            ),
            (
                across!(right - splat(self.u[0])),
                (right * end_z - end_u) + reach_u,
            ),
            (
                across!(splat(self.v[1]) - rows),
                (end_v - rows * end_z) + reach_v,
            ),
            (
                across!(bottom - splat(self.v[0])),
                (bottom * end_z - end_v) + reach_v,
            ),
            (
                high * z_far - less,
                high * splat(self.depth[1]) - constant * less,
            ),
            (
                more - low * z_near,
                constant * more - low * splat(self.depth[0]),
            ),
        ];
        let mut s_in = zero;
        let mut s_out = splat(if self.parallel { f32::INFINITY } else { 1.0 });
        for (start, end) in planes {
            let slope = if self.parallel { end } else { end - start };
            let crossing = (zero - start) / slope;
            // A plane that contains both ends on its inner side, or that is parallel to the beam, excludes
            // nothing.
            s_in = slope.simd_gt(zero).select(s_in.max(crossing), s_in);
            s_out = slope.simd_lt(zero).select(s_out.min(crossing), s_out);
        }
        let touched = s_in.simd_le(s_out * more) & low.simd_le(high);
        touched.to_bitmask() as u32
    }
}

/// Column and row of each child of a node.
const COLUMN: [f32; 16] = child_places(false);
const ROW: [f32; 16] = child_places(true);

const fn child_places(row: bool) -> [f32; 16] {
    let (mut places, mut child) = ([0.0; 16], 0);
    while child < 16 {
        places[child] = if row { child / 4 } else { child % 4 } as f32;
        child += 1;
    }
    places
}

impl GhostSurface {
    /// Whether no ray from within `radius` (metres) of one of `starts` (camera space) to any point of `end` hits
    /// the surface, from either side. True is certain; false is not.
    pub fn is_unoccluded(&self, starts: &[Vec3A], radius: f32, end: BeamEnd) -> bool {
        let Some(beam) = Beam::new(self, starts, radius, end) else {
            return false;
        };
        dispatch!(self.level, simd => self.walk_beam(simd, &beam))
    }

    #[inline(always)]
    fn walk_beam<S: Simd>(&self, simd: S, beam: &Beam) -> bool {
        let last = [self.cells_x as f32, self.cells_y as f32];
        let mut stack = [(0_u32, 0_u32, 0_u32); STACK];
        stack[0] = (self.levels.len() as u32, 0, 0);
        let mut n = usize::from(!self.levels.is_empty());
        let mut visited = 0;
        while n > 0 {
            n -= 1;
            let (level, x, y) = stack[n];
            visited += 1;
            if visited > MOST_NODES {
                return false;
            }
            let shape = &self.levels[level as usize - 1];
            let node = &self.nodes[shape.offset + y as usize * shape.stride + x as usize];
            let size = (1_u32 << (2 * (level - 1))) as f32;
            let origin = [(x << (2 * level)) as f32, (y << (2 * level)) as f32];
            let mut touched = beam.test(simd, node, origin, size, last);
            // The traversal ends above the cells.
            if level == 1 && touched != 0 {
                return false;
            }
            while touched != 0 {
                let child = touched.trailing_zeros();
                touched &= touched - 1;
                stack[n] = (level - 1, x * 4 + child % 4, y * 4 + child / 4);
                n += 1;
            }
        }
        true
    }
}
