//! Tests of cancelled frames.

use std::sync::atomic::{AtomicUsize, Ordering};

use glam::DVec3;

use super::*;
use crate::render::{
    BloomMethod, Cancel, CausticSettings, Checkpoint, GlareSettings, LensSettings, ShadowMethod,
    ShadowSettings,
};

/// Lets `passes` checkpoints pass, and counts all calls.
struct After {
    passes: usize,
    passed: AtomicUsize,
}

impl After {
    fn new(passes: usize) -> Self {
        Self {
            passes,
            passed: AtomicUsize::new(0),
        }
    }

    fn passed(&self) -> usize {
        self.passed.load(Ordering::Relaxed)
    }
}

impl Checkpoint for After {
    fn go_on(&self) -> bool {
        self.passed.fetch_add(1, Ordering::Relaxed) < self.passes
    }
}

/// Every stage has work, but little.
fn everything() -> RenderSettings {
    RenderSettings {
        caustics: CausticSettings {
            enabled: Some(true),
            photons: 2000,
            radius_m: 0.02,
        },
        shadows: ShadowSettings {
            method: ShadowMethod::AdaptiveNeighbours,
            filter_radius_px: 2,
            ..ShadowSettings::default()
        },
        glossy_samples: 2,
        edge_samples: 2,
        bloom: BloomSettings {
            threshold: 0.2,
            method: BloomMethod::Gaussians,
            ..BloomSettings::default()
        },
        glare: GlareSettings {
            enabled: true,
            threshold: 0.2,
            ..GlareSettings::default()
        },
        ..RenderSettings::default()
    }
}

fn room() -> Scene {
    let rough = Material {
        roughness: 0.3,
        ..mirror()
    };
    scene(
        &[
            (DVec3::new(-0.3, 0.0, 1.4), 0.2, mirror(), false),
            (DVec3::new(0.1, 0.1, 1.5), 0.2, glass(), false),
            (DVec3::new(0.4, -0.2, 1.6), 0.15, rough, false),
            (DVec3::new(0.4, 0.4, 1.8), 0.1, mirror(), true),
        ],
        vec![
            point_light(DVec3::new(-0.5, -0.3, 0.5), 3.0),
            point_light(DVec3::new(0.6, -0.6, 0.7), 3.0),
        ],
    )
}

/// A picture of a few tiles in which all neighbouring pixels differ.
fn small() -> RgbdFrame {
    let (width, height) = (64, 48);
    let shade = |i: u32| crate::numerics::hash(i, 1, 2).to_le_bytes();
    let pixels = (0..width * height).map(|i| [shade(i)[0], shade(i)[1], shade(i)[2], 255]);
    RgbdFrame {
        color: ColorImage {
            width,
            height,
            rgba: pixels.collect(),
        },
        depth: DepthImage::from_metres(width, height, vec![2.0; (width * height) as usize]),
        intrinsics: Intrinsics::new(56.0, 56.0, 31.5, 23.5, width, height).unwrap(),
        ..wall([0; 4])
    }
}

#[test]
fn a_frame_can_be_given_up_at_any_checkpoint_and_the_next_is_as_from_a_new_renderer() {
    let (scene, frame) = (room(), small());
    let blurred = RenderSettings {
        lens: LensSettings {
            radius_m: 0.02,
            focus_m: 1.0,
            samples: 4,
            ..LensSettings::default()
        },
        ..everything()
    };
    for settings in [everything(), blurred] {
        let expected = render(&scene, &frame, &settings, 1);
        let mut renderer = renderer_of(&scene, 1);
        // The first frame also allocates its tiles, with checkpoints in between.
        for given_up in [0, 200] {
            let after = After::new(given_up);
            assert!(renderer.render(&frame, &settings, &[], &after).is_err());
        }
        let first = After::new(usize::MAX);
        renderer.render(&frame, &settings, &[], &first).unwrap();
        let all = After::new(usize::MAX);
        renderer.render(&frame, &settings, &[], &all).unwrap();
        let n = all.passed();
        assert!(n > 300, "{n} checkpoints in a whole frame");
        // One thread reaches checkpoints in the same order each time: these are spread over all stages.
        for passes in (0..8).map(|i| n * i / 8).chain([n - 1]) {
            let after = After::new(passes);
            let given_up = renderer.render(&frame, &settings, &Aov::ALL, &after);
            assert!(given_up.is_err(), "{passes} of {n}");
            // No thread calls the checkpoint again after it has returned false.
            assert_eq!(after.passed(), passes + 1);
            if passes % 3 == 0 {
                let again = renderer.render(&frame, &settings, &Aov::ALL, &Uninterrupted);
                let again = again.unwrap();
                assert!(again.color == expected.color, "after {passes} of {n}");
                assert_eq!(again.aovs, expected.aovs);
                assert_eq!(again.stats, expected.stats);
            }
        }
    }
}

