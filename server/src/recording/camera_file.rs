//! Reads intrinsics from files as common tools write them: JSON with numbers of various names, flat or nested, with
//! matrices by rows or by columns; text with numbers, matrices or `name: value` lines.

use serde_json::{Map, Value};

use crate::camera::Intrinsics;

use super::camera_text::document_of;
use super::error::{Place, RecordingError};
use super::location::Location;
use super::rig::{CameraModel, check_units};
use super::text::{TextFile, check_focal, json_from_text, number};

/// Names of camera files, in order of preference, for every layout.
const NAMES: [&str; 15] = [
    "camera.json",
    "intrinsic.json",
    "intrinsics.json",
    "camera_intrinsic.json",
    "camera_intrinsics.json",
    "camera-intrinsics.json",
    "camera_primesense.json",
    "camera-intrinsics.txt",
    "camera_intrinsics.txt",
    "intrinsics.txt",
    "intrinsic.txt",
    "calibration.json",
    "calibration.txt",
    "camera.txt",
    "K.txt",
];

/// A skew of at most this share of the focal length is ignored: rounding or calibration explains it. A larger skew is
/// rejected, because it is not a pinhole camera.
const MAX_SKEW: f64 = 0.01;

/// Deepest nesting of a JSON document that is searched for intrinsics.
const MAX_DEPTH: usize = 6;

/// Content of a camera file.
#[derive(Debug)]
pub(super) struct CameraFile {
    pub(super) camera: CameraModel,
    pub(super) depth_units_per_metre: Option<f64>,
    /// Notes on the interpretation of unusual contents, one sentence each.
    pub(super) notes: Vec<String>,
}

/// Finds the camera file in `dir`: `preferred`, else one of the usual names. A file without intrinsics is skipped if
/// there is another file.
pub(super) fn find_camera_file(
    dir: &Location,
    preferred: &[&str],
) -> Result<Option<CameraFile>, RecordingError> {
    let mut failure = None;
    let mut passed_over = Vec::new();
    for name in preferred.iter().chain(&NAMES) {
        let path = dir.join(name);
        if !path.is_file() || passed_over.contains(name) {
            continue;
        }
        match read_camera_file(&path) {
            Ok(mut found) => {
                for name in passed_over {
                    found
                        .notes
                        .push(format!("{name} has no readable intrinsics and is skipped."));
                }
                return Ok(Some(found));
            }
            Err(error) => {
                failure.get_or_insert(error);
                passed_over.push(*name);
            }
        }
    }
    failure.map_or(Ok(None), Err)
}

/// Reads a camera file in one of the supported forms.
pub(super) fn read_camera_file(path: &Location) -> Result<CameraFile, RecordingError> {
    parse_camera_file(&TextFile::read(path)?)
}

pub(super) fn parse_camera_file(file: &TextFile) -> Result<CameraFile, RecordingError> {
    let place = Place::file(file.path());
    let mut notes = Vec::new();
    let text = file.text().trim_start();
    let document = if text.starts_with('{') {
        json_from_text(file)?
    } else if text.starts_with('[') && serde_json::from_str::<Value>(file.text()).is_ok() {
        Value::Object(Map::from_iter([(
            "intrinsics".to_owned(),
            json_from_text(file)?,
        )]))
    } else {
        document_of(file, &mut notes)?
    };
    let found = find_focal(&document, &place, &mut notes, 0)?.ok_or_else(|| {
        place.clone().field(
            "intrinsics",
            "\"intrinsics\", \"intrinsic_matrix\" or \"fx\", \"fy\", \"cx\", \"cy\"",
            "none of them",
        )
    })?;
    let [fx, fy, cx, cy] = check_focal(found.focal, &place)?;
    let size = match found.size {
        (Some(w), Some(h)) => {
            Intrinsics::new(fx, fy, cx, cy, w, h).map_err(|e| place.clone().camera(e))?;
            Some((w, h))
        }
        (None, None) => None,
        _ => return Err(place.field("width, height", "both or neither", "one of them")),
    };
    let units = find_units(&document, 0).map(|units| {
        // Metres per unit, as librealsense defines it.
        if units > 0.0 && units < 1.0 {
            1.0 / units
        } else {
            units
        }
    });
    if let Some(units) = units {
        check_units(units, &place)?;
    }
    let name = file.location.file_name();
    Ok(CameraFile {
        camera: CameraModel {
            focal: found.focal,
            size,
            origin: format!("from {name}"),
        },
        depth_units_per_metre: units,
        notes: notes
            .into_iter()
            .map(|note| format!("{name}: {note}"))
            .collect(),
    })
}

/// `fx fy cx cy`, and the size if known.
struct Found {
    focal: [f64; 4],
    size: (Option<u32>, Option<u32>),
}

