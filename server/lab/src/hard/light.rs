//! Shadows of lights that are points, touch a surface, are in it, or contain the surface that they light.

use std::sync::Arc;

use glam::{DQuat, DVec3, Vec3};

use super::frames::{SIDE, ball, frame, render};
use super::{HardCase, Measured, Worst};
use crate::oracle::closed::{Cap, sphere};
use ghostlight::camera::Pose;
use ghostlight::render::{Aov, AovImage, RenderSettings, Rendered, ShadowMethod};
use ghostlight::scene::{Environment, Light, Preset, Scene};

const SAMPLES: u32 = 256;

/// The maximum of shadow rays, one hard shadow ray for a point light, and no other blur.
fn settings() -> RenderSettings {
    let mut settings = RenderSettings::default();
    settings.shadows.method = ShadowMethod::Naive;
    settings.shadows.samples = SAMPLES;
    settings.shadows.filter_radius_px = 0;
    settings.bloom.enabled = false;
    // Lamps alone: their shadow term has a closed form.
    settings.ambient.enabled = false;
    settings.caustics.enabled = Some(false);
    settings
}

/// A light of radius `radius_m` and no other.
fn only(position: DVec3, radius_m: f64) -> Vec<Light> {
    vec![Light::Sphere {
        position,
        radius_m,
        intensity: Vec3::splat(2.0),
    }]
}

/// Removes ambient light, so that only the light's own part remains.
fn dark_around(scene: &mut Scene) {
    scene.environment = Some(Environment {
        width: 2,
        height: 1,
        radiance: Arc::new(vec![Vec3::ZERO; 2]),
        world_from_map: DQuat::IDENTITY,
    });
}

/// Share of light that remains for each pixel, 0..=255, and the mask.
fn shadow(rendered: &Rendered) -> Result<[&[u8]; 2], String> {
    let gray = |wanted: Aov| {
        rendered.aovs.iter().find_map(|(aov, image)| match image {
            AovImage::Gray8(pixels) if *aov == wanted => Some(pixels.as_slice()),
            _ => None,
        })
    };
    match (gray(Aov::Shadow), gray(Aov::Mask)) {
        (Some(shadow), Some(mask)) => Ok([shadow, mask]),
        _ => Err("no shadow or no mask came out".into()),
    }
}

/// The wall's point at a pixel, camera space.
fn wall_point(i: usize) -> DVec3 {
    let intrinsics = frame(Pose::IDENTITY).intrinsics;
    let side = SIDE as usize;
    intrinsics.unproject((i % side) as f64, (i / side) as f64, 2.0)
}

pub(super) const PENUMBRA: HardCase = HardCase {
    name: "shadow: a ball's penumbra behind a ball",
    why: "Every share of light from 0 to 1 occurs, and each has a closed form.",
    bound: "the exact share to 1/sqrt(N) of N = 256 rays (an outline crosses 2 sqrt(N) of N cells, half wrong in \
            each at worst), the disc's curvature, and half a code",
    check: |_| {
        let (light, radius) = (DVec3::new(-0.5, -0.25, 0.25), 0.3);
        let (blocker, blocker_radius) = (DVec3::new(0.0, 0.0, 1.5), 0.15);
        let mut scene = ball(blocker, blocker_radius, Preset::Matte, only(light, radius));
        dark_around(&mut scene);
        let rendered = render(&scene, &frame(Pose::IDENTITY), &settings())?;
        let [shadow, mask] = shadow(&rendered)?;
        let (mut worst, mut penumbra, mut sum) = (Worst::default(), 0u32, 0.0);
        for (i, (&code, _)) in shadow
            .iter()
            .zip(mask)
            .enumerate()
            .filter(|(_, (_, m))| **m == 0)
        {
            let point = wall_point(i);
            let own = Cap::of_ball(light - point, radius);
            let open = own.flux() - own.common_flux(&Cap::of_ball(blocker - point, blocker_radius));
            let share = open.z / own.flux().z;
            penumbra += u32::from(share > 0.01 && share < 0.99);
            let error = (f64::from(code) / 255.0 - share).abs();
            sum += error;
            let bound = 1.0 / f64::from(SAMPLES).sqrt() + own.radius_rad.powi(2) + 0.5 / 255.0;
            worst.note(error, bound, || format!("pixel {i}, share {share:.3}"));
        }
        worst.require(penumbra > 100, || format!("{penumbra} pixels of penumbra"));
        let (mean, share) = (sum / worst.trials as f64, worst.share);
        worst.told(format!(
            "worst at {share:.2} of the bound, mean error {mean:.1e}, {penumbra} pixels of penumbra"
        ))
    },
};

