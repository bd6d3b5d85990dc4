//! Levels of an environment map by direction: on the faces of an octahedron, unfolded to a square (Meyer et al.
//! 2010, "On Floating-Point Normal Vectors"), which needs no trigonometry for look-ups.

use glam::Vec3A;

use crate::numerics::luminance;
use crate::scene::Environment;

/// Texels per side of the finest level: 1.6 degrees each.
const FINEST: usize = 128;

/// Number of levels, each with half the side of the previous one.
const LEVELS: usize = 5;

/// Angle of a texel of the finest level: the side of a square with its share of the sphere.
const FINEST_ANGLE: f32 = 3.544_907_7 / FINEST as f32;

/// Position on the square, -1..1, of a direction of any length; NaN for a zero direction.
pub(crate) fn square_of(d: Vec3A) -> (f32, f32) {
    let size = (d.x.abs() + d.y.abs() + d.z.abs()).max(f32::MIN_POSITIVE);
    let (x, y) = (d.x / size, d.y / size);
    if d.z < 0.0 {
        ((1.0 - y.abs()).copysign(x), (1.0 - x.abs()).copysign(y))
    } else {
        (x, y)
    }
}

/// Direction of a position on the square, not normalized.
pub(crate) fn direction_of(x: f32, y: f32) -> Vec3A {
    let z = 1.0 - x.abs() - y.abs();
    // The lower half is folded outwards to the corners of the square.
    let fold = (-z).max(0.0);
    Vec3A::new(x - fold.copysign(x), y - fold.copysign(y), z)
}

/// Centre of the `i`-th of `n` texels along a side of the square.
pub(crate) fn middle(i: usize, n: usize) -> f32 {
    (i as f32 + 0.5) * (2.0 / n as f32) - 1.0
}

/// Radiance without lamps, at increasing blur.
#[derive(Debug, Clone)]
pub(crate) struct MapLevels {
    levels: Vec<Vec<Vec3A>>,
}

impl MapLevels {
    /// Computes the levels of a map without the radiance above `threshold`, which belongs to lamps.
    pub(crate) fn new(map: &Environment, threshold: f32) -> Self {
        // Means over each texel, from look-ups at the map's own resolution.
        let taps = (map.height as usize).div_ceil(FINEST).clamp(2, 16);
        let n = FINEST * taps;
        let texel = |i: usize| {
            let (x, y) = (i % FINEST * taps, i / FINEST * taps);
            let taps_there = (0..taps * taps).map(|k| (x + k % taps, y + k / taps));
            let sum: Vec3A = taps_there
                .map(|(x, y)| {
                    let direction = direction_of(middle(x, n), middle(y, n));
                    dimmed(Vec3A::from(map.lookup(direction.into())), threshold)
                })
                .sum();
            sum / (taps * taps) as f32
        };
        let mut levels = vec![(0..FINEST * FINEST).map(texel).collect::<Vec<_>>()];
        for k in 1..LEVELS {
            let (side, finer) = (FINEST >> k, &levels[k - 1]);
            let texel = |i: usize| {
                let first = i / side * 2 * (2 * side) + i % side * 2;
                let there = [first, first + 1, first + 2 * side, first + 2 * side + 1];
                there.iter().map(|&i| finer[i]).sum::<Vec3A>() * 0.25
            };
            levels.push((0..side * side).map(texel).collect());
        }
        Self { levels }
    }

    /// Memory held, bytes.
    pub(crate) const BYTES: u64 = (FINEST * FINEST * size_of::<Vec3A>() * 4 / 3) as u64;

    /// Mean radiance over `angle` radians around a direction of any length, world axes; `sharp` gives the
    /// radiance for angles below the resolution of the finest level.
    pub(crate) fn lookup(&self, d: Vec3A, angle: f32, sharp: impl Fn() -> Vec3A) -> Vec3A {
        let lod = (angle / FINEST_ANGLE).max(f32::MIN_POSITIVE).log2();
        if lod < 0.0 {
            // Angles a whole level finer use the map itself.
            let part = (lod + 1.0).max(0.0);
            return sharp().lerp(self.level(d, 0), part);
        }
        let lod = lod.min((LEVELS - 1) as f32);
        let fine = lod as usize;
        let coarse = (fine + 1).min(LEVELS - 1);
        self.level(d, fine).lerp(self.level(d, coarse), lod.fract())
    }