/// Finds the colour camera's intrinsics in a document or in its nested objects.
fn find_focal(
    value: &Value,
    place: &Place,
    notes: &mut Vec<String>,
    depth: usize,
) -> Result<Option<Found>, RecordingError> {
    const MATRICES: [&str; 9] = [
        "intrinsic_matrix",
        "intrinsics",
        "intrinsic",
        "camera_intrinsics",
        "camera_matrix",
        "cam_k",
        "k",
        "matrix",
        "data",
    ];
    let Value::Object(object) = value else {
        if let (Value::Array(list), true) = (value, depth < MAX_DEPTH) {
            let first = list.iter().find(|item| item.is_object());
            return first.map_or(Ok(None), |item| find_focal(item, place, notes, depth + 1));
        }
        return Ok(None);
    };
    let with_size = |focal| Found {
        focal,
        size: size_in(object),
    };
    if let Some(focal) = named_focal(object, place)? {
        return Ok(Some(with_size(focal)));
    }
    for name in MATRICES {
        if let Some(numbers) = get(object, &[name]).and_then(flat)
            && let Some(focal) = focal_from_numbers(&numbers, name, place, notes)?
        {
            return Ok(Some(with_size(focal)));
        }
    }
    if depth == MAX_DEPTH {
        return Ok(None);
    }
    // Objects of the colour camera come first, those of the depth camera last.
    let rank = |name: &str| {
        let name = name.to_ascii_lowercase();
        match () {
            () if ["color", "colour", "rgb"].iter().any(|c| name.contains(c)) => 0,
            () if ["depth", "infra", "ir"].iter().any(|d| name.starts_with(d)) => 2,
            () => 1,
        }
    };
    let mut children: Vec<(&String, &Value)> = object.iter().collect();
    children.sort_by_key(|(name, _)| rank(name));
    for (_, child) in children {
        if let Some(mut found) = find_focal(child, place, notes, depth + 1)? {
            if found.size == (None, None) {
                found.size = size_in(object);
            }
            return Ok(Some(found));
        }
    }
    Ok(None)
}

/// Focal lengths and principal point by their names; an error if only some of them are present.
fn named_focal(
    object: &Map<String, Value>,
    place: &Place,
) -> Result<Option<[f64; 4]>, RecordingError> {
    const FX: &[&str] = &[
        "fx",
        "fl_x",
        "f_x",
        "focal_x",
        "focal_length_x",
        "focallengthx",
    ];
    const FY: &[&str] = &[
        "fy",
        "fl_y",
        "f_y",
        "focal_y",
        "focal_length_y",
        "focallengthy",
    ];
    const CX: &[&str] = &[
        "cx",
        "ppx",
        "c_x",
        "principal_point_x",
        "principalpointx",
        "px",
    ];
    const CY: &[&str] = &[
        "cy",
        "ppy",
        "c_y",
        "principal_point_y",
        "principalpointy",
        "py",
    ];
    let one = |names| get(object, names).and_then(as_number);
    let two = |names| get(object, names).and_then(pair);
    let focal = two(&["focal_length", "focallength", "focal", "f"]);
    let centre = two(&[
        "principal_point",
        "principalpoint",
        "center",
        "centre",
        "c",
        "pp",
    ]);
    let numbers = [
        one(FX).or(focal.map(|f| f[0])),
        one(FY).or(focal.map(|f| f[1])),
        one(CX).or(centre.map(|c| c[0])),
        one(CY).or(centre.map(|c| c[1])),
    ];
    match numbers {
        [Some(fx), Some(fy), Some(cx), Some(cy)] => Ok(Some([fx, fy, cx, cy])),
        // One focal length for both axes, as in nerfstudio and COLMAP.
        [Some(fx), None, Some(cx), Some(cy)] => Ok(Some([fx, fx, cx, cy])),
        [Some(_), _, cx, cy] => {
            let missing = if cx.is_none() { "cx" } else { "cy" };
            let missing = if cx.is_some() && cy.is_some() {
                "fy"
            } else {
                missing
            };
            let got = format!("missing field `{missing}`");
            let expected = "\"fx\", \"fy\", \"cx\", \"cy\"";
            Err(place.clone().field("intrinsics", expected, got))
        }
        _ => Ok(None),
    }
}

/// Intrinsics from a list of numbers: four numbers, or a 3x3, 3x4 or 4x4 matrix. `None` for any other count.
fn focal_from_numbers(
    numbers: &[f64],
    field: &str,
    place: &Place,
    notes: &mut Vec<String>,
) -> Result<Option<[f64; 4]>, RecordingError> {
    let m: [[f64; 3]; 3] = match *numbers {
        // Four numbers of any other field may have another meaning.
        [fx, fy, cx, cy] if field.contains("intrinsic") || field == "k" => {
            return Ok(Some([fx, fy, cx, cy]));
        }
        [a, b, c, d, e, f, g, h, i] => [[a, b, c], [d, e, f], [g, h, i]],
        [a, b, c, _, d, e, f, _, g, h, i, _] => [[a, b, c], [d, e, f], [g, h, i]],
        [a, b, c, _, d, e, f, _, g, h, i, _, ..] if numbers.len() == 16 => {
            [[a, b, c], [d, e, f], [g, h, i]]
        }
        _ => return Ok(None),
    };
    let by_columns = m[2][0] != 0.0 || m[2][1] != 0.0;
    let rows = if by_columns { transposed(m) } else { m };
    // Open3D's field is column-major, all others are row-major.
    if !by_columns && field == "intrinsic_matrix" && (m[0][2] != 0.0 || m[1][2] != 0.0) {
        notes.push(format!(
            "\"{field}\" looks row-major (Open3D writes columns) and is read that way."
        ));
    } else if by_columns && field != "intrinsic_matrix" {
        notes.push(format!(
            "\"{field}\" looks column-major and is read that way."
        ));
    }
    focal_from_matrix(&rows, place, notes).map(Some)
}

