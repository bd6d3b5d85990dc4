//! Tests of shadows in whole frames.

use glam::{DVec3, Vec3};

use super::*;
use crate::render::ShadowSettings;

/// A point light with a sphere in its way: where the shadow must be black and lit, and how dark it is.
#[test]
fn a_shadow_falls_where_the_light_is_blocked_and_as_dark_as_irradiance_says() {
    let frame = wall([188, 188, 188, 255]);
    let light_at = DVec3::new(-0.6, 0.0, 0.5);
    let ball_at = DVec3::new(-0.1, 0.0, 1.3);
    let radius = 0.1;
    let lights = vec![point_light(light_at, 2.0)];
    let scene = scene(&[(ball_at, radius, Material::default(), false)], lights);
    let out = render(
        &scene,
        &frame,
        &RenderSettings {
            shadows: ShadowSettings {
                filter_radius_px: 0,
                ..ShadowSettings::default()
            },
            ..plain()
        },
        1,
    );
    let shadow = gray(&out, Aov::Shadow);
    let level = f64::from(linear_from_srgb(188));
    let (mut dark, mut wrong) = (0, 0);
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let p = frame.intrinsics.unproject(f64::from(x), f64::from(y), 2.0);
            let to = light_at - p;
            let distance = (ball_at - p).cross(to).length() / to.length();
            // The mesh is inside its sphere by up to 1 % of the radius.
            if (distance / radius - 1.0).abs() < 0.02 {
                continue;
            }
            let e = 2.0 * (-to.z / to.length()).abs() / to.length_squared();
            let ambient = std::f64::consts::PI * level;
            let expected = if distance < radius {
                ambient / (ambient + e)
            } else {
                1.0
            };
            let got = f64::from(shadow[at(x, y)]) / 255.0;
            dark += u32::from(expected < 1.0);
            // The error of spherical harmonics of order 2 of a uniform environment, and of 8 bits.
            wrong += u32::from((got - expected).abs() > 0.01);
        }
    }
    assert!(dark > 200, "{dark}");
    assert_eq!(wrong, 0, "of {dark} shadowed pixels");
}

#[test]
fn a_real_thing_in_front_occludes_and_shades() {
    let mut frame = wall([188, 188, 188, 255]);
    for y in 0..HEIGHT {
        for x in 0..60 {
            frame.depth.z_m[at(x, y)] = 1.0;
        }
    }
    let object = (DVec3::new(0.0, 0.0, 1.6), 0.4, Material::default(), false);
    let out = render(
        &scene(std::slice::from_ref(&object), vec![]),
        &frame,
        &plain(),
        1,
    );
    let mask = gray(&out, Aov::Mask);
    assert_eq!((mask[at(55, 60)], mask[at(64, 60)]), (0, 255));
    // A light behind the real screen cannot reach the side of the sphere that the screen hides.
    let light = vec![point_light(DVec3::new(-1.2, 0.0, 0.4), 4.0)];
    let lit = render(
        &scene(std::slice::from_ref(&object), light.clone()),
        &wall([188; 4]),
        &plain(),
        1,
    );
    let shaded = render(&scene(&[object], light), &frame, &plain(), 1);
    assert!(shaded.color.rgba[at(66, 60)][0] + 20 < lit.color.rgba[at(66, 60)][0]);
}

/// Points that are proven lit must be lit: casting every ray changes nothing.
#[test]
fn leaving_out_what_is_proven_changes_no_pixel() {
    let ball_light = |x, y, radius_m| Light::Sphere {
        position: DVec3::new(x, y, 0.5),
        radius_m,
        intensity: Vec3::ONE,
    };
    let objects = [
        (DVec3::new(-0.3, 0.1, 1.6), 0.15, Material::default(), false),
        (DVec3::new(0.3, 0.1, 1.4), 0.1, glass(), false),
        (DVec3::new(0.0, -0.3, 1.9), 0.05, mirror(), false),
    ];
    let lights = vec![
        ball_light(-0.6, -0.2, 0.1),
        ball_light(0.5, -0.8, 0.02),
        point_light(DVec3::new(0.0, 0.9, 0.7), 1.0),
    ];
    let scene = scene(&objects, lights);
    let mut frame = noise();
    // Steps, slopes and holes in the surface that receives the shadows.
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let z = &mut frame.depth.z_m[at(x, y)];
            *z += 0.002 * y as f32 - if x / 20 % 3 == 0 { 0.25 } else { 0.0 };
            if (x + y) % 23 < 2 {
                *z = f32::NAN;
            }
        }
    }
    for method in [
        ShadowMethod::Hard,
        ShadowMethod::Naive,
        ShadowMethod::Adaptive,
        ShadowMethod::AdaptiveNeighbours,
    ] {
        let [skipping, casting] = [true, false].map(|skip_proven| {
            let shadows = ShadowSettings {
                method,
                skip_proven,
                ..ShadowSettings::default()
            };
            let settings = RenderSettings {
                shadows,
                bloom: RenderSettings::default().bloom,
                ..plain()
            };
            render(&scene, &frame, &settings, 1)
        });
        assert_eq!(skipping.color, casting.color, "{method:?}");
        assert_eq!(skipping.aovs, casting.aovs, "{method:?}");
        assert!(2 * skipping.stats.shadow_points < casting.stats.shadow_points);
    }
}

