//! Tests of the traversals against each other and against brute force, on recorded and synthetic depth.

mod beam;
mod hard;
mod lockstep;
mod recorded;
mod shape;

use glam::Vec3A;

use super::*;
use crate::accel::Ray;
use crate::camera::Intrinsics;
use crate::frame::DepthImage;
use crate::numerics::uniform;

/// A box-shaped room with slanted boxes in it. With `sensed`, the depth has disparity in eighths of a pixel,
/// jitter and holes like that of a Kinect.
fn room(width: u32, height: u32, sensed: bool) -> (DepthImage, Intrinsics) {
    let f = 525.0 * f64::from(width) / 640.0;
    let (cx, cy) = (f64::from(width - 1) / 2.0, f64::from(height - 1) / 2.0);
    let intrinsics = Intrinsics::new(f, f, cx, cy, width, height).unwrap();
    let boxes = [
        (-0.5, 0.3, 0.25, 1.6),
        (0.4, 0.1, 0.2, 1.1),
        (0.1, -0.4, 0.3, 2.4),
    ];
    let z_m = (0..width * height)
        .map(|pixel| {
            let d = intrinsics.ray_direction((pixel % width) as f32, (pixel / width) as f32);
            let mut z = 3.5f32;
            z = z.min(if d.y > 0.0 { 1.2 / d.y } else { 9.0 });
            z = z.min(if d.x != 0.0 { 2.0 / d.x.abs() } else { 9.0 });
            for (x, y, half_side, front) in boxes {
                let (px, py) = (d.x * front - x, d.y * front - y);
                if px.abs() < half_side && py.abs() < half_side {
                    z = z.min(front + 0.3 * px);
                }
            }
            if sensed {
                let jitter = uniform(pixel, 0, 0) - 0.5;
                let disparity = (575.0 * 0.075 / z * 8.0 + jitter).round() / 8.0;
                z = 575.0 * 0.075 / disparity;
                if uniform(pixel / 7, 1, 1) < 0.03 {
                    z = 0.0;
                }
            }
            z
        })
        .collect();
    (DepthImage::from_metres(width, height, z_m), intrinsics)
}

fn surface_of(depth: &DepthImage, intrinsics: &Intrinsics) -> GhostSurface {
    let mut surface = GhostSurface::new();
    surface.rebuild(depth, intrinsics, &GhostSettings::default());
    surface
}

fn ray(origin: Vec3A, direction: Vec3A) -> Ray {
    Ray {
        origin,
        direction,
        t_min: 0.0,
        t_max: f32::INFINITY,
    }
}

/// Traces rays with every exact traversal; panics if the outcomes differ in a single bit.
fn exact(surface: &GhostSurface, rays: &[Ray], name: &str) -> Vec<GhostOutcome> {
    let mut outcomes = vec![GhostOutcome::Unknown; rays.len()];
    surface.trace_batch(rays, &mut outcomes);
    let mut occluded = vec![false; rays.len()];
    surface.occluded_batch(rays, &mut occluded);
    for ((ray, &batch), &blocked) in rays.iter().zip(&outcomes).zip(&occluded) {
        let dda = surface.trace(Traversal::Dda, ray);
        let pyramid = surface.trace(Traversal::Pyramid, ray);
        assert_eq!(dda, pyramid, "{name}: pyramid against dda, {ray:?}");
        assert_eq!(dda, batch, "{name}: batch against dda, {ray:?}");
        let hit = matches!(dda, GhostOutcome::Hit(_));
        assert_eq!(hit, blocked, "{name}: occlusion in a batch, {ray:?}");
        assert_eq!(hit, surface.occluded(ray), "{name}: occlusion, {ray:?}");
        if let GhostOutcome::Hit(hit) = dda {
            assert!(hit.t >= ray.t_min && hit.t <= ray.t_max, "{name}: {ray:?}");
        }
    }
    outcomes
}
