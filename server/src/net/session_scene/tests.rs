use std::fmt::Write as _;

use super::*;
use crate::camera::{Intrinsics, Pose};
use crate::frame::{ColorImage, DepthImage};
use crate::render::Backend;

/// Writes a wavy surface of `2 side^2` triangles.
fn write_mesh(path: &std::path::Path, side: usize) {
    let mut text = String::new();
    for (x, y) in (0..=side).flat_map(|x| (0..=side).map(move |y| (x as f64, y as f64))) {
        writeln!(text, "v {x} {} {y}", (0.3 * x).sin()).unwrap();
    }
    let vertex = |x: usize, y: usize| x * (side + 1) + y + 1;
    for (x, y) in (0..side).flat_map(|x| (0..side).map(move |y| (x, y))) {
        let [a, b] = [vertex(x, y), vertex(x, y + 1)];
        let [c, d] = [vertex(x + 1, y), vertex(x + 1, y + 1)];
        writeln!(text, "f {a} {b} {d}\nf {a} {d} {c}").unwrap();
    }
    std::fs::write(path, text).unwrap();
}

/// Frame of a wall 2 m away whose right half is 30 cm farther.
fn frame() -> RgbdFrame {
    let (width, height) = (640, 480);
    let z = (0..width * height).map(|i| if i % width < width / 2 { 2.0 } else { 2.3 });
    RgbdFrame {
        index: 0,
        time_ns: 0,
        color: ColorImage::filled(width, height, [90, 90, 90, 255]),
        depth: DepthImage::from_metres(width, height, z.collect()),
        intrinsics: Intrinsics::new(500.0, 500.0, 319.5, 239.5, width, height).unwrap(),
        pose: Pose::IDENTITY,
    }
}

/// A loaded scene whose document file no longer exists.
fn loaded(place: &str, settings: &RenderSettings) -> Box<dyn SceneRenderer> {
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene.json");
    write_mesh(&folder.path().join("sheet.obj"), 60);
    let text = format!(
        r#"{{"version": 1, "objects": [{{"mesh": "sheet.obj", "place": {{{place}, "size_m": 0.2}}}}]}}"#
    );
    std::fs::write(&scene, text).unwrap();
    let shared = Shared {
        scenes: Arc::new([("scene".to_owned(), OfferedScene::File(scene))]),
        engine: Engine::new(Backend::Cpu, 1, crate::clock::render_clock).unwrap(),
        max_triangles: 1_000_000,
        memory: Budget::unlimited(),
        uploads: Arc::default(),
    };
    let mut session = SessionScene::new(shared).unwrap();
    let load = session
        .begin_scene(&SceneChoice::Name("scene".to_owned()), &Assets::new())
        .unwrap();
    let loaded = load.run(&frame(), settings, &Arc::default()).unwrap();
    folder.close().unwrap();
    loaded
}

fn translation(scene: &dyn SceneRenderer) -> [f64; 3] {
    scene.objects()[0].stands.unwrap().pose.translation
}

#[test]
fn a_click_moves_an_object_whose_files_are_gone() {
    let settings = RenderSettings::default();
    let world = "\"frame\": \"world\", \"translation\": [9, 9, 9]";
    let mut scene = loaded(world, &settings);
    assert_eq!(translation(&*scene), [9.0, 9.0, 9.0]);
    let there = loaded("\"pixel\": [100, 300]", &settings);
    let note = scene.place("sheet", [100.0, 300.0], &frame(), &settings);
    assert_eq!(note, Ok(None));
    assert_eq!(translation(&*scene), translation(&*there));
    // A turn is kept.
    scene.turn("sheet", 0.5).unwrap();
    let turned = scene.objects()[0].stands.unwrap();
    scene
        .place("sheet", [150.0, 100.0], &frame(), &settings)
        .unwrap();
    scene
        .place("sheet", [100.0, 300.0], &frame(), &settings)
        .unwrap();
    let again = scene.objects()[0].stands.unwrap();
    assert_eq!(again.turned, 0.5);
    let pairs = turned
        .pose
        .translation
        .into_iter()
        .zip(again.pose.translation);
    for (a, b) in pairs.chain(
        turned
            .pose
            .quaternion
            .into_iter()
            .zip(again.pose.quaternion),
    ) {
        assert!((a - b).abs() < 1e-9, "{turned:?} {again:?}");
    }
    let error = scene
        .place("cup", [1.0, 1.0], &frame(), &settings)
        .unwrap_err();
    assert!(error.to_string().contains("[\"sheet\"]"), "{error}");
    let error = scene
        .place("sheet", [640.0, 1.0], &frame(), &settings)
        .unwrap_err();
    assert_eq!(error.code, Code::Object);
    assert!(error.to_string().contains("640x480"), "{error}");
    assert_eq!(scene.objects()[0].stands, Some(again));
}

#[test]
fn where_surfaces_end_is_the_users_setting() {
    // Near the step, a plane fitted across it would be tilted.
    let mut joined = RenderSettings::default();
    joined.ghost.edge_relative = 0.5;
    let apart = RenderSettings::default();
    let mut scene = loaded("\"pixel\": [318, 240]", &apart);
    let at_edge = translation(&*scene);
    assert_ne!(
        at_edge,
        translation(&*loaded("\"pixel\": [318, 240]", &joined))
    );
    scene
        .place("sheet", [318.0, 240.0], &frame(), &apart)
        .unwrap();
    assert_eq!(at_edge, translation(&*scene));
    scene
        .place("sheet", [318.0, 240.0], &frame(), &joined)
        .unwrap();
    let joined = loaded("\"pixel\": [318, 240]", &joined);
    assert_eq!(translation(&*scene), translation(&*joined));
}
