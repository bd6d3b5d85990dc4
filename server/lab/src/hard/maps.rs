//! Unusual depth maps: steps, holes, single pixels, the ends of the range.

use glam::{DVec3, Vec3A};

use super::shapes::Dice;
use super::wall::{ray, surface, trace};
use super::{HardCase, Measured, Worst};
use crate::oracle::ghost::{GhostOracle, Verdict};
use ghostlight::accel::Ray;
use ghostlight::camera::Intrinsics;
use ghostlight::frame::DepthImage;
use ghostlight::ghost::{GhostOutcome, GhostSurface};
use ghostlight::numerics::gamma;
use ghostlight::render::GhostSettings;

/// A depth map and the oracle's version of it.
struct Map {
    surface: GhostSurface,
    oracle: GhostOracle,
    intrinsics: Intrinsics,
    z_m: Vec<f32>,
}

impl Map {
    /// The focal length is the image's longer side: about 53 degrees.
    fn new(width: u32, height: u32, z: impl Fn(u32, u32) -> f32) -> Self {
        let z_m: Vec<f32> = (0..width * height)
            .map(|k| z(k % width, k / width))
            .collect();
        let f = f64::from(width.max(height));
        let (cx, cy) = (f64::from(width) / 2.0, f64::from(height) / 2.0);
        let intrinsics = Intrinsics {
            fx: f,
            fy: f,
            cx,
            cy,
            width,
            height,
        };
        let depth = DepthImage::from_metres(width, height, z_m);
        Self {
            surface: surface(width, height, [f, cx, cy], depth.z_m.clone()),
            oracle: GhostOracle::new(&depth, &intrinsics, &GhostSettings::default()),
            intrinsics,
            z_m: depth.z_m,
        }
    }

    fn vertex(&self, x: u32, y: u32) -> DVec3 {
        let z = self.z_m[(y * self.intrinsics.width + x) as usize];
        self.intrinsics
            .unproject(f64::from(x), f64::from(y), f64::from(z))
    }

    /// Rays on the map's own scale: from in front of and behind the surface, at its pixels and past them.
    fn rays(&self, n: u32, seed: u32) -> Vec<Ray> {
        let mut dice = Dice(seed, 0);
        (0..n)
            .map(|k| {
                // Whether rays along the view rays of the border are inside or outside depends on rounding.
                let mut inner = |side: u32| match side {
                    0..=2 => dice.below(side as usize) as u32,
                    _ => 1 + dice.below(side as usize - 2) as u32,
                };
                let (x, y) = (inner(self.intrinsics.width), inner(self.intrinsics.height));
                let mut target = self.vertex(x, y);
                if !target.is_finite() {
                    target = self.intrinsics.unproject(f64::from(x), f64::from(y), 1.0);
                }
                let at = target * f64::from(0.2 + 0.79 * dice.unit());
                let start = match k % 4 {
                    0 => at,
                    1 => at * 1.5,
                    2 => at + dice.direction().as_dvec3() * (0.2 * target.z),
                    _ => dice.direction().as_dvec3() * (0.1 * target.z),
                };
                let direction = if k % 3 == 0 {
                    dice.direction().as_dvec3() * target.z
                } else {
                    // Past the vertex, exactly at it, or along the view ray of the vertex.
                    target * (1.0 + 0.2 * f64::from(k % 5 == 0)) - start
                };
                Ray {
                    origin: start.as_vec3a(),
                    direction: direction.as_vec3a(),
                    t_min: 0.0,
                    t_max: f32::INFINITY,
                }
            })
            .collect()
    }

