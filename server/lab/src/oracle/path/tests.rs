//! Tests of the path tracer against closed forms. Bounds are five standard errors of the estimator, which normal
//! noise exceeds once in two million estimates, plus rounding.

mod light;

use std::f64::consts::PI;

use glam::DAffine3;

use super::*;
use crate::oracle::closed;
use ghostlight::scene;
use ghostlight::shapes;

/// Rounding error of a few thousand f64 operations on numbers of size 1.
const ROUNDING: f64 = 1e-12;

fn expect(name: &str, found: Estimate, truth: DVec3) {
    let bound = found.standard_error * 5.0 + ROUNDING;
    assert!(
        (found.mean - truth).abs().cmple(bound).all(),
        "{name}: {} for {truth}, standard error {}",
        found.mean,
        found.standard_error
    );
}

/// A square around the origin, facing +z.
fn ground(half: f64) -> Patch {
    Patch {
        origin: DVec3::new(-half, -half, 0.0),
        e1: DVec3::X * (2.0 * half),
        e2: DVec3::Y * (2.0 * half),
        triangle: false,
    }
}

fn ball(centre: DVec3, radius: f64, radiance: f64) -> Light {
    Light::Ball {
        centre,
        radius,
        radiance: DVec3::splat(radiance),
    }
}

/// A sphere of glass or another material around the origin; the distributed one stands on y = 0.
fn centred(radius: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::NEG_Y * radius)
}

#[test]
fn the_tree_finds_what_trying_every_patch_finds() {
    let mut random = Random::new(3, 0, 0);
    let mut point = |scale: f64| {
        DVec3::new(
            random.unit() - 0.5,
            random.unit() - 0.5,
            random.unit() - 0.5,
        ) * scale
    };
    let patches: Vec<Patch> = (0..700)
        .map(|i| Patch {
            origin: point(4.0),
            // Some are within an axis-aligned plane, where boxes have no thickness.
            e1: point(0.6)
                * if i % 5 == 0 {
                    DVec3::new(1.0, 1.0, 0.0)
                } else {
                    DVec3::ONE
                },
            e2: point(0.6)
                * if i % 5 == 0 {
                    DVec3::new(1.0, 1.0, 0.0)
                } else {
                    DVec3::ONE
                },
            triangle: i % 2 == 0,
        })
        .collect();
    let tree = Tree::new(patches.clone());
    let mut hits = 0;
    for k in 0..20_000 {
        let mut direction = point(2.0);
        if k % 7 == 0 {
            direction[k % 3] = if k % 2 == 0 { 0.0 } else { -0.0 };
        }
        // Some rays start at the coordinates of a corner.
        let origin = if k % 11 == 0 {
            patches[k % 700].origin - DVec3::X * 3.0
        } else {
            point(6.0)
        };
        let t_max = if k % 3 == 0 { 1.0 } else { f64::INFINITY };
        let truth = tree.nearest_of_all(origin, direction, t_max);
        assert_eq!(tree.nearest(origin, direction, t_max), truth);
        assert_eq!(tree.blocked(origin, direction, t_max), truth.is_some());
        hits += usize::from(truth.is_some());
    }
    assert!(hits > 2_000, "{hits}");
    assert_eq!(Tree::default().nearest(DVec3::ZERO, DVec3::X, 1.0), None);
}

#[test]
fn in_a_furnace_what_absorbs_nothing_cannot_be_seen() {
    // Flat shading, because a shading normal loses the light that it sends into the surface.
    let sphere = scene::Mesh {
        normals: Vec::new(),
        ..shapes::sphere(1.0, 3)
    };
    let metal = |roughness: f32| scene::Material {
        base_color: glam::Vec3::ONE,
        metallic: 1.0,
        roughness,
        ..scene::Material::default()
    };
    let glass = |thin: bool| scene::Material {
        thin,
        ..scene::Preset::Glass.material()
    };
    for (name, material) in [
        ("white", Material::matte(DVec3::ONE)),
        ("mirror", Material::of_scene(&metal(0.0))),
        ("glass", Material::of_scene(&glass(false))),
        ("thin glass", Material::of_scene(&glass(true))),
    ] {
        let mut world = World {
            surroundings: DVec3::splat(0.7),
            ..World::default()
        };
        world.add_mesh(&sphere, centred(1.0), material, 0);
        let tracer = world.tracer();
        for (k, x) in [0.0, 0.3, 0.7, 0.95].into_iter().enumerate() {
            let origin = DVec3::new(x, 0.1, 5.0);
            let found = tracer.radiance(origin, DVec3::NEG_Z, 4_000, [2, k as u64]);
            expect(&format!("{name} at {x}"), found, DVec3::splat(0.7));
        }
    }
}

