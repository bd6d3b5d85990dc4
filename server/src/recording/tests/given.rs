//! Options of the caller override the content of the folder: a trajectory, a depth camera.

use super::layouts::{LOST, camera_json, check, cv, write, write_frame};
use super::*;

/// The same poses in each form of trajectory, for a recording without poses.
#[test]
fn a_trajectory_may_be_given() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("r");
    let indices = [1u32, 2, 3, 4];
    for i in indices {
        write_frame(
            &root,
            i,
            &format!("color/{i}.png"),
            &format!("depth/{i}.png"),
        );
    }
    write(&root, "camera.json", camera_json());
    assert!(error(&root).contains("no camera poses"), "{}", error(&root));
    let tum = |i: u32, key: u32| {
        let Pose {
            rotation: q,
            translation: t,
        } = pose(i);
        format!(
            "{key} {} {} {} {} {} {} {}\n",
            t.x, t.y, t.z, q.x, q.y, q.z, q.w
        )
    };
    let lines = |line: &dyn Fn(u32) -> String| indices.map(line).concat();
    let first_12 = |i: u32| {
        cv(i, " ")
            .trim_end()
            .rsplitn(5, ' ')
            .last()
            .unwrap()
            .to_owned()
    };
    let all_from_0 = (0..6).map(|i| cv(i, " ") + "\n").collect::<String>();
    for (name, file, how) in [
        ("tum by number", lines(&|i| tum(i, i)), "number"),
        ("tum by order", lines(&|i| tum(i, i - 1)), "order"),
        ("kitti", lines(&|i| first_12(i) + "\n"), "order"),
        ("16", lines(&|i| cv(i, " ") + "\n"), "order"),
        ("17", lines(&|i| format!("{i} {}\n", cv(i, " "))), "number"),
        ("more than pictures", all_from_0, "counted from 0"),
        ("stack", lines(&|i| cv(i, "\n") + "\n"), "order"),
        (
            "log",
            lines(&|i| format!("{i} {i} {}\n{}", i + 1, cv(i, "\n"))),
            "number",
        ),
        (
            "log from 0",
            lines(&|i| format!("{0} {0} {1}\n{2}", i - 1, i, cv(i, "\n"))),
            "order",
        ),
        ("commas", lines(&|i| tum(i, i).replace(' ', ",")), "number"),
        (
            "heading",
            "time,tx,ty,tz,qx,qy,qz,qw\n".to_owned() + &lines(&|i| tum(i, i)),
            "number",
        ),
        (
            "comments",
            "# x\n\n".to_owned() + &lines(&|i| tum(i, i)),
            "number",
        ),
    ] {
        let path = dir.path().join("poses");
        fs::write(&path, file).unwrap();
        let options = OpenOptions {
            trajectory: Some(path),
            ..OpenOptions::default()
        };
        let recording = Recording::open(&root, &options).unwrap();
        let notes = recording.notes().join(" ");
        assert!(
            notes.contains(how) && !notes.contains("at rest"),
            "{name}: {notes}"
        );
        check(&recording, &indices, 1000.0);
    }
    for (file, message) in [
        ("1 2 3 4 5\n", "5 numbers"),
        ("", "none"),
        ("{\"frames\":[]}", "JSON"),
        (&tum(1, 77).repeat(3), "3 poses that do not fit"),
    ] {
        let path = dir.path().join("poses");
        fs::write(&path, file).unwrap();
        let options = OpenOptions {
            trajectory: Some(path),
            ..OpenOptions::default()
        };
        let error = Recording::open(&root, &options).unwrap_err().to_string();
        assert!(error.contains(message), "{error}");
    }
}

#[test]
fn a_lost_pose_of_a_trajectory_loses_its_picture_alone() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("r");
    for i in 0..4u32 {
        write_frame(
            &root,
            i,
            &format!("color/{i}.png"),
            &format!("depth/{i}.png"),
        );
    }
    write(&root, "camera.json", camera_json());
    let header = |i: u32| format!("{i} {i} {}\n", i + 1);
    // Lost as -inf, and left out completely.
    for lost in [LOST, ""] {
        let log = (0..4)
            .map(|i| header(i) + &if i == 2 { lost.to_owned() } else { cv(i, "\n") })
            .collect::<String>();
        let path = dir.path().join("t.log");
        fs::write(&path, log).unwrap();
        let options = OpenOptions {
            trajectory: Some(path),
            ..OpenOptions::default()
        };
        check(
            &Recording::open(&root, &options).unwrap(),
            &[0, 1, 3],
            1000.0,
        );
    }
}

#[test]
fn a_trajectory_goes_by_time_where_both_have_times() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path().join("tum");
    write_tum(&root, ColorFormat::Png);
    fs::remove_file(root.join("groundtruth.txt")).unwrap();
    let path = dir.path().join("t.txt");
    // Frames are at 5.000, 5.033 and 5.067; the last has no poses around it.
    let line = |time: f64, i: u32| {
        let Pose {
            rotation: q,
            translation: t,
        } = pose(i);
        format!(
            "{time} {} {} {} {} {} {} {}\n",
            t.x, t.y, t.z, q.x, q.y, q.z, q.w
        )
    };
    fs::write(&path, line(4.9, 0) + &line(5.0, 1) + &line(5.033_333, 2)).unwrap();
    let options = OpenOptions {
        trajectory: Some(path),
        ..OpenOptions::default()
    };
    let recording = Recording::open(&root, &options).unwrap();
    assert_eq!(recording.len(), 2);
    assert!(
        recording.poses()[0]
            .translation
            .distance(pose(1).translation)
            < 1e-6
    );
    assert!(
        recording.poses()[1]
            .translation
            .distance(pose(2).translation)
            < 1e-6
    );
}

#[test]
fn a_depth_camera_may_be_given() {
    let dir = tempfile::tempdir().unwrap();
    let root = dir.path();
    write_tum(root, ColorFormat::Png);
    let plain = open(root).unwrap().frame(0).unwrap();
    // The same camera: nothing changes.
    let same = OpenOptions {
        color_from_depth: Some(Pose::IDENTITY),
        ..OpenOptions::default()
    };
    let same = Recording::open(root, &same).unwrap().frame(0).unwrap();
    assert_eq!(same.depth.z_m, plain.depth.z_m);
    // Moved forward by 0.1 m: its measurements are 0.1 m farther from the colour camera.
    let forward = OpenOptions {
        color_from_depth: Some(Pose {
            rotation: DQuat::IDENTITY,
            translation: DVec3::new(0.0, 0.0, 0.1),
        }),
        ..OpenOptions::default()
    };
    let moved = Recording::open(root, &forward).unwrap();
    let z = moved.frame(0).unwrap().depth.z_m[23 * 64 + 31];
    assert!(
        (z - plain.depth.z_m[23 * 64 + 31] - 0.1).abs() < 0.01,
        "{z}"
    );
    assert!(moved.inspect().unwrap().depth_intrinsics.is_some());
    let narrow = OpenOptions {
        depth_intrinsics: Some([120.0, 120.0, 31.5, 23.5]),
        ..OpenOptions::default()
    };
    let frame = Recording::open(root, &narrow).unwrap().frame(0).unwrap();
    // The depth camera sees only the middle half.
    assert!(frame.depth.z_m[5].is_nan() && !frame.depth.z_m[23 * 64 + 31].is_nan());
}
