//! Placements that work for any recording: shares of the picture, holes, and objects without a given place or size.

use super::*;

/// The note that contains `words`; a failure shows all notes.
fn note<'a>(notes: &'a [String], words: &str) -> &'a str {
    let found = notes.iter().find(|note| note.contains(words));
    found.unwrap_or_else(|| panic!("{words:?} in {notes:?}"))
}

fn document(objects: &[&str]) -> String {
    let objects = objects.join(", ");
    format!("{{\"version\": 1, \"objects\": [{objects}]}}")
}

/// Centre of each instance's base, in the first camera's axes.
fn feet(scene: &Scene) -> Vec<DVec3> {
    let (frame, _) = floor();
    let camera_from_world = frame.pose.inverse();
    let foot = DVec3::new(0.5, 0.0, 2.0);
    let instances = scene.instances.iter();
    instances
        .map(|i| camera_from_world.transform_point(i.world_from_object.transform_point3(foot)))
        .collect()
}

#[test]
fn shares_of_the_picture_are_pixels_of_any_size() {
    let at = |place: &str| {
        let text = object(&format!("\"place\": {{{place}, \"size_m\": 0.1}}"));
        corners(&resolve(&text).unwrap().0)
    };
    // Pixel centres are whole numbers: (60 + 0.5) / 100, (50 + 0.5) / 80.
    let share = at("\"picture\": [0.605, 0.63125]");
    assert_eq!(share, at("\"pixel\": [60, 50]"));
    let level = at("\"frame\": \"surface\", \"picture\": [0.605, 0.63125]");
    assert_eq!(level, share);
    for (place, words) in [
        (
            "\"picture\": [0.5, 1.01]",
            "place.picture[1]: expected a number from 0 to 1",
        ),
        (
            "\"picture\": [0.5, 1], \"pixel\": [1, 1]",
            "expected pixel or picture, got both",
        ),
        (
            "\"picture\": [0.5, 1], \"frame\": \"world\"",
            "expected no picture unless",
        ),
    ] {
        let text = object(&format!("\"place\": {{{place}}}"));
        let error = resolve(&text).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
    // The corner of the picture is the last pixel.
    let text = object("\"place\": {\"picture\": [1, 1], \"size_m\": 0.1}");
    assert!(resolve(&text).is_ok());
}

#[test]
fn in_a_hole_the_nearest_measured_point_is_taken() {
    let hole = object("\"place\": {\"pixel\": [3, 50], \"size_m\": 0.1}");
    let beside = object("\"place\": {\"pixel\": [10, 50], \"size_m\": 0.1}");
    let (scene, notes) = resolve(&hole).unwrap();
    assert!(
        note(&notes, "nothing was measured").contains("(10, 50)"),
        "{notes:?}"
    );
    let (there, notes) = resolve(&beside).unwrap();
    assert_eq!(corners(&scene), corners(&there));
    assert!(
        notes.iter().all(|n| !n.contains("nothing was measured")),
        "{notes:?}"
    );
}

#[test]
fn a_mesh_without_a_document_stands_in_the_lower_middle_in_a_plausible_size() {
    let folder = folder();
    let (first_frame, surface) = floor();
    let placement = PlacementFrame {
        frame: &first_frame,
        surface: &surface,
    };
    let (document, base) = SceneDocument::load(&folder.path().join("brick.obj")).unwrap();
    let (scene, notes) = document.resolve(&base, &placement).unwrap();
    assert!(
        note(&notes, "brick is 4.00 m wide").contains("--size"),
        "{notes:?}"
    );
    let c = corners(&scene);
    // A length of 4 becomes 0.25; its base is on the floor, its height along the floor's normal.
    assert!(((c[4] - c[0]).length() - FIT_SIZE_M).abs() < 1e-9);
    assert!((c[0].dot(surface.normal) - surface.point.dot(surface.normal)).abs() < 1e-9);
    assert!((c[3] - c[0]).try_normalize().unwrap().dot(surface.normal) > 1.0 - 1e-9);
    let foot = feet(&scene)[0];
    let k = first_frame.intrinsics;
    let pixel = [k.fx * foot.x / foot.z + k.cx, k.fy * foot.y / foot.z + k.cy];
    assert!(
        (pixel[0] - 49.5).abs() < 1e-6 && (pixel[1] - 51.5).abs() < 1e-6,
        "{pixel:?}"
    );
    // A plausible size is kept.
    std::fs::write(
        folder.path().join("small.obj"),
        "v 0 0 0\nv .3 0 0\nv 0 .1 0\nf 1 2 3\n",
    )
    .unwrap();
    let (document, base) = SceneDocument::load(&folder.path().join("small.obj")).unwrap();
    let (_, notes) = document.resolve(&base, &placement).unwrap();
    note(&notes, "small is 0.30 m wide, as in its file");
    // A document sent to another process has the size written into it.
    let (mut document, base) = SceneDocument::load(&folder.path().join("brick.obj")).unwrap();
    document.settle_sizes(&base).unwrap();
    assert_eq!(document.objects[0].place.size_m, Some(FIT_SIZE_M));
    // An error about the mesh is about its file alone.
    let missing = folder.path().join("missing.glb");
    let (document, base) = SceneDocument::load(&missing).unwrap();
    let error = document.resolve(&base, &placement).unwrap_err().to_string();
    assert!(error.starts_with(&missing.display().to_string()), "{error}");
}

#[test]
fn objects_without_room_move_together() {
    let brick = |x: f64| {
        format!(
            "{{\"mesh\": \"brick.obj\", \"place\": {{\"frame\": \"surface\", \"picture\": [{x}, 0.6], \"size_m\": 0.1}}}}"
        )
    };
    // One of them overlaps the hole.
    let (scene, notes) = resolve(&document(&[&brick(0.02), &brick(0.3)])).unwrap();
    note(&notes, "nearest level surface with room");
    let (_, surface) = floor();
    let feet = feet(&scene);
    for foot in &feet {
        assert!(
            (foot - surface.point).dot(surface.normal).abs() < 1e-9,
            "{feet:?}"
        );
    }
    // They keep their order and distance in shares of the picture.
    let apart = feet[1] - feet[0];
    assert!(
        (apart.length() - 0.28 * 1.5).abs() < 1e-6 && apart.x > 0.0,
        "{feet:?}"
    );
    // At one point they would overlap.
    let (scene, _) = resolve(&document(&[&brick(0.5), &brick(0.501)])).unwrap();
    let feet = super::own_place::feet(&scene);
    assert!(feet[0].distance(feet[1]) > 0.005, "{feet:?}");
    // If all requested places are good, nothing is moved.
    let (_, notes) = resolve(&document(&[&brick(0.3), &brick(0.6)])).unwrap();
    assert!(
        notes.iter().all(|note| !note.contains("nearest")),
        "{notes:?}"
    );
}

/// A wall straight ahead, with nothing else.
struct Wall(Intrinsics);

impl Surface for Wall {
    fn plane_at(&self, u: f32, v: f32, _radius_px: f32) -> Option<(DVec3, DVec3)> {
        let point = self.0.unproject(f64::from(u), f64::from(v), 2.0);
        Some((point, DVec3::NEG_Z))
    }
}

#[test]
fn without_a_level_surface_any_will_do_and_without_any_it_is_an_error() {
    let folder = folder();
    let (mut frame, _) = floor();
    let wall = Wall(frame.intrinsics);
    frame.depth = DepthImage::from_metres(100, 80, vec![2.0; 8000]);
    let (document, base) = SceneDocument::load(&folder.path().join("brick.obj")).unwrap();
    let placement = PlacementFrame {
        frame: &frame,
        surface: &wall,
    };
    let (_, notes) = document.resolve(&base, &placement).unwrap();
    note(&notes, "as none with room is level");
    struct Nothing;
    impl Surface for Nothing {
        fn plane_at(&self, _: f32, _: f32, _: f32) -> Option<(DVec3, DVec3)> {
            None
        }
    }
    let placement = PlacementFrame {
        surface: &Nothing,
        ..placement
    };
    let error = document.resolve(&base, &placement).unwrap_err().to_string();
    assert!(error.contains("no measured surface"), "{error}");
}

#[test]
fn implausible_sizes_and_a_camera_inside_are_noted() {
    let (_, notes) = resolve(&object("\"place\": {\"pixel\": [60, 50]}")).unwrap();
    note(
        &notes,
        "brick is 4.00 m wide; place.size_m sets its largest side",
    );
    // A model of the room keeps its size.
    let (_, notes) = resolve(&object("\"ghost\": true")).unwrap();
    assert!(notes.iter().all(|note| !note.contains("wide")), "{notes:?}");
    let centred = "\"frame\": \"first_camera\", \"translation\": [-0.5, 1, 2], \"scale\": 1";
    let (_, notes) = resolve(&object(&format!("\"place\": {{{centred}}}"))).unwrap();
    note(
        &notes,
        "The camera starts inside brick, which is 4.00 m wide",
    );
    let beside = centred.replace("-0.5", "0.1");
    let (_, notes) = resolve(&object(&format!("\"place\": {{{beside}}}"))).unwrap();
    assert!(
        notes.iter().all(|note| !note.contains("inside")),
        "{notes:?}"
    );
}

#[test]
fn a_scene_may_carry_settings() {
    let text = |settings: &str| {
        format!("{{\"$schema\": \"s.json\", \"version\": 1, \"settings\": {settings}}}")
    };
    let document = SceneDocument::parse(&text("{\"caustics\": {\"enabled\": true}}"), "s").unwrap();
    let settings = document.settings.unwrap();
    assert!(settings.caustics.enabled == Some(true) && settings.max_bounces == 5);
    for (settings, words) in [
        (
            "{\"max_bounces\": 9}",
            "settings.max_bounces: expected 0 to 8, got 9",
        ),
        ("{\"max_bonces\": 2}", "did you mean \"max_bounces\"?"),
    ] {
        let error = SceneDocument::parse(&text(settings), "s")
            .unwrap_err()
            .to_string();
        assert!(error.contains(words), "{error}");
    }
}
