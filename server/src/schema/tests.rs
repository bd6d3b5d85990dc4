use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use super::*;

/// What a schema has against a value: the first fault and its path. As much of the 2020-12
/// vocabulary as these schemas use; an unknown keyword is a fault of the test.
fn fault(root: &Value, schema: &Value, value: &Value, at: &str) -> Option<String> {
    let schema = match schema {
        Value::Bool(true) => return None,
        Value::Bool(false) => return Some(format!("{at}: not allowed")),
        schema => schema.as_object().unwrap(),
    };
    let wrong = |what: &str| Some(format!("{at}: {what}"));
    let number = value.as_f64();
    for (keyword, rule) in schema {
        let found = match keyword.as_str() {
            "$schema" | "writeOnly" | "title" | "description" | "format" | "default" | "$defs" => {
                None
            }
            "$ref" => {
                let path = rule.as_str().unwrap().strip_prefix('#').unwrap();
                fault(root, root.pointer(path).unwrap(), value, at)
            }
            "type" => {
                let is = |name: &Value| match name.as_str().unwrap() {
                    "null" => value.is_null(),
                    "boolean" => value.is_boolean(),
                    "number" => value.is_number(),
                    "integer" => value.is_u64() || value.is_i64(),
                    "string" => value.is_string(),
                    "array" => value.is_array(),
                    "object" => value.is_object(),
                    other => panic!("type {other}"),
                };
                let fits = match rule {
                    Value::Array(names) => names.iter().any(is),
                    name => is(name),
                };
                if fits {
                    None
                } else {
                    wrong(&format!("not of type {rule}"))
                }
            }
            "enum" => match rule.as_array().unwrap().contains(value) {
                true => None,
                false => wrong("not one of the values"),
            },
            "const" => {
                if rule == value {
                    None
                } else {
                    wrong("another value")
                }
            }
            "minimum" => match number {
                Some(x) if x < rule.as_f64().unwrap() => wrong("too small"),
                _ => None,
            },
            "maximum" => match number {
                Some(x) if x > rule.as_f64().unwrap() => wrong("too large"),
                _ => None,
            },
            "minItems" | "maxItems" => {
                let n = value.as_array().map_or(0, Vec::len) as u64;
                let bound = rule.as_u64().unwrap();
                let broken =
                    (keyword == "minItems" && n < bound) || (keyword == "maxItems" && n > bound);
                if value.is_array() && broken {
                    wrong("length")
                } else {
                    None
                }
            }
            "items" => value.as_array().and_then(|items| {
                let mut items = items.iter().enumerate();
                items.find_map(|(i, item)| fault(root, rule, item, &format!("{at}[{i}]")))
            }),
            "anyOf" | "oneOf" => {
                let fits = |rule: &Value| fault(root, rule, value, at).is_none();
                match rule.as_array().unwrap().iter().any(fits) {
                    true => None,
                    false => wrong("none of the forms"),
                }
            }
            "required" => value.as_object().and_then(|object| {
                let mut names = rule.as_array().unwrap().iter();
                let missing = names.find(|name| !object.contains_key(name.as_str().unwrap()));
                missing.and_then(|name| wrong(&format!("{name} is missing")))
            }),
            "properties" => value.as_object().and_then(|object| {
                object.iter().find_map(|(name, value)| {
                    fault(root, rule.get(name)?, value, &format!("{at}.{name}"))
                })
            }),
            "additionalProperties" => {
                assert_eq!(*rule, json!(false));
                let known = schema.get("properties").cloned().unwrap_or_default();
                value.as_object().and_then(|object| {
                    let unknown = object.keys().find(|name| known.get(name).is_none())?;
                    wrong(&format!("{unknown} is unknown"))
                })
            }
            other => panic!("keyword {other} at {at}"),
        };
        if found.is_some() {
            return found;
        }
    }
    None
}

fn check(schema: &Schema, value: &Value) -> Option<String> {
    let root = schema.clone().to_value();
    fault(&root, &root, value, "")
}

fn bundled(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../recordings")
        .join(folder);
    let entries = std::fs::read_dir(folder).unwrap();
    entries.map(|entry| entry.unwrap().path()).collect()
}

