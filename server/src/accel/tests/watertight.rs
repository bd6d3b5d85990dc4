//! Closed solids let no ray through: rays aimed at edges and vertices, from inside and outside,
//! near and far, through every kernel.

use fearless_simd::Level;
use glam::{Affine3A, EulerRot, Quat, Vec3, Vec3A};

use super::shapes::{Dice, aimed, cube, icosphere, needles, torus};
use super::{blas, check_kernels, levels, placed, tlas};
use crate::accel::{Ray, Tlas};
use crate::numerics::gamma;
use crate::scene::{Mesh, Model, test_data};

/// A solid and a way to pick points well inside it.
struct Solid {
    name: &'static str,
    mesh: Mesh,
    inside: fn(&mut Dice) -> Vec3A,
}

fn solids() -> Vec<Solid> {
    vec![
        Solid {
            name: "icosphere",
            mesh: icosphere(4),
            inside: |dice| dice.direction() * (0.9 * dice.unit()),
        },
        Solid {
            name: "torus",
            mesh: torus(60, 40),
            inside: |dice| {
                let a = dice.unit() * std::f32::consts::TAU;
                let ring = Vec3A::new(a.cos(), a.sin(), 0.0) * 0.75;
                ring + dice.direction() * (0.2 * dice.unit())
            },
        },
        Solid {
            name: "cube",
            mesh: cube(12),
            inside: |dice| Vec3A::new(dice.signed(), dice.signed(), dice.signed()) * 0.9,
        },
        Solid {
            name: "needles",
            mesh: needles(16),
            inside: |dice| Vec3A::new(0.0, 0.0, 0.9 * dice.signed()),
        },
    ]
}

/// A vertex, or a point on an edge.
fn target(mesh: &Mesh, dice: &mut Dice) -> Vec3A {
    let corners = mesh.triangles[dice.below(mesh.triangles.len())];
    let k = dice.below(3);
    let [a, b] =
        [corners[k], corners[(k + 1) % 3]].map(|i| Vec3A::from(mesh.positions[i as usize]));
    match dice.below(4) {
        0 => a,
        1 => (a + b) * 0.5,
        _ => a.lerp(b, dice.unit()),
    }
}

/// Rays that must hit: from inside anywhere, or from outside through a point inside. `reach` is
/// how far out they start, in units of the solid's size.
fn rays(solid: &Solid, place: Affine3A, reach: f32, n: usize, dice: &mut Dice) -> Vec<Ray> {
    (0..n)
        .map(|_| {
            let inside = (solid.inside)(dice);
            let target = target(&solid.mesh, dice);
            let place = |p: Vec3A| place.transform_point3a(p);
            if dice.below(2) == 0 {
                aimed(place(inside), place(target))
            } else {
                // From beyond the target, back through it to the point inside.
                let out = (target - inside).try_normalize().unwrap_or(Vec3A::X);
                aimed(
                    place(target + out * (reach * (0.5 + dice.unit()))),
                    place(target),
                )
            }
        })
        .collect()
}

fn expect_no_leak(name: &str, tlas: &Tlas, rays: &[Ray]) {
    let hits: Vec<_> = rays.iter().map(|r| tlas.intersect_scalar(r, 1)).collect();
    let leaks = hits.iter().filter(|h| h.is_none()).count();
    assert_eq!(leaks, 0, "{name}: {leaks} of {} rays leak", rays.len());
    assert!(rays.iter().all(|r| tlas.occluded_scalar(r, 1)), "{name}");
    check_kernels(tlas, rays, &hits);
}

#[test]
fn a_million_rays_at_edges_and_vertices_all_hit() {
    let mut dice = Dice(1, 0);
    for solid in solids() {
        let tlas = tlas(
            Level::new(),
            &[placed(&blas(&solid.mesh), Affine3A::IDENTITY)],
        );
        let rays = rays(&solid, Affine3A::IDENTITY, 3.0, 250_000, &mut dice);
        expect_no_leak(solid.name, &tlas, &rays);
    }
}

#[test]
fn no_instruction_set_leaks() {
    for level in levels() {
        let mut dice = Dice(2, 0);
        for solid in solids() {
            let tlas = tlas(level, &[placed(&blas(&solid.mesh), Affine3A::IDENTITY)]);
            let rays = rays(&solid, Affine3A::IDENTITY, 3.0, 8_000, &mut dice);
            expect_no_leak(solid.name, &tlas, &rays);
        }
    }
}

#[test]
fn distance_does_not_open_a_leak() {
    for (i, reach) in [30.0, 100.0, 1e4, 1e6].into_iter().enumerate() {
        let mut dice = Dice(3, i as u32 * 1_000_000);
        // From so far the direction itself misses a thin solid.
        for solid in solids()
            .into_iter()
            .filter(|s| reach <= 100.0 || s.name != "needles")
        {
            let tlas = tlas(
                Level::new(),
                &[placed(&blas(&solid.mesh), Affine3A::IDENTITY)],
            );
            let rays = rays(&solid, Affine3A::IDENTITY, reach, 20_000, &mut dice);
            expect_no_leak(solid.name, &tlas, &rays);
        }
    }
}

