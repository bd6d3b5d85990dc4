//! NaN, infinity, denormal numbers and -0.0 in every input.

use glam::{DVec3, Vec3};
use serde_json::Value;

use super::frames::{PIXELS, SIDE, ball, differing, frame, render};
use super::{HardCase, Worst};
use ghostlight::camera::{Intrinsics, Pose};
use ghostlight::frame::{DepthImage, is_valid_depth};
use ghostlight::render::RenderSettings;
use ghostlight::scene::{Light, Preset, SceneDocument};

const NOT_FINITE: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

/// Finite values at the ends of the range.
const EXTREME: [f64; 8] = [-0.0, 5e-324, 1e-310, 1e-45, 1e39, -1e39, 1e300, f64::MIN];

pub(super) const DEPTH: HardCase = HardCase {
    name: "input: depth of NaN, infinity, -0.0, denormal, negative",
    why: "If such a value is read as a distance, it produces a false surface.",
    bound: "none counts as a measurement; the frame is the same as with holes at these pixels",
    check: |_| {
        let bad = [
            f32::NAN,
            -f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            0.0,
            -0.0,
            1e-45,
            f32::MIN_POSITIVE,
            -2.0,
            f32::MAX,
            0.999e-3,
            1.001e4,
        ];
        let mut worst = Worst::default();
        for z in bad {
            worst.require(!is_valid_depth(z), || format!("{z} counts as depth"));
            let map = DepthImage::from_metres(1, 1, vec![z]);
            worst.require(map.z_m[0].is_nan(), || {
                format!("{z} is kept as {}", map.z_m[0])
            });
        }
        for unit in [0, u16::MAX] {
            let map = DepthImage::from_units(1, 1, &[unit], 1e-300, f32::INFINITY);
            worst.require(map.z_m[0].is_nan(), || {
                format!("unit {unit} counts as depth")
            });
        }
        let scene = ball(DVec3::new(0.0, 0.0, 1.5), 0.25, Preset::Glass, Vec::new());
        let composite = |fill: &dyn Fn(usize) -> f32| {
            let mut input = frame(Pose::IDENTITY);
            let z_m = (0..input.depth.z_m.len())
                .map(|i| if i % 3 == 0 { fill(i / 3) } else { 2.0 })
                .collect();
            input.depth = DepthImage::from_metres(SIDE, SIDE, z_m);
            render(&scene, &input, &RenderSettings::default())
        };
        let holes = composite(&|_| DepthImage::INVALID)?;
        let spoiled = composite(&|k| bad[k % bad.len()])?;
        worst.require(holes.color == spoiled.color, || {
            "the kind of hole shows".into()
        });
        worst.told(format!("{} kinds, one outcome", bad.len()))
    },
};

pub(super) const CAMERA: HardCase = HardCase {
    name: "input: intrinsics of NaN, infinity, denormal, enormous",
    why: "A focal length that f32 cannot hold makes every ray NaN.",
    bound: "refused with the field's name, or the ray of every pixel is finite and not behind the camera",
    check: |_| {
        let mut worst = Worst::default();
        for field in 0..4 {
            for bad in NOT_FINITE.into_iter().chain(EXTREME) {
                let mut k = [100.0, 100.0, 50.0, 40.0];
                k[field] = bad;
                let name = ["fx", "fy", "cx", "cy"][field];
                match Intrinsics::new(k[0], k[1], k[2], k[3], 100, 80) {
                    Err(error) => {
                        let told = error.to_string();
                        worst.require(told.contains(name), || format!("{name} {bad:e}: {told}"));
                    }
                    Ok(camera) => {
                        worst.require(bad.is_finite(), || format!("{name} {bad:e} is accepted"));
                        for (u, v) in [(0.0, 0.0), (99.0, 0.0), (0.0, 79.0), (50.0, 40.0)] {
                            let d = camera.ray_direction(u, v);
                            // The square of its length must be finite as well, because rays are normalized.
                            let fine = d.length_squared().is_finite() && d.z == 1.0;
                            worst.require(fine, || format!("{name} {bad:e}: ray {d}"));
                        }
                    }
                }
            }
        }
        for (width, height) in [(0, 1), (1, 0), (u32::MAX, 1), (8193, 1)] {
            let refused = Intrinsics::new(1.0, 1.0, 0.0, 0.0, width, height).is_err();
            worst.require(refused, || format!("{width}x{height} is accepted"));
        }
        worst.told("refused by name, or usable")
    },
};

