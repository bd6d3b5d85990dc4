//! Named hard cases: all exact traversals must agree to the bit, return, and match the geometry.

use super::*;

/// The outcome that follows from geometry.
#[derive(Debug, Clone, Copy)]
enum Expected {
    /// A hit at this parameter, up to f32 rounding of the origin and direction.
    HitAt(f32),
    Environment,
    Unknown,
    /// Either outcome is right; the trace must return, and all traversals must agree.
    Any,
}

/// Flat depth of 2 m, 9x7 pixels, f = 8: pixel (4, 3) looks along z, pixels are 0.25 m apart at
/// 2 m, all exact in f32.
fn flat(z: f32) -> (DepthImage, Intrinsics) {
    let intrinsics = Intrinsics::new(8.0, 8.0, 4.0, 3.0, 9, 7).unwrap();
    (DepthImage::from_metres(9, 7, vec![z; 63]), intrinsics)
}

fn run(name: &str, surface: &GhostSurface, ray: Ray, expected: Expected) {
    let outcome = exact(surface, &[ray], name)[0];
    match (expected, outcome) {
        (Expected::HitAt(t), GhostOutcome::Hit(hit)) => {
            assert!(
                (hit.t - t).abs() <= 1e-6 * t.abs(),
                "{name}: {} for {t}",
                hit.t
            );
        }
        (Expected::Environment, GhostOutcome::Environment)
        | (Expected::Unknown, GhostOutcome::Unknown)
        | (Expected::Any, _) => {}
        _ => panic!("{name}: expected {expected:?}, got {outcome:?}"),
    }
}