    /// Compares every exact traversal with the oracle, where the oracle is certain. A hit's t is f64 except for
    /// the rounding of 1/z, which grazing angles magnify.
    fn check(&self, name: &str, n: u32, seed: u32, worst: &mut Worst) -> Result<u64, String> {
        let mut hits = 0;
        for ray in self.rays(n, seed) {
            let outcome = trace(&self.surface, &ray).map_err(|e| format!("{name}: {e}"))?;
            hits += u64::from(matches!(outcome, GhostOutcome::Hit(_)));
            match (self.oracle.verdict(&ray), outcome) {
                (Verdict::Hit { t, grazing, .. }, GhostOutcome::Hit(hit)) => {
                    let reach = t.abs()
                        + f64::from(ray.origin.length()) / f64::from(ray.direction.length());
                    let bound = f64::from(gamma(4)) * reach / grazing;
                    worst.note((f64::from(hit.t) - t).abs(), bound, || {
                        format!("{name}: {ray:?}")
                    });
                }
                (Verdict::Environment, GhostOutcome::Environment)
                | (Verdict::Unknown, GhostOutcome::Unknown)
                | (Verdict::AmbiguousHit, _)
                | (Verdict::AmbiguousMiss, GhostOutcome::Environment | GhostOutcome::Unknown) => {
                    worst.require(true, String::new);
                }
                (verdict, outcome) => worst.require(false, || {
                    format!("{name}: {ray:?}: {outcome:?}, oracle {verdict:?}")
                }),
            }
        }
        Ok(hits)
    }
}

const AGAINST_ORACLE: &str = "the double-precision oracle's outcome wherever that is sure; t to 4 roundings over the grazing angle";

fn all(maps: &[(&str, Map)]) -> Result<Measured, String> {
    let mut worst = Worst::default();
    let mut hits = 0;
    for ((name, map), seed) in maps.iter().zip(40..) {
        hits += map.check(name, 4_000, seed, &mut worst)?;
    }
    let share = worst.share;
    worst.told(format!("{hits} hits, worst at {share:.2} of the bound"))
}

pub(super) const NO_CRACKS: HardCase = HardCase {
    name: "depth map: rays at every vertex, edge and diagonal of a wavy sheet",
    why: "By rounding, each of two neighbouring cells may assign such a ray to the other.",
    bound: "every ray hits, because neighbours compute the same values on their common edge",
    check: |_| {
        let (width, height) = (49u32, 33u32);
        let map = Map::new(width, height, |x, y| {
            2.0 + 0.02 * (x as f32 * 0.9).sin() + 0.02 * (y as f32 * 1.3).cos()
        });
        let mut dice = Dice(9, 0);
        let mut worst = Worst::default();
        for k in 0..30_000u32 {
            let (x, y) = (2 + dice.below(44) as u32, 2 + dice.below(28) as u32);
            let (a, b) = (map.vertex(x, y), map.vertex(x + k % 2, y + (k / 2) % 2));
            let along = if k % 5 == 0 {
                0.0
            } else {
                f64::from(dice.unit())
            };
            let target = a.lerp(b, along).as_vec3a();
            let side = if k % 3 == 0 { 1.0 } else { -1.0 };
            let origin =
                target + Vec3A::new(0.15 * dice.signed(), 0.15 * dice.signed(), 0.4 * side);
            let ray = Ray {
                origin,
                direction: target - origin,
                t_min: 0.0,
                t_max: 2.0,
            };
            let outcome = trace(&map.surface, &ray)?;
            worst.require(matches!(outcome, GhostOutcome::Hit(_)), || {
                format!("{ray:?}: {outcome:?}")
            });
        }
        worst.told("no ray slips through")
    },
};

pub(super) const STEPS: HardCase = HardCase {
    name: "depth map: steps of one quantum and of metres",
    why: "The former must be connected, the latter must not, and both make long narrow triangles.",
    bound: AGAINST_ORACLE,
    check: |_| {
        all(&[
            (
                "one quantum",
                Map::new(
                    50,
                    40,
                    |x, y| {
                        if (x + 2 * y) % 3 == 0 { 2.0 } else { 2.001 }
                    },
                ),
            ),
            (
                "metres",
                Map::new(50, 40, |x, _| if x / 10 % 2 == 0 { 1.0 } else { 4.0 }),
            ),
            (
                "a ramp of ever larger steps",
                Map::new(50, 40, |x, y| 0.5 + (x * x) as f32 * 2e-3 + y as f32 * 1e-3),
            ),
        ])
    },
};

