//! Degenerate meshes: built in bounded time or rejected with a reason, and traced.

use std::time::{Duration, Instant};

use fearless_simd::Level;
use glam::{Affine3A, Vec3, Vec3A};

use super::{blas, check_kernels, placed, tlas};
use ghostlight::accel::{Blas, BuildError, BuildLimits, Ray};
use ghostlight::scene::Mesh;
use ghostlight_lab::hard::shapes::{Dice, aimed, icosphere, mesh};

fn triangle_at(p: Vec3, size: f32) -> [Vec3; 3] {
    [p, p + Vec3::X * size, p + Vec3::Y * size]
}

fn soup(corners: impl IntoIterator<Item = [Vec3; 3]>) -> Mesh {
    let positions: Vec<Vec3> = corners.into_iter().flatten().collect();
    let n = positions.len() as u32 / 3;
    mesh(
        positions,
        (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
    )
}

/// Builds the mesh within a time limit that only runaway behaviour exceeds, and checks all kernels on it.
fn builds(name: &str, mesh: &Mesh) -> Blas {
    let start = Instant::now();
    let built = Blas::build(mesh, BuildLimits::default()).unwrap();
    let took = start.elapsed();
    assert!(took < Duration::from_secs(3), "{name}: {took:?}");
    let shared = blas(mesh);
    let tlas = tlas(Level::new(), &[placed(&shared, Affine3A::IDENTITY)]);
    let mut dice = Dice(21, 0);
    let rays: Vec<Ray> = (0..320)
        .map(|_| {
            let corner = mesh.positions[dice.below(mesh.positions.len())];
            let middle = mesh.positions.iter().take(3).sum::<Vec3>() / 3.0;
            let target = if dice.below(2) == 0 { corner } else { middle };
            aimed(Vec3A::from(target) + dice.direction() * 2.0, target.into())
        })
        .collect();
    let hits: Vec<_> = rays.iter().map(|r| tlas.intersect_scalar(r, 1)).collect();
    check_kernels(&tlas, &rays, &hits);
    built
}

#[test]
fn meshes_that_defeat_a_builder_build_in_bounded_time() {
    let n = 20_000;
    let families: [(&str, Mesh); 8] = [
        // Triangles around one centre, each inside the next one.
        (
            "nested",
            soup((1..=n).map(|i| {
                let s = i as f32 * 1e-4;
                [
                    Vec3::new(-s, -s, 0.0),
                    Vec3::new(s, -s, 0.0),
                    Vec3::new(0.0, s, 0.0),
                ]
            })),
        ),
        // The same size and centre, rotated.
        (
            "fan",
            soup((0..n).map(|i| {
                let a = i as f32 / n as f32;
                let d = Vec3::new(a.cos(), a.sin(), 0.3);
                [d, -d, d.cross(Vec3::Z)]
            })),
        ),
        // Geometric growth by 1 % per triangle, from one place.
        (
            "growing",
            soup((0..n).map(|i| {
                triangle_at(Vec3::ZERO, 1.01_f32.powi(i % 2000) * 1e-6 + i as f32 * 1e-9)
            })),
        ),
        // Equal steps along a line, where all pairs are equally good.
        (
            "row",
            soup((0..n).map(|i| triangle_at(Vec3::X * i as f32, 1.0))),
        ),
        // A regular grid.
        (
            "grid",
            soup(
                (0..n)
                    .map(|i| triangle_at(Vec3::new((i % 141) as f32, (i / 141) as f32, 0.0), 1.0)),
            ),
        ),
        // Distances halve every 200 triangles: centres are concentrated at one end.
        (
            "crowded",
            soup((0..n).map(|i| {
                triangle_at(
                    Vec3::X * 2.0_f32.powi(-(i / 200)) * (1.0 + (i % 200) as f32 * 1e-3),
                    1e-3,
                )
            })),
        ),
        // Clusters of triangles that share a centre.
        (
            "clusters",
            soup((0..n).map(|i| {
                triangle_at(
                    Vec3::X * (i / 250) as f32 - Vec3::ONE * (i % 250) as f32 * 1e-3 / 3.0,
                    (i % 250) as f32 * 1e-3 + 1e-3,
                )
            })),
        ),
        // One huge triangle, and a tiny grid of all other triangles.
        (
            "speck",
            soup((0..n).map(|i| {
                if i == 0 {
                    triangle_at(Vec3::splat(-1e5), 2e5)
                } else {
                    triangle_at(
                        Vec3::new((i % 141) as f32, (i / 141) as f32, 0.0) * 1e-3,
                        1e-3,
                    )
                }
            })),
        ),
    ];
    for (name, mesh) in &families {
        let built = builds(name, mesh);
        assert!(
            built.triangles() > n as usize / 20,
            "{name}: {}",
            built.triangles()
        );
    }
}

#[test]
fn bad_meshes_are_refused_with_a_reason() {
    let good = icosphere(0);
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e11] {
        let mut mesh = good.clone();
        mesh.positions[7].y = bad;
        let error = Blas::build(&mesh, BuildLimits::default()).unwrap_err();
        assert!(
            matches!(error, BuildError::BadPosition { vertex: 7, .. }),
            "{error}"
        );
        assert!(error.to_string().starts_with("vertex 7 is at ["), "{error}");
    }
    let mut mesh = good.clone();
    mesh.triangles[3][1] = 12;
    assert_eq!(
        Blas::build(&mesh, BuildLimits::default())
            .unwrap_err()
            .to_string(),
        "triangle 3 refers to vertex 12, expected below 12"
    );
    assert_eq!(
        Blas::build(&good, BuildLimits { max_triangles: 19 })
            .unwrap_err()
            .to_string(),
        "mesh has 20 triangles, expected at most 19"
    );
    assert!(Blas::build(&good, BuildLimits { max_triangles: 20 }).is_ok());
}