#[test]
fn rays_at_a_flat_wall() {
    let (depth, intrinsics) = flat(2.0);
    let surface = surface_of(&depth, &intrinsics);
    let v = Vec3A::new;
    let to = |t_max: f32, ray: Ray| Ray { t_max, ..ray };
    let from = |t_min: f32, ray: Ray| Ray { t_min, ..ray };
    use Expected::*;
    let cases = [
        (
            "through the camera's centre",
            ray(v(0.0, 0.0, 0.0), v(0.0, 0.0, 1.0)),
            HitAt(2.0),
        ),
        (
            "centre, from behind the camera",
            ray(v(0.0, 0.0, -1.0), v(0.0, 0.0, 2.0)),
            HitAt(1.5),
        ),
        (
            "centre, through a vertex off axis",
            ray(v(0.0, 0.0, 0.0), v(0.125, 0.25, 1.0)),
            HitAt(2.0),
        ),
        (
            "centre, between vertices",
            ray(v(0.0, 0.0, 0.0), v(0.05, 0.03, 1.0)),
            HitAt(2.0),
        ),
        (
            "away from the wall",
            ray(v(0.0, 0.0, 1.0), v(0.0, 0.0, -1.0)),
            Environment,
        ),
        (
            "along x, before the wall",
            ray(v(0.0, 0.0, 1.0), v(1.0, 0.0, 0.0)),
            Environment,
        ),
        (
            "along -x, -0.0 elsewhere",
            ray(v(0.0, 0.0, 1.0), v(-1.0, -0.0, -0.0)),
            Environment,
        ),
        (
            "along y, before the wall",
            ray(v(0.0, 0.0, 1.0), v(0.0, -1.0, 0.0)),
            Environment,
        ),
        (
            "along x, behind the wall",
            ray(v(0.0, 0.0, 3.0), v(1.0, 0.0, 0.0)),
            Unknown,
        ),
        (
            "along z, at a pixel's edge",
            ray(v(0.125, 0.0, 1.0), v(0.0, 0.0, 1.0)),
            HitAt(1.0),
        ),
        (
            "along z, at a pixel's corner",
            ray(v(0.25, 0.25, 1.0), v(0.0, 0.0, 1.0)),
            HitAt(1.0),
        ),
        (
            "in the plane of a row of edges",
            ray(v(-0.3, 0.0, 1.0), v(0.25, 0.0, 1.0)),
            HitAt(1.0),
        ),
        (
            "in the plane of the diagonals",
            ray(v(-0.25, -0.25, 1.0), v(0.25, 0.25, 1.0)),
            HitAt(1.0),
        ),
        (
            "across the diagonals",
            ray(v(0.2, -0.2, 1.0), v(-0.2, 0.2, 1.0)),
            HitAt(1.0),
        ),
        (
            "from behind",
            ray(v(0.1, 0.1, 3.0), v(0.0, 0.0, -1.0)),
            HitAt(1.0),
        ),
        (
            "starting on the wall, leaving",
            ray(v(0.1, 0.05, 2.0), v(0.1, 0.0, -1.0)),
            HitAt(0.0),
        ),
        (
            "starting on the wall, past t_min",
            from(1e-3, ray(v(0.1, 0.05, 2.0), v(0.1, 0.0, -1.0))),
            Environment,
        ),
        (
            "starting on the wall, along it",
            ray(v(0.1, 0.05, 2.0), v(1.0, 0.0, 0.0)),
            HitAt(0.0),
        ),
        (
            "starting behind, leaving",
            ray(v(0.1, 0.05, 2.5), v(0.0, 0.0, 1.0)),
            Unknown,
        ),
        (
            "ending before the wall",
            to(0.5, ray(v(0.1, 0.05, 1.0), v(0.0, 0.0, 1.0))),
            Environment,
        ),
        (
            "ending on the wall",
            to(1.0, ray(v(0.1, 0.05, 1.0), v(0.0, 0.0, 1.0))),
            HitAt(1.0),
        ),
        (
            "starting at t_min on the wall",
            from(1.0, ray(v(0.1, 0.05, 1.0), v(0.0, 0.0, 1.0))),
            HitAt(1.0),
        ),
        (
            "starting past the wall",
            from(1.5, ray(v(0.1, 0.05, 1.0), v(0.0, 0.0, 1.0))),
            Unknown,
        ),
        (
            "at the image's border",
            ray(v(1.0, 0.0, 1.0), v(0.0, 0.0, 1.0)),
            HitAt(1.0),
        ),
        (
            "at the image's corner",
            ray(v(0.5, 0.375, 1.0), v(0.5, 0.375, 1.0)),
            HitAt(1.0),
        ),
        (
            "beside the image",
            ray(v(5.0, 0.0, 1.0), v(0.0, 0.0, 1.0)),
            Any,
        ),
        (
            "never in the image",
            ray(v(0.0, 5.0, 1.0), v(1.0, 1.0, 0.0)),
            Environment,
        ),
        (
            "wholly behind the camera",
            ray(v(0.0, 0.0, -1.0), v(0.1, 0.0, -1.0)),
            Environment,
        ),
        (
            "through the camera's plane",
            ray(v(0.1, 0.0, -1.0), v(0.0, 0.0, 1.0)),
            HitAt(3.0),
        ),
        (
            "denormal direction",
            ray(v(0.0, 0.0, 1.0), v(0.0, 0.0, 1e-40)),
            HitAt(f32::MAX),
        ),
        (
            "huge direction",
            ray(v(0.0, 0.0, 1.0), v(0.0, 0.0, 1e38)),
            HitAt(1e-38),
        ),
        (
            "huge origin",
            ray(v(0.0, 0.0, -1e20), v(0.0, 0.0, 1.0)),
            HitAt(1e20),
        ),
        (
            "largest numbers",
            ray(
                v(f32::MAX, f32::MAX, f32::MAX),
                v(f32::MIN, f32::MIN, f32::MIN),
            ),
            Any,
        ),
        (
            "no direction",
            ray(v(0.0, 0.0, 1.0), v(0.0, -0.0, 0.0)),
            Unknown,
        ),
        (
            "NaN direction",
            ray(v(0.0, 0.0, 1.0), v(f32::NAN, 0.0, 1.0)),
            Unknown,
        ),
        (
            "NaN origin",
            ray(v(0.0, f32::NAN, 1.0), v(0.0, 0.0, 1.0)),
            Unknown,
        ),
        (
            "infinite direction",
            ray(v(0.0, 0.0, 1.0), v(f32::INFINITY, 0.0, 1.0)),
            Unknown,
        ),
        (
            "opposite infinities",
            ray(v(f32::INFINITY, f32::NEG_INFINITY, 1.0), v(0.0, 0.0, 1.0)),
            Unknown,
        ),
        (
            "NaN t_max",
            to(f32::NAN, ray(v(0.0, 0.0, 1.0), v(0.0, 0.0, 1.0))),
            Unknown,
        ),
        (
            "NaN t_min",
            from(f32::NAN, ray(v(0.0, 0.0, 1.0), v(0.0, 0.0, 1.0))),
            Unknown,
        ),
        (
            "infinite t_min",
            from(f32::INFINITY, ray(v(0.0, 0.0, 1.0), v(0.0, 0.0, 1.0))),
            Unknown,
        ),
        (
            "empty interval",
            to(-1.0, ray(v(0.0, 0.0, 1.0), v(0.0, 0.0, 1.0))),
            Unknown,
        ),
        (
            "negative t_min",
            from(-5.0, ray(v(0.1, 0.05, 3.0), v(0.0, 0.0, 1.0))),
            HitAt(-1.0),
        ),
    ];
    for (name, ray, expected) in cases {
        run(name, &surface, ray, expected);
        // There is no exact result for the approximate traversals here, but they must return.
        surface.trace(Traversal::Bresenham, &ray);
        surface.trace(Traversal::BresenhamNearest, &ray);
    }
}

