//! Rays per second of the ghost surface's traversals, and their errors.
//!
//! 640x480 depth of a box room with boxes in it, quantised like a Kinect's disparity, one thread. There are three
//! sets of rays: reflections off random normals at random places in free space, reflections off a mirror ball in scan
//! order, and shadow rays from the surface to a light. Occlusion queries are measured beside the traversals. All run
//! in turn in each round and the median round counts, so that ratios hold on a busy machine. Errors are relative to
//! brute force in double precision.

use std::hint::black_box;

use ghostlight::accel::Ray;
use ghostlight::camera::Intrinsics;
use ghostlight::frame::DepthImage;
use ghostlight::ghost::{GhostHit, GhostOutcome, GhostSurface};
use ghostlight::numerics::uniform;
use ghostlight::render::GhostSettings;
use ghostlight_lab::compare::ghost_rays::{MirrorBall, TRACERS, Tracer, random_rays, shadow_rays};
use ghostlight_lab::compare::{median, take_turns};
use ghostlight_lab::oracle::ghost::{GhostOracle, Verdict};

const WIDTH: u32 = 640;
const HEIGHT: u32 = 480;

/// Depth of a room of 4 x 2.4 x 3.5 m with three boxes, with the quantisation of a disparity
/// sensor (575 px, 75 mm, eighths of a pixel), jitter and holes.
fn room() -> (DepthImage, Intrinsics) {
    let intrinsics = Intrinsics {
        fx: 525.0,
        fy: 525.0,
        cx: 319.5,
        cy: 239.5,
        width: WIDTH,
        height: HEIGHT,
    };
    let boxes = [
        (-0.5, 0.3, 0.25, 1.6),
        (0.4, 0.1, 0.2, 1.1),
        (0.1, -0.4, 0.3, 2.4),
    ];
    let z_m = (0..WIDTH * HEIGHT)
        .map(|pixel| {
            let d = intrinsics.ray_direction((pixel % WIDTH) as f32, (pixel / WIDTH) as f32);
            let mut z = 3.5f32;
            if d.y > 0.0 {
                z = z.min(1.2 / d.y);
            }
            if d.x != 0.0 {
                z = z.min(2.0 / d.x.abs());
            }
            for (x, y, half_side, front) in boxes {
                let (px, py) = (d.x * front - x, d.y * front - y);
                if px.abs() < half_side && py.abs() < half_side {
                    z = z.min(front + 0.3 * px);
                }
            }
            let jitter = uniform(pixel, 0, 0) - 0.5;
            let disparity = (575.0 * 0.075 / z * 8.0 + jitter).round() / 8.0;
            if uniform(pixel / 7, 1, 1) < 0.02 {
                0.0
            } else {
                575.0 * 0.075 / disparity
            }
        })
        .collect();
    (DepthImage::from_metres(WIDTH, HEIGHT, z_m), intrinsics)
}

/// Occlusion queries, measured beside the traversals.
const OCCLUSION: [(&str, Tracer); 1] = [("pyramid, occlusion", occlusion)];

/// An occlusion query: any hit, without its position.
fn occlusion(surface: &GhostSurface, rays: &[Ray], out: &mut [GhostOutcome]) {
    let mut occluded = vec![false; rays.len()];
    surface.occluded_batch(rays, &mut occluded);
    for (out, occluded) in out.iter_mut().zip(occluded) {
        *out = if occluded {
            MET
        } else {
            GhostOutcome::Environment
        };
    }
}

/// A hit whose position is unknown.
const MET: GhostOutcome = GhostOutcome::Hit(GhostHit {
    t: f32::NAN,
    u: f32::NAN,
    v: f32::NAN,
    from_front: true,
});

/// Misses, false hits, hits with an error over 1 %, and the median relative error.
fn errors(verdicts: &[Verdict], outcomes: &[GhostOutcome]) -> String {
    let (mut missed, mut false_hits, mut wrong) = (0, 0, 0);
    let mut relative = Vec::new();
    for pair in verdicts.iter().zip(outcomes) {
        match pair {
            (Verdict::AmbiguousHit, _) => {}
            (Verdict::Hit { .. }, GhostOutcome::Hit(hit)) if hit.t.is_nan() => {}
            (Verdict::Hit { t, .. }, GhostOutcome::Hit(hit)) => {
                let error = (f64::from(hit.t) - t).abs() / t;
                wrong += usize::from(error > 1e-2);
                relative.push(error);
            }
            (Verdict::Hit { .. }, _) => missed += 1,
            (_, GhostOutcome::Hit(_)) => false_hits += 1,
            _ => {}
        }
    }
    format!(
        "{missed:>6} {false_hits:>6} {wrong:>6}   {:.1e}",
        if relative.is_empty() {
            0.0
        } else {
            median(&mut relative)
        }
    )
}

fn main() {
    // `cargo test` builds and runs benchmarks too: then a single round shows that they work.
    let measure = std::env::args().any(|argument| argument == "--bench");
    let (rounds, n_random, n_checked) = if measure {
        (9, 60_000, 4_000)
    } else {
        (1, 500, 50)
    };
    let (depth, intrinsics) = room();
    let settings = GhostSettings::default();
    let mut surface = GhostSurface::new();
    surface.rebuild(&depth, &intrinsics, &settings);
    let oracle = GhostOracle::new(&depth, &intrinsics, &settings);
    let rebuild = take_turns(rounds * 5, &mut [()], |()| {
        surface.rebuild(black_box(&depth), &intrinsics, &settings);
    });
    println!("rebuild 640x480: {:.3} ms", rebuild[0] * 1e3);
    let mut ball = MirrorBall::before(&surface).rays(&surface);
    if !measure {
        ball.truncate(n_random as usize);
    }
    for (name, rays) in [
        ("random reflections", random_rays(&surface, 0..n_random, 3)),
        ("mirror ball", ball),
        ("shadows", shadow_rays(&surface, 0..n_random, 5)),
    ] {
        let stride = rays.len().div_ceil(n_checked);
        let verdicts: Vec<Verdict> = rays
            .iter()
            .step_by(stride)
            .map(|ray| oracle.verdict(ray))
            .collect();
        let tracers = [&TRACERS[..], &OCCLUSION[..]].concat();
        let mut variants: Vec<_> = tracers
            .iter()
            .map(|(_, tracer)| (tracer, vec![GhostOutcome::Unknown; rays.len()]))
            .collect();
        let seconds = take_turns(rounds, &mut variants, |(tracer, out)| {
            tracer(&surface, black_box(&rays), out);
        });
        let reports: Vec<String> = variants
            .iter()
            .map(|(_, out)| {
                let sampled: Vec<_> = out.iter().copied().step_by(stride).collect();
                errors(&verdicts, &sampled)
            })
            .collect();
        println!(
            "\n{name}: {} rays, {} checked\n{:<22} {:>8} {:>9} {:>9}   missed  false  >1 %   median",
            rays.len(),
            verdicts.len(),
            "",
            "Mray/s",
            "/ fl+ceil",
            "/ dda"
        );
        for (k, (tracer, _)) in tracers.iter().enumerate() {
            println!(
                "{tracer:<22} {:>8.3} {:>9.2} {:>9.2}   {}",
                rays.len() as f64 / seconds[k] * 1e-6,
                seconds[1] / seconds[k],
                seconds[2] / seconds[k],
                reports[k]
            );
        }
    }
}