#[test]
fn vertex_colours_stand_for_the_materials_colour() {
    // In a furnace a flat triangle reflects its colour, both if it diffuses and if it mirrors all light.
    for (metallic, mirrored) in [(0.0, false), (1.0, false), (1.0, true)] {
        let material = scene::Material {
            base_color: glam::Vec3::ONE,
            metallic,
            roughness: 0.0,
            ior: 1.0,
            ..scene::Material::default()
        };
        let z = glam::Vec3::Z;
        let mesh = scene::Mesh {
            positions: vec![-z, 4.0 * glam::Vec3::X - z, 4.0 * glam::Vec3::Y - z],
            colors: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
                .map(|rgb| glam::Vec3::from(rgb).extend(1.0))
                .to_vec(),
            triangles: vec![[0, 1, 2]],
            ..scene::Mesh::default()
        };
        let turn = if mirrored {
            DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0))
        } else {
            DAffine3::IDENTITY
        };
        let mut world = World {
            surroundings: DVec3::ONE,
            ..World::default()
        };
        world.add_mesh(&mesh, turn, Material::of_scene(&material), 0);
        // A quarter of the way to the second corner, and half of the way to the third.
        let origin = turn.transform_point3(DVec3::new(1.0, 2.0, 3.0));
        let found = world.tracer().radiance(origin, DVec3::NEG_Z, 2_000, [5, 0]);
        expect("corners", found, DVec3::new(0.25, 0.25, 0.5));
    }
}

#[test]
fn a_boundary_that_half_diffuses_keeps_all_light() {
    let mut world = World {
        surroundings: DVec3::splat(0.7),
        ..World::default()
    };
    let half_clear = scene::Material {
        transmission: 0.5,
        ..scene::Preset::Glass.material()
    };
    world.add_patch(ground(1.0), Material::of_scene(&half_clear), 0);
    for (k, direction) in [DVec3::NEG_Z, DVec3::Z, DVec3::new(0.9, 0.0, 0.2)]
        .into_iter()
        .enumerate()
    {
        let origin = direction * -0.5;
        let found = world
            .tracer()
            .radiance(origin, direction, 1_000, [2, k as u64]);
        expect("half clear", found, DVec3::splat(0.7));
    }
}

#[test]
fn rough_metal_loses_what_bounces_between_facets_and_no_more() {
    let material = Material::of_scene(&scene::Material {
        base_color: glam::Vec3::ONE,
        metallic: 1.0,
        roughness: 1.0,
        ..scene::Material::default()
    });
    let mut world = World {
        surroundings: DVec3::ONE,
        ..World::default()
    };
    world.add_patch(ground(1.0), material, 0);
    let found = world
        .tracer()
        .radiance(DVec3::Z, DVec3::NEG_Z, 200_000, [3, 0]);
    expect("head on", found, DVec3::splat(closed::ggx_head_on()));
}

