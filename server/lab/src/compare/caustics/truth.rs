//! A caustic against the path tracer: the total light behind a glass ball, computed without photons.

use std::f64::consts::PI;
use std::sync::Arc;

use anyhow::Result;
use glam::{DQuat, DVec3, Vec3};
use rayon::prelude::*;

use super::super::frames::once;
use super::super::{Bound, Curve, Lab, Section, number};
use super::settings;
use crate::oracle::closed;
use crate::oracle::path::{Light, Material, Patch, World};
use ghostlight::camera::{Intrinsics, Pose};
use ghostlight::frame::{ColorImage, DepthImage, RgbdFrame};
use ghostlight::numerics::{linear_from_srgb, srgb_from_linear};
use ghostlight::render::CausticSettings;
use ghostlight::scene::Environment;

/// Distance of the wall from the camera, metres.
const WALL_M: f64 = 2.0;
/// A dark wall, so that light of a second bounce, which the composite lacks, hardly counts.
const ALBEDO: f64 = 0.05;
/// The lamp: position and radius in metres, W/sr.
const LAMP: DVec3 = DVec3::new(-0.9, -0.5, 0.5);
const LAMP_M: f64 = 0.15;
const INTENSITY: f64 = 12.0;
/// The glass ball: centre in metres.
const BALL: DVec3 = DVec3::new(-0.3, -0.1, 1.62);
const BALL_M: f64 = 0.18;

/// Largest difference of the composite's light, percent. 8-bit codes near 60 are steps of 3 %, which average out
/// to a few tenths of a percent. Light that bounces between wall and ball is about the wall's 5 % times the tenth
/// that glass reflects of it.
const MOST_PERCENT: f64 = 2.0;

/// Irradiance of the wall from the lamp alone.
fn lit(p: DVec3) -> f64 {
    INTENSITY / (PI * LAMP_M * LAMP_M) * closed::sphere_irradiance(LAMP - p, LAMP_M, -DVec3::Z)
}

fn wall() -> Result<RgbdFrame> {
    let (width, height) = (96, 72);
    let intrinsics = Intrinsics::new(110.0, 110.0, 47.5, 35.5, width, height)?;
    let pixel = |i: u32| {
        let (x, y) = (f64::from(i % width), f64::from(i / width));
        let l = lit(intrinsics.unproject(x, y, WALL_M)) * ALBEDO / PI;
        [srgb_from_linear(l as f32); 3]
    };
    let pixels = (0..width * height).map(pixel);
    let color = ColorImage {
        width,
        height,
        rgba: pixels.map(|[r, g, b]| [r, g, b, 255]).collect(),
    };
    Ok(RgbdFrame {
        index: 0,
        time_ns: 0,
        depth: DepthImage::from_metres(width, height, vec![WALL_M as f32; color.rgba.len()]),
        color,
        intrinsics,
        pose: Pose::IDENTITY,
    })
}

