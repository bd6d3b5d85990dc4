//! Tests of the recording against closed forms; tests of its files are in [`files`].

mod files;

use glam::{DQuat, DVec3, Vec3};

use super::geometry::{Geometry, Material};
use super::light::{BakeQuality, RoomLight, bake};
use super::render::View;
use super::solid::Builder;
use super::texture::Pattern;
use super::*;
use ghostlight::camera::Pose;

fn grey() -> Material {
    Material::matte(Pattern::Flat(Vec3::splat(0.5)))
}

/// A camera at the origin that looks along +y with z up.
fn view(width: u32, height: u32) -> View {
    View {
        intrinsics: Intrinsics::new(525.0, 525.0, 319.5, 239.5, 640, 480)
            .unwrap()
            .scaled_to(width, height)
            .unwrap(),
        pose: Pose {
            rotation: DQuat::from_rotation_x(-std::f64::consts::FRAC_PI_2),
            translation: DVec3::ZERO,
        },
    }
}

/// A wall at y = `distance` that faces the camera, turned about z by `yaw_deg`.
fn wall(b: &mut Builder, distance: f64, half: f64, yaw_deg: f64) {
    let material = b.material(grey());
    let turn = DQuat::from_rotation_z(yaw_deg.to_radians());
    let (x, z) = (turn * DVec3::X * half, DVec3::Z * half);
    b.rectangle(DVec3::Y * distance - x - z, x * 2.0, z * 2.0, material, 1.0);
}

fn builder() -> Builder {
    Builder {
        coarseness: 1.0,
        ..Builder::default()
    }
}

#[test]
fn exact_depth_is_that_of_the_plane() {
    let mut b = builder();
    wall(&mut b, 2.0, 6.0, 31.0);
    let geometry = Geometry::new(b);
    let view = view(160, 120);
    let exact = sensor::exact_depth(&geometry, &view);
    let normal = DQuat::from_rotation_z(31f64.to_radians()) * DVec3::Y;
    for (i, &z) in exact.z_m.iter().enumerate() {
        let direction = view.ray((i % 160) as f64, (i / 160) as f64);
        let truth = 2.0 * normal.y / direction.dot(normal);
        assert!((z - truth).abs() < 1e-12 * truth, "pixel {i}: {z} {truth}");
    }
}

#[test]
fn depth_noise_and_quantum_grow_with_the_square_of_depth() {
    for distance in [0.8, 1.6, 3.2] {
        let mut b = builder();
        wall(&mut b, distance, 6.0, 0.0);
        let geometry = Geometry::new(b);
        let view = view(320, 240);
        let exact = sensor::exact_depth(&geometry, &view);
        let scale = sensor::FOCAL_PX * sensor::BASELINE_M * sensor::STEPS_PER_PX;
        let (mut sum, mut sum2, mut n) = (0.0, 0.0, 0.0);
        for frame in 0..4 {
            for units in sensor::sense(&geometry, &view, &exact, frame) {
                assert_ne!(units, 0, "a hole in an open wall at {distance} m");
                let z = f64::from(units) / sensor::UNITS_PER_METRE;
                let steps = scale / z;
                // Rounding to 0.2 mm units moves a step by scale / z^2 * 0.1 mm.
                let rounding = scale / (z * z) * 0.5 / sensor::UNITS_PER_METRE;
                assert!(
                    (steps - steps.round()).abs() <= 1.01 * rounding,
                    "{steps} at {z}"
                );
                sum += z - distance;
                sum2 += (z - distance).powi(2);
                n += 1.0;
            }
        }
        // Khoshelham and Elberink 2012, equation 7: sigma_z = z^2 / (f b) sigma_d.
        let predicted = distance * distance * sensor::NOISE_STEPS / scale;
        let found: f64 = (sum2 / n).sqrt();
        // How much of the rounding error is visible depends on where the true disparity is between two steps: up
        // to a fifth.
        assert!(
            (found / predicted - 1.0).abs() < 0.2,
            "{distance} m: {found} {predicted}"
        );
        let bias: f64 = sum / n;
        assert!(bias.abs() < 0.5 * predicted, "{distance} m: bias {bias}");
    }
}

#[test]
fn the_projectors_shadow_lies_to_the_left_of_what_casts_it() {
    let mut b = builder();
    wall(&mut b, 2.0, 4.0, 0.0);
    wall(&mut b, 1.0, 0.15, 0.0);
    let geometry = Geometry::new(b);
    let view = view(640, 480);
    let exact = sensor::exact_depth(&geometry, &view);
    let sensed = sensor::sense(&geometry, &view, &exact, 3);
    let row = &sensed[240 * 640..241 * 640];
    let edge = 525.0 * 0.15;
    let (left, right) = ((319.5 - edge) as usize, (319.5 + edge) as usize);
    let holes = |range: std::ops::Range<usize>| row[range].iter().filter(|&&d| d == 0).count();
    // Similar triangles: the shadow on the wall is b (z2 - z1) / z1 wide, at depth z2 that is
    // f b (1 / z1 - 1 / z2) pixels.
    let width = (525.0f64 * 0.075 * (1.0 - 0.5)).round() as usize;
    let found = holes(left - 60..left + 8);
    assert!(
        found.abs_diff(width) <= 4,
        "{found} holes, {width} expected"
    );
    assert_eq!(holes(left - 60..left - width - 4), 0);
    assert!(holes(right - 8..right + 60) <= 3, "holes on the lit side");
}

