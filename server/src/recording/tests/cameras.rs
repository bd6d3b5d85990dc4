//! Intrinsics in the forms that people write.

use super::*;
use camera_file::{CameraFile, parse_camera_file};

fn parse(name: &str, text: &str) -> Result<CameraFile, RecordingError> {
    let file = text::TextFile::from_bytes(Path::new(name), text.as_bytes().to_vec());
    parse_camera_file(&file)
}

#[test]
fn every_form_of_intrinsics_is_read() {
    const SIZE: Option<(u32, u32)> = Some((96, 72));
    for (text, size, note) in [
        (
            r#"{"fx": 90, "fy": 91, "cx": 47.5, "cy": 35.5, "width": 96, "height": 72}"#,
            SIZE,
            "",
        ),
        (
            "\u{feff}{\"fx\": 90, \"fy\": 91, \"cx\": 47.5, \"cy\": 35.5}",
            None,
            "",
        ),
        (
            r#"{"width": 96.0, "height": 72.0, "intrinsic_matrix": [90, 0, 0, 0, 91, 0, 47.5, 35.5, 1]}"#,
            SIZE,
            "",
        ),
        (
            r#"{"intrinsic_matrix": [90, 0, 47.5, 0, 91, 35.5, 0, 0, 1]}"#,
            None,
            "looks row-major",
        ),
        (
            r#"{"K": [[90, 0, 47.5], [0, 91, 35.5], [0, 0, 1]], "image_size": [96, 72]}"#,
            SIZE,
            "",
        ),
        (
            r#"{"K": [[90, 0, 0], [0, 91, 0], [47.5, 35.5, 1]]}"#,
            None,
            "looks column-major",
        ),
        (
            r#"{"camera_matrix": {"rows": 3, "cols": 3, "data": [90, 0, 47.5, 0, 91, 35.5, 0, 0, 1]}}"#,
            None,
            "",
        ),
        (r#"{"intrinsics": [90, 91, 47.5, 35.5]}"#, None, ""),
        (
            r#"{"camera": {"width": 96, "height": 72, "intrinsic_matrix": [90, 0, 0, 0, 91, 0, 47.5, 35.5, 1]}}"#,
            SIZE,
            "",
        ),
        (
            r#"{"depth": {"fx": 1, "fy": 1, "cx": 1, "cy": 1}, "color": {"intrinsics": {"fx": 90, "fy": 91, "ppx": 47.5, "ppy": 35.5, "width": 96, "height": 72}}}"#,
            SIZE,
            "",
        ),
        (
            r#"{"fl_x": 90, "fl_y": 91, "cx": 47.5, "cy": 35.5, "w": 96, "h": 72, "frames": []}"#,
            SIZE,
            "",
        ),
        (
            r#"{"focal_length": [90, 91], "principal_point": [47.5, 35.5], "resolution": {"width": 96, "height": 72}}"#,
            SIZE,
            "",
        ),
        (
            r#"{"Fx": "90", "Fy": "91.0", "Cx": "47.5", "Cy": "35.5", "width": null, "height": null}"#,
            None,
            "",
        ),
        ("90 91 47.5 35.5", None, ""),
        ("# fx fy cx cy\r\n90,91,47.5,35.5\r\n", None, ""),
        (
            "fx fy cx cy\n90 91 47.5 35.5 0.1 -0.2 0 0\n",
            None,
            "4 numbers after",
        ),
        ("90 0 47.5\n0 91 35.5\n0 0 1", None, ""),
        ("90 0 47.5 0\n0 91 35.5 0\n0 0 1 0\n0 0 0 1", None, ""),
        ("90 0 47.5 0\n0 91 35.5 0\n0 0 1 0", None, ""),
        ("90 0 47.5 0 91 35.5 0 0 1", None, ""),
        ("90 0 47.5 0 0 91 35.5 0 0 0 1 0 0 0 0 1", None, ""),
        ("[[90, 0, 47.5],\n [0, 91, 35.5],\n [0, 0, 1]]", None, ""),
        (
            "90 0.02 47.5\n0 91 35.5\n0 0 1",
            None,
            "a skew of 0.02 px is left out",
        ),
        ("90 91\n47.5 35.5", None, ""),
        (
            "fx: 90\nfy: 91\ncx: 47.5\ncy: 35.5\nwidth: 96\nheight: 72",
            SIZE,
            "",
        ),
        (
            "%YAML:1.0\nCamera.fx: 90.0\nCamera.fy: 91.0\nCamera.cx: 47.5\nCamera.cy: 35.5\nCamera.width: 96\nCamera.height: 72\n",
            SIZE,
            "",
        ),
    ] {
        let found = parse("camera.json", text).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!(found.camera.focal, [90.0, 91.0, 47.5, 35.5], "{text}");
        assert_eq!(found.camera.size, size, "{text}");
        let notes = found.notes.join("\n");
        assert_eq!(notes.is_empty(), note.is_empty(), "{text}: {notes}");
        assert!(notes.contains(note), "{text}: {notes}");
    }
    let one = parse("c", r#"{"focal_length": 90, "principal_point": [47, 35]}"#).unwrap();
    assert_eq!(one.camera.focal, [90.0, 90.0, 47.0, 35.0]);
}

#[test]
fn what_is_no_camera_is_one_clear_error() {
    for (text, words) in [
        ("", "intrinsics"),
        ("{}", "none of them"),
        ("1 2 3", "expected 4 numbers, got 3 words"),
        ("90 20 47.5\n0 91 35.5\n0 0 1", "fx 0 cx, 0 fy cy, 0 0 1"),
        ("90 0 47.5\n0 0 35.5\n0 0 1", "fy"),
        (
            "90 nan 47.5\n0 91 35.5\n0 0 1",
            "line 1: intrinsics: expected finite numbers",
        ),
        (r#"{"data": [1, 2, 3, 4]}"#, "none of them"),
        (
            r#"{"fx": 1, "fy": 1, "cx": 1, "cy": 1, "width": 5}"#,
            "both or neither",
        ),
    ] {
        let message = parse("c.txt", text).unwrap_err().to_string();
        assert!(
            message.contains(words) && message.starts_with("c.txt"),
            "{text}: {message}"
        );
        assert_eq!(message.lines().count(), 1);
    }
}

#[test]
fn metres_per_unit_are_turned_round() {
    let units = |scale: &str| {
        let text = format!(r#"{{"fx": 9, "fy": 9, "cx": 9, "cy": 9, "depth_scale": {scale}}}"#);
        parse("c", &text).unwrap().depth_units_per_metre
    };
    assert_eq!(units("1000"), Some(1000.0));
    assert_eq!(units("0.001"), Some(1000.0));
    assert_eq!(units("null"), None);
}

#[test]
fn a_camera_file_without_intrinsics_is_passed_over() {
    let dir = tempfile::tempdir().unwrap();
    made::LAYOUTS[0].write(dir.path(), 2, None);
    made::write(dir.path(), "manifest.json", r#"{"name": "another tool's"}"#);
    let recording = open(dir.path()).unwrap();
    assert_eq!(recording.intrinsics().fx, 20.0);
    assert!(
        recording
            .notes()
            .join("\n")
            .contains("manifest.json has no readable intrinsics")
    );
}