/// Adds the comparison to a section.
pub(super) fn compare(lab: &Lab, section: &mut Section) -> Result<()> {
    lab.phase("path-traced truth");
    let frame = wall()?;
    let [x, y, z] = BALL.to_array();
    let [lx, ly, lz] = LAMP.to_array();
    let document = format!(
        r#"{{"version":1,"objects":[{{"mesh":"../meshes/sphere.ply","place":{{"frame":"first_camera","translation":[{x},{},{z}],"size_m":{}}},
            "material":{{"preset":"glass"}}}}],
            "lights":[{{"type":"sphere","frame":"first_camera","position":[{lx},{ly},{lz}],"radius":{LAMP_M},"intensity":[{INTENSITY},{INTENSITY},{INTENSITY}]}}]}}"#,
        // Meshes are placed by their lowest point.
        y + BALL_M,
        2.0 * BALL_M
    );
    let mut scene = lab.scene(&document, &frame)?;
    scene.environment = Some(Environment {
        width: 2,
        height: 1,
        radiance: Arc::new(vec![Vec3::ZERO; 2]),
        world_from_map: DQuat::IDENTITY,
    });
    let caustics = CausticSettings {
        enabled: Some(true),
        photons: lab.pick(280_000, 1_000_000),
        ..CausticSettings::default()
    };
    let ours = once(lab, &frame, &scene, &settings(caustics), &[])?.color;

    let mut world = World::default();
    let instance = &scene.instances[0];
    world.add_mesh(
        &scene.meshes[instance.mesh as usize],
        instance.world_from_object,
        Material::of_scene(&scene.materials[instance.material as usize]),
        1,
    );
    let corner = DVec3::new(-10.0, -10.0, WALL_M);
    let wall = Patch {
        origin: corner,
        e1: DVec3::Y * 20.0,
        e2: DVec3::X * 20.0,
        triangle: false,
    };
    world.add_patch(wall, Material::matte(DVec3::splat(ALBEDO)), 0);
    world.lights.push(Light::Ball {
        centre: LAMP,
        radius: LAMP_M,
        radiance: DVec3::splat(INTENSITY / (PI * LAMP_M * LAMP_M)),
    });
    let tracer = world.tracer();
    let center = instance
        .world_from_object
        .transform_point3(middle(&scene.meshes[0]));

    // Pixels of the wall at which the ball hides part of the lamp, and whether it hides all of it.
    let zone: Vec<(usize, DVec3, bool)> = (0..frame.color.rgba.len())
        .filter_map(|i| {
            let (x, y) = (i as u32 % frame.color.width, i as u32 / frame.color.width);
            let p = frame
                .intrinsics
                .unproject(f64::from(x), f64::from(y), WALL_M);
            let (lamp, ball) = (LAMP - p, center - p);
            let between = lamp.angle_between(ball);
            let (lamp, ball) = (
                (LAMP_M / lamp.length()).asin(),
                (BALL_M / ball.length()).asin(),
            );
            let seen = tracer.first_hit(DVec3::ZERO, p)?.thing == 0;
            // Also away from the ball's outline, where a pixel shows both.
            let clear = center.cross(p).length() / p.length() > BALL_M * 1.1;
            // The mesh is inside its sphere.
            let all = between + lamp < 0.98 * ball;
            (between < ball + lamp && seen && clear).then_some((i, p, all))
        })
        .collect();
    let samples = lab.pick(1024, 16_384);
    let truths: Vec<_> = lab.pool().install(|| {
        zone.par_iter()
            .map(|&(i, p, _)| tracer.radiance(DVec3::ZERO, p, samples, [7, i as u64]))
            .collect()
    });
    section.prose(format!(
        "The path tracer uses no photons: its paths find the lamp through the glass by chance, with {samples} \
         paths per pixel. A ball of glass is in front of a dark wall. Two totals of light are compared, shadow \
         and caustic together: that on the wall's {} pixels from which the ball hides any part of the lamp, and \
         that on those {} from which it hides all of it, where all light has passed through the ball.",
        zone.len(),
        zone.iter().filter(|(_, _, all)| *all).count()
    ));
    let mut curve = Curve::new(
        "Light behind a glass ball, of the path tracer's",
        [
            ("without the ball", "%"),
            ("composite", "%"),
            ("path tracer's standard error", "%"),
        ],
    );
    for (name, all) in [("any of the lamp hidden", false), ("all of it", true)] {
        let (mut truth, mut noise, mut got, mut without) = (0.0, 0.0, 0.0, 0.0);
        for (&(i, p, hidden), estimate) in zone.iter().zip(&truths) {
            if hidden || !all {
                truth += estimate.mean.x;
                noise += estimate.standard_error.x.powi(2);
                got += f64::from(linear_from_srgb(ours.rgba[i][0]));
                without += lit(p) * ALBEDO / PI;
            }
        }
        let percent = |x: f64| 100.0 * x / truth;
        let error = percent(noise.sqrt());
        curve.point("", name, [percent(without), percent(got), error]);
        section.bound(Bound::at_most(
            format!(
                "light behind a glass ball, {name}, against the path tracer: off by more than four standard errors of {}%",
                number(error)
            ),
            MOST_PERCENT,
            ((percent(got) - 100.0).abs() - 4.0 * error).max(0.0),
            "%",
        ));
    }
    section.curve(curve);
    Ok(())
}

/// Centre of a mesh's AABB.
fn middle(mesh: &ghostlight::scene::Mesh) -> DVec3 {
    let (low, high) = mesh.bounds().unwrap_or_default();
    ((low + high) * 0.5).as_dvec3()
}