fn transposed(m: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|c| [m[0][c], m[1][c], m[2][c]])
}

/// Intrinsics from a row-major 3x3 matrix, which must be that of a pinhole; a small skew is ignored with a note.
pub(super) fn focal_from_matrix(
    m: &[[f64; 3]; 3],
    place: &Place,
    notes: &mut Vec<String>,
) -> Result<[f64; 4], RecordingError> {
    let zeros = [m[1][0], m[2][0], m[2][1], m[2][2] - 1.0];
    let skew = m[0][1];
    let small_skew = skew.abs() <= MAX_SKEW * m[0][0].abs();
    if !small_skew || !zeros.iter().all(|z| z.abs() <= 1e-6) {
        return Err(place.clone().field(
            "intrinsics matrix",
            "fx 0 cx, 0 fy cy, 0 0 1",
            format!("{m:?}"),
        ));
    }
    // Smaller values are rounding errors of matrix products.
    if skew.abs() > 1e-6 {
        notes.push(format!("a skew of {skew} px is left out."));
    }
    check_focal([m[0][0], m[1][1], m[0][2], m[1][2]], place)
}

/// The size of the pictures, under any of its names.
fn size_in(object: &Map<String, Value>) -> (Option<u32>, Option<u32>) {
    let whole = |number: f64| {
        let fits = number.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&number);
        fits.then_some(number as u32)
    };
    let one = |names| get(object, names).and_then(as_number).and_then(whole);
    let (width, height) = (
        one(&["width", "w", "image_width", "img_width", "imagewidth"]),
        one(&["height", "h", "image_height", "img_height", "imageheight"]),
    );
    if width.is_some() || height.is_some() {
        return (width, height);
    }
    match get(object, &["image_size", "imagesize", "resolution", "size"]) {
        Some(Value::Object(nested)) => size_in(nested),
        Some(value) => pair(value).map_or((None, None), |[w, h]| (whole(w), whole(h))),
        None => (None, None),
    }
}

/// Depth units per metre, from units per metre or metres per unit anywhere in a document.
fn find_units(value: &Value, depth: usize) -> Option<f64> {
    let Value::Object(object) = value else {
        return None;
    };
    let here = [
        "depth_units_per_metre",
        "depth_scale",
        "depth_factor",
        "depthmapfactor",
    ]
    .iter()
    .find_map(|name| as_number(get(object, &[name])?));
    if here.is_some() || depth == MAX_DEPTH {
        return here;
    }
    object
        .values()
        .find_map(|child| find_units(child, depth + 1))
}

/// The value of the first of some names (in lower case) that exists; names are compared without regard to case.
fn get<'a>(object: &'a Map<String, Value>, names: &[&str]) -> Option<&'a Value> {
    names.iter().find_map(|name| {
        let found = object
            .iter()
            .find(|(key, _)| key.eq_ignore_ascii_case(name));
        found
            .map(|(_, value)| value)
            .filter(|value| !value.is_null())
    })
}

fn as_number(value: &Value) -> Option<f64> {
    match value {
        Value::Number(number) => number.as_f64(),
        Value::String(text) => number(text.trim()),
        _ => None,
    }
}

/// Two numbers, or one number for both.
fn pair(value: &Value) -> Option<[f64; 2]> {
    match value {
        Value::Array(list) => match list.as_slice() {
            [a, b] => Some([as_number(a)?, as_number(b)?]),
            _ => None,
        },
        Value::Object(object) => {
            let of = |name| get(object, &[name]).and_then(as_number);
            Some([of("x")?, of("y")?])
        }
        one => as_number(one).map(|x| [x, x]),
    }
}

/// Numbers of a matrix, flat or by rows, or in OpenCV's `{"data": [...]}`.
fn flat(value: &Value) -> Option<Vec<f64>> {
    // More than any camera matrix has.
    const MAX: usize = 16;
    match value {
        Value::Array(list) if list.len() <= MAX => {
            let mut numbers = Vec::new();
            for item in list {
                match item {
                    Value::Array(row) if row.len() <= MAX => {
                        let row: Option<Vec<f64>> = row.iter().map(as_number).collect();
                        numbers.extend(row?);
                    }
                    one => numbers.push(as_number(one)?),
                }
            }
            Some(numbers)
        }
        Value::Object(object) => flat(get(object, &["data"]).filter(|data| data.is_array())?),
        _ => None,
    }
}
