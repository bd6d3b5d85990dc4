//! A frame allocates its picture, but nothing that grows with the number of pixels or rays.

use std::path::Path;

use ghostlight::frame::RgbdFrame;
use ghostlight::ghost::DepthPlanes;
use ghostlight::recording::{OpenOptions, Recording};
use ghostlight::render::{Backend, Engine, RenderSettings, Renderer};
use ghostlight::scene::{PlacementFrame, SceneDocument};

#[global_allocator]
static ALLOCATOR: dhat::Alloc = dhat::Alloc;

/// Number of counted frames.
const COUNTED: u64 = 6;

/// Allowed allocations per frame for passing work to the thread pool: its queue grows in blocks of some dozen jobs,
/// and a frame has about a dozen jobs.
const QUEUE_BLOCKS: u64 = 8;
const QUEUE_BYTES: u64 = 16 * 1024;

#[test]
fn frames_allocate_their_picture_once_buffers_have_grown() {
    let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings");
    let recording = Recording::open(&recordings.join("desk"), &OpenOptions::default()).unwrap();
    let frames: Vec<RgbdFrame> = (0..2).map(|i| recording.frame(i).unwrap()).collect();
    let mut settings = RenderSettings::default();
    settings.glare.enabled = true;
    settings.caustics.enabled = Some(true);
    settings.caustics.photons = 20_000;
    let ghost = settings.ghost;
    let surface = DepthPlanes::new(&frames[0].depth, &frames[0].intrinsics, &ghost);
    let (document, folder) =
        SceneDocument::load(&recordings.join("scenes/materials.json")).unwrap();
    let frame = PlacementFrame {
        frame: &frames[0],
        surface: &surface,
    };
    let (scene, _) = document.resolve(&folder, &frame).unwrap();
    // A pinhole, and a lens that blurs everything.
    for radius_m in [0.0, 0.01] {
        settings.lens.radius_m = radius_m;
        settings.lens.focus_m = 0.5;
        // A single thread: with more threads, it depends on timing which thread renders the most demanding tile, and
        // its buffers may still grow.
        let engine = Engine::new(Backend::Cpu, 1, || 0).unwrap();
        let mut renderer = engine.renderer(&scene).unwrap();
        check(&mut renderer, &frames, &settings);
    }
}

/// Counts the allocations of frames.
fn check(renderer: &mut Renderer, frames: &[RgbdFrame], settings: &RenderSettings) {
    let picture = frames[0].color.rgba.len() as u64 * 4;
    for frame in frames {
        renderer.render(frame, settings, &[]).expect("a frame");
    }
    let _profiler = dhat::Profiler::builder().testing().build();
    for k in 0..COUNTED {
        let rendered = renderer
            .render(&frames[k as usize % 2], settings, &[])
            .expect("a frame");
        assert!(rendered.stats.virtual_pixels > 1000);
        assert!(settings.caustics.enabled != Some(true) || rendered.stats.photons_stored > 1000);
    }
    let stats = dhat::HeapStats::get();
    let (blocks, bytes) = (stats.total_blocks / COUNTED, stats.total_bytes / COUNTED);
    assert!(
        blocks <= 1 + QUEUE_BLOCKS && bytes <= picture + QUEUE_BYTES,
        "lens of {} m: {blocks} allocations of {bytes} bytes a frame, its picture has {picture} bytes",
        settings.lens.radius_m
    );
}
