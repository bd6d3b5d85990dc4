//! The recording against closed forms, and the files it consists of.

use std::collections::BTreeMap;

use glam::{DQuat, DVec3, Vec3};
use indicatif::ProgressBar;

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
        // Where the true disparity falls between two steps decides how much of the rounding
        // is seen: up to a fifth.
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
    // A square metre of floor under a ball: irradiance intensity cos / d^2, exactly, as long
    // as no part of the ball is under the horizon.
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
    // From the air above the desk and from where the camera moves, no ray meets a back.
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

fn quick(folder: &FilePath, seed: u32) -> SynthOptions {
    SynthOptions {
        out: folder.to_path_buf(),
        frames: 3,
        width: 96,
        height: 72,
        seed,
        samples: 1,
        quick: true,
        ..SynthOptions::default()
    }
}

/// Every file of a folder by its relative path.
fn files(folder: &FilePath) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(current) = folders.pop() {
        for entry in std::fs::read_dir(current).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).unwrap().to_path_buf();
                all.insert(name, std::fs::read(&path).unwrap());
            }
        }
    }
    all
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let made = |name: &str, threads: usize, seed: u32| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let out = folder.path().join(name);
        let summary = pool
            .install(|| run(&quick(&out, seed), &ProgressBar::hidden()))
            .unwrap();
        let files = files(&out);
        assert_eq!(
            summary.bytes,
            files.values().map(|f| f.len() as u64).sum::<u64>()
        );
        files
    };
    let one = made("one", 1, 5);
    assert_eq!(one, made("three", 3, 5));
    let other = made("other", 2, 6);
    assert_eq!(one.len(), other.len());
    assert_ne!(one, other);
}

#[test]
fn what_is_written_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("deep/er");
    let summary = run(&quick(&out, 1), &ProgressBar::hidden()).unwrap();
    assert_eq!(summary.frames, 3);
    // A picture that a camera would have exposed like this.
    assert!((0.12..0.3).contains(&summary.mean_linear), "{summary:?}");
    assert!(summary.clipped_share < 0.1, "{summary:?}");
    assert!((0.02..0.3).contains(&summary.hole_share), "{summary:?}");

    let text = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
    let trajectory = text("groundtruth.txt");
    for (list, folder, colour) in [
        ("rgb.txt", "rgb", true),
        ("depth.txt", "depth", false),
        ("depth_exact.txt", "depth_exact", false),
    ] {
        let lines: Vec<String> = text(list)
            .lines()
            .filter(|line| !line.starts_with('#'))
            .map(str::to_owned)
            .collect();
        assert_eq!(lines.len(), 3);
        for line in lines {
            let (stamp, file) = line.split_once(' ').unwrap();
            assert!(file.starts_with(folder));
            let image = image::open(out.join(file)).unwrap();
            assert_eq!((image.width(), image.height()), (96, 72));
            assert_eq!(image.color() == image::ColorType::Rgb8, colour);
            // Exact poses, not interpolated ones.
            assert!(trajectory.lines().any(|pose| pose.starts_with(stamp)));
        }
    }
    for line in trajectory.lines().filter(|line| !line.starts_with('#')) {
        let x: Vec<f64> = line.split(' ').map(|w| w.parse().unwrap()).collect();
        assert_eq!(x.len(), 8);
        assert!((x[4..].iter().map(|q| q * q).sum::<f64>() - 1.0).abs() < 1e-8);
    }
    let manifest: serde_json::Value = serde_json::from_str(&text("manifest.json")).unwrap();
    assert_eq!(manifest["intrinsics"]["width"], 96);
    assert_eq!(manifest["depth_units_per_metre"], 5000.0);
    assert_eq!(manifest["lights"].as_array().unwrap().len(), 4);

    // Nothing is overwritten, and nothing is left behind.
    assert!(matches!(
        run(&quick(&out, 1), &ProgressBar::hidden()),
        Err(SynthError::NotEmpty(_))
    ));
    let siblings = std::fs::read_dir(folder.path().join("deep"))
        .unwrap()
        .count();
    assert_eq!(siblings, 1);
}

#[test]
fn the_sensed_depth_is_near_the_exact_one() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("r");
    let options = SynthOptions {
        width: 320,
        height: 240,
        frames: 1,
        ..quick(&out, 2)
    };
    run(&options, &ProgressBar::hidden()).unwrap();
    let depth = |name: &str| {
        let file = std::fs::read_dir(out.join(name))
            .unwrap()
            .next()
            .unwrap()
            .unwrap();
        image::open(file.path()).unwrap().into_luma16().into_raw()
    };
    let (sensed, exact) = (depth("depth"), depth("depth_exact"));
    let mut errors: Vec<f64> = sensed
        .iter()
        .zip(&exact)
        .filter(|&(&s, _)| s > 0)
        .map(|(&s, &e)| (f64::from(s) - f64::from(e)).abs() / sensor::UNITS_PER_METRE)
        .collect();
    errors.sort_by(f64::total_cmp);
    let median = errors[errors.len() / 2];
    // At 1 to 2 m half a step is 1.4 to 6 mm; the median of a normal error is 0.67 sigma.
    assert!((0.0005..0.005).contains(&median), "{median}");
    // Edges are displaced, but by a pixel, not everywhere.
    let wrong = errors.iter().filter(|&&e| e > 0.05).count() as f64 / errors.len() as f64;
    assert!((0.001..0.05).contains(&wrong), "{wrong}");
}