fn read(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

#[test]
fn bundled_files_keep_to_the_schemas() {
    for (folder, schema) in [("scenes", scene()), ("settings", settings())] {
        let files = bundled(folder);
        assert!(files.len() >= 2, "{folder}");
        for file in files {
            assert_eq!(check(&schema, &read(&file)), None, "{}", file.display());
        }
    }
}

/// A document that uses every field of its types.
fn everything() -> Value {
    json!({
        "$schema": "scene.schema.json",
        "version": 1,
        "objects": [{
            "name": "a", "mesh": "a.obj", "up": "z", "ghost": true,
            "place": {"frame": "pixel", "translation": [0, 0, 1], "rotation": [0, 0, 0, 1],
                      "scale": [1, 2, 3], "pixel": [3, 4]},
            "material": {"preset": "gold", "base_color": 0.5, "metallic": 1, "roughness": 0.1,
                         "transmission": 0, "ior": 1.5, "thin": false, "emissive": [0, 1, 2],
                         "attenuation_color": 1, "attenuation_distance_m": 0.1}},
            {"mesh": "b.obj", "place": {"frame": "surface", "picture": [0.5, 1], "size_m": 0.2}}],
        "lights": [
            {"type": "sphere", "frame": "world", "position": [0, 1, 2], "radius": 0, "intensity": 4},
            {"type": "directional", "direction": [0, 1, 0], "irradiance": [1, 1, 1],
             "angular_radius_deg": 0.3}],
        "environment": {"map": "a.hdr", "intensity": 2, "up": [0, 1, 0], "rotation_deg": 90},
        "settings": settings_of_all(),
    })
}

fn settings_of_all() -> Value {
    let mut value = serde_json::to_value(RenderSettings::default()).unwrap();
    value["$schema"] = "settings.schema.json".into();
    value["lens"]["focus_px"] = json!([1, 2]);
    // Numbers as people write them, not as f32 become f64: 0.95 is within 0.95.
    value["glare"]["attenuation"] = json!(0.92);
    value
}

#[test]
fn schemas_hold_every_field_and_agree_with_the_reader() {
    let document = everything();
    assert_eq!(check(&scene(), &document), None);
    SceneDocument::parse(&document.to_string(), "scene").unwrap();
    assert_eq!(check(&settings(), &settings_of_all()), None);
    let reads: RenderSettings = serde_json::from_value(settings_of_all()).unwrap();
    reads.validate().unwrap();
    // Every property of the schema is one of the document: none is promised and not read.
    let root = scene().to_value();
    let mut names = Vec::new();
    collect(&root, &mut names);
    let text = document.to_string();
    for name in names {
        // A marker is read, and refused with a reason.
        let marker = ["marker", "family", "id"].contains(&name.as_str());
        assert!(marker || text.contains(&format!("\"{name}\":")), "{name}");
    }
}

/// Names of all properties.
fn collect(schema: &Value, into: &mut Vec<String>) {
    match schema {
        Value::Object(fields) => {
            for (keyword, value) in fields {
                if let ("properties", Some(properties)) = (keyword.as_str(), value.as_object()) {
                    into.extend(properties.keys().cloned());
                }
                collect(value, into);
            }
        }
        Value::Array(items) => items.iter().for_each(|item| collect(item, into)),
        _ => {}
    }
}

#[test]
fn what_the_reader_refuses_the_schema_refuses() {
    for (path, value) in [
        ("/version", json!(2)),
        ("/objects/0/material/ior", json!(0.5)),
        ("/objects/0/material/preset", json!("silver")),
        ("/objects/0/place/scale", json!([1, 2])),
        ("/objects/1/place/picture", json!([0.5, 1.5])),
        ("/objects/1/place/size_m", json!(-1)),
        ("/lights/0/radius", json!(-1)),
        ("/environment/intensity", json!(-1)),
        ("/environment", json!(3)),
        ("/settings/max_bounces", json!(9)),
        ("/settings/lens/samples", json!(0)),
        ("/settings/shadows/method", json!("none")),
    ] {
        let mut document = everything();
        *document.pointer_mut(path).unwrap() = value;
        assert!(check(&scene(), &document).is_some(), "{path}");
        let read = SceneDocument::parse(&document.to_string(), "scene");
        assert!(read.is_err(), "{path}");
    }
    let mut document = everything();
    document["objects"][0]["colour"] = json!("red");
    assert_eq!(
        check(&scene(), &document).unwrap(),
        ".objects[0]: colour is unknown"
    );
}

#[test]
fn settings_have_the_ranges_that_are_checked() {
    for (path, beyond) in [
        ("/ghost/edge_relative", json!(1.1)),
        ("/shadows/samples", json!(4)),
        ("/caustics/photons", json!(999)),
        ("/caustics/radius_m", json!(0.2)),
        ("/glossy_samples", json!(65)),
        ("/lod_error_px", json!(17)),
        ("/bloom/levels", json!(9)),
        ("/bloom/threshold", json!(-1)),
        ("/glare/passes", json!(0)),
        ("/budget_ms", json!(20000)),
        ("/lens/focus_px", json!([-1, 0])),
    ] {
        let mut value = settings_of_all();
        *value.pointer_mut(path).unwrap() = beyond;
        assert!(check(&settings(), &value).is_some(), "{path}");
        let read: RenderSettings = serde_json::from_value(value).unwrap();
        assert!(read.validate().is_err(), "{path}");
    }
}

#[test]
fn an_environment_may_be_a_file_alone() {
    let document = json!({"version": 1, "environment": "sky.hdr"});
    assert_eq!(check(&scene(), &document), None);
    let read = SceneDocument::parse(&document.to_string(), "scene").unwrap();
    let whole = json!({"version": 1, "environment": {"map": "sky.hdr"}});
    let whole = SceneDocument::parse(&whole.to_string(), "scene").unwrap();
    assert_eq!(read.environment, whole.environment);
    // Errors inside the object still name their field.
    let slip = r#"{"version": 1, "environment": {"map": "sky.hdr", "intensty": 1}}"#;
    let error = SceneDocument::parse(slip, "s").unwrap_err().to_string();
    assert!(
        error.contains("environment.intensty") && error.contains("did you mean"),
        "{error}"
    );
}