#[test]
fn grazing_rays_meet_the_wall_where_geometry_says() {
    for z in [1e-3f32, 0.5, 2.0, 1e4] {
        let (depth, intrinsics) = flat(z);
        let surface = surface_of(&depth, &intrinsics);
        for exponent in 3..=7 {
            let slope = 10f32.powi(-exponent);
            // Starts `0.5 z slope` in front of the wall, so the ray hits it at t = 0.5 z.
            let start = z - 0.5 * z * slope;
            let origin = Vec3A::new(-0.3 * z, 0.013 * z, start);
            let direction = Vec3A::new(1.0, 0.0, slope);
            // In f32 the start has a rounded distance from the wall, so the actual distance counts.
            let t = (f64::from(z) - f64::from(start)) / f64::from(slope);
            let exact_outcome = exact(&surface, &[ray(origin, direction)], "grazing")[0];
            // Beyond the image's border.
            if t > 0.6 * f64::from(z) {
                continue;
            }
            match exact_outcome {
                GhostOutcome::Hit(hit) => {
                    let error = (f64::from(hit.t) - t).abs();
                    // The contact tolerance over the slope, and a rounding of t.
                    let bound = 2e-11 / f64::from(slope) * f64::from(z) + 1e-7 * t;
                    assert!(error <= bound, "{z} m, {slope}: {} for {t}", hit.t);
                }
                other => panic!("{z} m, {slope}: {other:?}"),
            }
        }
    }
}

