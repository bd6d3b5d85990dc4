//! Layouts of phones and of NeRF tools, whose axes and times differ from OpenCV's.

use super::archives::same_when_zipped;
use super::layouts::{FOCAL, check, rows, write, write_frame};
use super::*;
use crate::codec::png;

#[test]
fn nerfstudio_has_opengl_axes() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    let [fx, fy, cx, cy] = FOCAL;
    let mut frames = Vec::new();
    for i in 0..4 {
        write_frame(
            root,
            i,
            &format!("images/f_{i}.png"),
            &format!("depth/f_{i}.png"),
        );
        let [a, b, c] = rows(&pose(i), [1.0, -1.0, -1.0]);
        let matrix = serde_json::json!([a, b, c, [0, 0, 0, 1]]);
        let mut frame = serde_json::json!({
            "file_path": format!("./images/f_{i}.png"),
            "depth_file_path": format!("depth\\f_{i}.png"),
            "transform_matrix": if i == 2 { serde_json::json!("lost") } else { matrix },
        });
        // Intrinsics of a frame take precedence.
        if i > 0 {
            frame["fl_x"] = fx.into();
        }
        for (name, value) in [("fl_y", fy), ("cx", cx), ("cy", cy)] {
            frame[name] = value.into();
        }
        frames.push(frame);
    }
    frames.push(serde_json::json!({ "file_path": "../x.png", "depth_file_path": "depth/f_0.png" }));
    let document = serde_json::json!({
        "fl_x": fx, "fl_y": 1.0, "cx": 0.0, "cy": 0.0, "w": 64, "h": 48.0,
        "depth_unit_scale_factor": 0.0005, "frames": frames,
    });
    write(root, "transforms.json", document.to_string());
    let recording = open(root).unwrap();
    assert_eq!(recording.layout(), "nerfstudio");
    same_when_zipped(&recording);
    assert_eq!(recording.len(), 3);
    let notes = recording.notes().join(" ");
    assert!(
        notes.contains("outside the folder") && notes.contains("no usable pose"),
        "{notes}"
    );
    // The first frame has no fl_x of its own and uses the document's intrinsics.
    assert_eq!(recording.intrinsics().fy, 1.0);
    let mut document = document;
    document["frames"][0]["fl_x"] = fx.into();
    write(root, "transforms.json", document.to_string());
    check(&open(root).unwrap(), &[0, 1, 3], 2000.0);
    for frame in document["frames"].as_array_mut().unwrap() {
        frame.as_object_mut().unwrap().remove("depth_file_path");
    }
    write(root, "transforms.json", document.to_string());
    assert!(error(root).contains("without depth"), "{}", error(root));
}

/// A camera without rotation in OpenGL axes looks along -z, with y up.
#[test]
fn opengl_axes_by_hand() {
    let identity: [f64; 12] = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0.];
    let pose = poses::matrix(&identity, poses::Axes::OpenGl).unwrap().pose;
    let right_below = pose.transform_point(DVec3::new(0.5, 0.25, 2.0));
    assert!((right_below - DVec3::new(0.5, -0.25, -2.0)).length() < 1e-12);
}

#[test]
fn arkit_scenes_has_camera_from_world_and_times() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("41069021");
    let frames = root.join("41069021_frames");
    let mut trajectory = String::new();
    for i in 0..4u32 {
        let time = 100.0 + 0.1 * f64::from(i);
        let name = format!("41069021_{time:.3}.png");
        write_frame(
            &frames,
            i,
            &format!("lowres_wide/{name}"),
            &format!("lowres_depth/{name}"),
        );
        let pincam = format!("64 48 {} {} {} {}", FOCAL[0], FOCAL[1], FOCAL[2], FOCAL[3]);
        write(
            &frames,
            &format!("lowres_wide_intrinsics/41069021_{:.3}.pincam", time + 0.001),
            pincam,
        );
        let inverse = pose(i).inverse();
        let (a, t) = (inverse.rotation.to_scaled_axis(), inverse.translation);
        // Frame 3 has no pose.
        if i < 3 {
            trajectory += &format!("{time} {} {} {} {} {} {}\n", a.x, a.y, a.z, t.x, t.y, t.z);
        }
    }
    let low = png::encode_gray8(64, 48, &[0; 64 * 48], png::Effort::Fast).unwrap();
    write(&frames, "confidence/41069021_100.100.png", low);
    write(
        &frames,
        "lowres_wide.traj",
        trajectory + "nan nan nan nan nan nan nan\n",
    );
    let recording = open(&root).unwrap();
    assert_eq!(recording.layout(), "ARKitScenes");
    same_when_zipped(&recording);
    assert_eq!(recording.len(), 3);
    assert_eq!(
        recording.times_ns()[1] - recording.times_ns()[0],
        100_000_000
    );
    // All depth of frame 1 has low confidence.
    assert_eq!(recording.frame(1).unwrap().depth.invalid_share(), 1.0);
    let keep = OpenOptions {
        keep_low_confidence: true,
        ..OpenOptions::default()
    };
    check(&Recording::open(&root, &keep).unwrap(), &[0, 1, 2], 1000.0);
}

#[test]
fn polycam_prefers_corrected_cameras() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    let [fx, fy, cx, cy] = FOCAL;
    for i in 0..3u32 {
        let id = 5_000_000 + i * 100_000;
        write_frame(
            root,
            i,
            &format!("keyframes/corrected_images/{id}.jpg"),
            &format!("keyframes/depth/{id}.png"),
        );
        write_frame(
            root,
            99,
            &format!("keyframes/images/{id}.jpg"),
            &format!("keyframes/depth/{id}.png"),
        );
        write_frame(
            root,
            i,
            &format!("keyframes/corrected_images/{id}.jpg"),
            &format!("keyframes/depth/{id}.png"),
        );
        let mut camera = serde_json::json!({
            "fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": 64, "height": 48, "blur_score": 1.0,
        });
        for (r, row) in rows(&pose(i), [1.0, -1.0, -1.0]).iter().enumerate() {
            for (c, value) in row.iter().enumerate() {
                camera[format!("t_{r}{c}")] = (*value).into();
            }
        }
        write(
            root,
            &format!("keyframes/corrected_cameras/{id}.json"),
            camera.to_string(),
        );
        write(root, &format!("keyframes/cameras/{id}.json"), "{}");
    }
    let recording = open(root).unwrap();
    assert_eq!(recording.layout(), "Polycam raw data");
    same_when_zipped(&recording);
    assert_eq!(
        recording.times_ns()[1] - recording.times_ns()[0],
        100_000_000
    );
    check(&recording, &[0, 1, 2], 1000.0);
    fs::remove_dir_all(root.join("keyframes/corrected_cameras")).unwrap();
    assert!(error(root).contains("keyframes/cameras"), "{}", error(root));
}
