//! Bundles of rays: if a bundle is excluded, no ray of it hits anything.

use fearless_simd::Level;
use glam::{Affine3A, Mat3A, Vec3, Vec3A};
use proptest::prelude::*;

use super::{blas, levels, placed, tlas};
use ghostlight::accel::{MASK_GHOST, MASK_VIRTUAL, Ray, Shaft};
use ghostlight_lab::hard::shapes::{icosphere, mesh};

fn inside(v: [f32; 3]) -> Vec3A {
    Vec3A::from(v) / Vec3A::from(v).length().max(1.0)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// If a ray from one ball to another hits something, the shaft between them must not be excluded.
    #[test]
    fn nothing_that_is_hit_is_ruled_out(
        corners in prop::collection::vec(prop::array::uniform3(-1.0..1.0f32), 3..60),
        columns in prop::array::uniform3(prop::array::uniform3(-2.0..2.0f32)),
        shift in prop::array::uniform3(-3.0..3.0f32),
        from in prop::array::uniform3(-4.0..4.0f32), radius in 0.0..0.5f32,
        to_radius in 0.0..0.5f32, beyond in 0.0..3.0f32,
        a in prop::array::uniform3(-1.0..1.0f32), b in prop::array::uniform3(-1.0..1.0f32),
        weights in prop::array::uniform2(0.0..1.0f32), pick in 0usize..20,
        far in prop::sample::select(vec![1.0f32, 1e3, 1e-3]),
    ) {
        let positions: Vec<Vec3> = corners.into_iter().map(Vec3::from).collect();
        let n = positions.len() as u32 / 3;
        let shape = mesh(positions, (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect());
        let matrix = Mat3A::from_cols_array_2d(&columns);
        prop_assume!(matrix.determinant().abs() > 1e-3);
        let at = Affine3A { matrix3: matrix * far, translation: Vec3A::from(shift) * far };
        // Towards a point of a triangle, and beyond it.
        let triangle = shape.triangles[pick % n as usize].map(|i| Vec3A::from(shape.positions[i as usize]));
        let (u, v) = if weights[0] + weights[1] > 1.0 { (1.0 - weights[0], 1.0 - weights[1]) } else { (weights[0], weights[1]) };
        let target = at.transform_point3a(triangle[0] + (triangle[1] - triangle[0]) * u + (triangle[2] - triangle[0]) * v);
        let (from, radius, to_radius) = (Vec3A::from(from) * far, radius * far, to_radius * far);
        let origin = from + inside(a) * (radius * 0.999);
        let end = target + (target - origin) * beyond;
        let direction = end - origin;
        prop_assume!(direction.length() > 1e-3 * far);
        let light = end - inside(b) * (to_radius * 0.999);
        let ray = Ray { origin, direction, t_min: 0.0, t_max: 1.0 };
        let unit = (light - from).try_normalize().unwrap_or(Vec3A::Z);
        for level in levels() {
            let tlas = tlas(level, &[placed(&blas(&shape), at)]);
            if tlas.intersect(&ray, MASK_VIRTUAL).is_none() {
                continue;
            }
            let shaft = Shaft::between((from, radius), (light, to_radius));
            prop_assert!(tlas.may_intersect(&shaft, MASK_VIRTUAL), "{:?}", level);
            prop_assert!(!tlas.may_intersect(&shaft, MASK_GHOST));
            let towards = Shaft::towards((origin, 0.0), direction.try_normalize().unwrap(), 0.0);
            prop_assert!(tlas.may_intersect(&towards, MASK_VIRTUAL), "{:?} towards", level);
            let cone = Shaft::towards((from, radius + (end - light).length()), unit, 0.0);
            prop_assert!(tlas.may_intersect(&cone, MASK_VIRTUAL), "{:?} cone", level);
        }
    }
}

#[test]
fn what_passes_by_is_ruled_out_and_what_grazes_is_not() {
    let ball = blas(&icosphere(4));
    let scale = Affine3A::from_scale_rotation_translation(
        Vec3::splat(0.1),
        glam::Quat::from_rotation_y(0.3),
        Vec3::new(0.0, 0.0, 2.0),
    );
    for level in levels() {
        let tlas = tlas(level, &[placed(&ball, scale)]);
        let past = |offset: f32| {
            let from = (Vec3A::new(offset, 0.0, 1.0), 0.01);
            tlas.may_intersect(
                &Shaft::between(from, (Vec3A::new(offset, 0.0, 3.0), 0.01)),
                MASK_VIRTUAL,
            )
        };
        assert!(past(0.0) && past(0.1) && past(0.109), "{level:?}");
        // A hundredth of a metre beside the sphere, a tenth of its radius.
        assert!(!past(0.121), "{level:?}");
        let behind = Shaft::towards((Vec3A::new(0.0, 0.0, 3.0), 0.01), Vec3A::Z, 0.2);
        assert!(!tlas.may_intersect(&behind, MASK_VIRTUAL), "{level:?}");
        let widening = Shaft::towards((Vec3A::new(0.3, 0.0, 0.0), 0.0), Vec3A::Z, 0.11);
        assert!(tlas.may_intersect(&widening, MASK_VIRTUAL), "{level:?}");
    }
}

#[test]
fn odd_shafts_are_answered() {
    let ball = blas(&icosphere(2));
    let tlas = tlas(Level::new(), &[placed(&ball, Affine3A::IDENTITY)]);
    let z = Vec3A::new(0.0, 0.0, 5.0);
    // One end contains the other: the shaft has no sides, and nothing is excluded.
    assert!(tlas.may_intersect(&Shaft::between((z, 0.1), (z, 0.5)), MASK_VIRTUAL));
    // NaN: there is no ray either.
    assert!(!tlas.may_intersect(&Shaft::between((z * f32::NAN, 0.1), (z, 0.5)), MASK_VIRTUAL));
    // A length of zero: no sides either.
    assert!(tlas.may_intersect(&Shaft::between((z, 0.0), (z, 0.0)), MASK_VIRTUAL));
    assert!(tlas.may_intersect(&Shaft::between((Vec3A::ZERO, 2.0), (z, 0.1)), MASK_VIRTUAL));
}
