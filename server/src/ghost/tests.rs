//! The traversals against each other and against brute force.

use glam::Vec3A;

use super::*;
use crate::numerics::uniform;
use crate::oracle::ghost::{GhostOracle, Verdict};
use rayon::prelude::*;

/// A box room with boxes in it, seen by a Kinect: 640x480 by default.
fn room(width: u32, height: u32, quantised: bool) -> (DepthImage, Intrinsics) {
    let f = 525.0 * f64::from(width) / 640.0;
    let intrinsics = Intrinsics::new(
        f,
        f,
        f64::from(width) / 2.0 - 0.5,
        f64::from(height) / 2.0 - 0.5,
        width,
        height,
    )
    .unwrap();
    let z_m = (0..width * height)
        .map(|k| {
            let (x, y) = (k % width, k / width);
            let d = intrinsics.ray_direction(x as f32, y as f32);
            let mut z = 3.5f32;
            z = z.min(if d.y > 0.0 { 1.2 / d.y } else { 9.0 });
            z = z.min(if d.x != 0.0 { 2.0 / d.x.abs() } else { 9.0 });
            for (cx, cy, r, zb) in [
                (-0.5, 0.3, 0.25, 1.6),
                (0.4, 0.1, 0.2, 1.1),
                (0.1, -0.4, 0.3, 2.4),
            ] {
                let (px, py) = (d.x * zb - cx, d.y * zb - cy);
                if px.abs() < r && py.abs() < r {
                    z = z.min(zb + 0.3 * px);
                }
            }
            if quantised {
                // Disparity in eighths of a pixel, and a little noise.
                let noise = uniform(k, 0, 0) - 0.5;
                let disparity = (575.0 * 0.075 / z * 8.0 + noise).round() / 8.0;
                z = 575.0 * 0.075 / disparity;
                if uniform(k / 7, 1, 1) < 0.03 {
                    z = 0.0;
                }
            }
            z
        })
        .collect();
    (DepthImage::from_metres(width, height, z_m), intrinsics)
}

/// Reflection-like rays: from points a little in front of the surface, or anywhere.
fn random_rays(surface: &GhostSurface, n: u32, seed: u32) -> Vec<Ray> {
    (0..n)
        .map(|k| {
            let r = |d: u32| uniform(k, seed, d);
            let u = r(0) * surface.width() as f32;
            let v = r(1) * surface.height() as f32;
            let z = surface.depth_at(u, v).unwrap_or(2.0) * (0.3 + 0.8 * r(2));
            let origin = surface.intrinsics().ray_direction(u, v) * z;
            let mut direction = Vec3A::new(r(3) - 0.5, r(4) - 0.5, r(5) - 0.5);
            match k % 8 {
                0 => direction.x = 0.0,
                1 => direction.y = 0.0,
                2 => direction.z = 0.0,
                3 => direction *= 1e-3,
                _ => {}
            }
            let t_max = if k % 5 == 0 {
                r(6) * 4.0
            } else {
                f32::INFINITY
            };
            Ray {
                origin,
                direction,
                t_min: 0.0,
                t_max,
            }
        })
        .collect()
}

#[derive(Debug, Default, Clone)]
struct Tally {
    rays: usize,
    hits: usize,
    missed: usize,
    false_hits: usize,
    wrong: usize,
    outcome: usize,
    ambiguous: usize,
    errors: Vec<f64>,
}

fn judge(tally: &mut Tally, verdict: Verdict, outcome: GhostOutcome) {
    tally.rays += 1;
    match (verdict, outcome) {
        (Verdict::AmbiguousHit | Verdict::AmbiguousMiss, _) => tally.ambiguous += 1,
        (Verdict::Hit { t, from_front, .. }, GhostOutcome::Hit(hit)) => {
            tally.hits += 1;
            let error = (f64::from(hit.t) - t).abs() / t.abs().max(1e-30);
            if error > 1e-2 || from_front != hit.from_front {
                tally.wrong += 1;
            }
            tally.errors.push(error);
        }
        (Verdict::Hit { .. }, _) => tally.missed += 1,
        (_, GhostOutcome::Hit(_)) => tally.false_hits += 1,
        (Verdict::Environment, GhostOutcome::Environment)
        | (Verdict::Unknown, GhostOutcome::Unknown) => {}
        _ => tally.outcome += 1,
    }
}

fn check(
    name: &str,
    depth: &DepthImage,
    intrinsics: &Intrinsics,
    rays: impl Fn(&GhostSurface) -> Vec<Ray>,
) -> Tally {
    let settings = GhostSettings::default();
    let mut surface = GhostSurface::new();
    surface.rebuild(depth, intrinsics, &settings);
    let oracle = GhostOracle::new(depth, intrinsics, &settings);
    let rays = rays(&surface);
    let mut tally = rays
        .par_chunks(256)
        .map(|rays| {
            let mut tally = Tally::default();
            for ray in rays {
                let dda = surface.trace(Traversal::Dda, ray);
                let pyramid = surface.trace(Traversal::Pyramid, ray);
                assert_eq!(dda, pyramid, "{name}: {ray:?}");
                let verdict = oracle.verdict(ray);
                let before = (tally.missed, tally.false_hits, tally.wrong, tally.outcome);
                judge(&mut tally, verdict, pyramid);
                if before != (tally.missed, tally.false_hits, tally.wrong, tally.outcome) {
                    eprintln!("{name}: {ray:?}\n  {verdict:?} against {pyramid:?}");
                }
            }
            tally
        })
        .reduce(Tally::default, |mut a, b| {
            a.rays += b.rays;
            a.hits += b.hits;
            a.missed += b.missed;
            a.false_hits += b.false_hits;
            a.wrong += b.wrong;
            a.outcome += b.outcome;
            a.ambiguous += b.ambiguous;
            a.errors.extend(b.errors);
            a
        });
    tally.errors.sort_by(f64::total_cmp);
    let median = tally
        .errors
        .get(tally.errors.len() / 2)
        .copied()
        .unwrap_or(0.0);
    let worst = tally.errors.last().copied().unwrap_or(0.0);
    eprintln!(
        "{name}: {} rays, {} hits, {} missed, {} false, {} wrong, {} outcome, {} ambiguous, median {median:.1e}, worst {worst:.1e}",
        tally.rays,
        tally.hits,
        tally.missed,
        tally.false_hits,
        tally.wrong,
        tally.outcome,
        tally.ambiguous
    );
    tally
}

#[test]
fn synthetic() {
    for quantised in [false, true] {
        let (depth, intrinsics) = room(320, 240, quantised);
        let tally = check("room", &depth, &intrinsics, |surface| {
            random_rays(surface, 5000, 1)
        });
        assert_eq!(
            (tally.missed, tally.false_hits, tally.wrong, tally.outcome),
            (0, 0, 0, 0)
        );
    }
}
