//! Tests of whole frames against physics.

mod ambient;
mod bytes;
mod cancel;
mod caustics;
mod colors;
mod lens;
mod materials;
mod shadows;

use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3};

use super::*;
use crate::camera::{Intrinsics, Pose};
use crate::frame::DepthImage;
use crate::numerics::{linear_from_srgb, srgb_from_linear};
use crate::render::AovImage;
use crate::render::{BloomSettings, CausticSettings, GhostSettings, HolePolicy, Uninterrupted};
use crate::scene::Mesh;

const WIDTH: u32 = 160;
const HEIGHT: u32 = 120;

fn clock() -> u64 {
    0
}

/// A wall of one colour, two metres in front of the camera.
fn wall(rgba: [u8; 4]) -> RgbdFrame {
    RgbdFrame {
        index: 0,
        time_ns: 0,
        color: ColorImage::filled(WIDTH, HEIGHT, rgba),
        depth: DepthImage::from_metres(WIDTH, HEIGHT, vec![2.0; (WIDTH * HEIGHT) as usize]),
        intrinsics: Intrinsics::new(140.0, 140.0, 79.5, 59.5, WIDTH, HEIGHT).unwrap(),
        pose: Pose::IDENTITY,
    }
}

/// A picture in which all neighbouring pixels differ.
fn noise() -> RgbdFrame {
    let mut frame = wall([0; 4]);
    for (i, pixel) in frame.color.rgba.iter_mut().enumerate() {
        let h = crate::numerics::hash(i as u32, 1, 2).to_le_bytes();
        *pixel = [h[0], h[1], h[2], 255];
    }
    frame
}

