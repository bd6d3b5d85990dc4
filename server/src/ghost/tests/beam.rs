//! Tests of beams: if a beam is reported as unoccluded, none of its rays hits the surface.

use glam::Vec3A;
use proptest::prelude::*;

use super::*;
use crate::frame::depth_sigma_m;
use crate::ghost::BeamEnd;

fn unit(v: [f32; 3]) -> Vec3A {
    Vec3A::from(v).try_normalize().unwrap_or(Vec3A::Z)
}

fn inside(v: [f32; 3]) -> Vec3A {
    Vec3A::from(v) / Vec3A::from(v).length().max(1.0)
}

/// Rays from around each start to points of the end, and not beyond: the rays of a beam.
fn rays(starts: &[Vec3A], radius: f32, end: BeamEnd, seed: u32) -> Vec<Ray> {
    let mut rays = Vec::new();
    for (i, &start) in starts.iter().enumerate() {
        for k in 0..24 {
            let r = |dimension: u32| 2.0 * uniform(i as u32 * 24 + k, seed, dimension) - 1.0;
            // Rounding may put a point of the rim outside the radius.
            let origin = start + inside([r(0), r(1), r(2)]) * (radius * 0.999);
            let off = inside([r(3), r(4), r(5)]) * 0.999;
            rays.push(match end {
                BeamEnd::Ball(center, radius) => Ray {
                    t_max: 1.0,
                    ..ray(origin, center + off * radius - origin)
                },
                BeamEnd::Towards(towards, tangent) => ray(origin, towards + off * tangent),
            });
        }
    }
    rays
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(600))]

    #[test]
    fn no_ray_of_a_clear_beam_meets_the_surface(
        size in prop::sample::select(vec![(160u32, 120u32), (64, 48), (5, 5), (2, 2), (1, 9)]),
        sensed in any::<bool>(),
        at in prop::array::uniform2(0.0..1.0f32), z in 0.2..1.1f32,
        spread in 0.0..0.1f32, radius in 0.0..0.05f32,
        to in prop::array::uniform3(-2.0..2.0f32), end_radius in 0.0..0.4f32,
        towards in any::<bool>(), seed in 0u32..1000,
    ) {
        let (depth, intrinsics) = room(size.0, size.1, sensed);
        let surface = surface_of(&depth, &intrinsics);
        let (u, v) = (at[0] * (size.0 - 1) as f32, at[1] * (size.1 - 1) as f32);
        let middle = intrinsics.ray_direction(u, v) * (z * surface.depth_at(u, v).unwrap_or(2.0));
        let starts: Vec<Vec3A> = (0..5)
            .map(|k| {
                let r = |dimension: u32| 2.0 * uniform(k, seed, dimension + 10) - 1.0;
                middle + Vec3A::new(r(0), r(1), r(2)) * spread
            })
            .collect();
        let end = if towards {
            BeamEnd::Towards(unit(to), end_radius)
        } else {
            BeamEnd::Ball(middle + Vec3A::from(to), end_radius)
        };
        if surface.is_unoccluded(&starts, radius, end) {
            for ray in rays(&starts, radius, end, seed) {
                prop_assert!(!surface.occluded(&ray), "{ray:?}");
            }
        }
    }
}

/// Starts on a desk with a sensor's noise, offset from it like shadow rays: the way up to a lamp is unoccluded
/// unless an object is in it.
#[test]
fn a_lamp_above_a_noisy_desk_is_seen() {
    let (width, height) = (320, 240);
    let intrinsics = Intrinsics::new(525.0, 525.0, 159.5, 119.5, width, height).unwrap();
    let up = unit([0.0, -0.8, -0.6]);
    let desk = |u: u32, v: u32| {
        let d = intrinsics.ray_direction(u as f32, v as f32);
        d * (-1.2 / up.dot(d))
    };
    let z_m: Vec<f32> = (0..width * height)
        .map(|pixel| {
            let (u, v) = (pixel % width, pixel / width);
            let z = desk(u, v).z;
            // Within three standard deviations.
            let noise = (0..3).map(|k| uniform(pixel, k, 0) - 0.5).sum::<f32>() * 2.0;
            // A post stands in front of the desk.
            let post = (200..208).contains(&u) && v > 80;
            if post {
                0.7
            } else {
                z + noise * depth_sigma_m(z)
            }
        })
        .collect();
    let depth = DepthImage::from_metres(width, height, z_m);
    let surface = surface_of(&depth, &intrinsics);
    let block = |x: u32, y: u32, lamp: Vec3A| -> Vec<Vec3A> {
        let start = |u: u32, v: u32| {
            let lift = 4.0 * depth_sigma_m(desk(u, v).z);
            let origin = desk(u, v) + up * lift;
            origin + (lamp - origin).try_normalize().unwrap() * lift
        };
        (0..16).map(|k| start(x + k % 4, y + k / 4)).collect()
    };
    let clear = |x: u32, y: u32, lamp: Vec3A| {
        surface.is_unoccluded(&block(x, y, lamp), 0.001, BeamEnd::Ball(lamp, 0.05))
    };
    let lamp = Vec3A::new(-0.5, -0.9, 0.8);
    let blocks = || (0..6).flat_map(|i| (0..6).map(move |j| (8 + 28 * i, 100 + 20 * j)));
    let n = blocks().filter(|&(x, y)| clear(x, y, lamp)).count();
    assert!(n * 10 >= blocks().count() * 9, "{n}");
    // From behind the post to a lamp on its other side, in front of the picture.
    let (start, before) = (desk(230, 150), desk(203, 150) * (0.7 / desk(203, 150).z));
    assert!(!clear(228, 148, before + (before - start) * 0.5));
    // Under the desk.
    assert!(!clear(40, 160, Vec3A::new(0.0, 2.0, 1.5)));
}
