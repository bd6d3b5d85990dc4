//! Broken and hostile recordings: one clear error each, never a panic.

use super::*;
use crate::codec::png;
use proptest::prelude::*;

/// Each case damages a good recording of three frames, and contains the expected message: in a note if frames remain
/// (all except the first), or in a single error if none remains.
#[test]
fn every_damage_is_one_clear_note_or_error() {
    let gray8 = png::encode_gray8(64, 48, &[9; 64 * 48], png::Effort::Fast).unwrap();
    let thin = png::encode_gray16(64, 20, &[5000; 64 * 20], png::Effort::Fast).unwrap();
    let tiny = png::encode_rgb8(1, 1, &[1, 2, 3], png::Effort::Fast).unwrap();
    let wide = png::encode_rgb8(96, 48, &[7; 96 * 48 * 3], png::Effort::Fast).unwrap();
    let manifest = |k: &str| format!(r#"{{"intrinsics":{{{k}}}}}"#).into_bytes();
    let cases: Vec<(&str, Vec<u8>, &[&str])> = vec![
        (
            "rgb/5.000000.png",
            b"garbage".to_vec(),
            &["5.000000.png", "JPEG, PNG", "none of these"],
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
            &["without a usable frame", "3 frames have no poses"],
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
            &["manifest.json", "fx", "0.001 to 1e9", "got 0"],
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
        let of_first = file.starts_with("rgb/") || file.starts_with("depth/");
        let message = match open(dir.path()) {
            Err(error) if !of_first => error.to_string(),
            Ok(recording) if of_first => {
                assert_eq!(recording.len(), 2, "{file}");
                assert_eq!(recording.times_ns()[0], 5_033_333_000);
                assert!(recording.frame(0).is_ok() && recording.frame(1).is_ok());
                assert_eq!(recording.notes().len(), 1, "{:?}", recording.notes());
                recording.notes()[0].clone()
            }
            other => panic!("{file}: {other:?}"),
        };
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
    assert_eq!(recording.times_ns(), [5_000_000_000, 5_066_666_000]);
    let note = &recording.notes()[0];
    assert!(
        note.contains("1 of 3 frames have colour of another size and are left out: 5.033333.png")
            && note.contains("image size: expected 64x48 as most have, got 32x24"),
        "{note}"
    );
    assert!(recording.frame(1).is_ok());

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
        message.contains("expected a recording, found none of: ")
            && message.contains("; rgb.txt")
            && message.contains("7-Scenes"),
        "{message}"
    );
    assert!(error(&dir.path().join("nowhere")).contains("nowhere"));
    let file = dir.path().join("film.mp4");
    fs::write(&file, b"x").unwrap();
    assert!(error(&file).contains("expected a folder, or a zip archive of one, got a file"));
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
        let file = text::TextFile::from_bytes(Path::new("f.pose.txt"), text.as_bytes().to_vec());
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
    let stamps = |times: &[i64]| -> Vec<tum_lists::Stamped> {
        times
            .iter()
            .map(|&time_ns| tum_lists::Stamped {
                time_ns,
                file: PathBuf::new(),
            })
            .collect()
    };
    let pairs = tum::associate(&stamps(&[0, 30, 60, 90]), &stamps(&[8, 55, 62, 200]), 20);
    assert_eq!(pairs, [(0, 0), (2, 2)]);
    // Two colour frames are closest to the depth frame at 10; the nearer one gets it.
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
    let ns = |word| times::TimeUnit::SECONDS.parse_ns(word);
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

/// Text that looks valid, followed by arbitrary bytes.
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
        let file = text::TextFile::from_bytes(Path::new("f"), bytes);
        let _ = tum_lists::parse_list(&file);
        let _ = tum_lists::parse_associations(&file);
        let _ = tum_lists::has_poses(&file);
        let _ = tum::pose_at(&tum_lists::parse_poses(&file).items, 0, i64::MAX);
        let _ = seven_scenes::parse_pose(&file);
        let _ = open3d::parse_log(&file);
        let _ = scanner_app::parse_frame(&file);
        let _ = camera_file::parse_camera_file(&file);
        let _ = times::TimeUnit::SECONDS.parse_ns(file.text());
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