pub(super) const POSE: HardCase = HardCase {
    name: "input: poses of NaN, infinity, denormal, enormous, mirrored, sheared",
    why: "One NaN in a pose puts every object at NaN.",
    bound: "refused with the field's name, or a frame within 1 code of the unmoved one (except 1 pixel of 1000) or, from far away, \
            equal to the camera's",
    check: |_| {
        let mut worst = Worst::default();
        for bad in NOT_FINITE {
            for k in 0..4 {
                let mut q = [0.0, 0.0, 0.0, 1.0];
                q[k] = bad;
                let refused = Pose::from_quaternion(q, [0.0; 3]).is_err();
                worst.require(refused, || format!("quaternion {q:?} is accepted"));
            }
            for k in 0..3 {
                let mut t = [0.0; 3];
                t[k] = bad;
                let refused = Pose::from_quaternion([0.0, 0.0, 0.0, 1.0], t).is_err();
                worst.require(refused, || format!("translation {t:?} is accepted"));
                let mut rows = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
                rows[k][k] = bad;
                let refused = Pose::from_rows(rows, [0.0; 3]).is_err();
                worst.require(refused, || format!("rotation {rows:?} is accepted"));
            }
        }
        for rows in [
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]],
            [[1.0, 0.5, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            [[0.0; 3]; 3],
        ] {
            let refused = Pose::from_rows(rows, [0.0; 3]).is_err();
            worst.require(refused, || format!("rotation {rows:?} is accepted"));
        }
        let light = Light::Sphere {
            position: DVec3::new(0.0, -1.0, 0.5),
            radius_m: 0.1,
            intensity: Vec3::splat(3.0),
        };
        let scene = ball(
            DVec3::new(0.0, 0.0, 1.5),
            0.25,
            Preset::Plastic,
            vec![light],
        );
        let settings = RenderSettings::default();
        let here = render(&scene, &frame(Pose::IDENTITY), &settings)?;
        for x in EXTREME {
            let Ok(pose) = Pose::from_quaternion([-0.0, 0.0, -0.0, 1.0], [x, -0.0, 0.0]) else {
                continue;
            };
            let input = frame(pose);
            let rendered = render(&scene, &input, &settings)?;
            // A large offset moves every object out of view. A denormal offset only changes ties between
            // triangles that share an edge, which look the same up to rounding.
            let n = if x.abs() < 1.0 {
                differing(&rendered, &here, 1) as u64
            } else {
                u64::from(rendered.color != input.color) * PIXELS
            };
            worst.require(n * 1000 <= PIXELS, || {
                format!("translation {x:e}: {n} of {PIXELS} pixels")
            });
        }
        worst.told("refused by name, or rendered")
    },
};

/// Every number of a JSON value, as the path to it.
fn numbers(value: &Value, path: &[String], found: &mut Vec<Vec<String>>) {
    let below = |key: String| path.iter().cloned().chain([key]).collect::<Vec<_>>();
    match value {
        Value::Number(_) => found.push(path.to_vec()),
        Value::Array(items) => {
            for (i, item) in items.iter().enumerate() {
                numbers(item, &below(i.to_string()), found);
            }
        }
        Value::Object(fields) => {
            for (key, field) in fields {
                numbers(field, &below(key.clone()), found);
            }
        }
        _ => {}
    }
}

/// The value's text with the number at `path` replaced by `token`, which need not be valid JSON.
fn spoil(value: &Value, path: &[String], token: &str) -> String {
    let mut value = value.clone();
    let mut at = &mut value;
    for key in path {
        at = match at {
            Value::Array(items) => &mut items[key.parse::<usize>().unwrap_or(0)],
            other => &mut other[key.as_str()],
        };
    }
    *at = Value::String("\u{1}".into());
    value.to_string().replace("\"\\u0001\"", token)
}

/// Texts that are not numbers, or that no f32 can hold.
const NO_NUMBERS: [&str; 6] = ["NaN", "Infinity", "1e999", "-1e999", "1e39", "-1e300"];

