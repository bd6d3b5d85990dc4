//! Tests of depth, planes, normals, holes and buffers.

use fearless_simd::prelude::*;
use fearless_simd::{Fallback, f32x16, mask32x16};

use super::*;
use crate::ghost::node::{LevelShape, Node, W_FIRST, W_SHIFT};

/// Depth of the plane `n . p = d`.
fn plane_depth(intrinsics: &Intrinsics, n: Vec3A, d: f32) -> DepthImage {
    let z_m = (0..intrinsics.width * intrinsics.height)
        .map(|k| {
            let (x, y) = ((k % intrinsics.width) as f32, (k / intrinsics.width) as f32);
            d / n.dot(intrinsics.ray_direction(x, y))
        })
        .collect();
    DepthImage::from_metres(intrinsics.width, intrinsics.height, z_m)
}

fn planes_of<'a>(depth: &'a DepthImage, intrinsics: &'a Intrinsics) -> DepthPlanes<'a> {
    DepthPlanes::new(depth, intrinsics, &GhostSettings::default())
}

fn camera(width: u32, height: u32) -> Intrinsics {
    Intrinsics::new(100.0, 110.0, 40.0, 28.0, width, height).unwrap()
}

#[test]
fn a_plane_has_its_own_depth_and_normal_everywhere() {
    let intrinsics = camera(80, 60);
    for n in [
        Vec3A::new(0.0, 0.0, 1.0),
        Vec3A::new(0.3, -0.5, 0.8),
        Vec3A::new(0.0, 0.95, 0.6),
    ] {
        let depth = plane_depth(&intrinsics, n, 1.5);
        let surface = surface_of(&depth, &intrinsics);
        let facing = -n.try_normalize().unwrap();
        for (x, y) in [(0, 0), (79, 59), (40, 30), (3, 57), (79, 0)] {
            let normal = surface.normal_at(x, y).unwrap();
            // Depths have an error of half an f32 ulp, and a pixel is 1/100 of the depth: 1e-5 of slope.
            assert!(
                (normal - facing).length() < 2e-5,
                "{n} at {x} {y}: {normal}"
            );
        }
        for (u, v) in [(10.25, 20.5), (78.9, 58.99), (0.0, 0.0)] {
            let z = surface.depth_at(u, v).unwrap();
            let expected = 1.5 / n.dot(intrinsics.ray_direction(u, v));
            assert!((z - expected).abs() < 1e-6 * expected, "{z} {expected}");
            let (point, normal) = planes_of(&depth, &intrinsics).at(u, v, 10).unwrap();
            assert!((n.dot(point) - 1.5).abs() < 1e-5);
            assert!((normal - facing).length() < 2e-5);
        }
    }
}

#[test]
fn a_plane_fit_ignores_what_stands_on_the_plane() {
    let intrinsics = camera(80, 60);
    let n = Vec3A::new(0.1, 0.4, 0.9);
    let mut depth = plane_depth(&intrinsics, n, 1.5);
    // An object 2 cm high on a quarter of the window: it is connected, so only trimming removes it.
    for y in 20..30 {
        for x in 30..40 {
            depth.z_m[y * 80 + x] -= 0.02;
        }
    }
    let (point, normal) = planes_of(&depth, &intrinsics).at(42.0, 32.0, 10).unwrap();
    assert!((n.dot(point) - 1.5).abs() < 1e-5, "{point}");
    assert!(
        (normal + n.try_normalize().unwrap()).length() < 1e-4,
        "{normal}"
    );
}

#[test]
fn normals_do_not_reach_across_a_depth_edge() {
    let intrinsics = camera(80, 60);
    let z_m = (0..80 * 60)
        .map(|k| if k % 80 < 40 { 1.0 } else { 2.0 })
        .collect();
    let depth = DepthImage::from_metres(80, 60, z_m);
    let surface = surface_of(&depth, &intrinsics);
    for x in [38, 39, 40, 41] {
        let normal = surface.normal_at(x, 30).unwrap();
        assert!((normal - Vec3A::NEG_Z).length() < 1e-5, "{x}: {normal}");
    }
    // Between the two depths there is no triangle, so this is the nearer pixel's depth.
    assert_eq!(surface.depth_at(39.25, 30.0), Some(1.0));
    assert_eq!(surface.depth_at(39.75, 30.0), Some(2.0));
    assert_eq!(surface.depth_at(-0.6, 30.0), None);
    assert_eq!(surface.depth_at(f32::NAN, 30.0), None);
    assert_eq!(surface.w(39, 30), Some(1.0));
    assert_eq!(surface.w(80, 30), None);
}

