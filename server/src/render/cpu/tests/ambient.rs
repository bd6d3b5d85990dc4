//! Tests of ambient light on real surfaces, against closed forms.

use glam::{DQuat, DVec3, Vec3};

use super::*;
use crate::render::AmbientSettings;
use crate::scene::Environment;

/// A uniform environment of radiance 1.
fn even_world() -> Environment {
    Environment {
        width: 8,
        height: 4,
        radiance: Arc::new(vec![Vec3::ONE; 32]),
        world_from_map: DQuat::IDENTITY,
    }
}

/// A lamp that is off, so that no lamps are extracted from an environment map.
fn no_lamp() -> Vec<Light> {
    vec![point_light(DVec3::new(0.0, -1.0, 0.0), 0.0)]
}

/// A black matte material.
fn black() -> Material {
    Material {
        base_color: Vec3::ZERO,
        ..Material::default()
    }
}

fn settings(bounce: bool) -> RenderSettings {
    RenderSettings {
        ambient: AmbientSettings {
            samples: 64,
            bounce,
            ..AmbientSettings::default()
        },
        ..plain()
    }
}

/// A sphere in front of a wall under a uniform sky without lamps occludes its form factor of the light: (R / d)^2
/// times the cosine to the wall's normal, in closed form (Howell's catalogue, B-38), as long as the whole sphere
/// is above the wall's horizon.
#[test]
fn a_ball_takes_its_form_factor_of_the_light() {
    let frame = wall([188, 188, 188, 255]);
    let (center, radius) = (DVec3::new(0.1, -0.05, 1.75), 0.2);
    let mut scene = scene(&[(center, radius, black(), false)], no_lamp());
    scene.environment = Some(even_world());
    let out = render(&scene, &frame, &settings(false), 1);
    let (ambient, shadow) = (gray(&out, Aov::Ambient), gray(&out, Aov::Shadow));
    assert_eq!(ambient, shadow, "no lamp has a shadow");
    let (mut worst, mut sum, mut n, mut darkest) = (0.0_f64, 0.0, 0, 1.0_f64);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let p = frame.intrinsics.unproject(f64::from(x), f64::from(y), 2.0);
            let to = center - p;
            let cosine = -to.z / to.length();
            let expected = 1.0 - (radius / to.length()).powi(2) * cosine;
            let got = f64::from(ambient[at(x, y)]) / 255.0;
            let error = got - expected;
            (worst, sum, n) = (worst.max(error.abs()), sum + error * error, n + 1);
            darkest = darkest.min(expected);
        }
    }
    // All rays of the cone hit the sphere, so the error is that of interpolation. At the end of a record's reach
    // Ward's first-order bound is 4 / pi times 0.3 of the light; records on all sides of a pixel cancel most of
    // that: measured 0.059 at the steepest pixel.
    let rms = (sum / f64::from(n)).sqrt();
    assert!(darkest < 0.4, "{darkest}");
    assert!(worst < 0.08 && rms < 0.008, "{worst} {rms}");
}

/// A white wall in a uniform white environment, and a white sphere: the sphere returns the light that it
/// occludes.
#[test]
fn a_white_ball_in_a_white_furnace_takes_little() {
    let mut frame = wall([255, 255, 255, 255]);
    frame.color.rgba.fill([255, 255, 255, 255]);
    let white = Material {
        base_color: Vec3::ONE,
        ..Material::default()
    };
    let mut scene = scene(&[(DVec3::new(0.0, 0.0, 1.7), 0.2, white, false)], no_lamp());
    scene.environment = Some(even_world());
    let dark = render(&scene, &frame, &settings(false), 1);
    let lit = render(&scene, &frame, &settings(true), 1);
    let least = |out: &Rendered| *gray(out, Aov::Ambient).iter().min().unwrap();
    assert!(least(&dark) < 150, "{}", least(&dark));
    // One bounce of several, and microfacets that shadow each other: 4 % of F0 times 0.6.
    assert!(least(&lit) > 245, "{}", least(&lit));
}

