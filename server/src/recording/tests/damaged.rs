//! One bad item never makes the rest unreadable: lost poses, and unreadable pictures.

use super::made::{LAYOUTS, color, depth, reds, tenths, write};
use super::*;
use crate::codec::png;

#[test]
fn a_lost_pose_leaves_out_its_frame_in_every_layout() {
    let rows = |word: &str| vec![[word; 4].join(" "); 4].join("\n");
    let mut losses: Vec<String> = ["nan", "-nan", "inf", "-inf", "-1.#IND", "1.#QNAN", "1.#INF"]
        .iter()
        .map(|word| rows(word))
        .collect();
    losses.extend(["0", "lost", "-nan(ind)"].map(rows));
    // Singular, mirrored, with numbers missing, empty.
    losses.push("1 0 0 0\n1 0 0 0\n0 0 1 0\n0 0 0 1".to_owned());
    losses.push("-1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1".to_owned());
    losses.push("1 0 0 0\n0 1 0 0".to_owned());
    losses.push(String::new());
    for made in LAYOUTS.iter().filter(|made| made.layout != "TUM RGB-D") {
        for loss in &losses {
            let dir = tempfile::tempdir().unwrap();
            made.write(dir.path(), 5, Some(loss));
            let recording = open(dir.path()).unwrap();
            assert_eq!(tenths(&recording), [0, 1, 3, 4], "{made:?} {loss}");
            assert_eq!(reds(&recording), [0, 1, 3, 4]);
            // The other frames keep their times.
            let times = recording.times_ns();
            assert_eq!(times[2] - times[1], 2 * (times[1] - times[0]));
            let notes = recording.notes().join("\n");
            assert!(
                notes.contains("1 of 5 frames have lost their pose"),
                "{made:?} {loss}: {notes}"
            );
        }
    }
}

#[test]
fn a_lost_line_of_groundtruth_is_left_out() {
    // Far apart in time, so that nothing is interpolated.
    for loss in [
        "nan nan nan nan nan nan nan",
        "0 0 0 0 0 0 0",
        "1 2",
        "-1.#IND 0 0 0 0 0 1",
        "",
    ] {
        let dir = tempfile::tempdir().unwrap();
        LAYOUTS[0].write(dir.path(), 5, Some(loss));
        let recording = open(dir.path()).unwrap();
        assert_eq!(tenths(&recording), [0, 1, 3, 4], "{loss}");
        let notes = recording.notes().join("\n");
        assert!(
            notes.contains(
                "1 of 5 lines of groundtruth.txt cannot be read and are left out: line 3"
            ) && notes.contains("1 frames have no poses around them"),
            "{notes}"
        );
    }
}

