//! A scanned solid lets no ray through; the others are in `ghostlight_lab::hard`.

use fearless_simd::Level;
use glam::{Affine3A, Vec3A};

use super::{agree, blas, data, placed, tlas};
use ghostlight::accel::Ray;
use ghostlight::scene::{Mesh, load_meshes};
use ghostlight_lab::hard::shapes::{Dice, aimed};
use ghostlight_lab::hard::watertight::target;

/// Winding number of the mesh around the point (van Oosterom, Strackee 1983, "The Solid Angle of a Plane Triangle"):
/// 0 outside of a closed mesh, 1 or -1 inside.
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
    let Some(data) = data::folder() else {
        return;
    };
    let meshes = load_meshes(&data.join("meshes/dragon-100k.ply")).unwrap();
    let mesh = &meshes[0];
    assert!(mesh.triangles.len() > 99_000, "{}", mesh.triangles.len());
    let tlas = tlas(Level::new(), &[placed(&blas(mesh), Affine3A::IDENTITY)]);
    let (low, high) = tlas.bounds(0).unwrap();
    let mut dice = Dice(6, 0);
    let mut inside = Vec::new();
    while inside.len() < 20 {
        let at = Vec3A::new(dice.unit(), dice.unit(), dice.unit());
        let point = low + (high - low) * at;
        let turns = winding(mesh, point).abs();
        // An integer, as for any closed surface.
        assert!((turns - turns.round()).abs() < 1e-6, "{point} {turns}");
        if turns.round() == 1.0 {
            inside.push(point);
        }
    }
    let rays: Vec<Ray> = (0..100_000)
        .map(|i| aimed(inside[i % inside.len()], target(mesh, &mut dice)))
        .collect();
    let hits = agree(&tlas, &rays).unwrap();
    let leaks = hits.iter().filter(|hit| hit.is_none()).count();
    assert_eq!(leaks, 0, "{leaks} of {} rays leak", rays.len());
}