#[test]
fn isolated_pixels_have_no_normal_and_no_plane() {
    let intrinsics = camera(9, 9);
    let mut z_m = vec![0.0; 81];
    z_m[40] = 1.0;
    z_m[41] = 1.0;
    let depth = DepthImage::from_metres(9, 9, z_m);
    let surface = surface_of(&depth, &intrinsics);
    let planes = planes_of(&depth, &intrinsics);
    assert_eq!(surface.normal_at(4, 4), None);
    assert_eq!(surface.normal_at(0, 0), None);
    assert_eq!(planes.at(4.0, 4.0, 3), None);
    assert_eq!(planes.at(f32::NAN, 4.0, 3), None);
    assert_eq!(planes.at(0.0, 0.0, 2), None);
}

#[test]
fn a_hole_takes_the_farthest_of_its_four_nearest_depths() {
    let nan = DepthImage::INVALID;
    #[rustfmt::skip]
    let depth = DepthImage::from_metres(5, 3, vec![
        nan, 3.0, nan, nan, nan,
        1.0, nan, nan, nan, 2.0,
        nan, 4.0, nan, nan, nan,
    ]);
    let mut filled = FilledDepth::default();
    filled.rebuild(&depth);
    #[rustfmt::skip]
    let expected = [
        3.0, 3.0, 3.0, 3.0, 3.0,
        1.0, 4.0, 2.0, 2.0, 2.0,
        4.0, 4.0, 4.0, 4.0, 4.0,
    ];
    assert_eq!(filled.z_m, expected);
}

#[test]
fn a_hole_beyond_reach_stays_a_hole() {
    let reach = FILL_REACH_PX as usize;
    let width = 2 * reach + 4;
    let mut z_m = vec![0.0; width];
    z_m[0] = 1.0;
    z_m[width - 1] = 2.0;
    let depth = DepthImage::from_metres(width as u32, 1, z_m);
    let mut filled = FilledDepth::default();
    filled.rebuild(&depth);
    for (x, z) in filled.z_m.iter().enumerate() {
        let expected = if x <= reach {
            1.0
        } else if width - 1 - x <= reach {
            2.0
        } else {
            assert!(z.is_nan(), "{x}");
            continue;
        };
        assert_eq!(*z, expected, "{x}");
    }
}

#[test]
fn a_rebuilt_surface_equals_a_new_one_and_keeps_its_buffers() {
    let (first, intrinsics) = room(97, 61, true);
    let (second, _) = room(97, 61, false);
    let mut surface = surface_of(&first, &intrinsics);
    let buffers = |s: &GhostSurface| {
        (
            s.z.as_ptr(),
            s.w.as_ptr(),
            s.exists.as_ptr(),
            s.nodes.as_ptr(),
        )
    };
    let before = buffers(&surface);
    surface.rebuild(&second, &intrinsics, &GhostSettings::default());
    assert_eq!(buffers(&surface), before);
    let fresh = surface_of(&second, &intrinsics);
    let bits = |v: &[f32]| v.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&surface.z), bits(&fresh.z));
    assert_eq!(surface.exists, fresh.exists);
    for (a, b) in surface.nodes.iter().zip(&fresh.nodes) {
        assert_eq!(a.0, b.0);
    }
    // Other sizes, down and up.
    for (width, height) in [(3, 200), (640, 5), (97, 61)] {
        let (depth, intrinsics) = room(width, height, true);
        surface.rebuild(&depth, &intrinsics, &GhostSettings::default());
        let fresh = surface_of(&depth, &intrinsics);
        let rays = mixed_rays(&fresh, 300, 5);
        assert_eq!(
            exact(&surface, &rays, "reused"),
            exact(&fresh, &rays, "fresh")
        );
    }
}

#[test]
fn connectivity_is_the_documented_predicate() {
    let (depth, intrinsics) = room(100, 70, true);
    let surface = surface_of(&depth, &intrinsics);
    let settings = GhostSettings::default();
    let joined = |a: f32, b: f32| {
        let nearer = a.min(b);
        let sigma = crate::frame::depth_sigma_m(nearer);
        (a - b).abs() < settings.edge_relative * nearer + settings.edge_sigmas * sigma
    };
    let z = |x: usize, y: usize| depth.z_m[y * 100 + x];
    let mut n = [0; 2];
    for y in 0..69 {
        for x in 0..99 {
            let (a, b, c, d) = (z(x, y), z(x + 1, y), z(x, y + 1), z(x + 1, y + 1));
            let expected = (
                joined(a, b) && joined(b, d) && joined(a, d),
                joined(a, c) && joined(c, d) && joined(a, d),
            );
            assert_eq!(surface.triangles(x, y), expected, "{x} {y}");
            n[usize::from(expected.0)] += 1;
        }
    }
    assert!(n[0] > 100 && n[1] > 1000, "{n:?}");
}