/// A red sphere reddens the wall beside it, and an emissive one lights it.
#[test]
fn colour_and_glow_reach_the_wall() {
    let frame = wall([150, 150, 150, 255]);
    let at_wall = DVec3::new(0.0, 0.0, 1.78);
    let red = Material {
        base_color: Vec3::new(0.8, 0.05, 0.05),
        ..Material::default()
    };
    let of = |material: Material| {
        let mut scene = scene(&[(at_wall, 0.2, material, false)], no_lamp());
        scene.environment = Some(even_world());
        let out = render(&scene, &frame, &settings(true), 1);
        // Beside the sphere's outline.
        out.color.rgba[at(79 + 24, 60)]
    };
    let [r, g, b, _] = of(red);
    assert!(r > g && g == b && g < 150, "{r} {g} {b}");
    let glowing = Material {
        base_color: Vec3::ZERO,
        emissive: Vec3::new(0.0, 4.0, 0.0),
        ..Material::default()
    };
    let [r, g, _, _] = of(glowing);
    assert!(r < 150 && g > 170, "{r} {g}");
}

#[test]
fn off_leaves_real_surfaces_as_they_are() {
    let frame = noise();
    let objects = [(DVec3::new(0.0, 0.0, 1.75), 0.2, black(), false)];
    let mut scene = scene(&objects, no_lamp());
    scene.environment = Some(even_world());
    let off = RenderSettings {
        ambient: AmbientSettings {
            enabled: false,
            ..AmbientSettings::default()
        },
        ..plain()
    };
    let out = render(&scene, &frame, &off, 1);
    assert_eq!((out.stats.ambient_rays, out.stats.relit_pixels), (0, 0));
    assert!(gray(&out, Aov::Ambient).iter().all(|&share| share == 255));
    let on = render(&scene, &frame, &plain(), 1);
    assert!(on.stats.ambient_rays > 0 && on.stats.relit_pixels > 1000);
    // The same for any number of threads.
    assert_eq!(on.color, render(&scene, &frame, &plain(), 4).color);
}

/// Two lamps, one of them hidden from a glossy sphere by another sphere: its highlight is gone, and the other one
/// is unchanged.
#[test]
fn a_blocked_lamp_has_no_highlight_and_the_other_keeps_its_own() {
    let frame = wall([0, 0, 0, 255]);
    let glossy = Material {
        base_color: Vec3::splat(0.9),
        metallic: 1.0,
        roughness: 0.4,
        ..Material::default()
    };
    let center = DVec3::new(0.0, 0.0, 1.2);
    let [left, right] = [-1.0, 1.0].map(|x| DVec3::new(x, 0.0, 0.4));
    let lights = vec![point_light(left, 0.3), point_light(right, 0.3)];
    // On the way from the lamp to its highlight.
    let unit = |v: DVec3| v / v.length();
    let half = unit(unit(left - center) - unit(center));
    let blocker = (center + half * 0.25).lerp(left, 0.6);
    let ball = (center, 0.25, glossy, false);
    let both = render(
        &scene(std::slice::from_ref(&ball), lights.clone()),
        &frame,
        &plain(),
        1,
    );
    let one = render(
        &scene(&[ball, (blocker, 0.06, black(), false)], lights),
        &frame,
        &plain(),
        1,
    );
    // The brightest pixel of each half of the sphere.
    let peak = |out: &Rendered, columns: std::ops::Range<u32>| {
        let column = columns.clone();
        let pixels = column.flat_map(|x| (45..75).map(move |y| (x, y)));
        pixels
            .map(|(x, y)| out.color.rgba[at(x, y)][1])
            .max()
            .unwrap()
    };
    let (l, r) = (58..78, 82..102);
    assert!(peak(&both, l.clone()) > 60 && peak(&both, r.clone()) > 60);
    assert!(peak(&one, l.clone()) < peak(&both, l) / 3);
    assert!(peak(&one, r.clone()).abs_diff(peak(&both, r)) <= 1);
}