/// The work between two checkpoints is bounded, whatever the settings: rays are traced in packets of 16 with a
/// checkpoint before each packet. 16 points cast [`shadow::group::CHUNK`] samples of a light at a time, with at
/// most one ray each at virtual and at real occluders.
#[test]
fn checkpoints_are_as_many_as_the_work_asks_for() {
    const PACKET: u64 = 16;
    const SAMPLES: u64 = 2 * PACKET * shadow::group::CHUNK as u64;
    let frame = wall([120, 120, 120, 255]);
    let check = |what: &str, n_lights: usize, change: &dyn Fn(&mut RenderSettings)| {
        let light = |i: usize| Light::Sphere {
            position: DVec3::new(-0.5 + 0.01 * i as f64, -0.4, 0.4),
            radius_m: 0.05,
            intensity: Vec3::splat(0.1),
        };
        // One small object: few tiles with much work each.
        let objects = [(DVec3::new(0.0, 0.0, 1.5), 0.08, glass(), false)];
        let scene = scene(&objects, (0..n_lights).map(light).collect());
        let mut settings = plain();
        change(&mut settings);
        let all = After::new(usize::MAX);
        let mut renderer = renderer_of(&scene, 1);
        let rendered = renderer.render(&frame, &settings, &[], &all).unwrap();
        let stats = &rendered.stats;
        let shadows = (stats.shadow_points / PACKET).max(stats.shadow_rays / SAMPLES);
        let least = stats.secondary_rays / PACKET + stats.photons / PACKET + shadows;
        let passed = all.passed() as u64;
        assert!(passed >= least, "{what}: {passed} of {least}, {stats:?}");
        // With fewer, the test would show nothing.
        assert!(least > 500, "{what}: {least}, {stats:?}");
        passed
    };
    check("many lights", 100, &|_| {});
    check("many samples", 1, &|s| {
        s.shadows.method = ShadowMethod::Naive;
        s.shadows.samples = 256;
        s.shadows.skip_proven = false;
    });
    check("many paths", 1, &|s| s.edge_samples = 64);
    check("many photons", 1, &|s| {
        s.caustics.enabled = Some(true);
        s.caustics.photons = 100_000;
    });
    let through = |samples| {
        let lens = |s: &mut RenderSettings| {
            s.lens.radius_m = 0.05;
            s.lens.samples = samples;
            // No additional rays where samples disagree.
            s.lens.noise_threshold = 1.0;
        };
        check("a lens", 1, &lens)
    };
    // A packet of 16 pixels per sample. The square inside the sphere is 10 pixels wide, so it touches 9 packets
    // at any position.
    let (few, many) = (through(16), through(64));
    assert!(many >= few + 9 * (64 - 16), "{few}, {many}");
}

#[test]
fn a_flag_gives_up_every_frame_from_then_on() {
    let (scene, frame) = (room(), small());
    let mut renderer = renderer_of(&scene, 2);
    let cancel = Cancel::new();
    assert!(renderer.render(&frame, &plain(), &[], &cancel).is_ok());
    cancel.clone().set();
    assert!(renderer.render(&frame, &plain(), &[], &cancel).is_err());
    let decoded = renderer.render_decoding(
        || {
            Ok::<_, &str>(FrameGeometry {
                index: 7,
                time_ns: 0,
                depth: frame.depth.clone(),
                intrinsics: frame.intrinsics,
                pose: frame.pose,
            })
        },
        || Ok(frame.color.clone()),
        &plain(),
        &[],
        &cancel,
    );
    // The decoded frame is still returned.
    let (decoded, rendered) = decoded.unwrap();
    assert_eq!((decoded.index, &decoded.color), (7, &frame.color));
    assert!(rendered.is_err());
}

/// The widest allowed kernels, and more photons than the lists by tile can hold: the picture is the same with
/// unsorted photons.
#[test]
fn photons_that_are_not_sorted_by_tile_light_the_same_pixels() {
    let mut photons = Vec::new();
    for i in 0..500_u32 {
        let at = |d: u32| crate::numerics::uniform(i, 3, d) - 0.5;
        photons.push(photons::map::GhostPhoton {
            position: glam::Vec3A::new(at(0), at(1), 1.5 + at(2)),
            direction: glam::Vec3A::Z,
            flux: glam::Vec3A::ONE,
            radius: 0.1,
        });
    }
    let pinhole = Pinhole {
        fx: 140.0,
        fy: 140.0,
        cx: 79.5,
        cy: 59.5,
    };
    let of_tiles = |most: usize| {
        let mut chunk = photons::map::Chunk::default();
        chunk.ghost.clone_from(&photons);
        chunk.sort_by_tile(pinhole, 10, 8, most);
        (0..80)
            .map(|tile| {
                let reach = |p: &&photons::map::GhostPhoton| {
                    let [x0, x1, y0, y1] = photons::map::Footprint::new(pinhole, p).tiles(10, 8);
                    (x0..x1).contains(&(tile % 10)) && (y0..y1).contains(&(tile / 10))
                };
                let of_tile = chunk.of_tile(tile as usize).filter(reach);
                of_tile.map(|p| p.position.to_array()).collect::<Vec<_>>()
            })
            .collect::<Vec<_>>()
    };
    let (sorted, unsorted) = (of_tiles(usize::MAX), of_tiles(0));
    assert!(sorted.iter().any(|tile| tile.len() > 10));
    assert_eq!(sorted, unsorted);
}
