//! The ghost surface against double-precision brute force: no miss, no false hit.

mod data;

use ghostlight::accel::Ray;
use ghostlight::camera::Intrinsics;
use ghostlight::frame::DepthImage;
use ghostlight::ghost::{GhostOutcome, GhostSurface, mixed_rays};
use ghostlight::ghost::{GhostSettings, Traversal};
use ghostlight::recording::{OpenOptions, Recording};
use ghostlight_lab::oracle::ghost::{GhostOracle, Verdict};
use ghostlight_lab::synth::room_depth;
use rayon::prelude::*;

#[derive(Debug, Default)]
struct Tally {
    rays: usize,
    ambiguous: usize,
    /// Relative errors of t, for rays that are neither grazing nor near steep ends.
    errors: Vec<f64>,
    failures: Vec<String>,
}

impl Tally {
    fn judge(&mut self, ray: &Ray, verdict: Verdict, outcome: GhostOutcome) {
        self.rays += 1;
        match (verdict, outcome) {
            (Verdict::AmbiguousHit, _) => self.ambiguous += 1,
            (Verdict::AmbiguousMiss, GhostOutcome::Environment | GhostOutcome::Unknown) => {
                self.ambiguous += 1;
            }
            (
                Verdict::Hit {
                    t,
                    from_front,
                    grazing,
                },
                GhostOutcome::Hit(hit),
            ) => {
                let error = (f64::from(hit.t) - t).abs();
                self.errors.push(error / t.abs());
                // One rounding to f32, plus the margin within which the oracle itself is not sure.
                let reach = t.abs().max(10.0 / f64::from(ray.direction.length()));
                let bound = 1e-7 * t.abs() + 1e-8 / grazing * reach;
                if error > bound || from_front != hit.from_front {
                    self.fail(ray, verdict, outcome);
                }
            }
            (Verdict::Environment, GhostOutcome::Environment)
            | (Verdict::Unknown, GhostOutcome::Unknown) => {}
            _ => self.fail(ray, verdict, outcome),
        }
    }

    fn fail(&mut self, ray: &Ray, verdict: Verdict, outcome: GhostOutcome) {
        self.failures
            .push(format!("{ray:?}: expected {verdict:?}, got {outcome:?}"));
    }

    fn merge(mut self, other: Self) -> Self {
        self.rays += other.rays;
        self.ambiguous += other.ambiguous;
        self.errors.extend(other.errors);
        self.failures.extend(other.failures);
        self
    }
}

/// Traces mixed rays with every exact traversal and compares with brute force.
fn compare(name: &str, depth: &DepthImage, intrinsics: &Intrinsics, n: u32) -> Tally {
    let mut surface = GhostSurface::new();
    surface.rebuild(depth, intrinsics, &GhostSettings::default());
    let oracle = GhostOracle::new(depth, intrinsics, &GhostSettings::default());
    let rays = mixed_rays(&surface, n, n);
    let tally = rays
        .par_chunks(256)
        .map(|rays| {
            let mut tally = Tally::default();
            for (ray, outcome) in rays.iter().zip(exact(&surface, rays, name)) {
                tally.judge(ray, oracle.verdict(ray), outcome);
            }
            tally
        })
        .reduce(Tally::default, Tally::merge);
    assert!(
        tally.failures.is_empty(),
        "{name}: {} of {} rays; first: {}",
        tally.failures.len(),
        tally.rays,
        tally.failures[..tally.failures.len().min(5)].join("\n")
    );
    tally
}

/// Checks the median error, the number of hits and the share of ambiguous rays.
fn conclude(name: &str, mut tally: Tally) {
    tally.errors.sort_by(f64::total_cmp);
    let median = tally.errors[tally.errors.len() / 2];
    let share = tally.ambiguous as f64 / tally.rays as f64;
    println!(
        "{name}: {} rays, {} hits, {} ambiguous, median relative error of t {median:.1e}",
        tally.rays,
        tally.errors.len(),
        tally.ambiguous
    );
    assert!(median < 1e-6, "{name}: median error {median}");
    assert!(share < 0.005, "{name}: {share} ambiguous");
    assert!(tally.errors.len() * 5 > tally.rays, "{name}: too few hits");
}

/// Traces with every exact traversal, and checks that the results are bit-identical.
fn exact(surface: &GhostSurface, rays: &[Ray], name: &str) -> Vec<GhostOutcome> {
    let mut outcomes = vec![GhostOutcome::Unknown; rays.len()];
    surface.trace_batch(rays, &mut outcomes);
    for (ray, &batch) in rays.iter().zip(&outcomes) {
        for traversal in [Traversal::Dda, Traversal::Pyramid] {
            let single = surface.trace(traversal, ray);
            assert_eq!(
                single, batch,
                "{name}: {traversal:?} against batch, {ray:?}"
            );
        }
    }
    outcomes
}

#[test]
fn synthetic_depth_agrees_with_brute_force() {
    let room = room_depth(320, 240, 0).unwrap();
    for (name, depth) in [("exact room", &room.exact), ("sensed room", &room.sensed)] {
        conclude(name, compare(name, depth, &room.intrinsics, 12_000));
    }
}

/// Depth of three frames of each real recording; empty without the data.
fn recorded_maps() -> Vec<(&'static str, DepthImage, Intrinsics)> {
    let Some(data) = data::folder() else {
        return Vec::new();
    };
    let names = [
        "7scenes-redkitchen",
        "rgbd_dataset_freiburg1_desk-snippet",
        "iphone-lidar-3dscannerapp",
        "realsense-static",
    ];
    // Poses do not matter here, and one recording has none.
    let options = OpenOptions {
        assume_static: true,
        ..OpenOptions::default()
    };
    let frames = |name| {
        let recording = Recording::open(&data.join(name), &options)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        let step = (recording.len() / 3).max(1);
        (0..recording.len()).step_by(step).take(3).map(move |i| {
            let frame = recording
                .frame(i)
                .unwrap_or_else(|error| panic!("{name}: {error}"));
            (name, frame.depth, frame.intrinsics)
        })
    };
    names.into_iter().flat_map(frames).collect()
}

#[test]
fn recorded_depth_agrees_with_brute_force() {
    let maps = recorded_maps();
    if maps.is_empty() {
        return;
    }
    let mut all = Tally::default();
    for (name, depth, intrinsics) in &maps {
        let tally = compare(name, depth, intrinsics, 9_000);
        println!("{name}: {} rays, {} ambiguous", tally.rays, tally.ambiguous);
        all = all.merge(tally);
    }
    assert!(all.rays >= 100_000);
    conclude("recorded depth", all);
}
