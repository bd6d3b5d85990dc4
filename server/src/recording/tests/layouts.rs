//! A small recording in each layout is read with the right pictures, depth, poses and intrinsics.

use super::archives::same_when_zipped;
use super::*;
use crate::codec::{jpeg, png};
use proptest::prelude::*;

pub(super) const FOCAL: [f64; 4] = [60.0, 61.0, 31.5, 23.5];

pub(super) fn write(root: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = root.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

/// Writes the picture of [`picture`], whose blue channel identifies it.
pub(super) fn write_frame(root: &Path, index: u32, color: &str, depth: &str) {
    let (image, units) = picture(index);
    if color.ends_with("png") {
        let bytes = png::encode_rgba(64, 48, image.bytes(), png::Effort::Fast).unwrap();
        write(root, color, bytes);
    } else {
        write(root, color, jpeg::encode(&image, 100).unwrap());
    }
    let bytes = png::encode_gray16(64, 48, &units.units, png::Effort::Fast).unwrap();
    write(root, depth, bytes);
}

/// Rows of a pose's matrix, multiplied on the right by a diagonal matrix of signs.
pub(super) fn rows(pose: &Pose, signs: [f64; 3]) -> [[f64; 4]; 3] {
    let m = pose.to_affine();
    [0, 1, 2].map(|r| {
        let row = m.matrix3.row(r);
        [
            row.x * signs[0],
            row.y * signs[1],
            row.z * signs[2],
            m.translation[r],
        ]
    })
}

fn text(rows: &[[f64; 4]; 3], end: &str) -> String {
    let rows = rows.iter().chain([&[0.0, 0.0, 0.0, 1.0]]);
    rows.map(|[a, b, c, d]| format!("{a} {b} {c} {d}{end}"))
        .collect()
}

pub(super) fn cv(index: u32, end: &str) -> String {
    text(&rows(&pose(index), [1.0; 3]), end)
}

pub(super) const LOST: &str =
    "-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n-inf -inf -inf -inf\n";

/// Checks that the frames are those with these indices, with the right pictures, depth and poses.
pub(super) fn check(recording: &Recording, indices: &[u32], units_per_metre: f64) {
    let notes = recording.notes();
    assert_eq!(recording.len(), indices.len(), "{notes:?}");
    let k = recording.intrinsics();
    assert_eq!([k.fx, k.fy, k.cx, k.cy], FOCAL);
    for (i, &index) in indices.iter().enumerate() {
        let frame = recording.frame(i).unwrap();
        let blue = i32::from(frame.color.rgba[0][2]);
        assert!(
            (blue - index as i32).abs() <= 2,
            "picture {blue} for {index}"
        );
        // A point in the lower right part is where the true pose puts it.
        let at = 40 * 64 + 50;
        let z = f64::from(frame.depth.z_m[at]);
        let expected = f64::from(picture(index).1.units[at]) / units_per_metre;
        assert!((z - expected).abs() < 1e-5, "{z} {expected}");
        let point = k.unproject(50.0, 40.0, z);
        let error = frame.pose.transform_point(point) - pose(index).transform_point(point);
        assert!(error.length() < 1e-5, "{index}: {error}");
    }
    recording.inspect().unwrap();
}

fn intrinsics(rows: usize) -> String {
    let [fx, fy, cx, cy] = FOCAL;
    let all = [
        format!("{fx} 0 {cx} 0\n"),
        format!("0 {fy} {cy} 0\n"),
        "0 0 1 0\n".to_owned(),
        "0 0 0 1\n".to_owned(),
    ];
    all[..rows].concat()
}

pub(super) fn camera_json() -> String {
    let [fx, fy, cx, cy] = FOCAL;
    format!(r#"{{"intrinsics":{{"fx":{fx},"fy":{fy},"cx":{cx},"cy":{cy}}}}}"#)
}

#[test]
fn scannet_skips_lost_frames_and_warps_depth() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    // Not in the order of the names as text.
    for i in [0u32, 2, 9, 10, 11] {
        write_frame(
            root,
            i,
            &format!("color/{i}.jpg"),
            &format!("depth/{i}.png"),
        );
        let pose = if i == 9 { LOST.to_owned() } else { cv(i, "\n") };
        write(root, &format!("pose/{i}.txt"), pose);
    }
    write(root, "color/._0.jpg", b"no picture");
    for name in ["color", "depth"] {
        write(
            root,
            &format!("intrinsic/intrinsic_{name}.txt"),
            intrinsics(3).replace(" 0\n", "\n"),
        );
    }
    let recording = open(root).unwrap();
    assert_eq!(recording.layout(), "ScanNet export");
    check(&recording, &[0, 2, 10, 11], 1000.0);
    same_when_zipped(&recording);
    assert_eq!(recording.times_ns()[1], 2 * NOMINAL_PERIOD_NS);
    assert!(
        recording
            .notes()
            .iter()
            .any(|n| n.starts_with("1 of 5 frames have no usable pose"))
    );
    // Depth with different intrinsics: the centre of the depth image is at the same position in colour.
    write(
        root,
        "intrinsic/intrinsic_depth.txt",
        "30 0 31.5\n0 30 23.5\n0 0 1\n",
    );
    let recording = open(root).unwrap();
    let frame = recording.frame(0).unwrap();
    // Colour pixel u shows the same point as depth pixel (u - cx) / fx * 30 + cx.
    let z = frame.depth.z_m[23 * 64 + 41];
    let expected = (5000.0 + 20.0 * (31.5 + (41.0 - 31.5) / 60.0 * 30.0)) / 1000.0;
    assert!((f64::from(z) - expected).abs() < 0.02, "{z} {expected}");
    // All poses lost.
    for i in [0, 2, 10, 11] {
        write(root, &format!("pose/{i}.txt"), LOST);
    }
    assert!(error(root).contains("pose/N.txt"), "{}", error(root));
    let at_rest = OpenOptions {
        assume_static: true,
        ..OpenOptions::default()
    };
    assert_eq!(Recording::open(root, &at_rest).unwrap().len(), 5);
}

#[test]
fn scannet_pictures_made_smaller_keep_the_field_of_view() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    for i in 0..2 {
        write_frame(
            root,
            i,
            &format!("color/{i}.png"),
            &format!("depth/{i}.png"),
        );
        write(root, &format!("pose/{i}.txt"), cv(i, "\n"));
    }
    write(
        root,
        "intrinsic/intrinsic_color.txt",
        "1170 0 647.8 0\n0 1172 483.8 0\n0 0 1 0\n0 0 0 1\n",
    );
    write(root, "intrinsic/intrinsic_depth.txt", intrinsics(4));
    let recording = open(root).unwrap();
    let k = recording.intrinsics();
    assert!((k.fx - 1170.0 * 64.0 / 1296.0).abs() < 1e-9, "{k:?}");
    assert!(recording.notes().iter().any(|n| n.contains("1296x968")));
}