#[test]
fn every_tile_bounds_the_surface_below_it() {
    let (depth, intrinsics) = room(131, 77, true);
    let surface = surface_of(&depth, &intrinsics);
    for (level, shape) in surface.levels.iter().enumerate() {
        let size = 1usize << (2 * level);
        for j in 0..surface.cells_y {
            for i in 0..surface.cells_x {
                let (upper, lower) = surface.triangles(i, j);
                let (x, y) = (i / size, j / size);
                let tile = surface.tile(shape, x, y);
                let (low, high) = (w_of_code(tile & 0xffff), w_of_code(tile >> 16));
                let corners = [
                    (0, 0, upper | lower),
                    (1, 0, upper),
                    (0, 1, lower),
                    (1, 1, upper | lower),
                ];
                for (dx, dy, used) in corners {
                    if used {
                        let w = 1.0 / f64::from(depth.z_m[(j + dy) * 131 + i + dx]);
                        assert!(low <= w && w <= high, "{low} <= {w} <= {high}");
                    }
                }
            }
        }
    }
}

impl GhostSurface {
    fn tile(&self, shape: &LevelShape, x: usize, y: usize) -> u32 {
        let node = &self.nodes[shape.offset + y / 4 * shape.stride + x / 4];
        node.0[(y % 4) * 4 + x % 4]
    }
}

/// The w that a bound's code stands for.
fn w_of_code(code: u32) -> f64 {
    f64::from(f32::from_bits(W_FIRST.to_bits() + (code << W_SHIFT)))
}

#[test]
fn codes_bound_every_inverse_depth_closely() {
    for k in 0..=10_000u32 {
        let z = (DepthImage::MIN_M * 10f32.powf(k as f32 * 7e-4)).min(DepthImage::MAX_M);
        let w = 1.0 / z;
        let bounds = f32x16::splat(Fallback::new(), w);
        for full in [false, true] {
            let cells = mask32x16::splat(Fallback::new(), full);
            let tile = Node::encode(Fallback::new(), bounds, bounds, cells)[0];
            assert_eq!(tile & Node::FULL != 0, full);
            let (low, high) = (w_of_code(tile & 0xffff), w_of_code(tile >> 16));
            let w = f64::from(w);
            assert!(low <= w && w <= high, "{low} <= {w} <= {high}");
            // Eleven bits of mantissa, rounded up by one code, and by one more in full tiles.
            let codes = if full { 3.0 } else { 2.0 };
            assert!(high - low <= codes * w / 2048.0, "{low} .. {high}");
        }
    }
}

/// A segment behind a tile may be reported as behind the depth surface only if all cells below the tile have both
/// their triangles. A cell whose bounds are far apart never counts as full.
#[test]
fn full_tiles_hold_every_triangle() {
    let holes = |k: u32| {
        let hole = k % 4099 == 7;
        if hole {
            0.0
        } else {
            2.0 + 0.01 * uniform(k, 3, 0)
        }
    };
    let slanted = |k: u32| {
        let near = 1e-3 + 0.5e-3 * (k % 131) as f32;
        if k > 6000 { near + 100.0 } else { near }
    };
    let maps: [&dyn Fn(u32) -> f32; 2] = [&holes, &slanted];
    for (map, z) in maps.into_iter().enumerate() {
        let depth = DepthImage::from_metres(131, 77, (0..131 * 77).map(z).collect());
        let intrinsics = Intrinsics::new(100.0, 100.0, 65.0, 38.0, 131, 77).unwrap();
        // Connects depths that differ by a factor of three thousand.
        let settings = GhostSettings {
            edge_relative: 3e3,
            ..GhostSettings::default()
        };
        let mut surface = GhostSurface::new();
        surface.rebuild(&depth, &intrinsics, &settings);
        let (mut n_full, mut n_far) = ([0; 4], 0);
        for (level, shape) in surface.levels.iter().enumerate() {
            let size = 1usize << (2 * level);
            for (y, x) in (0..surface.cells_y.div_ceil(size))
                .flat_map(|y| (0..surface.cells_x.div_ceil(size)).map(move |x| (y, x)))
            {
                let tile = surface.tile(shape, x, y);
                let cells = (y * size..((y + 1) * size).min(surface.cells_y)).flat_map(|j| {
                    (x * size..((x + 1) * size).min(surface.cells_x)).map(move |i| (i, j))
                });
                let whole = cells
                    .clone()
                    .all(|(i, j)| surface.triangles(i, j) == (true, true));
                let far = cells.clone().any(|(i, j)| {
                    let corners = [(0, 0), (1, 0), (0, 1), (1, 1)];
                    let z = corners.map(|(dx, dy)| depth.z_m[(j + dy) * 131 + i + dx]);
                    z.into_iter().fold(0.0, f32::max) > 600.0 * z.into_iter().fold(1e9, f32::min)
                });
                assert_eq!(
                    tile & Node::FULL != 0,
                    whole && !far,
                    "{map} {level}: {x} {y}"
                );
                n_full[level] += usize::from(whole && !far);
                n_far += usize::from(whole && far);
            }
        }
        assert!(n_full[..3].iter().all(|&n| n > 0), "{n_full:?}");
        assert!((map == 0) == (n_far == 0), "{map}: {n_far}");
    }
}