#[test]
fn bad_options_name_their_field() {
    let folder = tempfile::tempdir().unwrap();
    let good = quick(&folder.path().join("x"), 1);
    for (options, field) in [
        (
            SynthOptions {
                frames: 0,
                ..good.clone()
            },
            "frames: ",
        ),
        (
            SynthOptions {
                rate_hz: f64::NAN,
                ..good.clone()
            },
            "rate_hz: ",
        ),
        (
            SynthOptions {
                samples: 17,
                ..good.clone()
            },
            "samples: ",
        ),
        (
            SynthOptions {
                width: 0,
                ..good.clone()
            },
            "image size: ",
        ),
    ] {
        let error = run(&options, &ProgressBar::hidden())
            .unwrap_err()
            .to_string();
        assert!(error.starts_with(field), "{error}");
        assert!(!options.out.exists());
    }
}

/// `recordings/` of the checkout.
fn shipped_folder() -> PathBuf {
    FilePath::new(env!("CARGO_MANIFEST_DIR")).join("../../recordings")
}

#[test]
fn the_shipped_meshes_are_the_ones_made_here() {
    for (name, mesh) in ghostlight::shapes::shipped() {
        let path = shipped_folder().join(format!("meshes/{name}.ply"));
        let (file, made) = (std::fs::read(&path).unwrap(), ply(&mesh));
        assert_eq!(file.len(), made.len(), "{name}");
        // Sines may differ in the last bit from one C library to the next, so numbers are
        // compared, not bytes.
        let header = made.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
        let faces = header + mesh.positions.len() * 24;
        assert_eq!(file[..header], made[..header], "{name}");
        assert_eq!(file[faces..], made[faces..], "{name}");
        let floats = |bytes: &[u8]| -> Vec<f32> {
            bytes[header..faces]
                .as_chunks::<4>()
                .0
                .iter()
                .map(|b| f32::from_le_bytes(*b))
                .collect()
        };
        for (a, b) in floats(&file).iter().zip(floats(&made)) {
            assert!((a - b).abs() < 1e-6, "{name}: {a} {b}");
        }
    }
}

#[test]
fn the_bundled_recording_is_complete_and_small() {
    let folder = shipped_folder();
    assert!(folder_bytes(&folder).unwrap() < 12_000_000);
    let desk = folder.join("desk");
    let text = std::fs::read_to_string(desk.join("manifest.json")).unwrap();
    let manifest: serde_json::Value = serde_json::from_str(&text).unwrap();
    // What `ghostlight synth` says today, or the recording has to be made anew.
    let options = SynthOptions::default();
    let room = room::build(6.0);
    let intrinsics = options.check().unwrap();
    let view = View {
        intrinsics,
        pose: Path::new(options.seed).pose(0.0),
    };
    let (u, v) = intrinsics.project(view.pose.inverse().transform_point(room::FREE_SPOT));
    let place = [u.round() as u32, v.round() as u32];
    let expected = output::manifest(&options, &intrinsics, &room.lights, place).unwrap();
    let expected: serde_json::Value = serde_json::from_str(&expected).unwrap();
    assert_eq!(manifest, expected);
    let mut listed = 0;
    for list in ["rgb.txt", "depth.txt"] {
        for line in std::fs::read_to_string(desk.join(list)).unwrap().lines() {
            if let Some((_, file)) = line.split_once(' ').filter(|_| !line.starts_with('#')) {
                assert!(desk.join(file).is_file(), "{file}");
                listed += 1;
            }
        }
    }
    assert_eq!(listed, 2 * options.frames);
    // The depth is what the sensor sees of the room from the first pose; a pixel in a thousand
    // may have fallen to the other side of a threshold on another machine.
    let exact = sensor::exact_depth(&room.geometry, &view);
    let noise = options.seed.rotate_left(16);
    let sensed = sensor::sense(&room.geometry, &view, &exact, noise);
    let file = desk.join(format!("depth/{}.png", output::stamp(output::START_NS)));
    let shipped = image::open(file).unwrap().into_luma16().into_raw();
    let different = shipped.iter().zip(&sensed).filter(|(a, b)| a != b).count();
    assert!(different <= shipped.len() / 1000, "{different} pixels");
}