#[test]
fn where_all_poses_are_lost_there_is_one_error() {
    for made in LAYOUTS {
        let dir = tempfile::tempdir().unwrap();
        made.write(dir.path(), 3, None);
        for i in 0..3 {
            write(dir.path(), &(made.pose)(i), "");
        }
        let message = error(dir.path());
        assert!(message.contains("without a usable frame"), "{message}");
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

#[test]
fn an_unreadable_picture_leaves_out_its_frame_in_every_layout() {
    let cut = |whole: Vec<u8>| whole[..whole.len() - 30].to_vec();
    let other = png::encode_rgb8(8, 20, &[7; 8 * 20 * 3], png::Effort::Fast).unwrap();
    for made in LAYOUTS {
        for (in_depth, name) in [(false, made.color), (true, made.depth)] {
            let whole = if in_depth { depth() } else { color(2) };
            let zeros = vec![0; whole.len()];
            for bytes in [
                Vec::new(),
                cut(whole),
                zeros,
                b"<html>".to_vec(),
                other.clone(),
            ] {
                for bad in [0, 2, 4] {
                    let dir = tempfile::tempdir().unwrap();
                    made.write(dir.path(), 5, None);
                    write(dir.path(), &name(bad), &bytes);
                    let recording = open(dir.path()).unwrap();
                    let expected: Vec<usize> = (0..5).filter(|i| *i != bad).collect();
                    assert_eq!(reds(&recording), expected, "{made:?} {}", name(bad));
                    let file = name(bad);
                    let file = file.rsplit('/').next().unwrap();
                    let notes = recording.notes().join("\n");
                    assert!(
                        notes.contains("1 of 5 frames") && notes.contains(file),
                        "{notes}"
                    );
                    if bad == 0 && bytes.is_empty() {
                        recording.inspect().unwrap();
                    }
                }
            }
        }
    }
}

#[test]
fn where_no_picture_can_be_read_there_is_one_error() {
    for made in LAYOUTS {
        let dir = tempfile::tempdir().unwrap();
        made.write(dir.path(), 3, None);
        for i in 0..3 {
            write(dir.path(), &(made.depth)(i), "");
        }
        let message = error(dir.path());
        assert!(
            message.contains("without a usable frame")
                && message.contains("3 of 3 frames have a picture that cannot be read")
                && message.contains("empty file"),
            "{message}"
        );
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

#[test]
fn an_unreadable_confidence_map_leaves_out_its_frame() {
    let dir = tempfile::tempdir().unwrap();
    LAYOUTS[3].write(dir.path(), 3, None);
    for i in [0, 2] {
        let map = vec![2; (made::WIDTH * made::HEIGHT) as usize];
        let map = png::encode_gray8(made::WIDTH, made::HEIGHT, &map, png::Effort::Fast).unwrap();
        write(dir.path(), &format!("conf_{i:05}.png"), map);
    }
    write(dir.path(), "conf_00001.png", "");
    let recording = open(dir.path()).unwrap();
    assert_eq!(reds(&recording), [0, 2]);
    assert!(recording.notes().join("\n").contains("conf_00001.png"));
}

#[test]
fn damage_inside_a_picture_is_an_error_of_its_frame_alone() {
    let dir = tempfile::tempdir().unwrap();
    LAYOUTS[0].write(dir.path(), 3, None);
    let mut bytes = color(1);
    // In the compressed pixels, so that both ends of the file are intact.
    let middle = bytes.len() / 2;
    bytes[middle..middle + 8].fill(0xAA);
    write(dir.path(), "rgb/1.0.png", bytes);
    let recording = open(dir.path()).unwrap();
    assert_eq!(recording.len(), 3);
    let error = recording.frame(1).unwrap_err();
    assert!(error.is_of_frame() && error.to_string().contains("1.0.png"));
    assert!(recording.frame(0).is_ok() && recording.frame(2).is_ok());
    assert!(!recording.frame(3).unwrap_err().is_of_frame());
    let inspection = recording.inspect().unwrap();
    assert_eq!(inspection.sampled, 2);
    assert!(
        inspection
            .notes
            .join("\n")
            .contains("1 of 3 sampled frames cannot be decoded")
    );
}

#[test]
fn hidden_files_are_no_pictures() {
    for made in LAYOUTS {
        let dir = tempfile::tempdir().unwrap();
        made.write(dir.path(), 3, None);
        for i in 0..3 {
            for name in [(made.color)(i), (made.depth)(i), (made.pose)(i)] {
                let (folder, file) = name.rsplit_once('/').unwrap_or((".", &name));
                write(dir.path(), &format!("{folder}/._{file}"), "\0\x05\x16\x07");
                write(dir.path(), &format!("{folder}/Thumbs.db"), "x");
                write(dir.path(), &format!("{folder}/.DS_Store"), "x");
            }
        }
        let recording = open(dir.path()).unwrap();
        assert_eq!(recording.layout(), made.layout);
        assert_eq!(reds(&recording), [0, 1, 2], "{made:?}");
        assert_eq!(tenths(&recording), [0, 1, 2]);
    }
}

#[test]
fn extensions_in_upper_case_are_read_in_every_layout() {
    for made in LAYOUTS {
        let dir = tempfile::tempdir().unwrap();
        made.write(dir.path(), 3, None);
        for i in 0..3 {
            for name in [(made.color)(i), (made.depth)(i)] {
                let upper = name.replace(".png", ".PNG");
                fs::rename(dir.path().join(&name), dir.path().join(upper)).unwrap();
            }
        }
        let recording = open(dir.path()).unwrap();
        assert_eq!(reds(&recording), [0, 1, 2], "{made:?}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn names_that_are_no_text_are_left_out_with_a_note() {
    use std::os::unix::ffi::OsStrExt;
    for made in LAYOUTS {
        let dir = tempfile::tempdir().unwrap();
        made.write(dir.path(), 3, None);
        let color = dir.path().join((made.color)(0));
        let odd = color.with_file_name(std::ffi::OsStr::from_bytes(b"b\xFCro.png"));
        fs::copy(&color, odd).unwrap();
        let recording = open(dir.path()).unwrap();
        assert_eq!(recording.len(), 3, "{made:?}");
        let notes = recording.notes().join("\n");
        assert!(
            notes.contains("files have names that are not UTF-8 and are left out: b\u{fffd}ro.png"),
            "{made:?}: {notes}"
        );
    }
}