/// A torus of 262 thousand triangles in front of a wall: with coarser levels of detail the picture is the same to
/// within half a pixel, and the shadow has a level of its own.
#[test]
fn a_coarser_level_shows_and_shades_the_same() {
    let frame = wall([188, 188, 188, 255]);
    let mesh = Arc::new(crate::shapes::ripples(512, 256));
    let lights = vec![point_light(DVec3::new(-0.6, 0.0, 0.5), 2.0)];
    let at = DVec3::new(-0.1, 0.0, 1.3);
    let picture = |material: Material, lod_error_px, threads| {
        let mut scene = scene(&[(at, 0.25, material, false)], lights.clone());
        scene.meshes[0] = Arc::clone(&mesh);
        let settings = RenderSettings {
            lod_error_px,
            ..plain()
        };
        render(&scene, &frame, &settings, threads)
    };
    let n = mesh.triangles.len() as u64;
    // The facets of a mirror are visible, so its level is chosen by them.
    for (material, limit) in [(Material::default(), 0.5), (mirror(), 2.0)] {
        let as_is = picture(material.clone(), 0.0, 1);
        assert_eq!(as_is.stats.triangles, n);
        let coarser = picture(material.clone(), limit, 1);
        assert!(
            coarser.stats.triangles < n / 3,
            "{}",
            coarser.stats.triangles
        );
        assert!(picture(material, limit, 3).color == coarser.color);
        for aov in [Aov::Mask, Aov::Shadow] {
            let (a, b) = (gray(&as_is, aov), gray(&coarser, aov));
            let differ = a
                .iter()
                .zip(b)
                .filter(|(a, b)| a.abs_diff(**b) > 128)
                .count();
            let there = a.iter().filter(|&&x| x != a[0]).count();
            assert!(there > 100 && differ * 50 < there, "{differ} of {there}");
        }
    }
    // The limit is so small that a mirror is shown at full detail, but not its shadow: on the mirror itself only
    // its reflection of that shadow differs.
    let as_is = picture(mirror(), 0.0, 1);
    let shadow_only = picture(mirror(), 0.5, 1);
    assert_eq!(shadow_only.stats.triangles, n);
    assert!(shadow_only.color != as_is.color);
    let mask = gray(&as_is, Aov::Mask);
    let same = |i: &usize| as_is.color.rgba[*i] == shadow_only.color.rgba[*i];
    let own: Vec<usize> = (0..mask.len()).filter(|&i| mask[i] == 255).collect();
    let n_same = own.iter().filter(|i| same(i)).count();
    assert!(n_same * 10 > own.len() * 9, "{n_same} of {}", own.len());
}

/// If all glass has the same tint, shadow rays do not look up which glass they hit. A sphere of other glass
/// behind the camera, where no ray goes, forces the look-up: the picture is the same.
#[test]
fn asking_which_glass_it_is_changes_nothing() {
    let frame = wall([188, 188, 188, 255]);
    let lights = vec![point_light(DVec3::new(-0.6, 0.0, 0.5), 2.0)];
    let tinted = |base_color| Material {
        base_color,
        ..glass()
    };
    let alike = [
        (
            DVec3::new(-0.1, 0.0, 1.3),
            0.1,
            tinted(Vec3::new(0.9, 0.5, 0.2)),
            false,
        ),
        (
            DVec3::new(0.0, 0.1, 1.5),
            0.1,
            tinted(Vec3::new(0.9, 0.5, 0.2)),
            false,
        ),
    ];
    let mut various = alike.to_vec();
    various.push((DVec3::new(0.0, 0.0, -9.0), 0.1, tinted(Vec3::ONE), false));
    let settings = plain();
    let picture = |objects: &[_]| render(&scene(objects, lights.clone()), &frame, &settings, 1);
    let (a, b) = (picture(&alike), picture(&various));
    let shadow = gray(&a, Aov::Shadow);
    assert!(shadow.iter().filter(|&&x| x < 250).count() > 200);
    assert!(a.color == b.color);
}
