//! Each frame gets its pose, whatever the names of pictures and entries.

use super::made::{color, depth, matrix, reds, tenths, write};
use super::*;

/// An Open3D recording with the given names of colour and depth and numbers of entries. The red channel of colour is
/// its index in `colors`, the x of an entry is its index in `entries`.
fn open3d(colors: &[&str], depths: &[&str], entries: &[&str]) -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    for (i, name) in colors.iter().enumerate() {
        write(dir.path(), &format!("color/{name}.png"), color(i));
    }
    for name in depths {
        write(dir.path(), &format!("depth/{name}.png"), depth());
    }
    let entry = |(i, header): (usize, &&str)| format!("{header}\n{}", matrix(i));
    let log: String = entries.iter().enumerate().map(entry).collect();
    write(dir.path(), "trajectory.log", log);
    write(
        dir.path(),
        "camera.json",
        r#"{"fx": 20, "fy": 20, "cx": 7.5, "cy": 5.5}"#,
    );
    dir
}

#[test]
fn pictures_take_the_poses_of_their_numbers() {
    // Names of colour and depth, numbers of entries, expected red values and tenths of metres, and words of the note.
    type Case<'a> = (
        &'a [&'a str],
        &'a [&'a str],
        &'a [usize],
        &'a [i64],
        &'a str,
    );
    let cases: [Case; 10] = [
        (
            &["000000", "000001", "000002"],
            &["0 0 1", "1 1 2", "2 2 3"],
            &[0, 1, 2],
            &[0, 1, 2],
            "by number",
        ),
        (
            &["000001", "000002", "000003"],
            &["1 1 2", "2 2 3", "3 3 4"],
            &[0, 1, 2],
            &[0, 1, 2],
            "by number",
        ),
        (
            &["1", "2", "3", "4"],
            &["0 0 1", "1 1 2", "2 2 3", "3 3 4"],
            &[0, 1, 2, 3],
            &[0, 1, 2, 3],
            "by order",
        ),
        (
            &["1", "2", "4"],
            &["0 0 1", "1 1 2", "2 2 3", "3 3 4"],
            &[0, 1, 2],
            &[0, 1, 3],
            "-1",
        ),
        (
            &["000000", "000010", "000020"],
            &["0 0 1", "10 10 11", "20 20 21"],
            &[0, 1, 2],
            &[0, 1, 2],
            "by number",
        ),
        (
            &["000000", "000010", "000020"],
            &["0 0 1", "1 1 2", "2 2 3"],
            &[0, 1, 2],
            &[0, 1, 2],
            "by order",
        ),
        (
            &["2024-01-05_0001", "2024-01-05_0002", "2024-01-05_0003"],
            &["1 1 2", "2 2 3", "3 3 4"],
            &[0, 1, 2],
            &[0, 1, 2],
            "by number",
        ),
        (
            &["cam0_1", "cam0_2", "cam0_10"],
            &["1 1 2", "2 2 3", "10 10 11"],
            &[0, 1, 2],
            &[0, 1, 2],
            "by number",
        ),
        // Numbers that carry no information; a missing entry.
        (
            &["000000", "000001", "000002"],
            &["0 0 0", "0 0 0", "0 0 0"],
            &[0, 1, 2],
            &[0, 1, 2],
            "by order",
        ),
        (
            &["000000", "000001", "000002"],
            &["0 0 1", "2 2 3"],
            &[0, 2],
            &[0, 1],
            "by number",
        ),
    ];
    for (names, entries, expected_reds, expected_tenths, words) in cases {
        let dir = open3d(names, names, entries);
        let recording = open(dir.path()).unwrap();
        assert_eq!(reds(&recording), expected_reds, "{names:?} {entries:?}");
        assert_eq!(tenths(&recording), expected_tenths, "{names:?} {entries:?}");
        let notes = recording.notes().join("\n");
        let note = format!("take their poses from trajectory.log {words}");
        assert!(
            notes.contains(&note) || (words == "-1" && notes.contains("by number, -1")),
            "{notes}"
        );
    }
}

#[test]
fn the_tenth_picture_comes_after_the_second() {
    let names: Vec<String> = (0..12).map(|i| format!("cam0_{i}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let headers: Vec<String> = (0..12).map(|i| format!("{i} {i} {}", i + 1)).collect();
    let headers: Vec<&str> = headers.iter().map(String::as_str).collect();
    let recording_dir = open3d(&names, &names, &headers);
    let recording = open(recording_dir.path()).unwrap();
    assert_eq!(reds(&recording), (0..12).collect::<Vec<_>>());
    assert_eq!(tenths(&recording), (0..12).collect::<Vec<_>>());
}

#[test]
fn colour_and_depth_are_paired_by_number_or_order() {
    let entries = ["0 0 1", "1 1 2", "2 2 3"];
    // Other prefixes.
    let dir = open3d(
        &["rgb_0", "rgb_1", "rgb_2"],
        &["d_0000", "d_0001", "d_0002"],
        &entries,
    );
    assert_eq!(reds(&open(dir.path()).unwrap()), [0, 1, 2]);
    // Only every third colour picture.
    let dir = open3d(
        &["0", "3", "6"],
        &["0", "1", "2", "3", "4", "5", "6"],
        &["0 0 1", "3 3 4", "6 6 7"],
    );
    let recording = open(dir.path()).unwrap();
    assert_eq!(
        (reds(&recording), tenths(&recording)),
        (vec![0, 1, 2], vec![0, 1, 2])
    );
    let paired = recording.listing.entries.iter().map(|e| name_of(&e.depth));
    assert!(paired.eq(["0.png", "3.png", "6.png"]));
    // One list counts from 0, the other from 1.
    let dir = open3d(&["0", "1", "2"], &["1", "2", "3"], &entries);
    let recording = open(dir.path()).unwrap();
    assert_eq!(reds(&recording), [0, 1, 2]);
    assert!(
        recording.notes()[0].contains("paired by order"),
        "{:?}",
        recording.notes()
    );
    // No rule applies.
    let dir = open3d(&["a", "b"], &["x", "y", "z"], &entries);
    assert!(error(dir.path()).contains("do not say which belong together"));
}

#[test]
fn trajectories_without_headers_and_with_damage_are_read() {
    let parse = |text: &str| -> Vec<(Option<u64>, Option<f64>)> {
        let file = text::TextFile::from_bytes(Path::new("t.log"), text.as_bytes().to_vec());
        let x =
            |entry: open3d::LogEntry| (entry.number, entry.pose.ok().map(|m| m.pose.translation.x));
        let (entries, _) = open3d::parse_log(&file);
        entries.into_iter().map(x).collect()
    };
    let [a, b] = [matrix(0), matrix(1)];
    assert_eq!(
        parse(&format!("{a}{b}")),
        [(None, Some(0.0)), (None, Some(0.1))]
    );
    // Missing rows, an extra row, a file that was cut.
    let missing = format!("0 0 1\n1 0 0 0\n0 1 0 0\n1 1 2\n{b}");
    assert_eq!(parse(&missing), [(Some(0), None), (Some(1), Some(0.1))]);
    let many = format!("0 0 1\n{a}0 0 0 1\n1 1 2\n{b}");
    assert_eq!(parse(&many), [(Some(0), Some(0.0)), (Some(1), Some(0.1))]);
    let cut = format!("0 0 1\n{a}1 1 2\n1 0 0");
    assert_eq!(parse(&cut), [(Some(0), Some(0.0)), (Some(1), None)]);
}