#[test]
fn grazing_and_distant_surfaces_return_nothing() {
    let sensed = |distance: f64, yaw: f64| {
        let mut b = builder();
        wall(&mut b, distance, 20.0, yaw);
        let geometry = Geometry::new(b);
        let view = view(64, 48);
        let exact = sensor::exact_depth(&geometry, &view);
        let sensed = sensor::sense(&geometry, &view, &exact, 0);
        sensed[24 * 64 + 28..24 * 64 + 36]
            .iter()
            .filter(|&&d| d == 0)
            .count()
    };
    assert_eq!(sensed(1.5, 60.0), 0);
    assert_eq!(sensed(1.5, 84.0), 8);
    assert_eq!(sensed(0.4, 0.0), 8);
    assert_eq!(sensed(6.0, 0.0), 8);
}

const QUALITY: BakeQuality = BakeQuality {
    shadow_side: 12,
    gather_side: 24,
    final_side: 40,
    passes: 1,
};

#[test]
fn baked_light_follows_the_closed_form() {
    // A square metre of floor under a sphere: the irradiance is intensity cos / d^2, exactly, as long as no part
    // of the sphere is below the horizon.
    let mut b = builder();
    let floor = b.material(grey());
    b.rectangle(DVec3::new(-0.5, -0.5, 0.0), DVec3::X, DVec3::Y, floor, 0.05);
    let geometry = Geometry::new(b);
    let centre = DVec3::new(0.3, 0.1, 0.9);
    let ball = RoomLight::Sphere {
        name: "ball",
        centre,
        radius: 0.2,
        intensity: Vec3::splat(2.0),
        in_room: false,
    };
    let baked = bake(&geometry, &[ball], QUALITY, &|_| ());
    for (site, light) in geometry.sites.iter().zip(&baked) {
        let to = centre - site.position;
        let truth = 2.0 * to.z / to.length().powi(3);
        // One round of smoothing, one-sided at the borders, over sites 0.05 m apart.
        assert!(
            (f64::from(light.x) / truth - 1.0).abs() < 0.04,
            "{light} {truth}"
        );
    }
}

#[test]
fn a_sampled_light_and_a_gathered_one_are_the_same() {
    let at = |sampled: bool| {
        let mut b = builder();
        let floor = b.material(grey());
        let radiance = Vec3::splat(3.0);
        let shine = b.material(Material {
            emission: Some(radiance),
            sampled_light: sampled,
            ..Material::matte(Pattern::Flat(Vec3::ONE))
        });
        b.rectangle(
            DVec3::new(-0.1, -0.1, 0.0),
            DVec3::X * 0.2,
            DVec3::Y * 0.2,
            floor,
            0.1,
        );
        let (origin, e1, e2) = (DVec3::new(-0.5, -0.5, 1.0), DVec3::Y, DVec3::X);
        b.rectangle(origin, e1, e2, shine, 0.5);
        let geometry = Geometry::new(b);
        let light = RoomLight::Rectangle {
            name: "panel",
            origin,
            e1,
            e2,
            radiance,
            pattern: Pattern::Flat(Vec3::ONE),
        };
        let lights: &[RoomLight] = if sampled { &[light] } else { &[] };
        f64::from(bake(&geometry, lights, QUALITY, &|_| ())[4].x)
    };
    // A square of side 2a at distance 1, centred: the form factor (4 / pi) (a / s) atan(a / s)
    // with s = sqrt(1 + a^2).
    let s = 1.25f64.sqrt();
    let truth = 3.0 * 4.0 * (0.5 / s) * (0.5 / s).atan();
    for sampled in [true, false] {
        let found = at(sampled);
        assert!(
            (found / truth - 1.0).abs() < 0.03,
            "sampled {sampled}: {found} {truth}"
        );
    }
}

#[test]
fn the_free_spot_is_free_and_in_view() {
    let room = room::build(6.0);
    let path = Path::new(SynthOptions::default().seed);
    for frame in 0..72 {
        let view = View {
            pose: path.pose(f64::from(frame) / 30.0),
            ..view(640, 480)
        };
        for i in 0..=8 {
            for j in 0..=8 {
                let offset = DVec3::new(f64::from(i - 4), f64::from(j - 4), 0.0) * 0.0438;
                let p = room::FREE_SPOT + offset;
                let down =
                    room.geometry
                        .caster
                        .intersect(p + DVec3::Z * 0.2, DVec3::NEG_Z, 0.0, 1.0);
                assert!(
                    (down.unwrap().t - 0.2).abs() < 1e-9,
                    "something stands at {p}"
                );
                let (u, v) = view
                    .intrinsics
                    .project(view.pose.inverse().transform_point(p));
                assert!(
                    (8.0..632.0).contains(&u) && (8.0..472.0).contains(&v),
                    "{p} at {u}, {v}"
                );
            }
        }
    }
}

#[test]
fn every_surface_of_the_room_faces_out() {
    let room = room::build(6.0);
    // No ray from the air above the desk or from the camera's path hits a back face.
    for i in 0..60_000u32 {
        let random = |d: u32| f64::from(ghostlight::numerics::uniform(i, 3, d));
        let origin = DVec3::new(
            random(0) * 3.0 - 1.5,
            random(1) * 2.0 - 2.4,
            random(2) * 1.8 + 0.3,
        );
        let direction = DVec3::new(random(3), random(4), random(5)) * 2.0 - 1.0;
        let hit = room
            .geometry
            .caster
            .intersect(origin, direction, 0.0, f64::INFINITY);
        let hit =
            hit.unwrap_or_else(|| panic!("a way out of the room from {origin} along {direction}"));
        assert!(!hit.back, "a back at {}", origin + direction * hit.t);
    }
}
