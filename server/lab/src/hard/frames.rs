//! Whole frames, which must not depend on their position in the world.

use std::sync::Arc;

use glam::{DAffine3, DQuat, DVec3, Vec3};

use super::shapes::icosphere;
use super::{HardCase, Measured};
use ghostlight::camera::{Intrinsics, Pose};
use ghostlight::frame::{ColorImage, DepthImage, RgbdFrame};
use ghostlight::numerics::hash;
use ghostlight::render::{Aov, Backend, Engine, RenderSettings, Rendered};
use ghostlight::scene::{Instance, Light, Preset, Scene};

/// A clock for tests that time no stage.
fn no_clock() -> u64 {
    0
}

/// Side of the square camera, pixels.
pub(super) const SIDE: u32 = 96;

/// A wall two metres in front of a camera with a field of view of 90 degrees; every pixel has a different colour.
pub(super) fn frame(pose: Pose) -> RgbdFrame {
    let f = f64::from(SIDE) / 2.0;
    let n = SIDE * SIDE;
    RgbdFrame {
        index: 0,
        time_ns: 0,
        color: ColorImage {
            width: SIDE,
            height: SIDE,
            rgba: (0..n)
                .map(|i| {
                    let [r, g, b, _] = hash(i, 1, 2).to_le_bytes();
                    // Light enough that shadows are visible.
                    [r | 0x80, g | 0x80, b | 0x80, 255]
                })
                .collect(),
        },
        depth: DepthImage::from_metres(SIDE, SIDE, vec![2.0; n as usize]),
        intrinsics: Intrinsics {
            fx: f,
            fy: f,
            cx: f,
            cy: f,
            width: SIDE,
            height: SIDE,
        },
        pose,
    }
}

/// A ball in a scene with lights.
pub(super) fn ball(center: DVec3, radius: f64, preset: Preset, lights: Vec<Light>) -> Scene {
    let mut scene = Scene {
        lights,
        ..Scene::default()
    };
    add_ball(&mut scene, center, radius, preset);
    scene
}

fn add_ball(scene: &mut Scene, center: DVec3, radius: f64, preset: Preset) {
    scene.instances.push(Instance {
        name: format!("{preset:?}"),
        mesh: scene.meshes.len() as u32,
        material: scene.materials.len() as u32,
        world_from_object: DAffine3::from_scale_rotation_translation(
            DVec3::splat(radius),
            DQuat::IDENTITY,
            center,
        ),
        ghost: false,
    });
    scene.meshes.push(Arc::new(icosphere(5)));
    scene.materials.push(preset.material());
}

pub(super) fn render(
    scene: &Scene,
    frame: &RgbdFrame,
    settings: &RenderSettings,
) -> Result<Rendered, String> {
    let engine = Engine::new(Backend::Cpu, 2, no_clock).map_err(|e| e.to_string())?;
    let mut renderer = engine.renderer(scene).map_err(|e| e.to_string())?;
    renderer
        .render(frame, settings, &[Aov::Mask, Aov::Shadow, Aov::Depth])
        .map_err(|e| e.to_string())
}

/// The same objects in front of the same camera, seen from `pose`.
fn seen_from(pose: Pose) -> Result<Rendered, String> {
    // Every coordinate is a multiple of 2^-6: exact in f64 with any of the offsets below.
    let place = |x: f64, y: f64, z: f64| pose.transform_point(DVec3::new(x, y, z));
    let light = Light::Sphere {
        position: place(-0.5, -1.0, 0.5),
        radius_m: 0.125,
        intensity: Vec3::splat(3.0),
    };
    let mut scene = ball(place(0.25, 0.0, 1.5), 0.25, Preset::Glass, vec![light]);
    add_ball(&mut scene, place(-0.25, 0.125, 1.25), 0.125, Preset::Mirror);
    add_ball(&mut scene, place(0.0, -0.375, 1.5), 0.125, Preset::Matte);
    // Rotated like the camera.
    for instance in &mut scene.instances {
        instance.world_from_object.matrix3 =
            glam::DMat3::from_quat(pose.rotation) * instance.world_from_object.matrix3;
    }
    render(&scene, &frame(pose), &RenderSettings::default())
}

/// Number of pixels in which any channel of two frames differs by more than `codes`.
pub(super) fn differing(a: &Rendered, b: &Rendered, codes: u8) -> usize {
    let pixels = a.color.rgba.iter().zip(&b.color.rgba);
    pixels
        .filter(|(p, q)| p.iter().zip(q.iter()).any(|(x, y)| x.abs_diff(*y) > codes))
        .count()
}

pub(super) const PIXELS: u64 = SIDE as u64 * SIDE as u64;

pub(super) const ORIGIN: HardCase = HardCase {
    name: "frame: world origins 1e5 and 1e7 m away",
    why: "At that distance neighbouring f32 coordinates are up to 1 m apart.",
    bound: "the same bytes: offsets of powers of two are exact in f64, and rays are relative to the camera",
    check: |_| {
        let near = seen_from(Pose::IDENTITY)?;
        let offsets = [17, 23, 24].map(|k| 2f64.powi(k));
        for far in offsets {
            let pose = Pose {
                rotation: DQuat::IDENTITY,
                translation: DVec3::new(far, -far, 0.5 * far),
            };
            let n = differing(&near, &seen_from(pose)?, 0);
            if n > 0 {
                return Err(format!("{far} m away {n} of {PIXELS} pixels differ"));
            }
        }
        Ok(Measured::new(3 * PIXELS, "no byte differs"))
    },
};

pub(super) const TURNED_ORIGIN: HardCase = HardCase {
    name: "frame: the same with a turned camera",
    why: "The rotation mixes coordinates of 1e7 m, and their difference is mostly rounding error.",
    bound: "at most 1 pixel of 1000 differs by more than 1 code (heuristic: 1e7 m round by 4e-9 m in f64, \
            a thousandth of what f32 rounds anyway)",
    check: |_| {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 0.7);
        let at = |translation| {
            seen_from(Pose {
                rotation,
                translation,
            })
        };
        let near = at(DVec3::ZERO)?;
        let mut worst = 0;
        for far in [1e5, 1e7] {
            worst = worst.max(differing(&near, &at(DVec3::new(far, -far, 0.4 * far))?, 1));
        }
        let told = format!("{worst} of {PIXELS} pixels");
        if worst as u64 * 1000 > PIXELS {
            return Err(told);
        }
        Ok(Measured::new(2 * PIXELS, told))
    },
};
