//! Tests of depth of field against a thin lens.

use glam::{DVec3, Vec3};

use super::*;
use crate::render::LensSettings;

/// Focal length of [`wall`]'s camera, pixels.
const FOCAL_PX: f64 = 140.0;

fn through(lens: LensSettings) -> RenderSettings {
    RenderSettings { lens, ..plain() }
}

fn lens(radius_m: f32, focus_m: f32) -> LensSettings {
    LensSettings {
        radius_m,
        focus_m,
        samples: 256,
        noise_threshold: 1.0,
        ..LensSettings::default()
    }
}

fn lamp() -> Material {
    Material {
        base_color: Vec3::ZERO,
        emissive: Vec3::new(1.0, 0.5, 0.2),
        ior: 1.0,
        ..Material::default()
    }
}

/// A lamp on the axis, one metre away.
fn small_lamp(radius: f64) -> Scene {
    scene(&[(DVec3::Z, radius, lamp(), false)], vec![])
}

fn share(code: u8) -> f64 {
    f64::from(code) / 255.0
}

/// From lens point O', a point at depth z is seen through the pixel `f O' (1/z - 1/focus)` away: the whole lens
/// sees a disc of radius c = f R |1/z - 1/focus| pixels. The image of a sphere, of radius a, becomes the
/// convolution of both discs and of the pixel's square: no light is lost, and the mean squares of their radii
/// (a^2 / 2, c^2 / 2, 1 / 6) add up.
#[test]
fn a_small_thing_out_of_focus_is_a_disc_of_the_circle_of_confusion() {
    let (radius, lens_radius) = (0.04, 0.05);
    for focus in [0.4, 0.6, 3.0, 1000.0] {
        let out = render(
            &small_lamp(radius),
            &noise(),
            &through(lens(lens_radius, focus)),
            1,
        );
        let c = FOCAL_PX * f64::from(lens_radius) * (1.0 - 1.0 / f64::from(focus)).abs();
        let a = FOCAL_PX * radius.asin().tan();
        let (mut area, mut square, mut farthest) = (0.0, 0.0, 0.0_f64);
        for (i, &m) in gray(&out, Aov::Mask).iter().enumerate() {
            let (x, y) = (i as u32 % WIDTH, i as u32 / WIDTH);
            let distance = (f64::from(x) - 79.5).hypot(f64::from(y) - 59.5);
            area += share(m);
            square += share(m) * distance * distance;
            if m > 0 {
                farthest = farthest.max(distance);
            }
        }
        // 256 stratified samples have an error under half a percent, and so has viewing a sphere from the lens's
        // rim; codes of 8 bits round to 1/510 in each of a few hundred pixels.
        let exact = std::f64::consts::PI * a * a;
        assert!(
            (area / exact - 1.0).abs() < 0.015,
            "{focus}: {area} {exact}"
        );
        let exact = 0.5 * (a * a + c * c) + 1.0 / 6.0;
        let found = square / area;
        assert!(
            (found / exact - 1.0).abs() < 0.02,
            "{focus}: {found} {exact}"
        );
        // Up to the corner of the pixel's square, and no farther.
        assert!(
            farthest <= a + c + 0.71 && farthest > a + c - 2.0,
            "{focus}: {farthest}"
        );
    }
}

/// Objects in the plane of focus are as sharp as with a pinhole.
#[test]
fn what_is_in_focus_is_as_sharp_as_through_a_pinhole() {
    let ball = small_lamp(0.04);
    let sharp = RenderSettings {
        edge_samples: 64,
        ..plain()
    };
    let pinhole = render(&ball, &noise(), &sharp, 1);
    // The front of the sphere is out of focus by more than half a pixel, its outline by 1/45.
    let through_lens = render(&ball, &noise(), &through(lens(0.1, 1.0)), 1);
    assert_ne!(through_lens.color, pinhole.color, "the lens was asked");
    let worst = gray(&pinhole, Aov::Mask)
        .iter()
        .zip(gray(&through_lens, Aov::Mask))
        .map(|(a, b)| a.abs_diff(*b))
        .max();
    // On an outline 64 even and 256 jittered samples differ by a twentieth of the pixel.
    assert!(worst.unwrap() <= 13, "{worst:?}");
}