#[test]
fn plastic_reflects_no_more_than_arrives() {
    for roughness in [0.0, 0.1, 0.2, 0.5, 1.0] {
        let mut material = Material::of_scene(&scene::Material {
            base_color: glam::Vec3::ONE,
            roughness,
            ..scene::Material::default()
        });
        // Schlick's function is convex, so facets tilted either way reflect slightly more than the surface between
        // them; without grazing reflectance the bound is sharp.
        material.reflectance.f90 = material.reflectance.f0.x;
        let mut world = World {
            surroundings: DVec3::ONE,
            ..World::default()
        };
        world.add_patch(ground(1.0), material, 0);
        for cosine in [0.1f64, 0.5, 1.0] {
            let view = DVec3::new((1.0 - cosine * cosine).sqrt(), 0.0, cosine);
            let found = world.tracer().radiance(view, -view, 50_000, [4, 0]);
            let bound = 1.0 + 5.0 * found.standard_error.x + ROUNDING;
            assert!(found.mean.x <= bound, "{roughness} {cosine}: {found:?}");
            assert!(found.mean.x > 0.5, "{roughness} {cosine}: {found:?}");
        }
    }
}

#[test]
fn inside_a_closed_box_light_adds_up_over_all_bounces() {
    // L = e + a L everywhere, so L = e / (1 - a).
    let albedo = DVec3::new(0.2, 0.5, 0.8);
    let mut world = World::default();
    let mut wall = Material::matte(albedo);
    wall.emission = Some(Colour::Flat(DVec3::ONE));
    for axis in 0..3 {
        for sign in [-1.0, 1.0] {
            let (mut n, mut e1) = (DVec3::ZERO, DVec3::ZERO);
            n[axis] = sign;
            e1[(axis + 1) % 3] = 2.0;
            // The normal points inwards.
            let e2 = e1.cross(n);
            let origin = n - (e1 + e2) * 0.5;
            let patch = Patch {
                origin,
                e1,
                e2,
                triangle: false,
            };
            world.add_patch(patch, wall.clone(), 0);
        }
    }
    let direction = DVec3::new(0.3, 0.5, 0.2);
    let truth = DVec3::ONE / (DVec3::ONE - albedo);
    let found = world
        .tracer()
        .radiance(DVec3::ZERO, direction, 20_000, [5, 0]);
    expect("found by chance", found, truth);
    // The same, with light sampling of the walls.
    world.lights = (0..6).map(|patch| Light::Patch { patch }).collect();
    let found = world
        .tracer()
        .radiance(DVec3::ZERO, direction, 20_000, [5, 1]);
    expect("aimed at", found, truth);
}

#[test]
fn a_glass_slab_lets_through_what_fresnel_and_beer_say() {
    let kept = 0.6;
    let thickness = 0.25;
    for colour in [1.0, kept] {
        for (k, angle_deg) in [0.0, 30.0, 56.31, 75.0, 88.0].into_iter().enumerate() {
            let glass = Material::of_scene(&scene::Material {
                attenuation_color: glam::Vec3::splat(colour as f32),
                attenuation_distance_m: thickness as f32,
                ..scene::Preset::Glass.material()
            });
            let mut world = World::default();
            // Wide enough for all relevant reflections at 88 degrees.
            let half = 200.0;
            world.add_patch(ground(half), glass.clone(), 0);
            let mut back = ground(half);
            back.origin.z = -thickness;
            (back.e1, back.e2) = (back.e2, back.e1);
            world.add_patch(back, glass, 0);
            let mut shine = ground(1e4);
            shine.origin.z = -1.0;
            let mut lamp = Material::matte(DVec3::ZERO);
            lamp.emission = Some(Colour::Flat(DVec3::ONE));
            world.add_patch(shine, lamp, 0);
            let angle = f64::to_radians(angle_deg);
            let direction = DVec3::new(angle.sin(), 0.0, -angle.cos());
            let found = world
                .tracer()
                .radiance(-direction, direction, 60_000, [8, k as u64]);
            let reflected = closed::reflectance(angle, 1.5);
            let slant = (1.0 - (angle.sin() / 1.5).powi(2)).sqrt();
            // The material stores its colour in f32.
            let kept = f64::from(colour as f32).powf(1.0 / slant);
            let truth = closed::slab_transmittance(reflected, kept);
            expect(
                &format!("{angle_deg} degrees, {colour}"),
                found,
                DVec3::splat(truth),
            );
        }
    }
}

