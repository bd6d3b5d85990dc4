//! Rays at a flat wall: every outcome follows from geometry.

use glam::Vec3A;

use super::{Effort, HardCase, Measured, Worst};
use ghostlight::accel::Ray;
use ghostlight::camera::Intrinsics;
use ghostlight::frame::DepthImage;
use ghostlight::ghost::{GhostOutcome, GhostSurface};
use ghostlight::numerics::gamma;
use ghostlight::render::{GhostSettings, Traversal};

/// The outcome that follows from geometry.
#[derive(Debug, Clone, Copy)]
enum Expected {
    /// A hit at this parameter.
    Hit(f32),
    Environment,
    Unknown,
    /// Undetermined by geometry; the trace must return, and all exact traversals must agree.
    Any,
}

use Expected::{Any, Environment, Hit, Unknown};

/// A wall at depth `z`, 9x7 pixels, f = 8: pixel (4, 3) looks along z, and at 2 m pixels are 0.25 m apart. All of
/// this is exact in f32.
fn wall(z: f32) -> GhostSurface {
    surface(9, 7, [8.0, 4.0, 3.0], vec![z; 63])
}

/// A surface with the given depths; focal length and principal point in pixels.
pub(super) fn surface(
    width: u32,
    height: u32,
    [f, cx, cy]: [f64; 3],
    z_m: Vec<f32>,
) -> GhostSurface {
    let intrinsics = Intrinsics {
        fx: f,
        fy: f,
        cx,
        cy,
        width,
        height,
    };
    let mut surface = GhostSurface::new();
    surface.rebuild(
        &DepthImage::from_metres(width, height, z_m),
        &intrinsics,
        &GhostSettings::default(),
    );
    surface
}

pub(super) fn ray(origin: [f32; 3], direction: [f32; 3]) -> Ray {
    Ray {
        origin: origin.into(),
        direction: direction.into(),
        t_min: 0.0,
        t_max: f32::INFINITY,
    }
}

/// The outcome of a ray, from every exact traversal and in a batch with other rays; an error if they differ in a
/// bit. The approximate traversals must only return.
pub(super) fn trace(surface: &GhostSurface, ray: &Ray) -> Result<GhostOutcome, String> {
    let walk = surface.trace(Traversal::Dda, ray);
    let away = Ray {
        direction: -ray.direction,
        ..*ray
    };
    let rays = [*ray, away, *ray];
    let (mut batch, mut blocked) = ([GhostOutcome::Unknown; 3], [false; 3]);
    surface.trace_batch(&rays, &mut batch);
    surface.occluded_batch(&rays, &mut blocked);
    let hit = matches!(walk, GhostOutcome::Hit(_));
    for (way, other) in [
        ("pyramid", surface.trace(Traversal::Pyramid, ray)),
        ("batch", batch[0]),
        ("end of the batch", batch[2]),
    ] {
        if other != walk {
            return Err(format!("{ray:?}: walk {walk:?}, {way} {other:?}"));
        }
    }
    if [blocked[0], blocked[2], surface.occluded(ray)] != [hit; 3] {
        return Err(format!("{ray:?}: {walk:?}, but occlusion {blocked:?}"));
    }
    surface.trace(Traversal::Bresenham, ray);
    surface.trace(Traversal::BresenhamNearest, ray);
    Ok(walk)
}

/// Compares the outcomes of rays with geometry. A hit is computed in f64 from depths and rays that are exact in
/// f32, except for 1/z, which is rounded once. With the rounding of the result there are two roundings, each
/// 2^-24 of the depth or of t; `gamma(4)` also covers their product with the slope.
fn shoot(surface: &GhostSurface, shots: &[(Ray, Expected)]) -> Result<Measured, String> {
    let mut worst = Worst::default();
    for (ray, expected) in shots {
        match (expected, trace(surface, ray)?) {
            (Hit(t), GhostOutcome::Hit(hit)) => {
                let bound = f64::from(gamma(4)) * f64::from(t.abs());
                let error = (f64::from(hit.t) - f64::from(*t)).abs();
                worst.note(error, bound, || format!("{ray:?}"));
            }
            (Environment, GhostOutcome::Environment)
            | (Unknown, GhostOutcome::Unknown)
            | (Any, _) => {
                worst.require(true, String::new);
            }
            (expected, outcome) => {
                worst.require(false, || {
                    format!("{ray:?}: {outcome:?}, expected {expected:?}")
                });
            }
        }
    }
    worst.bounded()
}