/// No blur of half a pixel anywhere: exactly the pinhole's pixels, whatever the other lens settings are.
#[test]
fn a_pinhole_and_a_lens_too_small_to_blur_change_no_byte() {
    let light = vec![point_light(DVec3::new(0.3, -0.8, 0.6), 1.0)];
    let objects = [
        (DVec3::new(-0.1, 0.1, 1.6), 0.25, mirror(), false),
        (DVec3::new(0.3, 0.1, 1.4), 0.15, glass(), false),
    ];
    let scene = scene(&objects, light);
    let pinhole = render(&scene, &noise(), &plain(), 1);
    for (radius, samples, focus_px) in [(0.0, 1, Some([3.0, 4.0])), (0.003, 256, None)] {
        let settings = through(LensSettings {
            samples,
            focus_px,
            ..lens(radius, 1.7)
        });
        let other = render(&scene, &noise(), &settings, 1);
        assert_eq!(other.color, pinhole.color);
        assert_eq!(other.aovs, pinhole.aovs);
        assert_eq!(other.stats, pinhole.stats);
    }
}

/// A real wall at 1 m covers the left half of an object in focus at 1.5 m. Beside its edge, the share of the lens
/// that sees the object is the part of a disc beyond a chord, averaged over the pixel.
#[test]
fn a_nearer_real_wall_out_of_focus_hides_softly() {
    let mut frame = noise();
    for y in 0..HEIGHT {
        for x in 0..WIDTH / 2 {
            frame.depth.z_m[at(x, y)] = 1.0;
        }
    }
    let radius = 0.06;
    let out = render(
        &scene(&[(DVec3::Z * 2.0, 0.5, lamp(), false)], vec![]),
        &frame,
        &through(lens(radius, 1.5)),
        1,
    );
    let c = FOCAL_PX * f64::from(radius) * (1.0 - 1.0 / 1.5);
    let beyond = |chord: f64| {
        let t = (chord / c).clamp(-1.0, 1.0);
        (t.acos() - t * (1.0 - t * t).sqrt()) / std::f64::consts::PI
    };
    for x in 70..90 {
        let parts = 100;
        let exact = (0..parts)
            .map(|i| beyond(79.5 - (f64::from(x) - 0.5 + (f64::from(i) + 0.5) / 100.0)))
            .sum::<f64>()
            / f64::from(parts);
        let column = (50..70).map(|y| share(gray(&out, Aov::Mask)[at(x, y)]));
        let found = column.sum::<f64>() / 20.0;
        // Twenty pixels of 256 samples each: three standard deviations, even without stratification.
        let noise = 3.0 * (exact * (1.0 - exact) / (20.0 * 256.0)).sqrt() + 1.0 / 510.0;
        assert!((found - exact).abs() <= noise, "{x}: {found} {exact}");
    }
}

/// A flat real wall out of focus shows the shadow on it blurred by its circle of confusion; in focus, as with a
/// pinhole.
#[test]
fn a_shadow_on_a_defocused_wall_is_defocused() {
    let ball = (DVec3::new(-0.4, 0.0, 1.4), 0.1, lamp(), false);
    let light = vec![point_light(DVec3::new(-1.0, 0.0, 1.0), 1.0)];
    let scene = scene(&[ball], light);
    let frame = wall([120, 120, 120, 255]);
    let pinhole = render(&scene, &frame, &plain(), 1);
    let sharp = gray(&pinhole, Aov::Shadow);
    let settings = through(lens(0.05, 1.0));
    let out = render(&scene, &frame, &settings, 1);
    let soft = gray(&out, Aov::Shadow);
    let mask = gray(&out, Aov::Mask);
    let c = FOCAL_PX * 0.05 * 0.5;
    let (mut shaded, mut checked) = (0, 0);
    for y in 20..HEIGHT - 20 {
        for x in 20..WIDTH - 20 {
            // Where the sphere is visible, no real surface is.
            if mask[at(x, y)] > 0 {
                continue;
            }
            let (mut sum, mut n) = (0.0, 0.0);
            let steps = 24;
            for (i, j) in (0..steps).flat_map(|j| (0..steps).map(move |i| (i, j))) {
                let place = |k: i32| (f64::from(k) + 0.5) / f64::from(steps) * 2.0 - 1.0;
                let (p, q) = (place(i), place(j));
                if p.hypot(q) > 1.0 {
                    continue;
                }
                for (s, t) in [(-0.25, -0.25), (0.25, -0.25), (-0.25, 0.25), (0.25, 0.25)] {
                    let u = (f64::from(x) + s + c * p).round() as u32;
                    let v = (f64::from(y) + t + c * q).round() as u32;
                    sum += f64::from(sharp[at(u, v)]);
                    n += 1.0;
                }
            }
            let exact: f64 = sum / n;
            checked += 1;
            shaded += usize::from(exact < 250.0 && exact > 5.0);
            let found = f64::from(soft[at(x, y)]);
            // Four standard deviations of 256 samples would be 32 without stratification.
            assert!((found - exact).abs() <= 12.0, "{x} {y}: {found} {exact}");
        }
    }
    assert!(checked > 3000 && shaded > 300, "{checked} {shaded}");

    let focused = render(&scene, &frame, &through(lens(0.05, 2.0)), 1);
    assert_eq!(gray(&focused, Aov::Shadow), sharp);
}

