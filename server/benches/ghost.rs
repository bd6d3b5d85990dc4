//! Rays per second of the ghost surface's traversals, with their errors beside them.
//!
//! 640x480 depth of a box room with boxes in it, quantised as a Kinect's disparity, one thread.
//! Three sets of rays: reflections off random normals at random places in free space, off a
//! mirror ball in scan order, and shadow rays from every second pixel to a light. Asking only
//! whether anything is met is measured beside the traversals. All run in turn within each round
//! and the median round counts, so that ratios hold on a busy machine. Errors are against brute
//! force in double precision.

use std::hint::black_box;
use std::time::Instant;

use ghostlight::accel::Ray;
use ghostlight::camera::Intrinsics;
use ghostlight::frame::DepthImage;
use ghostlight::ghost::{GhostHit, GhostOutcome, GhostSurface};
use ghostlight::numerics::uniform;
use ghostlight::oracle::ghost::{GhostOracle, Verdict};
use ghostlight::render::{GhostSettings, Traversal};
use glam::Vec3A;

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

fn reflect(direction: Vec3A, normal: Vec3A) -> Vec3A {
    direction - 2.0 * direction.dot(normal) * normal
}

fn ray(origin: Vec3A, direction: Vec3A) -> Ray {
    Ray {
        origin,
        direction,
        t_min: 1e-3,
        t_max: f32::INFINITY,
    }
}

/// Reflections at random places in front of the surface.
fn random_rays(surface: &GhostSurface, n: u32) -> Vec<Ray> {
    (0..n)
        .map(|k| {
            let r = |dimension| uniform(k, 3, dimension);
            let (u, v) = (r(0) * (WIDTH - 1) as f32, r(1) * (HEIGHT - 1) as f32);
            let view = surface.intrinsics().ray_direction(u, v);
            let z = surface.depth_at(u, v).unwrap_or(2.0) * (0.3 + 0.65 * r(2));
            // Uniform on the sphere, turned to the camera.
            let (height, angle) = (2.0 * r(3) - 1.0, std::f32::consts::TAU * r(4));
            let radius = (1.0 - height * height).sqrt();
            let normal = Vec3A::new(radius * angle.cos(), radius * angle.sin(), height);
            let normal = if normal.dot(view) > 0.0 {
                -normal
            } else {
                normal
            };
            ray(view * z, reflect(view, normal))
        })
        .collect()
}

/// Reflections off a mirror ball, in scan order.
fn ball_rays(surface: &GhostSurface) -> Vec<Ray> {
    let (centre, radius) = (Vec3A::new(0.0, 0.1, 1.0), 0.3f32);
    (0..WIDTH * HEIGHT)
        .filter_map(|pixel| {
            let view = surface
                .intrinsics()
                .ray_direction((pixel % WIDTH) as f32, (pixel / WIDTH) as f32);
            let (a, b) = (view.length_squared(), view.dot(centre));
            let root = b * b - a * (centre.length_squared() - radius * radius);
            (root > 0.0).then(|| {
                let point = view * ((b - root.sqrt()) / a);
                ray(point, reflect(view, (point - centre) / radius))
            })
        })
        .collect()
}

/// From points just above the surface to a light beside the camera, in scan order.
fn shadow_rays(surface: &GhostSurface) -> Vec<Ray> {
    let light = Vec3A::new(0.8, -0.5, 0.6);
    (0..WIDTH * HEIGHT)
        .step_by(2)
        .filter_map(|pixel| {
            let (u, v) = ((pixel % WIDTH) as f32, (pixel / WIDTH) as f32);
            let point = surface.intrinsics().ray_direction(u, v) * (surface.depth_at(u, v)? * 0.99);
            Some(Ray {
                t_max: 1.0,
                ..ray(point, light - point)
            })
        })
        .collect()
}

/// One traversal of all rays.
type Tracer = fn(&GhostSurface, &[Ray], &mut [GhostOutcome]);

const TRACERS: [(&str, Tracer); 6] = [
    ("bresenham nearest", |surface, rays, out| {
        one_by_one(Traversal::BresenhamNearest, surface, rays, out);
    }),
    ("bresenham floor+ceil", |surface, rays, out| {
        one_by_one(Traversal::Bresenham, surface, rays, out);
    }),
    ("dda", |surface, rays, out| {
        one_by_one(Traversal::Dda, surface, rays, out);
    }),
    ("pyramid, single", |surface, rays, out| {
        one_by_one(Traversal::Pyramid, surface, rays, out);
    }),
    ("pyramid, batch", |surface, rays, out| {
        surface.trace_batch(rays, out);
    }),
    ("pyramid, occlusion", |surface, rays, out| {
        occlusion(surface, rays, out);
    }),
];

/// Whether anything is met: a hit whose place was not asked for.
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

/// Stands for a hit of unknown place.
const MET: GhostOutcome = GhostOutcome::Hit(GhostHit {
    t: f32::NAN,
    u: f32::NAN,
    v: f32::NAN,
    from_front: true,
});

fn one_by_one(
    traversal: Traversal,
    surface: &GhostSurface,
    rays: &[Ray],
    out: &mut [GhostOutcome],
) {
    for (ray, out) in rays.iter().zip(out) {
        *out = surface.trace(traversal, ray);
    }
}

/// Seconds per call, the median of some rounds.
fn median(mut seconds: Vec<f64>) -> f64 {
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 2]
}

/// Misses, false hits, hits off by over 1 %, and the median relative error.
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
            median(relative)
        }
    )
}

fn main() {
    // `cargo test` builds and runs benches too: then one round shows that they work.
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
    let rebuild = (0..rounds * 5)
        .map(|_| {
            let start = Instant::now();
            surface.rebuild(black_box(&depth), &intrinsics, &settings);
            start.elapsed().as_secs_f64()
        })
        .collect();
    println!("rebuild 640x480: {:.3} ms", median(rebuild) * 1e3);
    let (mut ball, mut shadow) = (ball_rays(&surface), shadow_rays(&surface));
    if !measure {
        ball.truncate(n_random as usize);
        shadow.truncate(n_random as usize);
    }
    for (name, rays) in [
        ("random reflections", random_rays(&surface, n_random)),
        ("mirror ball", ball),
        ("shadows", shadow),
    ] {
        let stride = rays.len().div_ceil(n_checked);
        let verdicts: Vec<Verdict> = rays
            .iter()
            .step_by(stride)
            .map(|ray| oracle.verdict(ray))
            .collect();
        let mut out = vec![GhostOutcome::Unknown; rays.len()];
        let mut seconds = vec![Vec::new(); TRACERS.len()];
        let mut reports = vec![String::new(); TRACERS.len()];
        for _ in 0..rounds {
            for (k, (_, tracer)) in TRACERS.iter().enumerate() {
                let start = Instant::now();
                tracer(&surface, black_box(&rays), &mut out);
                seconds[k].push(start.elapsed().as_secs_f64());
                let sampled: Vec<_> = out.iter().copied().step_by(stride).collect();
                reports[k] = errors(&verdicts, &sampled);
            }
        }
        let seconds: Vec<f64> = seconds.into_iter().map(median).collect();
        println!(
            "\n{name}: {} rays, {} checked\n{:<22} {:>8} {:>9} {:>9}   missed  false  >1 %   median",
            rays.len(),
            verdicts.len(),
            "",
            "Mray/s",
            "/ fl+ceil",
            "/ dda"
        );
        for (k, (tracer, _)) in TRACERS.iter().enumerate() {
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
