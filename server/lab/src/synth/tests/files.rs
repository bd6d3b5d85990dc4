//! The written files: the same each time, readable, close to the ground truth, equal to the shipped ones.

use std::collections::BTreeMap;

use indicatif::ProgressBar;

use super::super::*;

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

/// Every file of a folder, by its relative path.
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
    // The picture is exposed as by a real camera.
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

    // No file is overwritten, and an error leaves no file behind.
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
    // Edges are displaced, but only by about a pixel.
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

/// The folder `recordings/` of the checkout.
fn shipped_folder() -> PathBuf {
    FilePath::new(env!("CARGO_MANIFEST_DIR")).join("../../recordings")
}

#[test]
fn the_shipped_meshes_are_the_ones_made_here() {
    for (name, mesh) in ghostlight::shapes::shipped() {
        let path = shipped_folder().join(format!("meshes/{name}.ply"));
        let (file, made) = (std::fs::read(&path).unwrap(), ply(&mesh));
        assert_eq!(file.len(), made.len(), "{name}");
        // Sines may differ in the last bit between C libraries, so numbers are compared, not bytes.
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
    // The recording has the options that `ghostlight synth` uses by default; otherwise it must be rendered again.
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
    // The depth is what the sensor measures from the first pose; on another machine, one pixel in a thousand may
    // fall on the other side of a threshold.
    let exact = sensor::exact_depth(&room.geometry, &view);
    let noise = options.seed.rotate_left(16);
    let sensed = sensor::sense(&room.geometry, &view, &exact, noise);
    let file = desk.join(format!("depth/{}.png", tum_text::stamp(output::START_NS)));
    let shipped = image::open(file).unwrap().into_luma16().into_raw();
    let different = shipped.iter().zip(&sensed).filter(|(a, b)| a != b).count();
    assert!(different <= shipped.len() / 1000, "{different} pixels");
}