#[test]
fn folders_of_poses_and_trajectories_under_usual_names() {
    let dir = tempfile::tempdir().unwrap();
    let one_line = |i: u32| cv(i, " ") + "\n";
    for (number, (color, depth, poses)) in [
        ("rgb/rgb_N.png", "depth/depth_N.png", "traj_w_c.txt"),
        ("images/N.jpg", "depth/N.png", "poses.txt"),
        ("color/frameN.png", "depth/frameN.png", "poses/poseN.txt"),
        ("image/imageN.png", "depth/N.png", "fragments/camera.log"),
    ]
    .into_iter()
    .enumerate()
    {
        let root = dir.path().join(number.to_string());
        let mut all = String::new();
        for i in 0..12 {
            let name = |pattern: &str| pattern.replace('N', &i.to_string());
            write_frame(&root, i, &name(color), &name(depth));
            if poses.contains('N') {
                write(&root, &name(poses), cv(i, "\n"));
            } else if poses.ends_with("log") {
                all += &format!("{i} {i} {}\n{}", i + 1, cv(i, "\n"));
            } else {
                all += &one_line(i);
            }
        }
        if !all.is_empty() {
            write(&root, poses, all);
        }
        write(&root, "camera.json", camera_json());
        let recording = open(&root).unwrap();
        assert_eq!(
            recording.layout(),
            "colour and depth folders with poses",
            "{poses}"
        );
        check(&recording, &(0..12).collect::<Vec<_>>(), 1000.0);
        same_when_zipped(&recording);
    }
}

#[test]
fn replica_with_and_without_its_camera_file() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("room0");
    let mut trajectory = String::new();
    for i in 0..3 {
        write_frame(
            &root,
            i,
            &format!("results/frame{i:06}.jpg"),
            &format!("results/depth{i:06}.png"),
        );
        trajectory += &(cv(i, " ") + "\n");
    }
    write(&root, "traj.txt", &trajectory);
    let recording = open(&root).unwrap();
    assert_eq!((recording.layout(), recording.len()), ("Replica", 3));
    same_when_zipped(&recording);
    // The same horizontal field of view as at 1200 pixels.
    assert_eq!(recording.intrinsics().fx, 32.0);
    write(
        dir.path(),
        "cam_params.json",
        r#"{"camera":{"w":64,"h":48,"fx":60.0,"fy":61.0,"cx":31.5,"cy":23.5,"scale":6553.5}}"#,
    );
    check(&open(&root).unwrap(), &[0, 1, 2], 6553.5);
    fs::remove_file(root.join("traj.txt")).unwrap();
    assert!(error(&root).contains("traj.txt"));
}

