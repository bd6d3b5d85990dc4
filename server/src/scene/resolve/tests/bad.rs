//! Documents that cannot be used.

use super::*;

#[test]
fn every_bad_document_gives_one_line_that_names_the_field() {
    let place = |fields: &str| object(&format!("\"place\": {{{fields}}}"));
    let light = |fields: &str| format!("{{\"version\": 1, \"lights\": [{{{fields}}}]}}");
    let cases = [
        (
            "{\"version\": 2, \"new\": 1}".to_owned(),
            "version: expected 1, got 2",
        ),
        ("{}".to_owned(), "missing field \"version\""),
        ("[".to_owned(), "not JSON: EOF"),
        (
            object("\"materail\": {}"),
            "objects[0].materail: unknown field, did you mean \"material\"?",
        ),
        (
            object("\"material\": {\"preset\": \"miror\"}"),
            "objects[0].material.preset: unknown value \"miror\", did you mean \"mirror\"?",
        ),
        (
            object("\"material\": {\"roughness\": 1.5}"),
            "objects[0].material.roughness: expected a number from 0 to 1, got 1.5",
        ),
        (
            object("\"material\": {\"base_color\": [1, 2, 1]}"),
            "objects[0].material.base_color[1]: expected a number from 0 to 1, got 2",
        ),
        (
            object("\"material\": {\"base_color\": [1, 1]}"),
            "objects[0].material.base_color: invalid length 2, expected a number or an array of 3 numbers",
        ),
        (
            object("\"material\": {\"base_color\": [1, 1, 1, 1]}"),
            "objects[0].material.base_color: invalid length 4",
        ),
        (
            object("\"material\": {\"ior\": 0.9}"),
            "objects[0].material.ior: expected a number from 1 to 5, got 0.9",
        ),
        (
            object("\"ghost\": 1"),
            "objects[0].ghost: invalid type: integer \"1\", expected a boolean",
        ),
        (
            object("\"marker\": {\"family\": \"tag36h11\", \"id\": 3, \"size_m\": 0.08}"),
            "objects[0].marker: objects that follow a marker are not supported",
        ),
        (
            object("\"marker\": {\"family\": \"tag36h11\", \"id\": 3, \"size_m\": -1}"),
            "objects[0].marker.size_m: expected a number from 0.001 to 10, got -1",
        ),
        (
            place("\"rotation\": [0, 0, 0, 0]"),
            "objects[0].place.rotation: expected a unit quaternion [x, y, z, w], got [0.0, 0.0, 0.0, 0.0] of length 0.0000",
        ),
        (
            place("\"rotation\": [0, 0, 0]"),
            "objects[0].place.rotation: invalid length 3",
        ),
        (
            place("\"scale\": 0"),
            "objects[0].place.scale: expected a number other than 0",
        ),
        (
            place("\"scale\": \"big\""),
            "objects[0].place.scale: invalid type: string \"big\", expected a number or an array of 3 numbers",
        ),
        (
            place("\"scale\": 1, \"size_m\": 1"),
            "objects[0].place: expected scale or size_m, got both",
        ),
        (
            place("\"translation\": [1e300, 0, 0]"),
            "objects[0].place.translation[0]: expected a number from -1000000000 to 1000000000",
        ),
        (
            place("\"translation\": [1e999, 0, 0]"),
            "objects[0].place.translation[0]: ",
        ),
        (
            place("\"frame\": \"camera\""),
            "objects[0].place.frame: unknown value \"camera\", did you mean \"first_camera\"?",
        ),
        (
            place("\"frame\": \"pixel\""),
            "objects[0].place.pixel: missing",
        ),
        (
            place("\"frame\": \"world\", \"pixel\": [1, 1]"),
            "objects[0].place.pixel: expected no pixel unless",
        ),
        (
            place("\"pixel\": [640, 50]"),
            "objects[0].place.pixel: expected a pixel of the 100x80 image, got (640, 50)",
        ),
        (
            "{\"version\": 1, \"objects\": [{\"mesh\": \"none.obj\"}]}".to_owned(),
            "objects[0].mesh: ",
        ),
        (
            "{\"version\": 1, \"objects\": [{\"mesh\": \"sky.hdr\"}]}".to_owned(),
            "objects[0].mesh: ",
        ),
        (
            "{\"version\": 1, \"objects\": [{\"mesh\": \"\"}]}".to_owned(),
            "objects[0].mesh: expected the path",
        ),
        (
            "{\"version\": 1, \"objects\": [{}]}".to_owned(),
            "objects[0]: missing field \"mesh\"",
        ),
        (
            light("\"type\": \"spot\""),
            "lights[0].type: unknown value \"spot\"",
        ),
        (
            light("\"type\": \"sphere\", \"intensity\": 1"),
            "lights[0].position: missing; a sphere light needs it",
        ),
        (
            light("\"type\": \"sphere\", \"position\": [0, 0, 0], \"intensity\": -1"),
            "lights[0].intensity[0]: expected a number from 0",
        ),
        (
            light(
                "\"type\": \"sphere\", \"position\": [0, 0, 0], \"intensity\": 1, \"direction\": [0, 0, 1]",
            ),
            "lights[0].direction: a sphere light has no such field",
        ),
        (
            light("\"type\": \"directional\", \"direction\": [0, 0, 0], \"irradiance\": 1"),
            "lights[0].direction: expected a direction",
        ),
        (
            "{\"version\": 1, \"environment\": {\"map\": \"none.hdr\"}}".to_owned(),
            "environment.map: ",
        ),
        (
            "{\"version\": 1, \"environment\": {\"map\": \"brick.obj\"}}".to_owned(),
            "environment.map: ",
        ),
        (
            "{\"version\": 1, \"environment\": {\"map\": \"sky.hdr\", \"intensity\": -1}}"
                .to_owned(),
            "environment.intensity: expected",
        ),
        (
            "{\"version\": 1, \"environment\": {\"map\": \"sky.hdr\", \"up\": [0, 0, 0]}}"
                .to_owned(),
            "environment.up: expected a direction",
        ),
    ];
    for (text, expected) in cases {
        let error = resolve(&text).unwrap_err().to_string();
        assert!(
            error.starts_with(&format!("scene.json: {expected}")),
            "{error}\n   against {expected}"
        );
        assert!(!error.contains('\n'), "{error}");
    }
    let many = vec!["{\"mesh\": \"brick.obj\"}"; SceneDocument::MAX_OBJECTS + 1].join(",");
    let error = resolve(&format!("{{\"version\": 1, \"objects\": [{many}]}}")).unwrap_err();
    assert_eq!(
        error.to_string(),
        "scene.json: objects: expected at most 10000, got 10001"
    );
}
