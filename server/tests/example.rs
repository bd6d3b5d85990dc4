//! The example of the documentation, compiled and run.

#![allow(clippy::unwrap_used, reason = "a test: a panic is its verdict")]

#[path = "../examples/render.rs"]
#[allow(dead_code, reason = "main is the example's own")]
mod render;

use std::path::Path;

#[test]
fn the_example_renders_a_frame_with_the_teapot_in_it() {
    let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings");
    let folder = tempfile::tempdir().unwrap();
    let picture = |scene: &str| {
        let path = folder.path().join("frame.png");
        render::render(
            &recordings.join("desk"),
            &recordings.join("scenes").join(scene),
            &path,
        )
        .unwrap();
        image::open(path).unwrap().to_rgb8()
    };
    let [empty, teapot] = ["empty.json", "teapot.json"].map(picture);
    assert_eq!(teapot.dimensions(), (640, 480));
    let changed = empty.pixels().zip(teapot.pixels()).filter(|(a, b)| a != b);
    let changed = changed.count();
    assert!((5_000..200_000).contains(&changed), "{changed} pixels");
}