pub(super) const CENTRE: HardCase = HardCase {
    name: "depth map: rays through the camera's centre",
    why: "In (u, v, 1/z) such a ray is a single point.",
    bound: "t of the wall with at most 4 roundings",
    check: |_| {
        let mut shots = vec![
            (ray([0.0, 0.0, -1.0], [0.0, 0.0, 2.0]), Hit(1.5)),
            (ray([0.0; 3], [-0.0, 0.0, 1.0]), Hit(2.0)),
            (ray([0.0; 3], [0.0, 0.0, -1.0]), Environment),
        ];
        // Vertices, midpoints of edges, and points between.
        for (i, j) in (0..=32).flat_map(|i| (0..=24).map(move |j| (i, j))) {
            let (x, y) = ((i as f32 / 4.0 - 4.0) / 8.0, (j as f32 / 4.0 - 3.0) / 8.0);
            shots.push((ray([0.0; 3], [x, y, 1.0]), Hit(2.0)));
            // From beyond the wall, back towards the camera's centre.
            shots.push((ray([4.0 * x, 4.0 * y, 4.0], [-x, -y, -1.0]), Hit(2.0)));
        }
        shoot(&wall(2.0), &shots)
    },
};

pub(super) const AXES: HardCase = HardCase {
    name: "depth map: rays along each axis, with both zeros",
    why: "Reciprocals are infinite, and those of -0.0 and 0.0 have different signs.",
    bound: "outcomes follow from geometry; t has at most 4 roundings",
    check: |_| {
        let mut shots = Vec::new();
        for zero in [0.0, -0.0] {
            for sign in [1.0, -1.0] {
                for (origin, free) in [
                    ([0.0, 0.0, 1.0], Environment),
                    ([0.125, -0.25, 1.0], Environment),
                    ([0.0, 0.0, 3.0], Unknown),
                ] {
                    shots.push((ray(origin, [sign, zero, zero]), free));
                    shots.push((ray(origin, [zero, sign, zero]), free));
                }
                let expected = if sign > 0.0 { Hit(1.0) } else { Environment };
                for x in [0.0, 0.125, 0.25, 0.06] {
                    shots.push((ray([x, 0.0, 1.0], [zero, zero, sign]), expected));
                }
                let back = if sign < 0.0 { Hit(1.0) } else { Unknown };
                shots.push((ray([0.1, 0.1, 3.0], [zero, zero, sign]), back));
                // The ray starts on the wall.
                shots.push((ray([0.1, 0.05, 2.0], [sign, zero, zero]), Hit(0.0)));
            }
        }
        shoot(&wall(2.0), &shots)
    },
};

pub(super) const EDGES: HardCase = HardCase {
    name: "depth map: rays exactly along pixel edges, corners and the diagonal",
    why: "A ray in the plane of an edge belongs to both cells or, after one rounding, to none.",
    bound: "t of the wall with at most 4 roundings",
    check: |_| {
        let mut shots = Vec::new();
        for (i, j) in (-14..=14).flat_map(|i| (-10..=10).map(move |j| (i, j))) {
            // Points of the wall, half a pixel apart: vertices, edges and diagonals.
            let (x, y) = (i as f32 * 0.0625, j as f32 * 0.0625);
            for (dx, dy) in [
                (0.0, 0.0),
                (0.25, 0.0),
                (0.0, 0.25),
                (0.25, 0.25),
                (-0.25, 0.25),
            ] {
                // The ray arrives along a line of the grid; it starts where the image sees it.
                let start = [x - dx * 0.5, y - dy * 0.5, 1.5];
                shots.push((ray(start, [dx, dy, 1.0]), Hit(0.5)));
            }
        }
        shoot(&wall(2.0), &shots)
    },
};

pub(super) const STARTS: HardCase = HardCase {
    name: "depth map: starting on the surface, behind it, behind the camera",
    why: "Hits at t = 0 and projections of points with z <= 0.",
    bound: "outcomes follow from geometry; t has at most 4 roundings",
    check: |_| {
        let within = |t_min: f32, t_max: f32, ray: Ray| Ray {
            t_min,
            t_max,
            ..ray
        };
        let all = f32::INFINITY;
        let (on, before) = ([0.1, 0.05, 2.0], [0.1, 0.05, 1.0]);
        let (forward, leaving) = ([0.0, 0.0, 1.0], [0.1, 0.0, -1.0]);
        let shots = [
            (ray(on, leaving), Hit(0.0)),
            (within(1e-3, all, ray(on, leaving)), Environment),
            (ray([0.1, 0.05, 2.5], forward), Unknown),
            (within(0.0, 0.5, ray(before, forward)), Environment),
            (within(0.0, 1.0, ray(before, forward)), Hit(1.0)),
            (within(1.0, all, ray(before, forward)), Hit(1.0)),
            (within(1.5, all, ray(before, forward)), Unknown),
            (within(-5.0, all, ray([0.1, 0.05, 3.0], forward)), Hit(-1.0)),
            (ray([0.0, 0.0, -1.0], [0.1, 0.0, -1.0]), Environment),
            (ray([0.1, 0.0, -1.0], forward), Hit(3.0)),
            (ray([0.0, 5.0, 1.0], [1.0, 1.0, 0.0]), Environment),
            (ray([0.0, 0.0, -1e20], forward), Hit(1e20)),
        ];
        shoot(&wall(2.0), &shots)
    },
};

