//! Time between the cancellation of a frame and its return, at many moments of the frame, for the most expensive
//! settings of each stage: `cargo bench -p ghostlight --bench cancel [-- MOMENTS] [PART OF A NAME]`.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use ghostlight::camera::{Intrinsics, Pose};
use ghostlight::clock::render_clock as clock;
use ghostlight::frame::{ColorImage, DepthImage, RgbdFrame};
use ghostlight::render::{
    Backend, BloomMethod, BloomSettings, CausticSettings, Checkpoint, Engine, GlareSettings,
    LensSettings, RenderSettings, ShadowMethod, ShadowSettings,
};
use ghostlight::scene::{Instance, Light, Material, Mesh, Scene};
use glam::{DAffine3, DVec3, Vec3};

/// Longest measured time of a frame.
const LONGEST: Duration = Duration::from_secs(6);

/// Cancels a frame at a given time.
struct Until(AtomicU64);

impl Checkpoint for Until {
    fn go_on(&self) -> bool {
        clock() < self.0.load(Ordering::Relaxed)
    }
}

/// A wavy wall with holes and a picture of noise: the worst case for compression and for conservative tests.
fn frame(width: u32, height: u32) -> RgbdFrame {
    let hash = |i: u32| {
        i.wrapping_mul(0x9E37_79B9)
            .rotate_left(13)
            .wrapping_mul(0x85EB_CA6B)
    };
    let pixels = 0..width * height;
    let depth = |i: u32| match hash(i) % 50 {
        0 => DepthImage::INVALID,
        noise => 1.8 + 0.2 * (i % width) as f32 / width as f32 + noise as f32 * 1e-4,
    };
    let rgba = |i: u32| [hash(i) as u8, hash(i + 1) as u8, hash(i + 2) as u8, 255];
    let (w, h) = (f64::from(width), f64::from(height));
    let camera = Intrinsics::new(0.8 * w, 0.8 * w, w / 2.0, h / 2.0, width, height);
    RgbdFrame {
        index: 0,
        time_ns: 0,
        color: ColorImage {
            width,
            height,
            rgba: pixels.clone().map(rgba).collect(),
        },
        depth: DepthImage::from_metres(width, height, pixels.map(depth).collect()),
        intrinsics: camera.expect("a camera"),
        pose: Pose::IDENTITY,
    }
}

/// `n` glass cubes before the camera, and `n_lights` lights above.
fn cubes(n: usize, n_lights: usize) -> Scene {
    let corner = |i: u32| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
    let faces = [
        [0, 2, 3, 1],
        [4, 5, 7, 6],
        [0, 1, 5, 4],
        [2, 6, 7, 3],
        [0, 4, 6, 2],
        [1, 3, 7, 5],
    ];
    let mesh = Mesh {
        positions: (0..8).map(corner).collect(),
        triangles: faces
            .iter()
            .flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]])
            .collect(),
        ..Mesh::default()
    };
    let side = (n as f64).cbrt().ceil();
    let cube = |i: usize| {
        let along = |stride: f64| (i as f64 / stride).floor() % side / side - 0.5;
        let place = DVec3::new(along(1.0), along(side), along(side * side) + 1.2);
        Instance {
            name: format!("cube {i}"),
            mesh: 0,
            material: 0,
            world_from_object: DAffine3::from_translation(place)
                * DAffine3::from_scale(DVec3::splat(0.5 / side)),
            ghost: false,
        }
    };
    let light = |i: usize| Light::Sphere {
        position: DVec3::new(
            0.05 * (i % 40) as f64 - 1.0,
            -0.8,
            0.2 + 0.08 * (i / 40) as f64,
        ),
        radius_m: 0.05,
        intensity: Vec3::splat(0.5 / n_lights as f32),
    };
    Scene {
        meshes: vec![Arc::new(mesh)],
        materials: vec![Material {
            transmission: 1.0,
            roughness: 0.0,
            ior: 1.5,
            ..Material::default()
        }],
        instances: (0..n).map(cube).collect(),
        lights: (0..n_lights).map(light).collect(),
        ..Scene::default()
    }
}

