//! Which tiles of a frame anything virtual can influence. The others are copied.

use glam::{Affine3A, Vec3A};

use crate::frame::DepthImage;
use crate::numerics::gamma;
use crate::scene::Mesh;

use super::light::CameraLight;
use super::tile::{TILE, Tile, TileGrid};

/// Most balls that stand for one mesh: more fit tighter, but each is tested.
const BALLS_PER_MESH: usize = 16;
/// Balls of a scene that [`Occluders`] can tell apart.
const BALLS_TOLD_APART: usize = 64;

/// Balls per mesh for a scene of `n` virtual objects, a power of two.
pub(super) fn balls_per_mesh(n: usize) -> usize {
    let share = (BALLS_TOLD_APART / n.max(1)).clamp(1, BALLS_PER_MESH);
    1 << share.ilog2()
}

/// A ball, in object or camera space.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ball {
    pub(super) center: Vec3A,
    pub(super) radius: f32,
}

/// Covers a mesh with at most `n` balls (a power of two), by halving its triangles along the longest
/// axis of their bounds.
pub(super) fn cover(mesh: &Mesh, n: usize) -> Vec<Ball> {
    let corners = |t: u32| mesh.triangles[t as usize].map(|i| Vec3A::from(mesh.positions[i as usize]));
    let bounds = |triangles: &[u32]| {
        triangles.iter().flat_map(|&t| corners(t)).fold(
            (Vec3A::splat(f32::INFINITY), Vec3A::splat(f32::NEG_INFINITY)),
            |(low, high), p| (low.min(p), high.max(p)),
        )
    };
    let mut all: Vec<u32> = (0..mesh.triangles.len() as u32).collect();
    let mut groups: Vec<&mut [u32]> = if all.is_empty() { Vec::new() } else { vec![&mut all] };
    while groups.len() < n && groups.iter().any(|group| group.len() > 1) {
        groups = groups
            .into_iter()
            .flat_map(|group| {
                let (low, high) = bounds(group);
                let size = high - low;
                let axis = if size.x >= size.y && size.x >= size.z { 0 } else if size.y >= size.z { 1 } else { 2 };
                let middle = group.len() / 2;
                if middle == 0 {
                    return vec![group];
                }
                let at = |t: u32| corners(t).iter().map(|p| p[axis]).sum::<f32>();
                group.select_nth_unstable_by(middle, |&a, &b| at(a).total_cmp(&at(b)).then(a.cmp(&b)));
                let (left, right) = group.split_at_mut(middle);
                vec![left, right]
            })
            .collect();
    }
    groups
        .into_iter()
        .map(|group| {
            let (low, high) = bounds(group);
            let center = (low + high) * 0.5;
            let radius = group.iter().flat_map(|&t| corners(t)).map(|p| (p - center).length()).fold(0.0, f32::max);
            Ball { center, radius }
        })
        .collect()
}

/// A ball that holds the image of `ball`.
pub(super) fn transform_ball(ball: &Ball, camera_from_object: &Affine3A) -> Ball {
    let m = camera_from_object.matrix3;
    let (x, y, z) = (m.x_axis, m.y_axis, m.z_axis);
    let lengths = [x.length_squared(), y.length_squared(), z.length_squared()];
    let longest = lengths[0].max(lengths[1]).max(lengths[2]);
    let skew = x.dot(y).abs().max(y.dot(z).abs()).max(z.dot(x).abs());
    // Gershgorin on the matrix of the axes' products bounds the largest stretch.
    let stretch = (longest + 2.0 * skew).sqrt();
    let center = camera_from_object.transform_point3a(ball.center);
    // Outward by the rounding of centre and radius.
    Ball { center, radius: ball.radius * stretch * (1.0 + gamma(16)) + gamma(16) * center.abs().max_element() }
}

