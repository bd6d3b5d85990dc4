//! Whole frames of the bundled recording, stage by stage, for the most expensive settings:
//! `cargo bench -p ghostlight --bench frame [-- FRAMES]`. Medians in milliseconds; only rows of the same run are
//! comparable.

use std::path::Path;

use ghostlight::clock::render_clock as clock;
use ghostlight::frame::RgbdFrame;
use ghostlight::ghost::DepthPlanes;
use ghostlight::numerics::percentile;
use ghostlight::recording::{OpenOptions, Recording};
use ghostlight::render::{Backend, Engine, RenderSettings, ShadowMethod, Stage, Traversal};
use ghostlight::scene::{PicturePoint, PlacementFrame, Scene, SceneDocument};

fn median_ms(mut ns: Vec<u64>) -> f64 {
    ns.sort_unstable();
    percentile(&ns, 0.5).map_or(0.0, |ns| ns as f64 / 1e6)
}

fn scene(name: &str, first: &RgbdFrame, settings: &RenderSettings) -> Scene {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../recordings/scenes")
        .join(name);
    let surface = DepthPlanes::new(&first.depth, &first.intrinsics, &settings.ghost);
    let (document, folder) = SceneDocument::load(&path).expect("a bundled scene");
    let frame = PlacementFrame {
        frame: first,
        surface: &surface,
    };
    document.resolve(&folder, &frame).expect("it resolves").0
}

fn main() {
    let n = std::env::args()
        .filter_map(|arg| arg.parse().ok())
        .next()
        .unwrap_or(24usize);
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../recordings/desk");
    let recording =
        Recording::open(&folder, &OpenOptions::default()).expect("the bundled recording");
    let frames: Vec<RgbdFrame> = (0..n.clamp(1, recording.len()))
        .map(|i| recording.frame(i).expect("a bundled frame"))
        .collect();

    let default = RenderSettings::default();
    let with_shadows = |method| {
        let mut settings = default;
        settings.shadows.method = method;
        settings
    };
    let with_traversal = |traversal| {
        let mut settings = default;
        settings.ghost.traversal = traversal;
        settings
    };
    let engine = Engine::new(Backend::Auto, 0, clock).expect("render threads");
    let rows = [
        ("teapot", "teapot.json", default),
        (
            "  shadows off",
            "teapot.json",
            with_shadows(ShadowMethod::Off),
        ),
        (
            "  shadows hard",
            "teapot.json",
            with_shadows(ShadowMethod::Hard),
        ),
        (
            "  shadows naive",
            "teapot.json",
            with_shadows(ShadowMethod::Naive),
        ),
        (
            "  no bounces",
            "teapot.json",
            RenderSettings {
                max_bounces: 0,
                ..default
            },
        ),
        (
            "  one ray a pixel",
            "teapot.json",
            RenderSettings {
                edge_samples: 1,
                ..default
            },
        ),
        ("  dda", "teapot.json", with_traversal(Traversal::Dda)),
        (
            "  bresenham",
            "teapot.json",
            with_traversal(Traversal::Bresenham),
        ),
        ("materials", "materials.json", default),
        ("empty", "empty.json", default),
    ];
    print!("{:<18}", "ms, median");
    for stage in Stage::ALL {
        print!(" {:>13}", stage.name());
    }
    println!(" {:>8}", "total");
    for (name, file, settings) in rows {
        let scene = scene(file, &frames[0], &settings);
        let mut renderer = engine.renderer(&scene).expect("render threads");
        // Buffers grow on the first frame.
        renderer
            .render(&frames[0], &settings, &[])
            .expect("not cancelled");
        let done: Vec<_> = frames
            .iter()
            .map(|frame| {
                renderer
                    .render(frame, &settings, &[])
                    .expect("not cancelled")
            })
            .collect();
        print!("{name:<18}");
        for stage in Stage::ALL {
            let ns = done.iter().map(|r| r.stage_ns[stage as usize]).collect();
            print!(" {:>13.3}", median_ms(ns));
        }
        println!(
            " {:>8.2}",
            median_ms(done.iter().map(|r| r.total_ns).collect())
        );
    }
    println!("{:<18} {:>13.3}", "click", click_ms(&frames, &default));
}

/// Cost of a click before the next frame: finding the object's new place in the frame, and updating a renderer.
fn click_ms(frames: &[RgbdFrame], settings: &RenderSettings) -> f64 {
    let engine = Engine::new(Backend::Auto, 0, clock).expect("render threads");
    let mut scene = scene("teapot.json", &frames[0], settings);
    let mut renderer = engine.renderer(&scene).expect("render threads");
    let clicks = frames.iter().map(|frame| {
        let start = clock();
        let surface = DepthPlanes::new(&frame.depth, &frame.intrinsics, &settings.ghost);
        let placement = PlacementFrame {
            frame,
            surface: &surface,
        };
        let middle = [frame.color.width, frame.color.height].map(|n| f64::from(n) * 0.5);
        let placed = scene.objects[0]
            .at(PicturePoint::Pixel(middle), &placement)
            .expect("the desk was measured");
        scene.put(0, &placed);
        for i in scene.objects[0].instances.clone() {
            renderer.set_transform(i, scene.instances[i].world_from_object);
        }
        clock() - start
    });
    median_ms(clicks.collect())
}