fn main() {
    let engine = Engine::new(Backend::Auto, 0, clock).expect("render threads");
    let moments = std::env::args()
        .filter_map(|arg| arg.parse().ok())
        .next()
        .unwrap_or(40u64);
    // Cargo adds its own flag, which is skipped.
    let part = std::env::args()
        .skip(1)
        .find(|arg| !arg.starts_with('-') && arg.parse::<u64>().is_err());
    let plain = RenderSettings {
        bloom: BloomSettings {
            enabled: false,
            ..BloomSettings::default()
        },
        ..RenderSettings::default()
    };
    // Cheap early stages, so that a frame reaches its last stages.
    let cheap = RenderSettings {
        shadows: ShadowSettings {
            method: ShadowMethod::Off,
            ..ShadowSettings::default()
        },
        max_bounces: 0,
        edge_samples: 1,
        ..plain
    };
    let glare = RenderSettings {
        glare: GlareSettings {
            enabled: true,
            passes: 5,
            samples: 16,
            threshold: 0.0,
            ..GlareSettings::default()
        },
        ..cheap
    };
    let bloom = |method| RenderSettings {
        bloom: BloomSettings {
            enabled: true,
            method,
            levels: 8,
            threshold: 0.0,
            ..BloomSettings::default()
        },
        ..cheap
    };
    let photons = RenderSettings {
        caustics: CausticSettings {
            enabled: Some(true),
            photons: 4_000_000,
            radius_m: 0.1,
        },
        ..plain
    };
    let most = RenderSettings {
        shadows: ShadowSettings {
            method: ShadowMethod::Naive,
            samples: 256,
            filter_radius_px: 4,
            ..ShadowSettings::default()
        },
        lens: LensSettings {
            radius_m: 0.1,
            samples: 256,
            noise_threshold: 0.0,
            ..LensSettings::default()
        },
        max_bounces: 8,
        glossy_samples: 64,
        edge_samples: 64,
        edge_contrast: 0.0,
        lod_error_px: 0.0,
        caustics: photons.caustics,
        glare: glare.glare,
        bloom: bloom(BloomMethod::Gaussians).bloom,
        ..plain
    };
    let (vga, phone, largest) = ((640, 480), (1920, 1440), (4096, 3072));
    for (what, size, scene, settings) in [
        ("one cube, 4096x3072", largest, cubes(1, 1), cheap),
        ("largest glare, 1920x1440", phone, cubes(8, 1), glare),
        ("largest glare, 4096x3072", largest, cubes(8, 1), glare),
        (
            "bloom of Gaussians, 4096x3072",
            largest,
            cubes(8, 1),
            bloom(BloomMethod::Gaussians),
        ),
        (
            "bloom of a pyramid, 4096x3072",
            largest,
            cubes(8, 1),
            bloom(BloomMethod::Pyramid),
        ),
        ("4 million photons, 640x480", vga, cubes(8, 4), photons),
        (
            "4 million photons, 3000 cubes, 1000 lights",
            vga,
            cubes(3000, 1000),
            photons,
        ),
        ("200,000 cubes", vga, cubes(200_000, 1), cheap),
        ("1000 lights, 1920x1440", phone, cubes(27, 1000), plain),
        (
            "everything, 3000 cubes, 1000 lights",
            vga,
            cubes(3000, 1000),
            most,
        ),
        ("everything, 4096x3072", largest, cubes(3000, 1000), most),
    ] {
        if part.as_ref().is_some_and(|part| !what.contains(part)) {
            continue;
        }
        let frame = frame(size.0, size.1);
        let mut renderer = engine.renderer(&scene).expect("a scene");
        let until = Until(AtomicU64::new(clock() + LONGEST.as_nanos() as u64));
        let start = clock();
        let whole = renderer.render_while(&frame, &settings, &[], &until);
        let length = clock() - start;
        let mut late: Vec<(u64, u64)> = (0..moments)
            .map(|i| {
                let at = length * (2 * i + 1) / (2 * moments);
                let end = clock() + at;
                until.0.store(end, Ordering::Relaxed);
                // A frame that ends before the cancellation counts as returned in time.
                let _ = renderer.render_while(&frame, &settings, &[], &until);
                (clock().saturating_sub(end), at)
            })
            .collect();
        late.sort_unstable();
        let ms = |ns: u64| ns as f64 * 1e-6;
        let (worst, at) = late[late.len() - 1];
        println!(
            "{what}: {:.0} ms{}; returns within {:.1} ms (median), {:.1} ms (worst, of {moments}; cancelled after {:.0} ms)",
            ms(length),
            if whole.is_ok() {
                " a frame"
            } else {
                " looked at"
            },
            ms(late[late.len() / 2].0),
            ms(worst),
            ms(at)
        );
    }
}