#[test]
fn a_glass_ball_focuses_where_optics_says() {
    // Effective focal length from the centre, n r / (2 (n - 1)), up to the square of the ray's height divided by the
    // radius. Through a dark pinhole there, nothing else of a bright background is visible.
    let (n, height) = (1.5, 1e-3);
    let focus = n / (2.0 * (n - 1.0));
    let mut world = World::default();
    world.add_mesh(
        &shapes::sphere(1.0, 6),
        centred(1.0),
        Material::of_scene(&scene::Preset::Glass.material()),
        0,
    );
    let mut lamp = Material::matte(DVec3::ZERO);
    lamp.emission = Some(Colour::Flat(DVec3::ONE));
    // A small disc of light at the focus, far smaller than the ray's height.
    let small = height / 20.0;
    let mut spot = ground(small);
    spot.origin.z = -focus;
    world.add_patch(spot, lamp, 0);
    let found = world
        .tracer()
        .radiance(DVec3::new(height, 0.0, 3.0), DVec3::NEG_Z, 20_000, [9, 0]);
    // Two crossings near normal incidence; further reflections come from other directions.
    let through = (1.0 - closed::reflectance(0.0, n)).powi(2);
    expect("at the focus", found, DVec3::splat(through));
}

#[test]
fn the_camera_does_not_see_ball_lights_but_mirrors_do() {
    let mirror = scene::Preset::Mirror.material();
    let mut world = World::default();
    world.add_patch(ground(1.0), Material::of_scene(&mirror), 0);
    world.lights.push(ball(DVec3::Z * 2.0, 0.1, 5.0));
    let tracer = world.tracer();
    let seen = tracer.radiance(DVec3::Z * 3.0, DVec3::NEG_Z, 4, [10, 0]);
    let truth = 5.0 * f64::from(mirror.base_color.x);
    expect("by way of the mirror", seen, DVec3::splat(truth));
    assert_eq!(
        tracer.radiance(DVec3::Z, DVec3::Z, 4, [10, 0]).mean,
        DVec3::ZERO
    );
    assert_eq!(
        tracer.first_hit(DVec3::Z, DVec3::NEG_Z),
        Some(FirstHit { t: 1.0, thing: 0 })
    );
}

#[test]
fn a_picture_is_the_same_on_any_number_of_threads() {
    let mut world = World {
        surroundings: DVec3::splat(0.2),
        ..World::default()
    };
    world.add_patch(ground(1.0), Material::matte(DVec3::splat(0.5)), 0);
    let place = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0)) * centred(0.4);
    let material = Material::of_scene(&scene::Preset::Plastic.material());
    world.add_mesh(&shapes::sphere(0.4, 2), place, material, 1);
    world.lights.push(ball(DVec3::new(0.5, 0.3, 1.5), 0.2, 4.0));
    let intrinsics = Intrinsics::new(20.0, 20.0, 9.5, 7.5, 20, 16).unwrap();
    let pose = Pose {
        rotation: glam::DQuat::from_rotation_x(PI),
        translation: DVec3::Z * 2.0,
    };
    let picture = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| render(&world, &intrinsics, &pose, 8, 11).pixels)
    };
    let one = picture(1);
    assert_eq!(one, picture(3));
    assert!(one.iter().all(|p| p.mean.is_finite()));
    assert_ne!(one, render(&world, &intrinsics, &pose, 8, 12).pixels);
    // A mirrored mesh keeps its outside.
    let towards = pose.rotation * intrinsics.unproject(9.5, 7.5, 1.0);
    assert_eq!(
        world
            .tracer()
            .first_hit(pose.translation, towards)
            .unwrap()
            .thing,
        1
    );
    assert!(one.iter().all(|p| p.standard_error.is_finite()));
    // Noise is inversely proportional to the square root of the number of samples: four times as many samples halve
    // it.
    let error = |samples: u32| {
        let pixels = render(&world, &intrinsics, &pose, samples, 12).pixels;
        pixels
            .iter()
            .map(|p| p.standard_error.x.powi(2))
            .sum::<f64>()
            .sqrt()
    };
    let ratio = error(64) / error(256);
    assert!((1.6..2.5).contains(&ratio), "{ratio}");
}