pub(super) const HOLES: HardCase = HardCase {
    name: "depth map: one-pixel holes, islands and checkerboards",
    why: "A cell needs three valid corners: most of these pixels have no surface at all.",
    bound: AGAINST_ORACLE,
    check: |_| {
        let checkered = |x: u32, y: u32| (x + y).is_multiple_of(2);
        let maps = [
            (
                "holes",
                Map::new(50, 40, |x, y| if (x + 3 * y) % 7 == 0 { 0.0 } else { 2.0 }),
            ),
            (
                "islands",
                Map::new(
                    50,
                    40,
                    |x, y| {
                        if x % 5 == 2 && y % 5 == 2 { 2.0 } else { 0.0 }
                    },
                ),
            ),
            (
                "islands before a wall",
                Map::new(
                    50,
                    40,
                    |x, y| {
                        if x % 5 == 2 && y % 5 == 2 { 1.0 } else { 2.0 }
                    },
                ),
            ),
            (
                "checkerboard of holes",
                Map::new(33, 21, |x, y| if checkered(x, y) { 2.0 } else { 0.0 }),
            ),
            (
                "checkerboard of depths",
                Map::new(33, 21, |x, y| if checkered(x, y) { 1.0 } else { 3.0 }),
            ),
            ("nothing at all", Map::new(40, 30, |_, _| 0.0)),
        ];
        // Without three connected corners there is no triangle to hit.
        for k in [1, 3, 5] {
            let (name, map) = &maps[k];
            if map.oracle.n_triangles() > 0 {
                return Err(format!("{name}: {} triangles", map.oracle.n_triangles()));
            }
        }
        all(&maps)
    },
};

pub(super) const SMALL: HardCase = HardCase {
    name: "depth map: 1x1, 2x2, 1xN, Nx1, and one pixel past a tile",
    why: "Pyramids and batches have a last level, a last tile and a last lane.",
    bound: AGAINST_ORACLE,
    check: |_| {
        let sizes = [
            (1, 1),
            (2, 1),
            (1, 2),
            (2, 2),
            (3, 3),
            (1, 300),
            (300, 1),
            (2, 300),
            (6, 6),
            (17, 17),
            (16, 16),
            (65, 33),
            (700, 3),
        ];
        let maps: Vec<(String, Map)> = sizes
            .into_iter()
            .map(|(w, h)| {
                (
                    format!("{w}x{h}"),
                    Map::new(w, h, |x, _| 2.0 + (x % 5) as f32 * 1e-3),
                )
            })
            .collect();
        let mut worst = Worst::default();
        let mut hits = 0;
        for ((name, map), seed) in maps.iter().zip(60..) {
            let found = map.check(name, 1_500, seed, &mut worst)?;
            let k = &map.intrinsics;
            if (k.width == 1 || k.height == 1) && found > 0 {
                return Err(format!("{name}: {found} hits without a cell"));
            }
            hits += found;
        }
        let share = worst.share;
        worst.told(format!("{hits} hits, worst at {share:.2} of the bound"))
    },
};

pub(super) const RANGE: HardCase = HardCase {
    name: "depth map: from 1 mm to 10 km, alone and side by side",
    why: "1/z spans seven decimal orders, which is the number of digits of an f32.",
    bound: AGAINST_ORACLE,
    check: |_| {
        // The ends of the range are valid measurements; values beyond are not.
        let ends = surface(4, 1, [4.0, 2.0, 0.0], vec![1e-3, 1e4, 0.999e-3, 1.001e4]);
        let valid: Vec<bool> = (0..4).map(|x| ends.w(x, 0).is_some()).collect();
        if valid != [true, true, false, false] {
            return Err(format!("ends of the range: {valid:?}"));
        }
        let end = trace(&ends, &ray([0.0; 3], [f32::MIN_POSITIVE, 0.0, 1.0]))?;
        if matches!(end, GhostOutcome::Hit(_)) {
            return Err(format!("a row of single pixels: {end:?}"));
        }
        let slanted = |z: f32| move |x: u32, y: u32| z * (1.0 + x as f32 * 1e-3 + y as f32 * 2e-3);
        all(&[
            // Slightly inside the range, because rays are clipped at its near end.
            ("1 mm", Map::new(50, 40, slanted(1.1e-3))),
            ("10 km", Map::new(50, 40, slanted(8.5e3))),
            (
                "both",
                Map::new(50, 40, |x, y| if (x + y) % 11 < 5 { 1.1e-3 } else { 1e4 }),
            ),
        ])
    },
};