/// A mesh's camera-space bounds, and what of the picture they cover.
#[derive(Debug, Clone, Copy)]
pub(super) struct ObjectBounds {
    /// Pixels x0..x1, y0..y1, clipped to the picture; empty if out of view.
    pixels: [u32; 4],
    /// Modelled ghosts show the camera's pixel and cause no change by themselves.
    pub(super) ghost: bool,
}

impl ObjectBounds {
    /// From a box in camera space. Conservative: a box that reaches behind the camera covers all.
    pub(super) fn new(low: Vec3A, high: Vec3A, ghost: bool, intrinsics: &crate::camera::Intrinsics) -> Self {
        let (width, height) = (intrinsics.width, intrinsics.height);
        let near = DepthImage::MIN_M;
        let pixels = if high.z <= 0.0 {
            [0; 4]
        } else if low.z < near {
            [0, width, 0, height]
        } else {
            let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
            for corner in 0..8 {
                let pick = |axis: usize| f64::from(if corner >> axis & 1 == 0 { low[axis] } else { high[axis] });
                let (u, v) = intrinsics.project(glam::DVec3::new(pick(0), pick(1), pick(2)));
                lo = [lo[0].min(u), lo[1].min(v)];
                hi = [hi[0].max(u), hi[1].max(v)];
            }
            // A pixel more on each side: sub-pixel samples and outline neighbours.
            let clip = |x: f64, n: u32| x.clamp(0.0, f64::from(n)) as u32;
            [
                clip(lo[0].floor() - 1.0, width),
                clip(hi[0].ceil() + 2.0, width),
                clip(lo[1].floor() - 1.0, height),
                clip(hi[1].ceil() + 2.0, height),
            ]
        };
        Self { pixels, ghost }
    }

    fn covers(&self, x0: u32, y0: u32, x1: u32, y1: u32) -> bool {
        let [px0, px1, py0, py1] = self.pixels;
        px0 < x1 && x0 < px1 && py0 < y1 && y0 < py1
    }
}

/// The tiles to be traced, at the front of `tiles`; returns how many. `tiles` grows to the largest
/// number ever needed and is reused.
pub(super) fn plan_tiles(
    depth: &[f32],
    [width, height]: [u32; 2],
    ray_direction: impl Fn(f32, f32) -> Vec3A,
    objects: &[ObjectBounds],
    balls: &[Ball],
    lights: &[CameraLight],
    grid: &mut TileGrid,
    tiles: &mut Vec<Tile>,
) -> usize {
    grid.reset(width, height);
    let mut n = 0;
    if objects.iter().all(|object| object.ghost) {
        return 0;
    }
    for row in 0..grid.rows {
        for column in 0..grid.columns {
            let (x0, y0) = (column * TILE, row * TILE);
            let (x1, y1) = ((x0 + TILE).min(width), (y0 + TILE).min(height));
            let sees_objects = objects.iter().any(|object| object.covers(x0, y0, x1, y1));
            let occluders = match ghost_ball(depth, width, &ray_direction, x0, y0, x1, y1) {
                Some((center, radius)) => Occluders::of_ball(center, radius, balls, lights),
                None => Occluders::default(),
            };
            if !sees_objects && occluders.is_empty() {
                continue;
            }
            if n == tiles.len() {
                tiles.push(Tile::new());
            }
            let tile = &mut tiles[n];
            (tile.x0, tile.y0) = (x0, y0);
            (tile.width, tile.height) = (x1 - x0, y1 - y0);
            tile.sees_objects = sees_objects;
            tile.occluders = occluders;
            grid.set(column, row, n);
            n += 1;
        }
    }
    n
}

/// Which virtual balls may come between some points and which lights: bit i stands for the i-th,
/// the last bit for all from there on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) struct Occluders {
    lights: u64,
    balls: u64,
}

impl Occluders {
    /// Nothing is ruled out.
    pub(super) const ALL: Self = Self { lights: u64::MAX, balls: u64::MAX };

    pub(super) fn is_empty(self) -> bool {
        self.lights == 0
    }