pub(super) const BORDER: HardCase = HardCase {
    name: "depth map: ending on the border",
    why: "After clipping to the image, a ray's end may round to either side of the last vertex.",
    bound: "outcomes follow from geometry; t has at most 4 roundings",
    check: |_| {
        let mut shots = Vec::new();
        for k in -12i16..=12 {
            let y = f32::from(k) * 0.0625;
            for x in [-1.0, 1.0] {
                shots.push((ray([x, y, 1.0], [0.0, 0.0, 1.0]), Hit(1.0)));
                // From inside, exactly to the last column.
                shots.push((ray([0.0, y, 1.0], [x, 0.0, 1.0]), Hit(1.0)));
                // Passes the wall outside the picture and enters the picture behind the wall.
                shots.push((ray([x * 1.25, y, 1.0], [0.0, 0.0, 1.0]), Unknown));
                shots.push((ray([x * 1.25, y, 1.0], [0.0, 0.0, -1.0]), Environment));
            }
        }
        for (x, y) in [(0.5, 0.375), (-0.5, 0.375), (0.5, -0.375), (-0.5, -0.375)] {
            shots.push((ray([x, y, 1.0], [x, y, 1.0]), Hit(1.0)));
        }
        shoot(&wall(2.0), &shots)
    },
};

pub(super) const GRAZING: HardCase = HardCase {
    name: "depth map: grazing at 1e-3 to 1e-7 rad, 1 mm to 10 km",
    why: "A rounding of depth moves the hit by that rounding divided by the slope.",
    bound: "exact up to one rounding of 1/z divided by the slope, and one of t",
    check: |_| {
        let mut worst = Worst::default();
        for z in [1e-3f32, 0.5, 2.0, 1e4] {
            let wall = wall(z);
            for exponent in 3..=7 {
                let slope = 10f32.powi(-exponent);
                for share in [0.1f32, 0.25, 0.5, 0.75] {
                    // The ray hits the wall after about `share` z. In f32 the start has a rounded distance from
                    // the wall, so the actual distance counts.
                    let start = z - share * z * slope;
                    let t = (f64::from(z) - f64::from(start)) / f64::from(slope);
                    let ray = ray([-0.3 * z, 0.013 * z, start], [1.0, 0.0, slope]);
                    // The ray leaves the picture before it reaches the wall.
                    if t > 0.75 * f64::from(z) {
                        continue;
                    }
                    let GhostOutcome::Hit(hit) = trace(&wall, &ray)? else {
                        worst.require(false, || format!("{z} m, {slope} rad: no hit"));
                        continue;
                    };
                    let unit = f64::from(gamma(1));
                    let bound = unit * f64::from(z) / f64::from(slope) + unit * t;
                    worst.note((f64::from(hit.t) - t).abs(), bound, || {
                        format!("{z} m, {slope} rad")
                    });
                }
            }
        }
        worst.bounded()
    },
};

pub(super) const RAYS: HardCase = HardCase {
    name: "depth map: NaN, infinite, denormal and huge rays",
    why: "A NaN compares false with everything, so a traversal may never end.",
    bound: "an invalid ray gives `Unknown`; t has at most 4 roundings and is at most the largest f32",
    check: |_: &Effort| {
        let good = ray([0.0, 0.0, 1.0], [0.0, 0.0, 1.0]);
        let mut shots = vec![
            (ray([0.0, 0.0, 1.0], [0.0, 0.0, 1e-40]), Hit(f32::MAX)),
            (ray([0.0, 0.0, 1.0], [0.0, 0.0, 1e38]), Hit(1e-38)),
            (ray([1e-42, -1e-42, 1.0], [1e-42, -0.0, 1.0]), Hit(1.0)),
            (ray([f32::MAX; 3], [f32::MIN; 3]), Any),
            (ray([0.0, 0.0, 1.0], [0.0, -0.0, 0.0]), Unknown),
            (
                Ray {
                    t_max: -1.0,
                    ..good
                },
                Unknown,
            ),
            (
                Ray {
                    t_min: f32::NAN,
                    ..good
                },
                Unknown,
            ),
            (
                Ray {
                    t_min: f32::INFINITY,
                    ..good
                },
                Unknown,
            ),
            (
                Ray {
                    t_max: f32::NAN,
                    ..good
                },
                Unknown,
            ),
        ];
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for axis in 0..3 {
                let mut spoiled = good;
                spoiled.origin[axis] = bad;
                shots.push((spoiled, Unknown));
                let mut spoiled = good;
                spoiled.direction[axis] = bad;
                shots.push((spoiled, Unknown));
            }
            shots.push((
                Ray {
                    origin: Vec3A::new(bad, -bad, 1.0),
                    ..good
                },
                Unknown,
            ));
        }
        shoot(&wall(2.0), &shots)
    },
};
