//! Against double-precision brute force: no miss, no false hit.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::*;
use crate::oracle::ghost::{GhostOracle, Verdict};

#[derive(Debug, Default)]
struct Tally {
    rays: usize,
    ambiguous: usize,
    /// Of rays clear of grazing and of steep ends, relative error of t.
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
                // One rounding to f32, and what the oracle itself calls too close to tell.
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

/// Traces mixed rays by every exact way and compares with brute force.
fn compare(name: &str, depth: &DepthImage, intrinsics: &Intrinsics, n: u32) -> Tally {
    let surface = surface_of(depth, intrinsics);
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

/// Median error, hits and share of ambiguous rays within their bounds.
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

#[test]
fn synthetic_depth_agrees_with_brute_force() {
    for (name, sensed) in [("clean room", false), ("sensed room", true)] {
        let (depth, intrinsics) = room(320, 240, sensed);
        conclude(name, compare(name, &depth, &intrinsics, 12_000));
    }
}

/// The folder with the recordings, if this run has one.
fn data() -> Option<PathBuf> {
    if let Some(folder) = std::env::var_os("GHOSTLIGHT_DATA") {
        return Some(folder.into());
    }
    let required = std::env::var("GHOSTLIGHT_REQUIRE").unwrap_or_default();
    assert!(
        !required.contains("data"),
        "GHOSTLIGHT_REQUIRE asks for data, but GHOSTLIGHT_DATA is not set"
    );
    println!("SKIPPED: GHOSTLIGHT_DATA not set");
    None
}

/// Every `step`-th file of a folder whose name begins and ends as given.
fn files(folder: &Path, begin: &str, end: &str, n: usize) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            name.starts_with(begin) && name.ends_with(end)
        })
        .collect();
    files.sort();
    let step = (files.len() / n).max(1);
    files.into_iter().step_by(step).take(n).collect()
}

/// Folder, first and last part of file names, units per metre, focal lengths and principal point.
type Recording = (&'static str, &'static str, &'static str, f64, [f64; 4]);

pub(super) fn sets_of_recordings() -> [Recording; 4] {
    [
        (
            "7scenes-redkitchen",
            "frame",
            ".depth.png",
            1000.0,
            [585.0, 585.0, 320.0, 240.0],
        ),
        (
            "rgbd_dataset_freiburg1_desk-snippet/depth",
            "",
            ".png",
            5000.0,
            [517.3, 516.5, 318.6, 255.3],
        ),
        (
            "iphone-lidar-3dscannerapp",
            "depth",
            ".png",
            1000.0,
            [193.86, 193.86, 129.4, 94.9],
        ),
        (
            "realsense-static/depth",
            "",
            ".png",
            1000.0,
            [423.81, 423.81, 319.5, 236.5],
        ),
    ]
}

/// Depth maps of each recording, `n` of each, cut to a window in the middle of at most the given
/// size; none without the data.
pub(super) fn recorded_maps(
    sets: [Recording; 4],
    n: usize,
    width: u32,
    height: u32,
) -> Vec<(&'static str, DepthImage, Intrinsics)> {
    let Some(data) = data() else {
        return Vec::new();
    };
    let mut maps = Vec::new();
    for (folder, begin, end, units, [fx, fy, cx, cy]) in sets {
        for path in files(&data.join(folder), begin, end, n) {
            let image = image::open(&path).unwrap().into_luma16();
            let (width, height) = (image.width().min(width), image.height().min(height));
            let (x, y) = ((image.width() - width) / 2, (image.height() - height) / 2);
            let window = image::imageops::crop_imm(&image, x, y, width, height).to_image();
            let (cx, cy) = (cx - f64::from(x), cy - f64::from(y));
            let intrinsics = Intrinsics::new(fx, fy, cx, cy, width, height).unwrap();
            let depth = DepthImage::from_units(width, height, &window, units, 100.0);
            maps.push((folder, depth, intrinsics));
        }
    }
    maps
}

#[test]
fn recorded_depth_agrees_with_brute_force() {
    let maps = recorded_maps(sets_of_recordings(), 3, u32::MAX, u32::MAX);
    if maps.is_empty() {
        return;
    }
    let mut all = Tally::default();
    for (folder, depth, intrinsics) in &maps {
        let tally = compare(folder, depth, intrinsics, 9_000);
        println!(
            "{folder}: {} rays, {} ambiguous",
            tally.rays, tally.ambiguous
        );
        all = all.merge(tally);
    }
    assert!(all.rays >= 100_000);
    conclude("recorded depth", all);
}
