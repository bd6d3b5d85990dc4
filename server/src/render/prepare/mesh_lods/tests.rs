use glam::{Mat3A, Vec3};

use super::*;
use crate::render::Uninterrupted;
use crate::shapes::wrapped_grid;

fn lods_of(mesh: &Arc<Mesh>) -> Result<MeshLods, String> {
    MeshLods::new(mesh, &Uninterrupted)
}

#[test]
fn ordinary_meshes_are_probed_as_often_as_there_may_be() {
    let stride_of = |mesh: &Mesh| {
        let blas = Blas::build(mesh, BuildLimits::default()).unwrap();
        stride(mesh, &blas, 0.05)
    };
    assert_eq!(stride_of(&torus(64, 32)), Some(1));
    assert_eq!(stride_of(&torus(512, 256)), Some(8));
}

/// Where thousands of triangles overlap, every probe visits all of them, so the least number of visits is known:
/// fewer probes are used, or none if that leaves too few.
#[test]
fn where_triangles_lie_on_each_other_fewer_probes_are_taken() {
    // A stack thinner than the reach of the probes.
    const REACH: f32 = 0.05;
    let stack = |n: usize| {
        let layer = |i: usize| {
            let up = Vec3::new(0.0, 0.0, 0.5 * REACH * i as f32 / n as f32);
            [up, up + Vec3::X, up + Vec3::Y]
        };
        Mesh {
            positions: (0..n).flat_map(layer).collect(),
            triangles: (0..n as u32)
                .map(|i| [3 * i, 3 * i + 1, 3 * i + 2])
                .collect(),
            ..Mesh::default()
        }
    };
    let told = |n: usize| {
        let mesh = stack(n);
        let blas = Blas::build(&mesh, BuildLimits::default()).unwrap();
        let [a, b] = [-REACH, REACH].map(|z| Vec3A::new(1.0 / 3.0, 1.0 / 3.0, z));
        // The two rays of a probe together reach as far as this one.
        (stride(&mesh, &blas, REACH), blas.visits(a, b, usize::MAX))
    };
    let (fewer, of_probe) = told(16_000);
    assert!(16_000 * of_probe > MOST_VISITS, "{of_probe}");
    let fewer = fewer.unwrap();
    let n_probes = 16_000_usize.div_ceil(fewer);
    assert!(n_probes >= LEAST_PROBES && n_probes * of_probe <= MOST_VISITS + of_probe);
    let (none, of_probe) = told(100_000);
    assert!(LEAST_PROBES * of_probe > MOST_VISITS, "{of_probe}");
    assert_eq!(none, None);
}

#[test]
fn a_mesh_that_takes_forever_is_without_levels_and_says_so() {
    let n = 40_000u32;
    let rim = |i: u32| {
        let (sin, cos) = (i as f32 / n as f32 * std::f32::consts::TAU).sin_cos();
        Vec3::new(cos, 0.0, sin)
    };
    let mesh = Mesh {
        positions: (0..n).map(rim).chain([Vec3::Y]).collect(),
        triangles: (0..n).map(|i| [n, (i + 1) % n, i]).collect(),
        ..Mesh::default()
    };
    let fan = lods_of(&Arc::new(mesh)).unwrap();
    assert!(fan.without_lods && fan.levels.len() == 1);
    assert!(!lods_of(&Arc::new(torus(64, 32))).unwrap().without_lods);
}
/// A torus of radii 1 and 0.4 with exact normals, of `2 n m` triangles.
fn torus(n: u32, m: u32) -> Mesh {
    let angle = |k: u32, of: u32| k as f32 / of as f32 * std::f32::consts::TAU;
    let (mut positions, mut normals) = (Vec::new(), Vec::new());
    for i in 0..n * m {
        let ((sa, ca), (sb, cb)) = (angle(i / m, n).sin_cos(), angle(i % m, m).sin_cos());
        let ring = 1.0 + 0.4 * cb;
        positions.push(Vec3::new(ring * ca, 0.4 * sb, ring * sa));
        normals.push(Vec3::new(cb * ca, sb, cb * sa));
    }
    Mesh {
        positions,
        normals,
        triangles: wrapped_grid(n, m),
        ..Mesh::default()
    }
}

/// Distance from the ideal torus, and the angle between a normal and that of the torus there.
fn off(p: Vec3A, normal: Vec3A) -> (f32, f32) {
    let flat = Vec3A::new(p.x, 0.0, p.z);
    let tube = p - flat.try_normalize().unwrap();
    (
        (tube.length() - 0.4).abs(),
        normal.angle_between(tube.try_normalize().unwrap()),
    )
}