/// Name, width, height, depth by pixel number and width.
type Map = (&'static str, u32, u32, fn(u32, u32) -> f32);

/// Small and unusual maps: all traversals agree, and none hangs or panics.
#[test]
fn odd_maps() {
    let checkerboard = |k: u32, width: u32| (k % width + k / width).is_multiple_of(2);
    let maps: [Map; 13] = [
        ("1x1", 1, 1, |_, _| 2.0),
        ("2x1", 2, 1, |_, _| 2.0),
        ("1x2", 1, 2, |_, _| 2.0),
        ("2x2", 2, 2, |_, _| 2.0),
        ("1xN", 1, 300, |_, _| 2.0),
        ("Nx1", 300, 1, |_, _| 2.0),
        ("5x5, one tile and a bit", 6, 6, |_, _| 2.0),
        ("all invalid", 40, 30, |_, _| 0.0),
        ("one-pixel holes", 50, 40, |k, _| {
            if k % 7 == 0 { 0.0 } else { 2.0 }
        }),
        (
            "one quantum",
            50,
            40,
            |k, _| if k % 3 == 0 { 2.0 } else { 2.001 },
        ),
        ("steps of metres", 50, 40, |k, w| {
            if (k % w) / 10 % 2 == 0 { 1.0 } else { 4.0 }
        }),
        ("nearest and farthest", 50, 40, |k, _| {
            if k % 11 < 5 { 1e-3 } else { 1e4 }
        }),
        ("wide, many levels", 4200, 3, |k, _| {
            2.0 + 0.3 * ((k % 97) as f32 / 97.0)
        }),
    ];
    for (name, width, height, z) in maps {
        let intrinsics = camera(width, height);
        let z_m = (0..width * height).map(|k| z(k, width)).collect();
        let depth = DepthImage::from_metres(width, height, z_m);
        let surface = surface_of(&depth, &intrinsics);
        let rays = mixed_rays(&surface, 3000, 17);
        let outcomes = exact(&surface, &rays, name);
        if width == 1 || height == 1 || name == "all invalid" {
            assert!(
                !outcomes.iter().any(|o| matches!(o, GhostOutcome::Hit(_))),
                "{name}"
            );
        }
        for ray in &rays {
            surface.trace(Traversal::Bresenham, ray);
            surface.trace(Traversal::BresenhamNearest, ray);
        }
    }
    let (width, height) = (33, 21);
    let z_m = (0..width * height)
        .map(|k| if checkerboard(k, width) { 2.0 } else { 0.0 })
        .collect();
    let depth = DepthImage::from_metres(width, height, z_m);
    let surface = surface_of(&depth, &camera(width, height));
    let outcomes = exact(&surface, &mixed_rays(&surface, 3000, 23), "checkerboard");
    assert!(!outcomes.iter().any(|o| matches!(o, GhostOutcome::Hit(_))));
}

fn camera(width: u32, height: u32) -> Intrinsics {
    let f = f64::from(width.max(height));
    Intrinsics::new(
        f,
        f,
        f64::from(width) / 2.0,
        f64::from(height) / 2.0,
        width,
        height,
    )
    .unwrap()
}

/// Through a gap in the depth surface, and past its edge.
#[test]
fn a_ray_behind_the_sheet_is_unknown() {
    let (mut depth, intrinsics) = flat(2.0);
    for y in 0..7 {
        depth.z_m[y * 9 + 4] = DepthImage::INVALID;
    }
    let surface = surface_of(&depth, &intrinsics);
    let v = Vec3A::new;
    let through = ray(v(0.0, 0.0, 1.0), v(0.0, 0.0, 1.0));
    run(
        "through the gap, to infinity",
        &surface,
        through,
        Expected::Unknown,
    );
    let ends_in_gap = Ray {
        t_max: 0.5,
        ..through
    };
    run(
        "ending before the gap",
        &surface,
        ends_in_gap,
        Expected::Unknown,
    );
    let aside = ray(v(0.0, 0.0, 1.9), v(-0.3, 0.0, 1.0));
    run(
        "through the gap, then behind",
        &surface,
        aside,
        Expected::Unknown,
    );
    let back = ray(v(0.0, 0.0, 3.0), v(0.5, 0.0, -1.0));
    run(
        "from behind the gap, back out",
        &surface,
        back,
        Expected::HitAt(1.0),
    );
    let crossing = ray(v(-0.5, 0.0, 1.5), v(1.0, 0.0, 0.0));
    run(
        "before the gap, out at the border",
        &surface,
        crossing,
        Expected::Environment,
    );
}

/// Rays at every vertex, edge and diagonal of a wavy depth surface, from both sides: none passes through.
#[test]
fn the_sheet_has_no_cracks() {
    let intrinsics = Intrinsics::new(60.0, 60.0, 24.0, 16.0, 49, 33).unwrap();
    let z_m = (0..49 * 33)
        .map(|k| 2.0 + 0.02 * ((k % 49) as f32 * 0.9).sin() + 0.02 * ((k / 49) as f32 * 1.3).cos())
        .collect();
    let depth = DepthImage::from_metres(49, 33, z_m);
    let surface = surface_of(&depth, &intrinsics);
    let mut rays = Vec::new();
    for k in 0..60_000u32 {
        let r = |dimension| uniform(k, 9, dimension);
        let (x, y) = (2 + (r(0) * 44.0) as u32, 2 + (r(1) * 28.0) as u32);
        let at = |x: u32, y: u32| {
            intrinsics.ray_direction(x as f32, y as f32) * depth.z_m[(y * 49 + x) as usize]
        };
        let (a, b) = (at(x, y), at(x + k % 2, y + (k / 2) % 2));
        let target = a + (b - a) * if k % 5 == 0 { 0.0 } else { r(2) };
        let side = if k % 3 == 0 { 1.0 } else { -1.0 };
        let origin = target + Vec3A::new(0.3 * (r(3) - 0.5), 0.3 * (r(4) - 0.5), 0.4 * side);
        rays.push(Ray {
            t_max: 2.0,
            ..ray(origin, target - origin)
        });
    }
    for (ray, outcome) in rays.iter().zip(exact(&surface, &rays, "cracks")) {
        assert!(
            matches!(outcome, GhostOutcome::Hit(_)),
            "{ray:?}: {outcome:?}"
        );
    }
}

/// A view ray through a vertex is a segment along grid lines: a contact in the column on one side says nothing
/// about the cells on the other. Depths are 1.1 mm and 10 km, so that rounding in the ray's last millimetre
/// carries the segment across the picture, through near cells beside the far cell in which it starts.
#[test]
fn a_segment_along_a_grid_line_is_looked_for_on_both_sides() {
    let (width, height) = (50, 40);
    let intrinsics = Intrinsics::new(50.0, 50.0, 25.0, 20.0, width, height).unwrap();
    let z_m = (0..width * height)
        .map(|k| {
            if (k % width + k / width) % 11 < 5 {
                1.1e-3
            } else {
                1e4
            }
        })
        .collect();
    let surface = surface_of(&DepthImage::from_metres(width, height, z_m), &intrinsics);
    let along = ray(
        Vec3A::new(0.0, 1249.8306, 12498.306),
        Vec3A::new(0.0, -249.83055, -2498.3054),
    );
    run("down a sight line", &surface, along, Expected::HitAt(1.0));
    let lines: Vec<Ray> = (1..width - 1)
        .flat_map(|x| (1..height - 1).map(move |y| (x, y)))
        .flat_map(|(x, y)| {
            let view = intrinsics.ray_direction(x as f32, y as f32);
            [12_500.0, 1e4, 0.5, 1.1e-3].map(|z| ray(view * z, view * (-0.2 * z)))
        })
        .collect();
    exact(&surface, &lines, "sight lines through vertices");
}
