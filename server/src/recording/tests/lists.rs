//! TUM's lists in the forms that people write.

use super::made::{LAYOUTS, color, depth, reds, tenths, write};
use super::*;

const RGB: &str = "0.0 rgb/0.0.png\n1.0 rgb/1.0.png\n2.0 rgb/2.0.png\n";
const DEPTH: &str = "0.0 depth/0.0.png\n1.0 depth/1.0.png\n2.0 depth/2.0.png\n";
const POSES: &str = "0.0 0 0 0 0 0 0 1\n1.0 0.1 0 0 0 0 0 1\n2.0 0.2 0 0 0 0 0 1\n";

fn tum() -> tempfile::TempDir {
    let dir = tempfile::tempdir().unwrap();
    LAYOUTS[0].write(dir.path(), 3, None);
    dir
}

fn utf16(text: &str) -> Vec<u8> {
    let units = std::iter::once(0xFEFF).chain(text.encode_utf16());
    units.flat_map(u16::to_le_bytes).collect()
}

/// Three frames, each with its own picture and pose.
fn check(root: &Path, what: &str) -> String {
    let recording = open(root).unwrap_or_else(|e| panic!("{what}: {e}"));
    assert_eq!(recording.layout(), "TUM RGB-D");
    assert_eq!(reds(&recording), [0, 1, 2], "{what}");
    assert_eq!(tenths(&recording), [0, 1, 2], "{what}");
    recording.notes().join("\n")
}

#[test]
fn every_way_of_writing_a_list_is_read() {
    let each = |f: fn(&str) -> String| [RGB, DEPTH, POSES].map(|text| f(text).into_bytes());
    let commas = each(|text| text.replace(' ', ","));
    for (what, files) in [
        ("commas", commas.clone()),
        ("commas and blanks", each(|text| text.replace(' ', ", "))),
        ("semicolons", each(|text| text.replace(' ', ";"))),
        ("tabs", each(|text| text.replace(' ', "\t"))),
        (
            "blanks",
            each(|text| text.replace(' ', "   ").replace('\n', "  \n")),
        ),
        (
            "further columns",
            each(|text| text.replace('\n', " 0.01 x\n")),
        ),
        ("backslashes", each(|text| text.replace('/', "\\"))),
        (
            "quotes",
            each(|text| {
                text.replace("rgb/", "\"rgb/")
                    .replace("depth/", "\"depth/")
                    .replace("png", "png\"")
            }),
        ),
        (
            "headings",
            each(|text| format!("timestamp filename tx ty\n{text}")),
        ),
        (
            "other signs",
            each(|text| format!("% a\n// b\n! c\n{text}")),
        ),
        ("CR alone", each(|text| text.replace('\n', "\r"))),
        ("CR LF", each(|text| text.replace('\n', "\r\n"))),
        ("case", each(|text| text.replace("png", "PNG"))),
        (
            "another root",
            each(|text| {
                text.replace("rgb/", "/home/me/data/rgb/")
                    .replace("depth/", "C:\\data\\depth\\")
            }),
        ),
        ("padding", each(|text| format!("{text}\0\0\0"))),
        ("UTF-16", [RGB, DEPTH, POSES].map(utf16)),
        ("a mark", each(|text| format!("\u{feff}{text}"))),
        (
            "Latin-1",
            [RGB, DEPTH, POSES].map(|text| [b"# M\xFCller\n", text.as_bytes()].concat()),
        ),
        ("a mixture", [commas[0].clone(), DEPTH.into(), POSES.into()]),
        (
            "decimal commas",
            each(|text| {
                text.replace(".0 ", ",0 ")
                    .replace(" 0.1 ", " 0,1 ")
                    .replace(" 0.2 ", " 0,2 ")
            }),
        ),
    ] {
        let dir = tum();
        for (name, bytes) in ["rgb.txt", "depth.txt", "groundtruth.txt"]
            .iter()
            .zip(files)
        {
            write(dir.path(), name, bytes);
        }
        let notes = check(dir.path(), what);
        assert!(notes.is_empty(), "{what}: {notes}");
    }
}

#[test]
fn bad_lines_are_left_out_and_named() {
    let dir = tum();
    write(
        dir.path(),
        "rgb.txt",
        format!("{RGB}x rgb/3.0.png\n3.0\n4.0 ../../etc/passwd\n"),
    );
    write(
        dir.path(),
        "depth.txt",
        format!("{DEPTH}{}\n", "7".repeat(10_000)),
    );
    let notes = check(dir.path(), "bad lines");
    for words in [
        "3 of 6 lines of rgb.txt cannot be read and are left out: line 4, line 5, line 6 (",
        "1 of 4 lines of depth.txt cannot be read",
    ] {
        assert!(notes.contains(words), "{notes}");
    }
}