pub(super) const SETTINGS: HardCase = HardCase {
    name: "input: every setting NaN, infinite, beyond f32, -0.0, denormal",
    why: "A NaN compares false with both ends of its range.",
    bound: "refused, or the frame is rendered without black pixels",
    check: |_| {
        let mut worst = Worst::default();
        let defaults =
            serde_json::to_value(RenderSettings::default()).map_err(|e| e.to_string())?;
        let mut paths = Vec::new();
        numbers(&defaults, &[], &mut paths);
        let read = |text: &str| {
            serde_json::from_str::<RenderSettings>(text)
                .ok()
                .filter(|settings| settings.validate().is_ok())
        };
        let scene = ball(DVec3::new(0.0, 0.0, 1.5), 0.25, Preset::Plastic, Vec::new());
        let input = frame(Pose::IDENTITY);
        for path in &paths {
            for token in NO_NUMBERS {
                // 1e39 and -1e300 are numbers, but out of range for every setting.
                let accepted = read(&spoil(&defaults, path, token));
                worst.require(accepted.is_none(), || {
                    format!("{} = {token} is accepted", path.join("."))
                });
            }
            for token in ["-0.0", "1e-45", "1e-310"] {
                if let Some(settings) = read(&spoil(&defaults, path, token)) {
                    let rendered = render(&scene, &input, &settings)?;
                    let black = rendered
                        .color
                        .rgba
                        .iter()
                        .filter(|p| p[..3] == [0; 3])
                        .count();
                    worst.require(black == 0, || {
                        format!("{} = {token}: {black} black pixels", path.join("."))
                    });
                }
            }
        }
        let fields: [fn(&mut RenderSettings) -> &mut f32; 12] = [
            |s| &mut s.ghost.edge_relative,
            |s| &mut s.ghost.edge_sigmas,
            |s| &mut s.ghost.occlusion_sigmas,
            |s| &mut s.ghost.bias_sigmas,
            |s| &mut s.edge_contrast,
            |s| &mut s.lod_error_px,
            |s| &mut s.bloom.threshold,
            |s| &mut s.bloom.knee,
            |s| &mut s.bloom.intensity,
            |s| &mut s.glare.threshold,
            |s| &mut s.glare.attenuation,
            |s| &mut s.glare.intensity,
        ];
        for (k, field) in fields.into_iter().enumerate() {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0] {
                let mut settings = RenderSettings::default();
                *field(&mut settings) = bad;
                worst.require(settings.validate().is_err(), || {
                    format!("field {k} = {bad} is accepted")
                });
            }
        }
        worst.told(format!("{} settings", paths.len()))
    },
};

/// A document that contains every number a scene can have.
const DOCUMENT: &str = r#"{"version":1,
 "objects":[
  {"mesh":"a.ply","place":{"frame":"world","translation":[0.5,0.5,0.5],"rotation":[0,0,0,1],"scale":[0.5,0.5,0.5]},
   "material":{"base_color":[0.5,0.5,0.5],"metallic":0.5,"roughness":0.5,"transmission":0.5,"ior":1.5,
    "emissive":[0.5,0.5,0.5],"attenuation_color":[0.5,0.5,0.5],"attenuation_distance_m":0.5}},
  {"mesh":"a.ply","place":{"frame":"pixel","pixel":[10.5,10.5],"size_m":0.5}}],
 "lights":[
  {"type":"sphere","frame":"first_camera","position":[0.5,0.5,0.5],"radius":0.5,"intensity":[0.5,0.5,0.5]},
  {"type":"directional","direction":[0.5,0.5,0.5],"irradiance":[0.5,0.5,0.5],"angular_radius_deg":0.5}],
 "environment":{"map":"a.hdr","intensity":0.5,"rotation_deg":0.5}}"#;

pub(super) const SCENE: HardCase = HardCase {
    name: "input: every number of a scene NaN, infinite, beyond f32, null, -0.0, denormal",
    why: "Scenes are written by hand or exported by arbitrary programs.",
    bound: "numbers out of the range of f32 are refused with the field's name; others are read or refused",
    check: |_| {
        let document: Value = serde_json::from_str(DOCUMENT).map_err(|e| e.to_string())?;
        SceneDocument::parse(DOCUMENT, "scene").map_err(|e| e.to_string())?;
        let mut paths = Vec::new();
        numbers(&document, &[], &mut paths);
        let mut worst = Worst::default();
        for path in &paths {
            let field = path.iter().rev().find(|key| key.parse::<usize>().is_err());
            let field = field.map_or("", String::as_str);
            for token in NO_NUMBERS {
                let told = SceneDocument::parse(&spoil(&document, path, token), "scene").err();
                let told = told.map(|error| error.to_string());
                // Invalid JSON is reported with line and column instead of the field.
                let named = |t: &String| t.contains(field) || t.contains("line");
                worst.require(told.as_ref().is_some_and(named), || {
                    format!("{} = {token}: {told:?}", path.join("."))
                });
            }
            for token in ["null", "-0.0", "1e-310", "1e-45"] {
                // Must return without a panic; the result does not matter.
                let _ = SceneDocument::parse(&spoil(&document, path, token), "scene");
                worst.trials += 1;
            }
        }
        // A direction is normalized or refused, however small it is.
        for tiny in [[1e-310, 0.0, 0.0], [1e-160; 3], [-0.0; 3]] {
            let text = format!(
                r#"{{"version":1,"objects":[],"lights":[{{"type":"directional","direction":{tiny:?},"irradiance":[1,1,1]}}]}}"#
            );
            let read = SceneDocument::parse(&text, "scene");
            worst.require(read.is_err(), || format!("direction {tiny:?} is accepted"));
        }
        worst.told(format!("{} numbers", paths.len()))
    },
};
