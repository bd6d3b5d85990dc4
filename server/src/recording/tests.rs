//! Tests of whole recordings, real and generated; broken ones are in [`hostile`].

mod archives;
mod cameras;
mod damaged;
mod given;
mod hostile;
mod layouts;
mod lists;
mod made;
mod matching;
mod phones;

use super::*;
use crate::codec;
use crate::frame::is_valid_depth;
use glam::{DQuat, DVec3};
use std::fs;

/// The folder of real recordings; without it a test prints that it is skipped, unless data is required.
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
    assert_eq!((recording.layout(), recording.len()), ("7-Scenes", 60));
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
    assert_eq!(odd.units.n_saturated(), 46);
    assert!(odd.sensor_depth.z_m.iter().all(|z| z.is_nan() || *z < 10.0));

    // The measurement from which the Kinect's default was derived.
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
    assert_eq!((recording.layout(), recording.len()), ("TUM RGB-D", 9));
    let notes = recording.notes().join(" ");
    assert!(
        notes.contains("604 of 613") && notes.contains("586 of 595") && notes.contains("freiburg1"),
        "{notes}"
    );
    assert_eq!(recording.intrinsics().fx, 517.3);
    assert_eq!(recording.times_ns()[0], 1_305_031_453_359_684_000);
    let frames = [0, 1, 8].map(|i| recording.frame(i).unwrap());
    // Measured independently: 5 mm at one frame, 10 to 12 mm at eight.
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
    assert_eq!((recording.layout(), recording.len()), ("3D Scanner App", 6));
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
    assert_eq!(
        (recording.layout(), recording.len()),
        ("RGB-D without poses", 12)
    );
    assert_eq!(recording.frame(11).unwrap().pose, Pose::IDENTITY);
    assert!(matches!(
        recording.inspect().unwrap().alignment,
        Alignment::Off { .. }
    ));
}

/// A synthetic scene: a slanted wall with a stripe, so that positions in depth and colour can be checked.
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
    assert_eq!((recording.layout(), recording.len()), ("Open3D", 3));
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
    // The files are unregistered, and the depth camera's poses fit the depth: 1.4 mm.
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