#[test]
fn stamps_in_other_units_are_told_by_their_size() {
    for (zeros, unit) in [
        ("000", "milliseconds"),
        ("000000", "microseconds"),
        ("000000000", "nanoseconds"),
    ] {
        let dir = tum();
        for (name, text) in [
            ("rgb.txt", RGB),
            ("depth.txt", DEPTH),
            ("groundtruth.txt", POSES),
        ] {
            let lines = text.lines().enumerate().map(|(i, line)| {
                let rest = line.split_once(' ').unwrap().1;
                format!("170000000{i}{zeros} {rest}\n")
            });
            write(dir.path(), name, lines.collect::<String>());
        }
        let notes = check(dir.path(), unit);
        assert!(
            notes.contains(&format!("rgb.txt are taken as {unit}")),
            "{notes}"
        );
        assert_eq!(
            open(dir.path()).unwrap().times_ns()[1],
            1_700_000_001_000_000_000
        );
    }
}

#[test]
fn associations_take_the_place_of_lists() {
    let line = |i: usize| {
        [
            format!("{i}.0 rgb/{i}.0.png"),
            format!("{i}.005 depth/{i}.0.png"),
        ]
    };
    type Form = fn([String; 2]) -> String;
    let forms: [(&str, Form); 4] = [
        ("colour first", |[c, d]| format!("{c} {d}\n")),
        ("depth first", |[c, d]| format!("{d}\t{c}\n")),
        ("commas", |[c, d]| format!("{c} {d}\n").replace(' ', ",")),
        ("poses before", |[c, d]| {
            format!("0.0 1 2 3 0 0 0 1 {c} {d}\n")
        }),
    ];
    for (what, form) in forms {
        for name in [
            "associations.txt",
            "associate.txt",
            "assoc.txt",
            "fr1_Associated.txt",
        ] {
            let dir = tum();
            fs::remove_file(dir.path().join("rgb.txt")).unwrap();
            fs::remove_file(dir.path().join("depth.txt")).unwrap();
            let text: String = (0..3).map(|i| form(line(i))).collect();
            write(
                dir.path(),
                name,
                format!("{text}9.0 rgb/9.png 9.0 depth/9.png\nx\n"),
            );
            let notes = check(dir.path(), what);
            assert!(
                notes.contains(&format!("1 of 4 pairs listed in {name}"))
                    && notes.contains("1 of 5 lines"),
                "{notes}"
            );
            let recording = open(dir.path()).unwrap();
            assert_eq!(
                recording.listing.entries[1].depth_lag_ns, 5_000_000,
                "{what}"
            );
        }
    }
}

#[test]
fn poses_are_found_under_other_names_if_they_are_poses() {
    for name in [
        "gt.txt",
        "traj.txt",
        "poses.txt",
        "CameraTrajectory.txt",
        "GroundTruth.TXT",
    ] {
        let dir = tum();
        fs::rename(dir.path().join("groundtruth.txt"), dir.path().join(name)).unwrap();
        let notes = check(dir.path(), name);
        assert!(
            notes.contains(&format!("poses are those of {name}")),
            "{notes}"
        );
    }
    let dir = tum();
    fs::remove_file(dir.path().join("groundtruth.txt")).unwrap();
    write(dir.path(), "traj.txt", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n");
    assert!(error(dir.path()).contains("no camera poses: looked for groundtruth.txt"));
}

#[cfg(unix)]
#[test]
fn names_in_other_encodings_and_with_blanks_are_found() {
    let dir = tempfile::tempdir().unwrap();
    LAYOUTS[0].write(dir.path(), 2, None);
    let latin = crate::text::path_from_bytes(b"gr\xFCn.png");
    fs::write(dir.path().join(latin), color(2)).unwrap();
    write(dir.path(), "depth/my picture.png", depth());
    write(
        dir.path(),
        "rgb.txt",
        [&RGB.as_bytes()[..32], b"2.0 gr\xFCn.png\n"].concat(),
    );
    write(
        dir.path(),
        "depth.txt",
        format!("{}2.0 depth/my picture.png\n", &DEPTH[..36]),
    );
    write(dir.path(), "groundtruth.txt", POSES);
    check(dir.path(), "names");
}