pub(super) const POINT: HardCase = HardCase {
    name: "shadow: a light of radius 0",
    why: "Its disc has no extent, and its radiance would be infinite.",
    bound: "fully lit or dark, on the right side of the ball's outline to within a pixel",
    check: |_| {
        let light = DVec3::new(-0.5, -0.25, 0.25);
        let (blocker, radius) = (DVec3::new(0.0, 0.0, 1.5), 0.15);
        let mut scene = ball(blocker, radius, Preset::Matte, only(light, 0.0));
        dark_around(&mut scene);
        let rendered = render(&scene, &frame(Pose::IDENTITY), &settings())?;
        let [shadow, mask] = shadow(&rendered)?;
        let (mut worst, mut dark) = (Worst::default(), 0);
        for (i, (&code, _)) in shadow
            .iter()
            .zip(mask)
            .enumerate()
            .filter(|(_, (_, m))| **m == 0)
        {
            let point = wall_point(i);
            // The mesh is inside the sphere by less than 1 % of its radius, far less than a pixel.
            let blocked = |by: f64| sphere(point, light - point, blocker, by).is_some();
            let pixel = 2.0 / f64::from(SIDE);
            let expected = match (blocked(radius - pixel), blocked(radius + pixel)) {
                (true, _) => 0,
                (_, false) => 255,
                _ => continue,
            };
            dark += u32::from(expected == 0);
            worst.require(code == expected, || {
                format!("pixel {i}: {code}, expected {expected}")
            });
        }
        worst.require(dark > 20, || format!("{dark} pixels in shadow"));
        worst.told(format!("{dark} pixels dark, all others lit"))
    },
};

/// Lights close to and in the wall and the ball; nothing white may become black, and pixels that no shadow can
/// reach must not change.
fn survives(lights: &[(&str, DVec3, f64)]) -> Result<Measured, String> {
    let mut worst = Worst::default();
    for preset in [
        Preset::Matte,
        Preset::Plastic,
        Preset::Mirror,
        Preset::Glass,
    ] {
        for &(name, position, radius) in lights {
            let center = DVec3::new(0.0, 0.0, 1.5);
            let scene = ball(center, 0.25, preset, only(position, radius));
            let input = frame(Pose::IDENTITY);
            for method in [
                ShadowMethod::Adaptive,
                ShadowMethod::Naive,
                ShadowMethod::Hard,
            ] {
                let mut settings = settings();
                settings.shadows.method = method;
                settings.shadows.samples = 20;
                let rendered = render(&scene, &input, &settings)?;
                let [shadow, mask] = shadow(&rendered)?;
                for (i, (&share, &mask)) in shadow.iter().zip(mask).enumerate() {
                    let found = rendered.color.rgba[i];
                    let told = || {
                        format!(
                            "{preset:?}, {name}, {method:?}, pixel {i}: {found:?}, share {share}"
                        )
                    };
                    if mask == 0 && share == 255 {
                        worst.require(found == input.color.rgba[i], told);
                    } else if mask == 255 {
                        // A NaN would be written as black; the surroundings alone are brighter.
                        worst.require(found[..3] != [0; 3], told);
                    }
                }
            }
        }
    }
    worst.told("nothing turns black or moves")
}

pub(super) const TOUCHING: HardCase = HardCase {
    name: "shadow: lights that touch the surface, lie half in it, or at the shaded point itself",
    why: "The distance is 0: irradiance is infinite, the disc fills the hemisphere.",
    bound: "no lit pixel is black; pixels without shadow equal the camera's, byte for byte",
    check: |_| {
        // The wall's point at the pixel.
        let point = wall_point(20 * SIDE as usize + 20);
        survives(&[
            ("touching the wall", point - DVec3::Z * 0.125, 0.125),
            ("half in the wall", point, 0.125),
            ("a point on the wall", point, 0.0),
            ("behind the wall", point + DVec3::Z * 0.5, 0.125),
            ("touching the ball", DVec3::new(0.0, 0.0, 1.0), 0.25),
            ("a point on the ball", DVec3::new(0.0, 0.0, 1.25), 0.0),
        ])
    },
};

pub(super) const WITHIN: HardCase = HardCase {
    name: "shadow: lights inside the object, around it, around the camera, far away",
    why: "From inside, a light has no disc; from 10^8 m it is a point in f32.",
    bound: "no lit pixel is black; pixels without shadow equal the camera's, byte for byte",
    check: |_| {
        let center = DVec3::new(0.0, 0.0, 1.5);
        survives(&[
            ("inside the ball", center, 0.125),
            ("a point inside the ball", center, 0.0),
            ("around the ball", center, 0.375),
            ("around everything", center, 100.0),
            ("at the camera", DVec3::ZERO, 0.0),
            ("around the camera", DVec3::ZERO, 0.25),
            ("far away", DVec3::new(1e8, -1e8, -1e8), 1.0),
            ("as large as far", DVec3::new(0.0, -1e8, 0.0), 1e8 - 1.0),
        ])
    },
};