#[test]
fn nothing_is_lost_in_mirrors_and_glass_out_of_focus() {
    let frame = wall([120, 120, 120, 255]);
    for (material, max_bounces) in [(mirror(), 0), (mirror(), 5), (glass(), 5)] {
        let settings = RenderSettings {
            max_bounces,
            ..through(LensSettings {
                samples: 25,
                ..lens(0.03, 0.5)
            })
        };
        let object = (DVec3::new(0.1, 0.0, 1.2), 0.25, material, false);
        let out = render(&scene(&[object], vec![]), &frame, &settings, 1);
        assert!(out.stats.virtual_pixels > 1000);
        let worst = out.color.rgba.iter().map(|p| p[0].abs_diff(120)).max();
        // Paths with too little throughput to be visible are cut, as without a lens.
        assert!(worst.unwrap() <= 1, "{max_bounces}: {worst:?}");
    }
}

#[test]
fn lens_rays_give_the_same_bytes_on_any_number_of_threads() {
    let sphere_light = Light::Sphere {
        position: DVec3::new(0.4, -0.8, 0.6),
        radius_m: 0.1,
        intensity: Vec3::ONE,
    };
    let rough = Material {
        metallic: 1.0,
        roughness: 0.4,
        ..Material::default()
    };
    let objects = [
        (DVec3::new(-0.1, 0.1, 1.6), 0.25, mirror(), false),
        (DVec3::new(0.3, 0.1, 1.4), 0.15, glass(), false),
        (DVec3::new(0.1, -0.3, 1.5), 0.1, rough, false),
        (DVec3::new(-0.5, -0.2, 1.5), 0.2, mirror(), true),
    ];
    let scene = scene(&objects, vec![sphere_light]);
    let settings = through(LensSettings {
        samples: 9,
        noise_threshold: 0.1,
        ..lens(0.03, 0.8)
    });
    let one = render(&scene, &noise(), &settings, 1);
    for threads in [2, 5] {
        let other = render(&scene, &noise(), &settings, threads);
        assert_eq!(one.color, other.color);
        assert_eq!(one.aovs, other.aovs);
        assert_eq!(one.stats, other.stats);
    }
    let mut again = renderer_of(&scene, 2);
    for settings in [&settings, &plain(), &settings] {
        let rendered = again
            .render(&noise(), settings, &[], &Uninterrupted)
            .unwrap();
        assert_eq!(
            rendered.color == one.color,
            settings.lens.radius_m > 0.0,
            "buffers must not leak between frames"
        );
    }
}

/// A small bright lamp far out of focus is found by few rays of each pixel. More rays where the two halves
/// disagree bring the picture nearer to that of many rays everywhere.
#[test]
fn pixels_whose_rays_disagree_take_more() {
    let mut bright = lamp();
    bright.emissive = Vec3::splat(40.0);
    let scene = scene(&[(DVec3::Z, 0.01, bright, false)], vec![]);
    let frame = wall([60, 60, 60, 255]);
    let picture = |samples, noise_threshold| {
        let settings = through(LensSettings {
            samples,
            noise_threshold,
            ..lens(0.05, 0.4)
        });
        render(&scene, &frame, &settings, 1).color
    };
    let reference = picture(256, 0.0);
    let error = |other: &ColorImage| -> u64 {
        let pairs = reference.rgba.iter().zip(&other.rgba);
        pairs
            .map(|(a, b)| u64::from(a[0].abs_diff(b[0])).pow(2))
            .sum()
    };
    let (few, more) = (error(&picture(16, 1.0)), error(&picture(16, 0.1)));
    assert!(more * 4 < few, "{more} against {few}");
}

#[test]
fn focus_follows_the_depth_sensed_at_a_pixel() {
    let mut frame = noise();
    for y in 0..HEIGHT {
        for x in 0..WIDTH / 2 {
            frame.depth.z_m[at(x, y)] = 1.2;
        }
        for x in WIDTH - 20..WIDTH {
            frame.depth.z_m[at(x, y)] = DepthImage::INVALID;
        }
    }
    // A single wrong depth does not change the focus.
    frame.depth.z_m[at(40, 60)] = 0.2;
    let scene = small_lamp(0.1);
    let focused = |focus_m, focus_px| {
        let settings = through(LensSettings {
            focus_px,
            samples: 4,
            ..lens(0.05, focus_m)
        });
        render(&scene, &frame, &settings, 1).color
    };
    let near = focused(1.2, None);
    let far = focused(2.0, None);
    assert_ne!(near, far);
    assert_eq!(focused(0.7, Some([40.0, 60.0])), near);
    assert_eq!(focused(0.7, Some([100.0, 20.0])), far);
    for unknown in [[150.0, 60.0], [5000.0, 0.0], [0.0, 3e38]] {
        assert_eq!(focused(2.0, Some(unknown)), far);
    }
}