    /// Bilinear interpolation, also across the edges of the square: each edge is folded onto itself at its
    /// centre.
    fn level(&self, d: Vec3A, k: usize) -> Vec3A {
        let side = (FINEST >> k) as i32;
        let (x, y) = square_of(d);
        let place = |x: f32| {
            let x = (x + 1.0) * (0.5 * side as f32) - 0.5;
            // NaN becomes 0.
            let first = (x.floor() as i32).clamp(-1, side - 1);
            (first, x - first as f32)
        };
        let ((x0, fx), (y0, fy)) = (place(x), place(y));
        let at = |dx: i32, dy: i32| {
            let (mut x, mut y) = (x0 + dx, y0 + dy);
            if !(0..side).contains(&x) {
                (x, y) = (x.clamp(0, side - 1), side - 1 - y);
            }
            if !(0..side).contains(&y) {
                (x, y) = (side - 1 - x, y.clamp(0, side - 1));
            }
            self.levels[k][(y * side + x) as usize]
        };
        at(0, 0)
            .lerp(at(1, 0), fx)
            .lerp(at(0, 1).lerp(at(1, 1), fx), fy)
    }
}

/// Radiance without the part above a luminance, which belongs to lamps extracted from the map.
pub(crate) fn dimmed(radiance: Vec3A, threshold: f32) -> Vec3A {
    let luminance = luminance(radiance);
    if luminance > threshold {
        radiance * (threshold / luminance)
    } else {
        radiance
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use glam::{DQuat, Vec3};

    use super::*;

    fn map(texel: impl Fn(u32, u32) -> Vec3) -> Environment {
        let (width, height) = (64, 32);
        let texels = (0..width * height).map(|i| texel(i % width, i / width));
        Environment {
            width,
            height,
            radiance: Arc::new(texels.collect()),
            world_from_map: DQuat::IDENTITY,
        }
    }

    #[test]
    fn square_and_direction_are_each_others_inverse() {
        for (x, y) in [
            (0.0, 0.0),
            (0.9, 0.8),
            (-0.3, 0.6),
            (-0.95, -0.2),
            (0.4, -0.7),
        ] {
            let (u, v) = square_of(direction_of(x, y) * 3.0);
            assert!((u - x).abs() < 1e-6 && (v - y).abs() < 1e-6, "{x} {y}");
        }
    }

    #[test]
    fn an_even_map_is_even_at_every_level_and_lamps_are_dimmed() {
        let lamp = map(|x, y| Vec3::splat(if (x, y) == (10, 5) { 500.0 } else { 0.5 }));
        let levels = MapLevels::new(&lamp, 0.5);
        for angle in [0.0, 0.001, 0.03, 0.2, 1.0, 10.0] {
            for d in [Vec3A::X, -Vec3A::Y, -Vec3A::Z, Vec3A::new(0.3, -0.4, -0.7)] {
                let got = levels.lookup(d, angle, || Vec3A::splat(0.5)).x;
                assert!((got - 0.5).abs() < 1e-5, "{angle} {d}: {got}");
            }
        }
    }

    #[test]
    fn a_wide_lookup_sees_what_is_around() {
        // White above, black below; no level is so coarse that they mix at the poles.
        let halves = map(|_, y| if y < 16 { Vec3::ONE } else { Vec3::ZERO });
        let levels = MapLevels::new(&halves, f32::INFINITY);
        let up = Vec3A::from(
            (0..3)
                .map(|axis| Vec3::AXES[axis])
                .find(|&d| (halves.lookup(d) - halves.lookup(-d)).x.abs() > 0.5)
                .unwrap(),
        );
        let up = if halves.lookup(up.into()).x > 0.5 {
            up
        } else {
            -up
        };
        let aside = up.any_orthonormal_vector();
        let never = || -> Vec3A { panic!("wider than the map") };
        assert!(levels.lookup(up, 0.2, never).x > 0.99);
        assert!(levels.lookup(-up, 0.2, never).x < 0.01);
        let edge = levels.lookup(aside, 0.2, never).x;
        assert!((0.2..0.8).contains(&edge), "{edge}");
    }
}