    fn bit(i: usize) -> u64 {
        1 << i.min(BALLS_TOLD_APART - 1)
    }

    /// For every point of a ball.
    fn of_ball(center: Vec3A, radius: f32, balls: &[Ball], lights: &[CameraLight]) -> Self {
        let mut found = Self::default();
        for (b, ball) in balls.iter().enumerate() {
            for (l, light) in lights.iter().enumerate() {
                if light.may_be_blocked(center, radius, ball.center, ball.radius) {
                    found.lights |= Self::bit(l);
                    found.balls |= Self::bit(b);
                }
            }
        }
        found
    }

    /// Whether anything may come between light `l` and a point.
    pub(super) fn may_block(self, point: Vec3A, l: usize, light: &CameraLight, balls: &[Ball]) -> bool {
        if self.lights & Self::bit(l) == 0 {
            return false;
        }
        let mut left = self.balls;
        while left != 0 {
            let b = left.trailing_zeros() as usize;
            left &= left - 1;
            let last = b == BALLS_TOLD_APART - 1;
            let same_bit = if last { balls.get(b..) } else { balls.get(b..=b) }.unwrap_or_default();
            if same_bit.iter().any(|ball| light.may_be_blocked(point, 0.0, ball.center, ball.radius)) {
                return true;
            }
        }
        false
    }
}

/// A ball around the part of the ghost surface that a tile sees; `None` in a hole.
fn ghost_ball(
    depth: &[f32],
    width: u32,
    ray_direction: &impl Fn(f32, f32) -> Vec3A,
    x0: u32,
    y0: u32,
    x1: u32,
    y1: u32,
) -> Option<(Vec3A, f32)> {
    let (mut near, mut far) = (f32::INFINITY, f32::NEG_INFINITY);
    for y in y0..y1 {
        let row = (y * width) as usize;
        for &z in &depth[row + x0 as usize..row + x1 as usize] {
            // Both leave their accumulator alone where z is invalid, a NaN.
            near = near.min(z);
            far = far.max(z);
        }
    }
    if near > far {
        return None;
    }
    let (mut low, mut high) = (Vec3A::splat(f32::INFINITY), Vec3A::splat(f32::NEG_INFINITY));
    for (u, v) in [(x0, y0), (x1 - 1, y0), (x0, y1 - 1), (x1 - 1, y1 - 1)] {
        let d = ray_direction(u as f32, v as f32);
        for z in [near, far] {
            low = low.min(d * z);
            high = high.max(d * z);
        }
    }
    Some(((low + high) * 0.5, (high - low).length() * 0.5))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use proptest::prelude::*;

    proptest! {
        /// Every vertex of a placed mesh lies in one of its placed balls, however it is stretched.
        #[test]
        fn the_balls_cover_the_mesh(
            corners in prop::collection::vec(prop::array::uniform3(-2.0..2.0f32), 3..90),
            columns in prop::array::uniform3(prop::array::uniform3(-3.0..3.0f32)),
            shift in prop::array::uniform3(-5.0..5.0f32),
        ) {
            let positions: Vec<Vec3> = corners.into_iter().map(Vec3::from).collect();
            let triangles = (0..positions.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
            let mesh = Mesh { positions, triangles, ..Mesh::default() };
            let placed = Affine3A::from_mat3_translation(glam::Mat3::from_cols_array_2d(&columns), shift.into());
            let balls: Vec<Ball> = cover(&mesh, BALLS_PER_MESH).iter().map(|ball| transform_ball(ball, &placed)).collect();
            prop_assert!(balls.len() <= BALLS_PER_MESH);
            for triangle in &mesh.triangles {
                let inside = |p: Vec3A| balls.iter().any(|b| (p - b.center).length() <= b.radius * (1.0 + gamma(8)));
                for &i in triangle {
                    prop_assert!(inside(placed.transform_point3a(mesh.positions[i as usize].into())));
                }
            }
        }
    }
}
