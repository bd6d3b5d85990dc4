//! Reflection and refraction at a surface.

use std::sync::LazyLock;

use glam::Vec3A;

use crate::numerics::radical_inverse;

/// A direction reflected at a surface with unit normal `n`.
pub(crate) fn reflect(d: Vec3A, n: Vec3A) -> Vec3A {
    d - n * (2.0 * d.dot(n))
}

/// Share of unpolarised light reflected by a dielectric; `eta` is the index of refraction on the far side divided
/// by that on the near side. One for total internal reflection.
pub(crate) fn fresnel_dielectric(cos_i: f32, eta: f32) -> f32 {
    let cos_i = cos_i.clamp(0.0, 1.0);
    let sin2_t = (1.0 - cos_i * cos_i) / (eta * eta);
    if sin2_t >= 1.0 {
        return 1.0;
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    let parallel = (eta * cos_i - cos_t) / (eta * cos_i + cos_t);
    let perpendicular = (cos_i - eta * cos_t) / (cos_i + eta * cos_t);
    0.5 * (parallel * parallel + perpendicular * perpendicular)
}

/// Schlick's approximation (HQ-AR, section 3): `F0 + (1 - F0)(1 - cos)^5`.
pub(crate) fn fresnel_schlick(f0: Vec3A, cos: f32) -> Vec3A {
    let m = (1.0 - cos).clamp(0.0, 1.0);
    let m2 = m * m;
    f0 + (Vec3A::ONE - f0) * (m2 * m2 * m)
}

/// Reflectance at normal incidence of a dielectric against air.
pub(crate) fn f0_of_ior(ior: f32) -> f32 {
    let r = (ior - 1.0) / (ior + 1.0);
    r * r
}

/// Direction of the refracted ray by Snell's law; `None` for total internal reflection. `n` faces the incoming
/// ray, `eta` as in [`fresnel_dielectric`].
pub(crate) fn refract(incoming: Vec3A, n: Vec3A, eta: f32) -> Option<Vec3A> {
    let cos_i = -incoming.dot(n);
    let sin2_t = (1.0 - cos_i * cos_i).max(0.0) / (eta * eta);
    if sin2_t >= 1.0 {
        return None;
    }
    let cos_t = (1.0 - sin2_t).sqrt();
    (incoming / eta + n * (cos_i / eta - cos_t)).try_normalize()
}

/// GGX normal distribution, by the cosine between microfacet normal and surface normal.
fn distribution(n_dot_h: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let d = n_dot_h * n_dot_h * (a2 - 1.0) + 1.0;
    a2 / (std::f32::consts::PI * d * d)
}

/// Smith's Lambda for GGX: self-shadowing of microfacets for a direction with this cosine.
fn lambda(cosine: f32, alpha: f32) -> f32 {
    let c = cosine.max(1e-6);
    0.5 * ((1.0 + alpha * alpha * (1.0 - c * c).max(0.0) / (c * c)).sqrt() - 1.0)
}

/// GGX BRDF without Fresnel: radiance towards the viewer per irradiance on the surface (Walter et al. 2007, with
/// Smith's height-correlated shadowing, Heitz 2014).
pub(crate) fn ggx(n_dot_v: f32, n_dot_l: f32, n_dot_h: f32, alpha: f32) -> f32 {
    let a2 = alpha * alpha;
    let v = n_dot_l * (n_dot_v * n_dot_v * (1.0 - a2) + a2).sqrt();
    let l = n_dot_v * (n_dot_l * n_dot_l * (1.0 - a2) + a2).sqrt();
    let denominator = 2.0 * (v + l);
    if denominator > 0.0 {
        distribution(n_dot_h, alpha) / denominator
    } else {
        0.0
    }
}

/// Samples a unit microfacet normal from those visible from `incoming` (Heitz 2018). `u` are two numbers in [0,
/// 1).
pub(crate) fn sample_half(incoming: Vec3A, n: Vec3A, alpha: f32, u: [f32; 2]) -> Option<Vec3A> {
    let (tx, ty) = n.any_orthonormal_pair();
    let view = -incoming;
    let v = Vec3A::new(view.dot(tx), view.dot(ty), view.dot(n).max(1e-6));
    let stretched = Vec3A::new(alpha * v.x, alpha * v.y, v.z).try_normalize()?;
    let (t1, t2) = if stretched.z < 0.999_9 {
        let t1 = Vec3A::Z.cross(stretched).try_normalize()?;
        (t1, stretched.cross(t1))
    } else {
        (Vec3A::X, Vec3A::Y)
    };
    let r = u[0].sqrt();
    let phi = std::f32::consts::TAU * u[1];
    let p1 = r * phi.cos();
    let s = 0.5 * (1.0 + stretched.z);
    let p2 = (1.0 - s) * (1.0 - p1 * p1).max(0.0).sqrt() + s * r * phi.sin();
    let m = t1 * p1 + t2 * p2 + stretched * (1.0 - p1 * p1 - p2 * p2).max(0.0).sqrt();
    let h = Vec3A::new(alpha * m.x, alpha * m.y, m.z.max(0.0)).try_normalize()?;
    Some(tx * h.x + ty * h.y + n * h.z)
}

/// Weight of a ray reflected or refracted at a normal from [`sample_half`], without Fresnel: G2 / G1 for the
/// cosines of the outgoing and the incoming direction to the surface normal.
pub(crate) fn shadowing_weight(n_dot_v: f32, n_dot_l: f32, alpha: f32) -> f32 {
    let (lv, ll) = (lambda(n_dot_v, alpha), lambda(n_dot_l, alpha));
    (1.0 + lv) / (1.0 + lv + ll)
}

/// Solid angle of normals that one sample of [`sample_half`] represents: one over its density `G1 D (v.h) /
/// (n.v)`.
pub(crate) fn solid_angle_of_half(n_dot_v: f32, n_dot_h: f32, h_dot_v: f32, alpha: f32) -> f32 {
    let visible = distribution(n_dot_h, alpha) * h_dot_v.max(1e-6);
    (1.0 + lambda(n_dot_v, alpha)) * n_dot_v.max(1e-6) / visible.max(f32::MIN_POSITIVE)
}

/// Directional albedo of a GGX lobe without Fresnel, for the cosine `n_dot_v` of the incoming direction; the rest
/// is lost between microfacets. Read from a table that is computed once by integrating the lobe.
pub(crate) fn directional_albedo(n_dot_v: f32, alpha: f32) -> f32 {
    const SIDE: usize = 16;
    const SAMPLES: u32 = 256;
    static TABLE: LazyLock<[[f32; SIDE]; SIDE]> = LazyLock::new(|| {
        let part = |i: usize| i as f32 / (SIDE - 1) as f32;
        let entry = |row: usize, column: usize| {
            let (alpha, cosine) = (part(row).max(1e-3), part(column).max(1e-2));
            let incoming = Vec3A::new((1.0 - cosine * cosine).sqrt(), 0.0, -cosine);
            let weight = |i: u32| {
                let u = [(i as f32 + 0.5) / SAMPLES as f32, radical_inverse(i)];
                sample_ggx(incoming, Vec3A::Z, alpha, u).map_or(0.0, |r| r.weight)
            };
            (0..SAMPLES).map(weight).sum::<f32>() / SAMPLES as f32
        };
        std::array::from_fn(|row| std::array::from_fn(|column| entry(row, column)))
    });
    let place = |x: f32| {
        let x = x.clamp(0.0, 1.0) * (SIDE - 1) as f32;
        // NaN becomes 0.
        let first = (x as usize).min(SIDE - 2);
        (first, x - first as f32)
    };
    let ((row, s), (column, t)) = (place(alpha), place(n_dot_v));
    let [a, b] = [row, row + 1].map(|row| {
        let row = &TABLE[row];
        row[column] + (row[column + 1] - row[column]) * t
    });
    a + (b - a) * s
}

/// Factor on a rough reflection of reflectance `f0` that compensates for light lost between microfacets, which is
/// reflected again several times and leaves (Turquin 2019, "Practical multiple scattering compensation for
/// microfacet models").
pub(crate) fn more_scattered(f0: Vec3A, n_dot_v: f32, alpha: f32) -> Vec3A {
    let albedo = directional_albedo(n_dot_v, alpha).max(0.1);
    Vec3A::ONE + f0 * (1.0 / albedo - 1.0)
}

/// A direction reflected at a normal from [`sample_half`].
pub(crate) struct Reflected {
    pub(crate) direction: Vec3A,
    /// Solid angle of directions that this sample represents if it is the only one.
    pub(crate) solid_angle: f32,
    /// Weight without Fresnel.
    pub(crate) weight: f32,
    /// Cosine of the angle between view direction and microfacet normal.
    pub(crate) h_dot_v: f32,
}

/// Samples a reflected direction from the visible normals of GGX. `None` if it points into the surface.
pub(crate) fn sample_ggx(incoming: Vec3A, n: Vec3A, alpha: f32, u: [f32; 2]) -> Option<Reflected> {
    let h = sample_half(incoming, n, alpha, u)?;
    let direction = reflect(incoming, h);
    let n_dot_l = direction.dot(n);
    let (n_dot_v, h_dot_v) = (-incoming.dot(n), -incoming.dot(h));
    (n_dot_l > 0.0).then(|| Reflected {
        direction,
        // The Jacobian of reflection is 4 (v.h).
        solid_angle: 4.0 * h_dot_v * solid_angle_of_half(n_dot_v, n.dot(h), h_dot_v, alpha),
        weight: shadowing_weight(n_dot_v, n_dot_l, alpha),
        h_dot_v,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn glass_reflects_four_percent_head_on_and_all_beyond_the_critical_angle() {
        assert!((fresnel_dielectric(1.0, 1.5) - 0.04).abs() < 1e-6);
        assert!((f0_of_ior(1.5) - 0.04).abs() < 1e-6);
        let critical = (1.0f32 / 1.5).asin();
        assert_eq!(fresnel_dielectric((critical + 1e-3).cos(), 1.0 / 1.5), 1.0);
        assert!(fresnel_dielectric((critical - 1e-2).cos(), 1.0 / 1.5) < 1.0);
    }

    #[test]
    fn ggx_reflects_no_more_than_arrives() {
        // The mean of the weights is the directional albedo.
        let albedo = |alpha: f32, cos: f32| {
            let incoming = Vec3A::new((1.0 - cos * cos).sqrt(), 0.0, -cos);
            let n = 4096;
            let mut sum = 0.0;
            for i in 0..n {
                let u = [(i as f32 + 0.5) / n as f32, (i as f32 * 0.618_034) % 1.0];
                sum += sample_ggx(incoming, Vec3A::Z, alpha, u).map_or(0.0, |r| r.weight);
            }
            sum / n as f32
        };
        for alpha in [0.01f32, 0.25, 1.0] {
            for cos in [0.1f32, 0.5, 1.0] {
                // 4096 uniform samples of an integrand of at most 1.
                assert!(albedo(alpha, cos) <= 1.0 + 1e-3, "{alpha} {cos}");
            }
        }
        // Smooth: a mirror. Roughest, at normal incidence: 1 - ln 2, the integral in closed form.
        assert!((albedo(0.01, 1.0) - 1.0).abs() < 1e-3);
        assert!((albedo(1.0, 1.0) - (1.0 - 2f32.ln())).abs() < 1e-3);
    }

    #[test]
    fn the_table_of_albedos_follows_the_lobe() {
        // Roughest, at normal incidence: 1 - ln 2. A mirror loses nothing. Between entries the table has an
        // interpolation error.
        assert!((directional_albedo(1.0, 1.0) - (1.0 - 2f32.ln())).abs() < 5e-3);
        assert!((directional_albedo(0.5, 0.0) - 1.0).abs() < 5e-3);
        for (alpha, cosine) in [(0.1f32, 0.73f32), (0.37, 0.21), (0.5, 0.5), (0.93, 0.08)] {
            let incoming = Vec3A::new((1.0 - cosine * cosine).sqrt(), 0.0, -cosine);
            let n = 16_384;
            let weight = |i: u32| {
                let u = [(i as f32 + 0.5) / n as f32, (i as f32 * 0.618_034) % 1.0];
                sample_ggx(incoming, Vec3A::Z, alpha, u).map_or(0.0, |r| r.weight)
            };
            let exact = (0..n).map(weight).sum::<f32>() / n as f32;
            let got = directional_albedo(cosine, alpha);
            assert!(
                (got - exact).abs() < 0.02,
                "{alpha} {cosine}: {got} {exact}"
            );
        }
    }

    proptest! {
        #[test]
        fn refraction_obeys_snell_and_reverses(angle in 0.0..1.55f32, ior in 1.01..2.5f32) {
            let incoming = Vec3A::new(angle.sin(), 0.0, -angle.cos());
            let out = refract(incoming, Vec3A::Z, ior).unwrap();
            prop_assert!((out.x * ior - angle.sin()).abs() < 1e-5);
            let back = refract(-out, -Vec3A::Z, 1.0 / ior).unwrap();
            prop_assert!((back + incoming).length() < 2e-3, "{back} {incoming}");
        }

        #[test]
        fn a_boundary_looks_the_same_from_both_sides(angle in 0.0..1.5f32, ior in 1.01..2.5f32) {
            // Stokes: the reflectance along a refracted path equals that along the reverse path.
            let there = fresnel_dielectric(angle.cos(), ior);
            let inside = (angle.sin() / ior).asin();
            let back = fresnel_dielectric(inside.cos(), 1.0 / ior);
            prop_assert!((there - back).abs() < 1e-4, "{there} {back}");
        }
    }
}