/// A sphere of radius 1 with smooth normals, from a subdivided octahedron.
fn ball() -> Mesh {
    let mut positions = vec![Vec3::X, Vec3::Y, Vec3::Z, -Vec3::X, -Vec3::Y, -Vec3::Z];
    let mut triangles: Vec<[u32; 3]> = vec![
        [0, 1, 2],
        [1, 3, 2],
        [3, 4, 2],
        [4, 0, 2],
        [1, 0, 5],
        [3, 1, 5],
        [4, 3, 5],
        [0, 4, 5],
    ];
    for _ in 0..4 {
        let mut finer = Vec::new();
        let mut middles = std::collections::HashMap::new();
        for [a, b, c] in triangles {
            let mut middle = |i: u32, j: u32| {
                *middles.entry((i.min(j), i.max(j))).or_insert_with(|| {
                    positions.push(
                        (positions[i as usize] + positions[j as usize])
                            .try_normalize()
                            .unwrap(),
                    );
                    positions.len() as u32 - 1
                })
            };
            let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
            finer.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
        triangles = finer;
    }
    Mesh {
        normals: positions.clone(),
        positions,
        triangles,
        ..Mesh::default()
    }
}

fn mirror() -> Material {
    Material {
        base_color: Vec3::ONE,
        metallic: 1.0,
        roughness: 0.0,
        ..Material::default()
    }
}

fn glass() -> Material {
    Material {
        base_color: Vec3::ONE,
        roughness: 0.0,
        transmission: 1.0,
        ior: 1.5,
        ..Material::default()
    }
}

fn scene(objects: &[(DVec3, f64, Material, bool)], lights: Vec<Light>) -> Scene {
    Scene {
        meshes: vec![Arc::new(ball())],
        materials: objects.iter().map(|object| object.2.clone()).collect(),
        instances: objects
            .iter()
            .enumerate()
            .map(|(i, &(center, radius, _, ghost))| crate::scene::Instance {
                name: format!("ball {i}"),
                mesh: 0,
                material: i as u32,
                world_from_object: DAffine3::from_scale_rotation_translation(
                    DVec3::splat(radius),
                    glam::DQuat::from_rotation_y(0.3),
                    center,
                ),
                ghost,
            })
            .collect(),
        lights,
        ..Scene::default()
    }
}

fn plain() -> RenderSettings {
    RenderSettings {
        caustics: CausticSettings {
            enabled: Some(false),
            ..CausticSettings::default()
        },
        bloom: BloomSettings {
            enabled: false,
            ..BloomSettings::default()
        },
        ..RenderSettings::default()
    }
}

/// Emissive objects do not light the wall behind them: only bloom spreads.
fn bloom_only() -> RenderSettings {
    let mut settings = RenderSettings::default();
    settings.ambient.enabled = false;
    settings
}

/// A renderer with `threads` threads.
fn renderer_of(scene: &Scene, threads: usize) -> CpuRenderer {
    let lods = |mesh| MeshLods::new(mesh, &Uninterrupted).map(Arc::new);
    let lods = scene.meshes.iter().map(lods).collect();
    let threads = Arc::new(Threads::new(threads, clock).unwrap());
    let buffers = Arc::new(BufferPool::new(threads.count()));
    CpuRenderer::new(scene, lods, threads, buffers, clock).unwrap()
}

fn render(scene: &Scene, frame: &RgbdFrame, settings: &RenderSettings, threads: usize) -> Rendered {
    renderer_of(scene, threads)
        .render(frame, settings, &Aov::ALL, &Uninterrupted)
        .unwrap()
}

fn gray(rendered: &Rendered, wanted: Aov) -> &[u8] {
    match rendered.aovs.iter().find(|(aov, _)| *aov == wanted) {
        Some((_, AovImage::Gray8(pixels))) => pixels,
        other => panic!("{wanted:?}: {other:?}"),
    }
}

fn at(x: u32, y: u32) -> usize {
    (y * WIDTH + x) as usize
}

fn point_light(position: DVec3, intensity: f32) -> Light {
    Light::Sphere {
        position,
        radius_m: 0.0,
        intensity: Vec3::splat(intensity),
    }
}

#[test]
fn nothing_virtual_is_the_camera_bit_for_bit() {
    let frame = noise();
    let behind = (DVec3::new(0.0, 0.0, -3.0), 0.3, mirror(), false);
    let hidden = (DVec3::new(0.0, 0.0, 5.0), 0.3, mirror(), false);
    let modelled = (DVec3::new(0.0, 0.0, 1.5), 0.3, Material::default(), true);
    for objects in [vec![], vec![behind], vec![hidden], vec![modelled]] {
        let out = render(&scene(&objects, vec![]), &frame, &plain(), 1);
        assert_eq!(out.color, frame.color);
        assert_eq!(out.stats.virtual_pixels, 0);
        assert!(gray(&out, Aov::Mask).iter().all(|&m| m == 0));
    }
    let out = render(&Scene::default(), &frame, &plain(), 1);
    assert_eq!((out.color, out.stats.traced_pixels), (frame.color, 0));
}

/// Every ray returns the same colour, so perfect mirrors and clear glass are invisible: any energy lost or added,
/// at any bounce or outline, is visible.
#[test]
fn mirrors_and_glass_vanish_in_an_even_world() {
    let frame = wall([120, 120, 120, 255]);
    for material in [
        mirror(),
        glass(),
        Material {
            thin: true,
            ..glass()
        },
    ] {
        for max_bounces in [0, 1, 2, 5, 8] {
            let two = [
                (DVec3::new(-0.15, 0.0, 1.2), 0.25, material.clone(), false),
                (DVec3::new(0.35, 0.1, 1.5), 0.2, material.clone(), false),
            ];
            let out = render(
                &scene(&two, vec![]),
                &frame,
                &RenderSettings {
                    max_bounces,
                    ..plain()
                },
                1,
            );
            assert!(out.stats.virtual_pixels > 1000);
            let worst = out
                .color
                .rgba
                .iter()
                .map(|p| p[0].abs_diff(120))
                .max()
                .unwrap();
            // Paths below MIN_THROUGHPUT are cut; they carry less than one code.
            assert!(
                worst <= 1,
                "{} bounces, transmission {}: off by {worst}",
                max_bounces,
                material.transmission
            );
        }
    }
}

#[test]
fn a_matte_ball_in_an_even_world_shows_its_albedo() {
    let frame = wall([188, 188, 188, 255]);
    let albedo = 0.5;
    let material = Material {
        base_color: Vec3::splat(albedo),
        ior: 1.0,
        ..Material::default()
    };
    let out = render(
        &scene(&[(DVec3::new(0.0, 0.0, 1.5), 0.3, material, false)], vec![]),
        &frame,
        &plain(),
        1,
    );
    let expected = srgb_from_linear(linear_from_srgb(188) * albedo);
    let center = out.color.rgba[at(80, 60)][0];
    assert!(
        center.abs_diff(expected) <= 1,
        "{center} against {expected}"
    );
}

#[test]
fn the_mask_is_the_projected_disc() {
    let (z, r) = (1.5, 0.3);
    let out = render(
        &scene(&[(DVec3::new(0.0, 0.0, z), r, mirror(), false)], vec![]),
        &noise(),
        &plain(),
        1,
    );
    let area: f64 = gray(&out, Aov::Mask)
        .iter()
        .map(|&m| f64::from(m) / 255.0)
        .sum();
    // The cone of tangency: half-angle asin(r / z), a disc of radius f tan.
    let exact = std::f64::consts::PI * (140.0 * (r / z).asin().tan()).powi(2);
    assert!((area / exact - 1.0).abs() < 0.01, "{area} against {exact}");
}

#[test]
fn holes_follow_their_policy() {
    let mut frame = wall([100, 100, 100, 255]);
    for y in 50..70 {
        for x in 70..90 {
            frame.depth.z_m[at(x, y)] = DepthImage::INVALID;
        }
    }
    for (z, policy, expected) in [
        (1.5, HolePolicy::ShowReal, 0),
        (1.5, HolePolicy::ShowVirtual, 255),
        (1.5, HolePolicy::Fill, 255),
        (2.5, HolePolicy::ShowVirtual, 255),
        (2.5, HolePolicy::Fill, 0),
    ] {
        let settings = RenderSettings {
            ghost: GhostSettings {
                holes: policy,
                ..GhostSettings::default()
            },
            ..plain()
        };
        let out = render(
            &scene(&[(DVec3::new(0.0, 0.0, z), 0.4, mirror(), false)], vec![]),
            &frame,
            &settings,
            1,
        );
        assert_eq!(
            gray(&out, Aov::Mask)[at(80, 60)],
            expected,
            "{policy:?} at {z}"
        );
    }
}

/// Missing depth removes nothing: neither where a region has none nor where the whole frame has none; the same
/// with a lens.
#[test]
fn an_object_stays_when_depth_drops_out() {
    let ball = || scene(&[(DVec3::new(0.0, 0.0, 1.5), 0.3, mirror(), false)], vec![]);
    let pinhole = plain();
    let lens = RenderSettings {
        lens: crate::render::LensSettings {
            radius_m: 0.02,
            focus_m: 1.0,
            samples: 8,
            ..Default::default()
        },
        ..plain()
    };
    let frame = wall([100, 100, 100, 255]);
    let (width, height) = (frame.depth.width, frame.depth.height);
    let without = |first_column: u32| {
        let mut frame = frame.clone();
        for y in 0..height {
            for x in first_column..width {
                frame.depth.z_m[at(x, y)] = DepthImage::INVALID;
            }
        }
        frame
    };
    for settings in [pinhole, lens] {
        let whole = render(&ball(), &frame, &settings, 1);
        assert!(whole.stats.virtual_pixels > 1000);
        assert_eq!(whole.stats.unmeasured_pixels, 0);
        for first_column in [0, 12] {
            let dropped = render(&ball(), &without(first_column), &settings, 1);
            assert_eq!(gray(&dropped, Aov::Mask), gray(&whole, Aov::Mask));
            assert!(
                dropped.stats.unmeasured_pixels > 0,
                "from column {first_column}"
            );
        }
        let mut real = settings;
        real.ghost.holes = HolePolicy::ShowReal;
        let hidden = render(&ball(), &without(0), &real, 1);
        assert_eq!(hidden.stats.virtual_pixels, 0);
    }
}

#[test]
fn a_real_mirror_shows_virtual_things_and_nothing_else_new() {
    let frame = wall([100, 100, 100, 255]);
    let real_mirror = (DVec3::new(0.3, 0.0, 1.5), 0.25, mirror(), true);
    let alone = render(
        &scene(std::slice::from_ref(&real_mirror), vec![]),
        &frame,
        &plain(),
        1,
    );
    assert_eq!(alone.color, frame.color);
    let red = Material {
        base_color: Vec3::ZERO,
        emissive: Vec3::new(1.0, 0.0, 0.0),
        ..Material::default()
    };
    let both = render(
        &scene(
            &[real_mirror, (DVec3::new(-0.3, 0.0, 1.3), 0.2, red, false)],
            vec![],
        ),
        &frame,
        &plain(),
        1,
    );
    let mask = gray(&both, Aov::Mask);
    let reflected = (0..WIDTH * HEIGHT)
        .filter(|&i| {
            mask[i as usize] == 0
                && both.color.rgba[i as usize][0] > 150
                && both.color.rgba[i as usize][1] < 90
        })
        .count();
    assert!(reflected > 20, "{reflected}");
}

#[test]
fn highlights_bloom_over_the_camera_and_stay_finite() {
    let frame = wall([40, 40, 40, 255]);
    for emitted in [10.0, 1e6, f32::INFINITY, f32::NAN] {
        let lamp = Material {
            base_color: Vec3::ZERO,
            emissive: Vec3::splat(emitted),
            ..Material::default()
        };
        let out = render(
            &scene(&[(DVec3::new(0.0, 0.0, 1.5), 0.1, lamp, false)], vec![]),
            &frame,
            &bloom_only(),
            1,
        );
        let beside = out.color.rgba[at(80, 60 - 13)][0];
        if emitted.is_nan() {
            assert_eq!(beside, 40, "what is no light spreads nowhere");
            continue;
        }
        assert_eq!(out.color.rgba[at(80, 60)][0], 255);
        assert!(beside > 40, "{emitted}: {beside}");
    }
    let dim = Material {
        base_color: Vec3::ZERO,
        emissive: Vec3::splat(0.3),
        ior: 1.0,
        ..Material::default()
    };
    let out = render(
        &scene(&[(DVec3::new(0.0, 0.0, 1.5), 0.1, dim, false)], vec![]),
        &frame,
        &bloom_only(),
        1,
    );
    assert_eq!(
        out.color.rgba[at(80, 60 - 13)][0],
        40,
        "nothing exceeds the threshold"
    );
}

#[test]
fn tiny_and_degenerate_frames_render() {
    for (w, h) in [(1, 1), (1, 7), (3, 2), (17, 33)] {
        let mut frame = wall([90, 90, 90, 255]);
        frame.color = ColorImage::filled(w, h, [90, 90, 90, 255]);
        frame.intrinsics =
            Intrinsics::new(20.0, 20.0, f64::from(w) / 2.0, f64::from(h) / 2.0, w, h).unwrap();
        for z in [2.0, f32::NAN] {
            frame.depth = DepthImage::from_metres(w, h, vec![z; (w * h) as usize]);
            let light = vec![point_light(DVec3::ZERO, 1.0)];
            let settings = RenderSettings {
                ghost: GhostSettings {
                    holes: HolePolicy::ShowVirtual,
                    ..GhostSettings::default()
                },
                ..RenderSettings::default()
            };
            let out = render(
                &scene(&[(DVec3::new(0.0, 0.0, 1.0), 0.2, mirror(), false)], light),
                &frame,
                &settings,
                2,
            );
            assert_eq!(out.color.rgba.len(), (w * h) as usize);
            assert!(out.stats.virtual_pixels > 0, "{w}x{h} {z}");
        }
    }
}

#[test]
fn a_world_origin_far_away_changes_nothing() {
    let light = |at: DVec3| {
        vec![Light::Sphere {
            position: at + DVec3::new(0.4, -0.8, 0.6),
            radius_m: 0.1,
            intensity: Vec3::ONE,
        }]
    };
    let near = render(
        &scene(
            &[(DVec3::new(0.0, 0.0, 1.5), 0.3, mirror(), false)],
            light(DVec3::ZERO),
        ),
        &noise(),
        &plain(),
        1,
    );
    let far = DVec3::new(1e5, -1e5, 1e5);
    let mut frame = noise();
    frame.pose.translation = far;
    let moved = render(
        &scene(
            &[(far + DVec3::new(0.0, 0.0, 1.5), 0.3, mirror(), false)],
            light(far),
        ),
        &frame,
        &plain(),
        1,
    );
    // Poses are f64: at 1e5 m their resolution is 1.5e-11 m, which may change a pixel of noise seen in a mirror.
    let differ = near
        .color
        .rgba
        .iter()
        .zip(&moved.color.rgba)
        .filter(|(a, b)| (0..3).any(|c| a[c].abs_diff(b[c]) > 2))
        .count();
    assert!(differ <= 20, "{differ}");
}