/// In this trajectory y points up in both camera and world, which a negative fy indicates.
#[test]
fn icl_nuim_has_its_y_turned_down() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    let mut trajectory = String::new();
    for i in 1..4 {
        write_frame(root, i, &format!("rgb/{i}.png"), &format!("depth/{i}.png"));
        let Pose {
            rotation: q,
            translation: t,
        } = pose(i);
        // Mirrored in y: a rotation about y is reversed, and a shift along y changes its sign.
        trajectory += &format!(
            "{i} {} {} {} {} {} {} {}\n",
            t.x, -t.y, t.z, -q.x, q.y, -q.z, q.w
        );
    }
    write_frame(root, 0, "rgb/0.png", "depth/0.png");
    write(root, "livingRoom2.gt.freiburg", trajectory);
    write(root, "associations.txt", "1 depth/1.png 1 rgb/1.png\n");
    let given = OpenOptions {
        intrinsics: Some(FOCAL),
        ..OpenOptions::default()
    };
    let recording = Recording::open(root, &given).unwrap();
    assert_eq!(recording.layout(), "ICL-NUIM");
    same_when_zipped(&recording);
    // Picture 0 has no pose.
    check(&recording, &[1, 2, 3], 5000.0);
    assert!((open(root).unwrap().intrinsics().fx - 48.12).abs() < 1e-9);
}

/// Depth files of other formats, in a layout that names its files.
#[test]
fn depth_files_of_other_forms_are_read() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    write_tum(root, ColorFormat::Png);
    let metres: Vec<u8> = picture(0)
        .1
        .units
        .iter()
        .flat_map(|&u| (f32::from(u) / 5000.0).to_le_bytes())
        .collect();
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (48, 64), }\n";
    let length = (header.len() as u16).to_le_bytes();
    let npy = [b"\x93NUMPY\x01\0", &length[..], header.as_bytes(), &metres].concat();
    write(root, "depth/5.000000.png", npy);
    let recording = open(root).unwrap();
    assert!(recording.notes()[0].contains("taken as metres"));
    let z = recording.frame(0).unwrap().depth.z_m;
    assert!((z[63] - (5000.0 + 63.0 * 20.0) / 5000.0).abs() < 1e-6);
    // A given scale applies to all formats.
    let scaled = OpenOptions {
        depth_units_per_metre: Some(2.0),
        ..OpenOptions::default()
    };
    let half = Recording::open(root, &scaled).unwrap().frame(0).unwrap();
    assert_eq!(half.depth.z_m[63], z[63] / 2.0);
    let inspection = recording.inspect().unwrap();
    assert!(inspection.depth_m.is_some());
}

#[test]
fn a_container_is_no_folder() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), "take.bag", b"#ROSBAG V2.0\n");
    for path in [dir.path().to_owned(), dir.path().join("take.bag")] {
        let error = error(&path);
        assert!(
            error.contains("take.bag") && error.contains("rs-convert"),
            "{error}"
        );
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Any text in each file that the layouts read gives an error or frames, never a panic.
    #[test]
    fn arbitrary_text_in_their_files_never_panics(
        words in prop::collection::vec(prop_oneof![
            Just("0".to_owned()), Just("1".to_owned()), Just("-inf".to_owned()), Just("\n".to_owned()),
            Just("1e300".to_owned()), Just("{".to_owned()), Just("\"fx\":".to_owned()), any::<i64>().prop_map(|n| n.to_string()),
        ], 0..80),
        shape in 0..9usize,
    ) {
        let n = [4, 7, 8, 12, 13, 16, 17, 3, 5][shape];
        let free = words.join(" ");
        let lines: String = words.chunks(n).map(|line| line.join(" ") + "\n").collect();
        let dir = tempfile::tempdir().unwrap();
        let root = dir.path();
        write_frame(root, 1, "results/frame1.png", "results/depth1.png");
        write_frame(root, 1, "keyframes/images/1.png", "keyframes/depth/1.png");
        write_frame(root, 1, "lowres_wide/1_1.000.png", "lowres_depth/1_1.000.png");
        write_frame(root, 1, "color/1.png", "depth/1.png");
        for text in [&free, &lines] {
            for name in [
                "traj.txt", "keyframes/cameras/1.json", "lowres_wide_intrinsics/1_1.000.pincam",
                "lowres_wide.traj", "pose/1.txt", "x.gt.freiburg", "cam_params.json", "transforms.json",
                "intrinsic/intrinsic_color.txt", "intrinsic/intrinsic_depth.txt",
            ] {
                write(root, name, text);
            }
            let options = OpenOptions::default();
            for layout in [
                folders::LAYOUT, folders::ICL_NUIM, replica::LAYOUT, nerfstudio::LAYOUT,
                arkit_scenes::LAYOUT, polycam::LAYOUT,
            ] {
                let _ = (layout.list)(&root.into(), &options);
            }
            let given = OpenOptions {
                trajectory: Some(root.join("traj.txt")),
                assume_static: true,
                ..options
            };
            let _ = Recording::open(root, &given);
        }
    }
}