#[test]
fn transforms_do_not_open_a_leak() {
    let turn = Quat::from_euler(EulerRot::XYZ, 0.3, 1.1, -2.0);
    let places = [
        Affine3A::from_scale_rotation_translation(
            Vec3::splat(1.0),
            turn,
            Vec3::new(3.0, -2.0, 5.0),
        ),
        Affine3A::from_scale_rotation_translation(
            Vec3::splat(1e-4),
            turn,
            Vec3::new(0.1, 0.2, 1.0),
        ),
        Affine3A::from_scale_rotation_translation(Vec3::splat(1e4), turn, Vec3::new(1e4, 3e4, 2e4)),
        Affine3A::from_scale_rotation_translation(Vec3::new(-1.0, 2.0, 0.3), turn, Vec3::Z),
        Affine3A::from_scale_rotation_translation(Vec3::new(1e2, 1.0, -1e-2), turn, Vec3::Z),
    ];
    let mut dice = Dice(4, 0);
    for place in places {
        for solid in solids().into_iter().filter(|s| s.name != "needles") {
            let tlas = tlas(Level::new(), &[placed(&blas(&solid.mesh), place)]);
            let rays = rays(&solid, place, 3.0, 10_000, &mut dice);
            expect_no_leak(solid.name, &tlas, &rays);
        }
    }
}

#[test]
fn meshes_far_from_their_origin_do_not_leak() {
    let mut dice = Dice(5, 0);
    for offset in [1e2, 1e4, 9e5] {
        for solid in solids().into_iter().filter(|s| s.name != "needles") {
            let shift = Vec3::new(offset, -offset, 0.5 * offset);
            let mut far = solid.mesh.clone();
            // The grid of f32 is coarse out there, so the solid is made large enough to survive
            // on it.
            let scale = (offset * 1e-3).max(1.0);
            far.positions
                .iter_mut()
                .for_each(|p| *p = *p * scale + shift);
            let place = Affine3A::from_scale(Vec3::splat(scale));
            let back = Affine3A::from_translation(-shift);
            let tlas = tlas(Level::new(), &[placed(&blas(&far), back)]);
            let rays = rays(&solid, place, 3.0, 10_000, &mut dice);
            expect_no_leak(solid.name, &tlas, &rays);
        }
    }
}

#[test]
fn rays_along_axes_hit_grid_vertices_and_edges() {
    let n = 12;
    let tlas = tlas(Level::new(), &[placed(&blas(&cube(n)), Affine3A::IDENTITY)]);
    let mut rays = Vec::new();
    for axis in 0..3 {
        for i in 0..=2 * n {
            for j in 0..=2 * n {
                for (sign, zero) in [(1.0, 0.0), (1.0, -0.0), (-1.0, 0.0), (-1.0, -0.0)] {
                    // Vertices and the middles of edges, the border of the face included.
                    let mut origin = Vec3A::ZERO;
                    origin[(axis + 1) % 3] = (i - n) as f32 / n as f32;
                    origin[(axis + 2) % 3] = (j - n) as f32 / n as f32;
                    origin[axis] = -3.0 * sign;
                    let mut direction = Vec3A::splat(zero);
                    direction[axis] = sign;
                    for start in [-3.0, 0.0] {
                        origin[axis] = start * sign;
                        rays.push(Ray {
                            origin,
                            direction,
                            t_min: 0.0,
                            t_max: f32::INFINITY,
                        });
                    }
                }
            }
        }
    }
    expect_no_leak("axes", &tlas, &rays);
    for ray in &rays {
        let hit = tlas.intersect(ray, 1).unwrap();
        let expected = if ray.origin.abs().max_element() > 2.0 {
            2.0
        } else {
            1.0
        };
        // Weights that are rounded in each of five steps, and as many for t itself.
        let bound = gamma(10) * 3.0;
        assert!((hit.t - expected).abs() <= bound, "{ray:?} {hit:?}");
    }
}

/// How often the mesh goes around the point (van Oosterom, Strackee 1983, "The Solid Angle of a
/// Plane Triangle"): 0 outside of a closed one, 1 or -1 inside.
fn winding(mesh: &Mesh, point: Vec3A) -> f64 {
    let sum: f64 = mesh
        .triangles
        .iter()
        .map(|corners| {
            let [a, b, c] =
                corners.map(|i| mesh.positions[i as usize].as_dvec3() - point.as_dvec3());
            let (x, y, z) = (a.length(), b.length(), c.length());
            let across = x * y * z + a.dot(b) * z + b.dot(c) * x + c.dot(a) * y;
            a.dot(b.cross(c)).atan2(across)
        })
        .sum();
    sum / std::f64::consts::TAU
}

#[test]
fn a_scanned_solid_does_not_leak() {
    let Some(data) = test_data::folder() else {
        return;
    };
    let model = Model::load(&data.join("meshes/dragon-100k.ply")).unwrap();
    let mesh = &model.meshes[0];
    assert!(mesh.triangles.len() > 99_000, "{}", mesh.triangles.len());
    let tlas = tlas(Level::new(), &[placed(&blas(mesh), Affine3A::IDENTITY)]);
    let (low, high) = tlas.bounds(0).unwrap();
    let mut dice = Dice(6, 0);
    let mut inside = Vec::new();
    while inside.len() < 20 {
        let at = Vec3A::new(dice.unit(), dice.unit(), dice.unit());
        let point = low + (high - low) * at;
        let turns = winding(mesh, point).abs();
        // A whole number, as for any closed surface.
        assert!((turns - turns.round()).abs() < 1e-6, "{point} {turns}");
        if turns.round() == 1.0 {
            inside.push(point);
        }
    }
    let rays: Vec<Ray> = (0..100_000)
        .map(|i| aimed(inside[i % inside.len()], target(mesh, &mut dice)))
        .collect();
    expect_no_leak("dragon", &tlas, &rays);
}