#[test]
fn a_level_is_off_as_far_as_its_distance_from_the_ideal_surface_says() {
    let mesh = Arc::new(torus(512, 256));
    let lods = lods_of(&mesh).unwrap();
    assert_eq!(lods.levels.len(), 3);
    assert_eq!(lods.levels[0].error, LodError::default());
    let mut before = 0.0;
    for lod in &lods.levels[1..] {
        // The distance from the ideal torus at a dense set of points on every triangle of the level. It must
        // agree with the measurement by rays, except for the mesh's own distance from the ideal and the quantile
        // that is left out.
        let (mut farthest, mut squares, mut area) = (0.0f32, 0.0, 0.0);
        for triangle in 0..lod.mesh.triangles.len() {
            let at = |i: u32| Vec3A::from(lod.mesh.positions[i as usize]);
            let [a, b, c] = lod.mesh.triangles[triangle].map(at);
            let size = (b - a).cross(c - a).length();
            for (u, v) in [
                (1.0 / 3.0, 1.0 / 3.0),
                (0.5, 0.25),
                (0.25, 0.5),
                (0.25, 0.25),
            ] {
                let p = a * (1.0 - u - v) + b * u + c * v;
                let normal = normal_at(&lod.mesh, triangle, u, v).unwrap();
                let (distance, angle) = off(p, normal);
                farthest = farthest.max(distance);
                squares += size * angle * angle;
                area += size;
            }
        }
        let normal = (squares / area).sqrt();
        let LodError {
            position,
            normal: measured,
            color,
        } = lod.error;
        assert!(
            position < 1.1 * farthest && position > 0.4 * farthest,
            "{position} {farthest}"
        );
        assert!(
            measured < 1.5 * normal && measured > 0.67 * normal,
            "{measured} {normal}"
        );
        assert!(position > before);
        assert_eq!(color, 0.0);
        before = position;
    }
}

/// A torus in which every second ring is shrunk to nothing, with slivers and triangles of zero area, far from the
/// origin: any levels of detail have finite errors.
#[test]
fn a_mesh_that_hardly_has_an_area_has_levels_or_none() {
    for (squeeze, at) in [
        (0.0, 0.0),
        (1e-30, 0.0),
        (1e-6, 0.0),
        (1e-3, 1e5),
        (1.0, 9e5),
    ] {
        let mut mesh = torus(512, 128);
        for (i, p) in mesh.positions.iter_mut().enumerate() {
            p.y *= if i / 128 % 2 == 0 { squeeze } else { 1.0 };
            *p = *p * squeeze.max(1e-12) + Vec3::splat(at);
        }
        let lods = lods_of(&Arc::new(mesh)).unwrap();
        for Lod { error, .. } in &lods.levels {
            assert!(error.position.is_finite() && error.normal.is_finite());
        }
    }
}

#[test]
fn colours_that_differ_are_smeared_as_far_as_a_triangle_is_large() {
    let (mut mesh, mut coarse) = (torus(64, 32), torus(32, 16));
    let blas = Arc::new(Blas::build(&coarse, BuildLimits::default()).unwrap());
    let size = (0..coarse.triangles.len()).map(|i| longest_side(&coarse, i));
    let (least, most) = (
        size.clone().fold(f32::MAX, f32::min),
        size.fold(0.0, f32::max),
    );
    let mut measured = |fine: Vec4, rough: Vec4| {
        mesh.colors = vec![fine; mesh.positions.len()];
        coarse.colors = vec![rough; coarse.positions.len()];
        LodError::measured(&mesh, &coarse, &blas, 0.1)
            .unwrap()
            .color
    };
    let (red, reddish) = (Vec4::X, Vec4::new(0.99, 0.0, 0.0, 0.0));
    assert_eq!(measured(red, red), 0.0);
    assert_eq!(measured(red, reddish), 0.0);
    assert!((least..=most).contains(&measured(red, Vec4::Y)));
}

#[test]
fn the_nearer_and_the_stricter_the_finer() {
    let lods = lods_of(&Arc::new(torus(512, 256))).unwrap();
    let at = |z: f32, scale: f32| {
        Placed::new(Affine3A::from_mat3_translation(
            (Mat3A::from_diagonal(Vec3::splat(scale))).into(),
            Vec3::new(0.0, 0.0, z),
        ))
    };
    let lod = |wanted, placed: &Placed, limit| lods.lod_for(wanted, placed, 525.0, limit);
    for wanted in [Use::Specular, Use::Matte, Use::Shadow] {
        assert_eq!(lod(wanted, &at(1e4, 1.0), 0.5), 2);
        // Inside the sphere, and behind the camera but within its reach.
        assert_eq!(lod(wanted, &at(0.5, 1.0), 16.0), 0);
        assert_eq!(lod(wanted, &at(-1.3, 1.0), 16.0), 0);
        assert_eq!(lod(wanted, &at(3.0, 1.0), 0.0), 0);
        let mut last = 0;
        for step in 0..40 {
            let now = lod(wanted, &at(1.5 * 1.3f32.powi(step), 1.0), 0.5);
            assert!(now >= last, "{wanted:?} at step {step}");
            last = now;
        }
        // Half the size at half the distance gives the same picture.
        for z in [3.0, 10.0, 30.0, 100.0] {
            let (whole, half) = (at(z, 1.0), at(0.5 * z, 0.5));
            assert_eq!(lod(wanted, &whole, 0.5), lod(wanted, &half, 0.5));
        }
    }
    let placed = at(6.0, 1.0);
    let [specular, matte, shadow] =
        [Use::Specular, Use::Matte, Use::Shadow].map(|wanted| lod(wanted, &placed, 0.5));
    assert!(specular <= matte && matte <= shadow);
}
