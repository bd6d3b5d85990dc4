//! Renders the first frame of a recording, with a scene placed into it, to a PNG:
//!
//! ```sh
//! cargo run --release -p ghostlight --example render -- recordings/desk recordings/scenes/teapot.json frame.png
//! ```

use std::error::Error;
use std::path::Path;

use ghostlight::clock::render_clock;
use ghostlight::ghost::DepthPlanes;
use ghostlight::recording::{OpenOptions, Recording};
use ghostlight::render::{Backend, Engine};
use ghostlight::replay::png_of;
use ghostlight::scene::{PlacementFrame, SceneDocument};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [recording, scene, picture] = arguments.as_slice() else {
        return Err("expected RECORDING SCENE PICTURE.png".into());
    };
    render(recording.as_ref(), scene.as_ref(), picture.as_ref())
}

/// Renders the first frame of `recording` with the scene document or mesh `scene` into `picture`.
pub(crate) fn render(recording: &Path, scene: &Path, picture: &Path) -> Result<(), Box<dyn Error>> {
    // Recordings are read frame by frame: colour, depth registered to it, intrinsics and pose.
    let recording = Recording::open(recording, &OpenOptions::default())?;
    let frame = recording.frame(0)?;

    // A document becomes a scene after its meshes are loaded and its objects are placed. This needs a frame, because
    // placements may refer to the real surface at a pixel of it.
    let (document, folder) = SceneDocument::load(scene)?;
    let settings = document.settings.unwrap_or_default();
    let surface = DepthPlanes::new(&frame.depth, &frame.intrinsics, &settings.ghost);
    let placement = PlacementFrame {
        frame: &frame,
        surface: &surface,
    };
    let (scene, notes) = document.resolve(&folder, &placement)?;
    for note in notes {
        eprintln!("note: {note}");
    }

    // A renderer keeps data for several frames, such as BVHs: create one per scene. The last argument lists images
    // beside the composite.
    let n_threads = 0; // One per core.
    let engine = Engine::new(Backend::Auto, n_threads, render_clock)?;
    let mut renderer = engine.renderer(&scene)?;
    let rendered = renderer.render(&frame, &settings, &[])?;
    std::fs::write(picture, png_of(&rendered.color)?)?;
    Ok(())
}
