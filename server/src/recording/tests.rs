//! Whole recordings: real ones, assembled ones, broken ones.

use super::*;
use crate::codec::png;
use crate::frame::is_valid_depth;
use glam::{DQuat, DVec3};
use proptest::prelude::*;
use std::fs;

/// The folder of real recordings; without it a test says so loudly and is skipped, unless data
/// are required.
fn data(name: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("GHOSTLIGHT_DATA") else {
        let required = std::env::var("GHOSTLIGHT_REQUIRE").is_ok_and(|r| r.contains("data"));
        assert!(
            !required,
            "GHOSTLIGHT_REQUIRE asks for data, but GHOSTLIGHT_DATA is not set"
        );
        eprintln!("SKIPPED: GHOSTLIGHT_DATA not set");
        return None;
    };
    Some(PathBuf::from(root).join(name))
}

fn open(path: &Path) -> Result<Recording, RecordingError> {
    Recording::open(path, &OpenOptions::default())
}

fn error(path: &Path) -> String {
    open(path).unwrap_err().to_string()
}

/// Median difference of depth, metres, between `to` and `from` seen from `to`'s pose.
fn reprojection_m(from: &RgbdFrame, to: &RgbdFrame) -> f64 {
    let to_from = to.pose.inverse().then(&from.pose);
    let mut errors = Vec::new();
    for (i, &z) in from
        .depth
        .z_m
        .iter()
        .enumerate()
        .step_by(31)
        .filter(|(_, z)| is_valid_depth(**z))
    {
        let (x, y) = (i as u32 % from.depth.width, i as u32 / from.depth.width);
        let p = to_from.transform_point(from.intrinsics.unproject(x.into(), y.into(), z.into()));
        let (u, v) = to.intrinsics.project(p);
        let (u, v) = (u.round(), v.round());
        if u >= 0.0 && v >= 0.0 && u < to.intrinsics.width.into() && v < to.intrinsics.height.into()
        {
            let seen = to.depth.z_m[v as usize * to.depth.width as usize + u as usize];
            if is_valid_depth(seen) {
                errors.push((f64::from(seen) - p.z).abs());
            }
        }
    }
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

#[test]
fn seven_scenes_is_registered_better_than_it_came_and_its_poses_fit() {
    let Some(path) = data("7scenes-redkitchen") else {
        return;
    };
    let recording = open(&path).unwrap();
    assert_eq!(
        (recording.layout(), recording.len()),
        (Layout::SevenScenes, 60)
    );
    assert!(
        recording
            .notes()
            .iter()
            .any(|n| n.contains("not registered"))
    );
    let frames = [0, 1, 30].map(|i| recording.frame(i).unwrap());
    // 1.4 mm and 6.9 mm before registration; an inverted pose gives 110 mm.
    let (near, far) = (
        reprojection_m(&frames[0], &frames[1]),
        reprojection_m(&frames[0], &frames[2]),
    );
    assert!(near < 0.003 && far < 0.012, "{near} {far}");
    let odd = recording.read(33).unwrap();
    assert_eq!(
        odd.units.units.iter().filter(|&&u| u == u16::MAX).count(),
        46
    );
    assert!(odd.sensor_depth.z_m.iter().all(|z| z.is_nan() || *z < 10.0));

    // The measurement behind the Kinect's default.
    let (mut after, mut before) = (align::Aligner::new(640), align::Aligner::new(640));
    for index in [0, 20, 40, 59] {
        let raw = recording.read(index).unwrap();
        before.add(&raw.color, &raw.sensor_depth);
        let frame = recording.frame(index).unwrap();
        after.add(&frame.color, &frame.depth);
    }
    let (after, before) = (after.peak().unwrap(), before.peak().unwrap());
    let length = |(x, y): (i32, i32)| f64::from(x).hypot(f64::from(y));
    assert!(length(after.shift_px) <= 2.0, "{after:?}");
    assert!(length(before.shift_px) >= 10.0, "{before:?}");
    assert!(
        after.contrast_here > 1.3 * before.contrast_here,
        "{after:?} {before:?}"
    );
}

#[test]
fn tum_pairs_by_time_and_skips_what_is_missing() {
    let Some(path) = data("rgbd_dataset_freiburg1_desk-snippet") else {
        return;
    };
    let recording = open(&path).unwrap();
    assert_eq!((recording.layout(), recording.len()), (Layout::Tum, 9));
    let notes = recording.notes().join(" ");
    assert!(
        notes.contains("604 of 613") && notes.contains("586 of 595") && notes.contains("freiburg1"),
        "{notes}"
    );
    assert_eq!(recording.intrinsics().fx, 517.3);
    assert_eq!(recording.times_ns()[0], 1_305_031_453_359_684_000);
    let frames = [0, 1, 8].map(|i| recording.frame(i).unwrap());
    // Measured elsewhere: 5 mm at one frame, 10 to 12 at eight.
    let (near, far) = (
        reprojection_m(&frames[0], &frames[1]),
        reprojection_m(&frames[0], &frames[2]),
    );
    assert!(near < 0.008 && far < 0.016, "{near} {far}");
    let strict = OpenOptions {
        max_time_gap_ns: 1_000_000,
        ..OpenOptions::default()
    };
    let refused = Recording::open(&path, &strict).unwrap_err().to_string();
    assert!(
        refused.contains("without a usable frame") && refused.contains("9 of 9"),
        "{refused}"
    );
}

#[test]
fn scanner_app_turns_axes_masks_confidence_and_keeps_frames_with_colour() {
    let Some(path) = data("iphone-lidar-3dscannerapp") else {
        return;
    };
    let recording = open(&path).unwrap();
    assert_eq!(
        (recording.layout(), recording.len()),
        (Layout::ScannerApp, 6)
    );
    assert!(
        recording
            .notes()
            .iter()
            .any(|n| n.contains("10 of 16 frames have no colour"))
    );
    let [first, last] = [0, 5].map(|i| recording.frame(i).unwrap());
    assert_eq!(
        (first.color.width, first.depth.width, first.depth.height),
        (1920, 1920, 1440)
    );
    assert!(first.depth.invalid_share() > 0.001);
    // 1.8 mm with the axes turned, 50 mm without.
    let miss = reprojection_m(&first, &last);
    assert!(miss < 0.006, "{miss}");
    assert_ne!(first.intrinsics, last.intrinsics);
    let keep = OpenOptions {
        keep_low_confidence: true,
        ..OpenOptions::default()
    };
    let all = Recording::open(&path, &keep).unwrap().frame(0).unwrap();
    assert_eq!(all.depth.invalid_share(), 0.0);
}

#[test]
fn folders_without_poses_are_refused_unless_static() {
    let Some(path) = data("realsense-static") else {
        return;
    };
    let refused = error(&path);
    assert!(
        refused.contains("no camera poses: looked for trajectory.log"),
        "{refused}"
    );
    let options = OpenOptions {
        assume_static: true,
        ..OpenOptions::default()
    };
    let recording = Recording::open(&path, &options).unwrap();
    assert_eq!((recording.layout(), recording.len()), (Layout::NoPoses, 12));
    assert_eq!(recording.frame(11).unwrap().pose, Pose::IDENTITY);
    assert!(matches!(
        recording.inspect().unwrap().alignment,
        Alignment::Off { .. }
    ));
}

/// A made scene: a slanted wall with a stripe, so that depth and colour say where they are.
fn picture(index: u32) -> (ColorImage, codec::DepthUnits) {
    let (width, height) = (64, 48);
    let n = width * height;
    let rgba = (0..n).map(|i| {
        [
            (i % width * 4) as u8,
            (i / width * 5) as u8,
            index as u8,
            255,
        ]
    });
    let units = (0..n)
        .map(|i| 5000 + (i % width * 20 + index) as u16)
        .collect();
    (
        ColorImage {
            width,
            height,
            rgba: rgba.collect(),
        },
        codec::DepthUnits {
            width,
            height,
            units,
        },
    )
}

fn pose(index: u32) -> Pose {
    let t = f64::from(index);
    Pose {
        rotation: DQuat::from_rotation_y(0.01 * t),
        translation: DVec3::new(0.1 * t, -0.02, 1.5),
    }
}

/// A TUM recording of three frames.
fn write_tum(root: &Path, format: ColorFormat) {
    let mut writer = TumWriter::create(root, format).unwrap();
    for i in 0..3 {
        let (color, depth) = picture(i);
        writer
            .push(
                &color,
                &depth,
                i64::from(i) * 33_333_000 + 5_000_000_000,
                &pose(i),
            )
            .unwrap();
    }
    writer.finish().unwrap();
    let manifest = r#"{"intrinsics":{"fx":60.0,"fy":61.0,"cx":31.5,"cy":23.5,"width":64,"height":48},"depth_units_per_metre":5000,"seed":7}"#;
    fs::write(root.join("manifest.json"), manifest).unwrap();
}

#[test]
fn what_the_tum_writer_writes_comes_back() {
    for format in [ColorFormat::Png, ColorFormat::Jpeg(92)] {
        let dir = tempfile::tempdir().unwrap();
        write_tum(dir.path(), format);
        let recording = open(dir.path()).unwrap();
        assert_eq!(recording.len(), 3);
        assert_eq!(recording.intrinsics().fy, 61.0);
        assert!(recording.notes().is_empty(), "{:?}", recording.notes());
        for i in 0..3u32 {
            let frame = recording.frame(i as usize).unwrap();
            let (color, depth) = picture(i);
            if format == ColorFormat::Png {
                assert_eq!(frame.color, color);
            }
            let expected = DepthImage::from_units(64, 48, &depth.units, 5000.0, 10.0);
            assert_eq!(frame.depth.z_m, expected.z_m);
            assert_eq!(frame.time_ns, i64::from(i) * 33_333_000 + 5_000_000_000);
            assert!(frame.pose.translation.distance(pose(i).translation) < 1e-6);
            assert!(frame.pose.rotation.angle_between(pose(i).rotation) < 1e-7);
        }
        let mut again = TumWriter::create(dir.path(), format)
            .unwrap_err()
            .to_string();
        again.retain(|c| c != '\n');
        assert!(again.contains("rgb.txt") && again.contains("one that holds a recording"));
        assert!(
            recording
                .frame(3)
                .unwrap_err()
                .to_string()
                .contains("expected 0..3")
        );
    }
}

#[test]
fn assembled_layouts_open_as_the_folder_they_came_from() {
    let Some(source) = data("7scenes-redkitchen") else {
        return;
    };
    let original = open(&source).unwrap();
    let dir = tempfile::tempdir().unwrap();
    // Sequences with the intrinsics one level up, a gap, and another first number.
    let sequences = dir.path().join("kitchen");
    for (sequence, numbers) in [("seq-02", 5..6), ("seq-01", 10..14)] {
        fs::create_dir_all(sequences.join(sequence)).unwrap();
        for number in numbers.filter(|n| *n != 12) {
            for end in ["color.jpg", "depth.png", "pose.txt"] {
                let name = format!("frame-{number:06}.{end}");
                fs::copy(source.join(&name), sequences.join(sequence).join(&name)).unwrap();
            }
        }
    }
    fs::copy(
        source.join("camera-intrinsics.txt"),
        sequences.join("camera-intrinsics.txt"),
    )
    .unwrap();
    let all = open(&sequences).unwrap();
    assert_eq!(all.times_ns(), [0, 33_333_333, 99_999_999]);
    assert!(
        all.notes()[0].contains("seq-01, seq-02"),
        "{:?}",
        all.notes()
    );
    assert_eq!(all.poses()[2], original.poses()[13]);
    assert_eq!(all.inspect().unwrap().gaps, 1);
    let second = open(&sequences.join("seq-02")).unwrap();
    assert_eq!(
        (second.len(), second.intrinsics()),
        (1, original.intrinsics())
    );
    assert_eq!(
        second.frame(0).unwrap().color,
        original.frame(5).unwrap().color
    );

    // Open3D: the same files under other names, with a log and a camera JSON.
    let root = dir.path().join("open3d");
    fs::create_dir_all(root.join("image")).unwrap();
    fs::create_dir_all(root.join("depth")).unwrap();
    let mut log = String::new();
    for i in 0..3 {
        fs::copy(
            source.join(format!("frame-{i:06}.color.jpg")),
            root.join(format!("image/{i:06}.jpg")),
        )
        .unwrap();
        fs::copy(
            source.join(format!("frame-{i:06}.depth.png")),
            root.join(format!("depth/{i:06}.png")),
        )
        .unwrap();
        let pose = fs::read_to_string(source.join(format!("frame-{i:06}.pose.txt"))).unwrap();
        log += &format!("{i} {i} {}\n{}\n", i + 1, pose.trim());
    }
    fs::write(root.join("camera_poses.log"), &log).unwrap();
    let recording = open(&root).unwrap();
    assert_eq!((recording.layout(), recording.len()), (Layout::Open3d, 3));
    assert!(
        recording.notes()[0].contains("PrimeSense"),
        "{:?}",
        recording.notes()
    );
    fs::write(
        root.join("camera.json"),
        r#"{"width":640,"height":480,"intrinsic_matrix":[585,0,0,0,586,0,320,240,1]}"#,
    )
    .unwrap();
    let recording = open(&root).unwrap();
    let k = recording.intrinsics();
    assert_eq!((k.fx, k.fy, k.cx, k.cy), (585.0, 586.0, 320.0, 240.0));
    // Unregistered as these files are, the depth camera's poses fit the depth: 1.4 mm.
    let [a, b] = [0, 1].map(|i| recording.frame(i).unwrap());
    assert!(reprojection_m(&a, &b) < 0.003);
    let given = OpenOptions {
        intrinsics: Some([1.0, 2.0, 3.0, 4.0]),
        depth_units_per_metre: Some(2000.0),
        ..OpenOptions::default()
    };
    let recording = Recording::open(&root, &given).unwrap();
    assert_eq!(recording.intrinsics().fy, 2.0);
    let (z, half) = (
        a.depth.z_m[240 * 640 + 320],
        recording.frame(0).unwrap().depth.z_m[240 * 640 + 320],
    );
    assert!(z.is_nan() || (z * 0.5 - half).abs() < 1e-6);
}

/// Each damage to a good recording, and what its one error must say.
#[test]
fn every_damage_is_one_clear_error() {
    let gray8 = png::encode_gray8(64, 48, &[9; 64 * 48], png::Effort::Fast).unwrap();
    let thin = png::encode_gray16(64, 20, &[5000; 64 * 20], png::Effort::Fast).unwrap();
    let tiny = png::encode_rgb8(1, 1, &[1, 2, 3], png::Effort::Fast).unwrap();
    let wide = png::encode_rgb8(96, 48, &[7; 96 * 48 * 3], png::Effort::Fast).unwrap();
    let manifest = |k: &str| format!(r#"{{"intrinsics":{{{k}}}}}"#).into_bytes();
    let cases: Vec<(&str, Vec<u8>, &[&str])> = vec![
        (
            "rgb/5.000000.png",
            b"garbage".to_vec(),
            &["5.000000.png", "JPEG or PNG", "neither"],
        ),
        (
            "rgb/5.000000.png",
            b"\x89PNG\r\n\x1a\ngarbage".to_vec(),
            &["5.000000.png", "Png error"],
        ),
        (
            "rgb/5.000000.png",
            b"\xFF\xD8\xFF\xE0\x00\x04ab".to_vec(),
            &["5.000000.png", "complete JPEG"],
        ),
        ("rgb/5.000000.png", tiny, &["image size", "64x48", "1x1"]),
        ("rgb/5.000000.png", wide, &["image size", "64x48", "96x48"]),
        (
            "depth/5.000000.png",
            gray8,
            &["depth/5.000000.png", "16-bit", "1 channel(s) of 8 bits"],
        ),
        (
            "depth/5.000000.png",
            thin,
            &["depth/5.000000.png", "depth size", "64x48", "64x20"],
        ),
        (
            "depth/5.000000.png",
            Vec::new(),
            &["depth/5.000000.png", "empty file"],
        ),
        (
            "groundtruth.txt",
            b"5.0 0 0 0 0 0 0 nan".to_vec(),
            &["groundtruth.txt line 1", "quaternion", "NaN"],
        ),
        (
            "groundtruth.txt",
            b"# x\n5.0 inf 0 0 0 0 0 1".to_vec(),
            &["groundtruth.txt line 2", "translation", "inf"],
        ),
        (
            "groundtruth.txt",
            b"5.0 0 0 0 0 0 0 2".to_vec(),
            &["groundtruth.txt line 1", "expected a rotation"],
        ),
        (
            "groundtruth.txt",
            b"5.0 0 0 0 0 0 1".to_vec(),
            &["line 1: pose", "8 numbers", "7 words"],
        ),
        (
            "groundtruth.txt",
            b"5.0 0 x 0 0 0 0 1".to_vec(),
            &["pose, number 3", "\"x\""],
        ),
        (
            "groundtruth.txt",
            b"\xFF\xFE".to_vec(),
            &["groundtruth.txt: encoding", "offset 0"],
        ),
        (
            "groundtruth.txt",
            b"".to_vec(),
            &[
                "TUM RGB-D recording without a usable frame",
                "3 frames have no poses",
            ],
        ),
        (
            "rgb.txt",
            b"# nothing".to_vec(),
            &["without a usable frame"],
        ),
        (
            "rgb.txt",
            b"5.0 ../../etc/passwd".to_vec(),
            &["rgb.txt line 1", "inside the recording", "etc/passwd"],
        ),
        (
            "rgb.txt",
            b"5.0 /etc/passwd".to_vec(),
            &["rgb.txt line 1", "inside the recording"],
        ),
        (
            "rgb.txt",
            b"x rgb/5.000000.png".to_vec(),
            &["rgb.txt line 1: time stamp", "\"x\""],
        ),
        ("rgb.txt", b"5.0".to_vec(), &["rgb.txt line 1: file name"]),
        (
            "rgb.txt",
            vec![b'7'; 100_000],
            &["rgb.txt line 1", "length of the line", "100000"],
        ),
        (
            "manifest.json",
            manifest(r#""fx":0,"fy":1,"cx":0,"cy":0"#),
            &["manifest.json", "fx", "> 0", "got 0"],
        ),
        (
            "manifest.json",
            manifest(r#""fx":1,"fy":-3,"cx":0,"cy":0"#),
            &["manifest.json", "fy", "got -3"],
        ),
        (
            "manifest.json",
            manifest(r#""fx":1,"fy":1,"cx":0"#),
            &["manifest.json", "missing field `cy`"],
        ),
        ("manifest.json", b"{".to_vec(), &["manifest.json line 1"]),
        (
            "manifest.json",
            br#"{"fx":9,"fy":9,"cx":9,"cy":9,"depth_scale":0}"#.to_vec(),
            &["depth units per metre", "got 0"],
        ),
    ];
    for (file, bytes, words) in cases {
        let dir = tempfile::tempdir().unwrap();
        write_tum(dir.path(), ColorFormat::Png);
        fs::write(dir.path().join(file), &bytes).unwrap();
        let message = error(dir.path());
        assert!(
            words.iter().all(|w| message.contains(w)),
            "{file}: {message}, expected {words:?}"
        );
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

#[test]
fn a_frame_of_another_size_all_invalid_depth_and_tiny_pictures() {
    let dir = tempfile::tempdir().unwrap();
    write_tum(dir.path(), ColorFormat::Png);
    let small = png::encode_rgb8(32, 24, &[7; 32 * 24 * 3], png::Effort::Fast).unwrap();
    fs::write(dir.path().join("rgb/5.033333.png"), small).unwrap();
    let recording = open(dir.path()).unwrap();
    let message = recording.frame(1).unwrap_err().to_string();
    assert!(
        message
            .contains("5.033333.png: image size: expected 64x48 as in the first frame, got 32x24"),
        "{message}"
    );
    assert!(recording.frame(2).is_ok());

    let dir = tempfile::tempdir().unwrap();
    write_tum(dir.path(), ColorFormat::Png);
    let blind = png::encode_gray16(64, 48, &[0; 64 * 48], png::Effort::Fast).unwrap();
    fs::write(dir.path().join("depth/5.000000.png"), blind).unwrap();
    let recording = open(dir.path()).unwrap();
    assert!(
        recording.notes()[0].contains("no valid depth at all"),
        "{:?}",
        recording.notes()
    );
    let inspection = recording.inspect().unwrap();
    assert!(
        inspection
            .oddities
            .iter()
            .any(|o| o.contains("No valid depth at all in sampled frames 0"))
    );
    assert!(inspection.to_string().contains("alignment"));
    assert!(
        serde_json::to_string(&inspection)
            .unwrap()
            .contains("\"verdict\":\"unclear\"")
    );

    for (width, height) in [(1, 1), (3, 5), (17, 1)] {
        let dir = tempfile::tempdir().unwrap();
        let n = (width * height) as usize;
        let mut writer = TumWriter::create(dir.path(), ColorFormat::Png).unwrap();
        let depth = codec::DepthUnits {
            width,
            height,
            units: vec![6000; n],
        };
        writer
            .push(
                &ColorImage::filled(width, height, [1, 2, 3, 255]),
                &depth,
                0,
                &Pose::IDENTITY,
            )
            .unwrap();
        writer.finish().unwrap();
        let given = OpenOptions {
            intrinsics: Some([9.0, 9.0, 1.0, 1.0]),
            ..OpenOptions::default()
        };
        let recording = Recording::open(dir.path(), &given).unwrap();
        assert_eq!(recording.frame(0).unwrap().depth.z_m, vec![1.2; n]);
        recording.inspect().unwrap();
    }
}

#[test]
fn what_is_no_recording_is_said_so() {
    let dir = tempfile::tempdir().unwrap();
    let message = error(dir.path());
    assert!(
        message.contains("expected a recording, found none of: rgb.txt")
            && message.contains("7-Scenes"),
        "{message}"
    );
    assert!(error(&dir.path().join("nowhere")).contains("nowhere"));
    let file = dir.path().join("film.mp4");
    fs::write(&file, b"x").unwrap();
    assert!(error(&file).contains("expected a folder, got a file"));
    let bad = [
        OpenOptions {
            intrinsics: Some([0.0, 1.0, 1.0, 1.0]),
            ..OpenOptions::default()
        },
        OpenOptions {
            depth_units_per_metre: Some(f64::NAN),
            ..OpenOptions::default()
        },
        OpenOptions {
            max_depth_m: -1.0,
            ..OpenOptions::default()
        },
        OpenOptions {
            max_time_gap_ns: -1,
            ..OpenOptions::default()
        },
    ];
    for options in bad {
        assert!(Recording::open(dir.path(), &options).is_err());
    }
}

#[test]
fn bad_pose_files_name_file_and_row() {
    let parse = |text: &str| {
        let file =
            text::TextFile::from_bytes(Path::new("f.pose.txt"), text.as_bytes().to_vec()).unwrap();
        seven_scenes::parse_pose(&file)
            .map(|m| m.pose)
            .map_err(|e| e.to_string())
    };
    assert_eq!(
        parse("1 0 0 1\n0 1 0 2\n0 0 1 3\n0 0 0 1")
            .unwrap()
            .translation,
        DVec3::new(1.0, 2.0, 3.0)
    );
    for (text, words) in [
        (
            "2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1",
            "f.pose.txt: pose rotation: expected a rotation",
        ),
        (
            "nan 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1",
            "rotation: expected a finite number, got NaN",
        ),
        (
            "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 1 1",
            "pose, row 4: expected 0 0 0 1",
        ),
        (
            "1 0 0 0\n0 1 0\n0 0 1 0\n0 0 0 1",
            "line 2: pose row 2: expected 4 numbers, got 3 words",
        ),
        ("1 0 0 0", "expected 4 lines of 4 numbers, got 1 lines"),
    ] {
        let message = parse(text).unwrap_err();
        assert!(message.contains(words), "{message}");
    }
}

#[test]
fn association_is_nearest_one_to_one_and_bounded() {
    let stamps = |times: &[i64]| -> Vec<tum::Stamped> {
        times
            .iter()
            .map(|&time_ns| tum::Stamped {
                time_ns,
                file: PathBuf::new(),
            })
            .collect()
    };
    let pairs = tum::associate(&stamps(&[0, 30, 60, 90]), &stamps(&[8, 55, 62, 200]), 20);
    assert_eq!(pairs, [(0, 0), (2, 2)]);
    // Both want the depth at 10; the nearer gets it.
    assert_eq!(
        tum::associate(&stamps(&[4, 9]), &stamps(&[10]), 20),
        [(1, 0)]
    );
    assert!(tum::associate(&stamps(&[]), &stamps(&[1]), 20).is_empty());
    let extreme = tum::associate(
        &stamps(&[i64::MIN, i64::MAX]),
        &stamps(&[i64::MIN, i64::MAX]),
        i64::MAX,
    );
    assert_eq!(extreme, [(0, 0), (1, 1)]);
}

#[test]
fn poses_are_interpolated_between_near_neighbours_only() {
    let at = |x: f64| Pose {
        translation: DVec3::new(x, 0.0, 0.0),
        ..Pose::IDENTITY
    };
    let poses = [(0, at(0.0)), (40_000_000, at(4.0)), (900_000_000, at(90.0))];
    let x = |t| tum::pose_at(&poses, t, 20_000_000).map(|p| p.translation.x);
    assert!((x(10_000_000).unwrap() - 1.0).abs() < 1e-12);
    assert_eq!(x(40_000_500), Some(4.0));
    assert_eq!(
        (x(500_000_000), x(-5_000_000), x(900_100_000)),
        (None, None, None)
    );
}

#[test]
fn time_stamps_are_exact() {
    let ns = text::parse_time_ns;
    assert_eq!(ns("1305031453.359684"), Some(1_305_031_453_359_684_000));
    assert_eq!(ns("-0.5"), Some(-500_000_000));
    assert_eq!(ns("7"), Some(7_000_000_000));
    assert_eq!(ns(".25"), Some(250_000_000));
    assert_eq!(ns("1.5e1"), Some(15_000_000_000));
    for bad in [
        "",
        ".",
        "-",
        "x",
        "nan",
        "inf",
        "1e300",
        "99999999999999999999",
    ] {
        assert_eq!(ns(bad), None, "{bad}");
    }
}

/// Text that looks like the real thing, then arbitrary bytes.
fn hostile() -> impl Strategy<Value = Vec<u8>> {
    let word = prop_oneof![
        "[0-9.eE+-]{1,9}",
        Just("nan".to_owned()),
        Just("1".to_owned()),
        Just("0".to_owned()),
        "[{}\\[\\]\":,a-z]{1,6}"
    ];
    let line = prop::collection::vec(word, 0..10).prop_map(|words| words.join(" "));
    prop_oneof![
        prop::collection::vec(any::<u8>(), 0..300),
        prop::collection::vec(line, 0..12).prop_map(|lines| lines.join("\n").into_bytes()),
    ]
}

proptest! {
    #[test]
    fn arbitrary_text_never_panics(bytes in hostile()) {
        if let Ok(file) = text::TextFile::from_bytes(Path::new("f"), bytes) {
            let _ = tum::parse_list(&file);
            let _ = tum::parse_poses(&file).map(|poses| tum::pose_at(&poses, 0, i64::MAX));
            let _ = seven_scenes::parse_pose(&file);
            let _ = open3d::parse_log(&file);
            let _ = scanner_app::parse_frame(&file);
            let _ = rig::parse_camera_file(&file);
            let _ = text::parse_time_ns(file.text());
        }
    }

    #[test]
    fn a_damaged_recording_never_panics(which in 0..7usize, bytes in hostile()) {
        let dir = tempfile::tempdir().unwrap();
        write_tum(dir.path(), ColorFormat::Jpeg(80));
        let files = ["rgb.txt", "depth.txt", "groundtruth.txt", "manifest.json", "rgb/5.000000.jpg", "depth/5.000000.png", "depth/5.033333.png"];
        fs::write(dir.path().join(files[which]), bytes).unwrap();
        if let Ok(recording) = open(dir.path()) {
            for i in 0..recording.len() {
                let _ = recording.frame(i);
            }
            let _ = recording.inspect().map(|i| i.to_string());
        }
    }
}
