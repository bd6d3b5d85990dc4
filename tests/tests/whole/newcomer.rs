//! A new user's first steps: placing a mesh with one command, without JSON.

use crate::stage::{Stage, fail, ghostlight, hashes, succeed};

/// The notes that a successful command prints on stderr.
fn notes(stage: &Stage, args: &[&str]) -> String {
    String::from_utf8(succeed(stage.path(), args).stderr).expect("notes are text")
}

#[test]
fn an_object_needs_no_document() {
    let stage = Stage::new();
    let one = [
        "replay",
        "recording",
        "--object",
        "cube.obj",
        "--frames",
        "0..2",
    ];
    let told = notes(&stage, &[&one[..], &["--out", "film.mp4"]].concat());
    assert!(stage.path().join("film.mp4").is_file());
    // The cube is 1 m or larger in its file; a note says that it was scaled.
    assert!(
        told.contains("cube is") && told.contains("--size"),
        "{told}"
    );
    // Given as the scene, the mesh gives the same picture.
    let frames = ["--frames", "0..2", "--out", "a"];
    let object = hashes(&stage.report(&[&["--object", "cube.obj"], &frames[..]].concat()));
    let scene = hashes(&stage.report(&[&["--scene", "cube.obj"], &frames[..]].concat()));
    assert_eq!(object, scene);
    // The flags for size, material and place have an effect.
    let more = ["--size", "0.1", "--material", "gold", "--place", "50%,60%"];
    for n in [2, 4, 6] {
        let args = [&["--object", "cube.obj"], &more[..n], &frames].concat();
        assert_ne!(hashes(&stage.report(&args)), object, "{:?}", &more[..n]);
    }
    // Without --object they apply to the scene's first object.
    let scene = ["--scene", "scene.json"];
    let plain = hashes(&stage.report(&[&scene, &frames[..]].concat()));
    let gold = hashes(&stage.report(&[&scene, &["--material", "gold"], &frames[..]].concat()));
    assert_ne!(plain, gold);
    // With both, the object is added to the scene.
    let both = [&scene, &["--object", "cube.obj"], &frames[..]].concat();
    assert_ne!(hashes(&stage.report(&both)), plain);
}

#[test]
fn what_cannot_be_is_one_line() {
    let stage = Stage::new();
    let replay = ["replay", "recording", "--out", "out"];
    for (args, words) in [
        (&["--object", "missing.glb"][..], &["missing.glb"][..]),
        (&["--object", "scene.json"], &["scene.json", "mesh"]),
        (
            &["--object", "cube.obj", "--material", "silver"],
            &["silver", "gold"],
        ),
        (
            &["--object", "cube.obj", "--place", "120%,5%"],
            &["0% to 100%"],
        ),
        (
            &["--object", "cube.obj", "--place", "9999,5"],
            &["pixel", "161x121"],
        ),
        (
            &["--scene", "empty.json", "--size", "1"],
            &["--size", "--object"],
        ),
        (&[], &["--scene"]),
    ] {
        let told = fail(stage.path(), &[&replay, args].concat());
        for word in words {
            assert!(told.contains(word), "{args:?}: {told}");
        }
    }
}

#[test]
fn a_scene_brings_its_settings_and_the_command_line_wins() {
    let stage = Stage::new();
    let with = |settings: &str| {
        let text = std::fs::read_to_string(stage.path().join("scene.json")).expect("a scene");
        let text = text.replacen(
            "\"version\":1,",
            &format!("\"version\":1,\"settings\":{settings},"),
            1,
        );
        stage.write("with.json", &text);
    };
    let frames = ["--frames", "0..1", "--out", "a"];
    let report = |args: &[&str]| hashes(&stage.report(&[args, &frames].concat()));
    stage.write("off.json", r#"{"$schema":"s","shadows":{"method":"off"}}"#);
    stage.write("defaults.json", "{}");
    let plain = report(&["--scene", "scene.json"]);
    let off = report(&["--scene", "scene.json", "--settings", "off.json"]);
    assert_ne!(plain, off);
    with(r#"{"shadows":{"method":"off"}}"#);
    assert_eq!(report(&["--scene", "with.json"]), off);
    assert_eq!(
        report(&["--scene", "with.json", "--settings", "defaults.json"]),
        plain
    );
}

#[test]
fn presets_and_schemas_are_printed() {
    let stage = Stage::new();
    let said = |args: &[&str]| {
        let output = ghostlight(stage.path(), args);
        assert!(output.status.success(), "{args:?}");
        String::from_utf8(output.stdout).expect("text")
    };
    let presets = said(&["presets"]);
    assert!(
        presets.lines().any(|line| line.starts_with("gold ")),
        "{presets}"
    );
    for (of, field) in [("scene", "environment"), ("settings", "max_bounces")] {
        let schema: serde_json::Value = serde_json::from_str(&said(&["schema", of])).expect("JSON");
        assert!(schema["properties"][field].is_object(), "{schema}");
        assert!(
            schema["$schema"]
                .as_str()
                .is_some_and(|s| s.contains("2020-12"))
        );
    }
}