#[test]
fn tiles_that_nothing_out_of_focus_reaches_are_left_alone() {
    let scene = small_lamp(0.04);
    let traced = |settings: &RenderSettings| {
        let out = render(&scene, &noise(), settings, 1);
        let mask = gray(&out, Aov::Mask).iter().filter(|&&m| m > 0).count();
        (out.stats.traced_pixels, mask)
    };
    let (pinhole, _) = traced(&plain());
    let (blurred, shown) = traced(&through(lens(0.05, 0.5)));
    assert!(
        blurred > pinhole && blurred < u64::from(WIDTH * HEIGHT) / 4,
        "{blurred}"
    );
    assert!(shown as u64 <= blurred);
}

#[test]
fn holes_follow_their_policy_through_a_lens() {
    let mut frame = wall([100, 100, 100, 255]);
    for y in 50..70 {
        for x in 70..90 {
            frame.depth.z_m[at(x, y)] = DepthImage::INVALID;
        }
    }
    for (z, holes, expected) in [
        (1.5, HolePolicy::ShowReal, 0),
        (1.5, HolePolicy::ShowVirtual, 255),
        (1.5, HolePolicy::Fill, 255),
        (2.5, HolePolicy::Fill, 0),
    ] {
        let mut settings = through(LensSettings {
            samples: 16,
            ..lens(0.05, 1.0)
        });
        settings.ghost.holes = holes;
        let ball = (DVec3::new(0.0, 0.0, z), 0.4, lamp(), false);
        let out = render(&scene(&[ball], vec![]), &frame, &settings, 1);
        assert_eq!(gray(&out, Aov::Mask)[at(80, 60)], expected, "{holes:?} {z}");
    }
}

#[test]
fn extreme_lenses_end_and_stay_finite() {
    let mut frame = noise();
    frame.depth.z_m[at(80, 60)] = DepthImage::MIN_M;
    frame.depth.z_m[at(20, 20)] = DepthImage::MAX_M;
    let around = (DVec3::new(0.0, 0.0, 0.1), 0.3, glass(), false);
    let beside = (DVec3::new(0.2, 0.0, 0.02), 0.01, lamp(), false);
    let light = vec![point_light(DVec3::new(0.0, -0.5, 1.0), 1.0)];
    let scene = scene(&[around, beside], light);
    for (radius, focus_m, samples) in [(0.1, 0.01, 1), (0.1, 1000.0, 2), (1e-30, 0.01, 3)] {
        let settings = through(LensSettings {
            radius_m: radius,
            focus_m,
            samples,
            ..LensSettings::default()
        });
        let out = render(&scene, &frame, &settings, 2);
        assert!(out.stats.virtual_pixels > 0, "{radius} {focus_m}");
    }
}

#[test]
fn a_lens_out_of_range_is_named() {
    let named = |lens: LensSettings| through(lens).validate().map_err(|error| error.field);
    assert_eq!(named(lens(0.1, 0.01)), Ok(()));
    assert_eq!(named(lens(-0.001, 1.0)), Err("lens.radius_m"));
    assert_eq!(named(lens(f32::NAN, 1.0)), Err("lens.radius_m"));
    assert_eq!(named(lens(0.01, 0.0)), Err("lens.focus_m"));
    for noise_threshold in [-0.1, 1.1, f32::NAN] {
        let lens = LensSettings {
            noise_threshold,
            ..lens(0.01, 1.0)
        };
        assert_eq!(named(lens), Err("lens.noise_threshold"));
    }
    for samples in [0, 257] {
        let lens = LensSettings {
            samples,
            ..lens(0.01, 1.0)
        };
        assert_eq!(named(lens), Err("lens.samples"));
    }
    for focus_px in [[-1.0, 0.0], [0.0, f32::INFINITY]] {
        let lens = LensSettings {
            focus_px: Some(focus_px),
            ..lens(0.01, 1.0)
        };
        assert_eq!(named(lens), Err("lens.focus_px"));
    }
    let read = |text: &str| serde_json::from_str::<RenderSettings>(text);
    let settings = read(r#"{"lens": {"radius_m": 0.01, "focus_px": [320, 240]}}"#).unwrap();
    assert_eq!(settings.lens.focus_px, Some([320.0, 240.0]));
    assert_eq!(settings.lens.samples, 25);
    assert!(read(r#"{"lens": {"radius": 0.01}}"#).is_err());
}
