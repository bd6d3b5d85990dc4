//! Irradiance of lights, measured as the radiance of a white matte ground.

use std::f64::consts::PI;

use glam::DVec2;

use super::*;

/// Looks from a point at the origin of a white matte ground, whose radiance is irradiance / pi.
fn irradiance(world: &World, from: DVec3, samples: u32, place: u64) -> Estimate {
    let seen = world.tracer().radiance(from, -from, samples, [1, place]);
    Estimate {
        mean: seen.mean * PI,
        standard_error: seen.standard_error * PI,
    }
}

#[test]
fn irradiance_of_a_ball_light_at_every_height() {
    for (k, (angle_deg, distance, radius)) in [
        (0.0, 1.0, 0.1),
        (0.0, 1.0, 0.9),
        (45.0, 3.0, 0.01),
        (60.0, 1.0, 0.3),
        (80.0, 1.0, 0.3),
        (90.0, 1.0, 0.5),
        (100.0, 1.0, 0.5),
    ]
    .into_iter()
    .enumerate()
    {
        let angle = f64::to_radians(angle_deg);
        let to = DVec3::new(angle.sin(), 0.0, angle.cos()) * distance;
        let mut world = World::default();
        world.add_patch(ground(0.05), Material::matte(DVec3::ONE), 0);
        world.lights.push(ball(to, radius, 7.0));
        let found = irradiance(&world, DVec3::new(0.3, 0.2, 4.0), 40_000, k as u64);
        let truth = 7.0 * closed::sphere_irradiance(to, radius, DVec3::Z);
        expect(&format!("{angle_deg} degrees"), found, DVec3::splat(truth));
    }
}

#[test]
fn a_balls_penumbra_behind_a_ball() {
    let (light, radius) = (DVec3::new(0.0, 0.0, 2.0), 0.2);
    let mut seen = [0; 3];
    for step in 0..=16u32 {
        let x = 0.02 * f64::from(step);
        let (blocker, blocker_radius) = (DVec3::new(x, 0.0, 1.0), 0.14);
        let mut world = World::default();
        world.add_patch(ground(0.05), Material::matte(DVec3::ONE), 0);
        world.lights = vec![ball(light, radius, 3.0), ball(blocker, blocker_radius, 0.0)];
        // From below the side of the blocker, so that the camera's ray is not blocked.
        let found = irradiance(&world, DVec3::new(-2.0, 0.0, 1.0), 40_000, u64::from(step));
        let caps = [
            closed::Cap::of_ball(light, radius),
            closed::Cap::of_ball(blocker, blocker_radius),
        ];
        let open = caps[0].flux() - caps[0].common_flux(&caps[1]);
        let share = open.z / caps[0].flux().z;
        seen[if share < 0.01 {
            0
        } else if share < 0.99 {
            1
        } else {
            2
        }] += 1;
        expect(&format!("{x} m aside"), found, DVec3::splat(3.0 * open.z));
    }
    assert!(
        seen.iter().all(|&n| n > 1),
        "umbra, penumbra, light: {seen:?}"
    );
}

#[test]
fn irradiance_below_the_corner_of_a_lit_rectangle() {
    let (width, height, distance) = (0.8, 0.5, 0.7);
    let mut world = World::default();
    world.add_patch(ground(0.05), Material::matte(DVec3::ONE), 0);
    let lamp = Material {
        emission: Some(Colour::Painted(std::sync::Arc::new(|_, place: DVec2| {
            // The nearer half along e1.
            if place.x < 0.5 {
                DVec3::ONE
            } else {
                DVec3::ZERO
            }
        }))),
        ..Material::matte(DVec3::ZERO)
    };
    let patch = world.add_patch(
        Patch {
            origin: DVec3::Z * distance,
            e1: DVec3::Y * height,
            e2: DVec3::X * width,
            triangle: false,
        },
        lamp,
        0,
    );
    let truth = DVec3::splat(closed::corner_irradiance(width, 0.5 * height, distance));
    // Seen from the side without the blocker.
    let look = |world: &World, place| irradiance(world, DVec3::new(-0.5, -0.5, 1.0), 60_000, place);
    expect("found by chance", look(&world, 0), truth);
    world.lights.push(Light::Patch { patch });
    let aimed = look(&world, 1);
    expect("aimed at", aimed, truth);
}
