//! Closed forms: exact results for spheres, planes, dielectric boundaries and sphere lights.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;

/// Parameters at which a line intersects a sphere, in order; `None` if there is no intersection. The direction need
/// not have unit length.
pub fn sphere(origin: DVec3, direction: DVec3, centre: DVec3, radius: f64) -> Option<[f64; 2]> {
    let to = centre - origin;
    let a = direction.length_squared();
    let along = to.dot(direction) / a;
    // From the perpendicular itself, to avoid a difference of large squares (Haines et al. 2019, "Precision
    // Improvements for Ray/Sphere Intersection").
    let half2 = (radius * radius - (to - direction * along).length_squared()) / a;
    (half2 >= 0.0).then(|| {
        let half = half2.sqrt();
        [along - half, along + half]
    })
}

/// Parameter at which a line intersects the plane through `point`; `None` if they are parallel.
pub fn plane(origin: DVec3, direction: DVec3, point: DVec3, normal: DVec3) -> Option<f64> {
    let speed = direction.dot(normal);
    (speed != 0.0).then(|| (point - origin).dot(normal) / speed)
}

/// Reflectance of a boundary for unpolarised light, from the angles of incidence and refraction (Fresnel's sine and
/// tangent laws). `eta` is the index on the far side divided by that on the near side.
pub fn reflectance(angle_rad: f64, eta: f64) -> f64 {
    let sine = angle_rad.sin() / eta;
    if sine >= 1.0 {
        return 1.0;
    }
    let refracted = sine.asin();
    let (sum, difference) = (angle_rad + refracted, angle_rad - refracted);
    if sum == 0.0 {
        // The limit at normal incidence, where both laws are 0 / 0.
        return ((eta - 1.0) / (eta + 1.0)).powi(2);
    }
    let across = difference.sin() / sum.sin();
    let along = difference.tan() / sum.tan();
    0.5 * (across * across + along * along)
}

/// Share of light that passes a slab with parallel faces, including all internal reflections: each face reflects
/// `reflected`, and `kept` remains after crossing the slab once.
pub fn slab_transmittance(reflected: f64, kept: f64) -> f64 {
    (1.0 - reflected).powi(2) * kept / (1.0 - (reflected * kept).powi(2))
}

/// Irradiance on a surface from a sphere of radiance 1 with its centre at `to_centre`, including spheres that the
/// horizon cuts (Snyder 1996, "Area Light Sources for Real-Time Graphics", equation for the sphere). The point must
/// be outside the sphere, and the normal must have unit length.
pub fn sphere_irradiance(to_centre: DVec3, radius: f64, normal: DVec3) -> f64 {
    let distance = to_centre.length();
    let sin_sigma = radius / distance;
    let cos_sigma = (1.0 - sin_sigma * sin_sigma).sqrt();
    let cos_omega = to_centre.dot(normal) / distance;
    let sin_omega = (1.0 - cos_omega * cos_omega).max(0.0).sqrt();
    let (omega, sigma) = (cos_omega.clamp(-1.0, 1.0).acos(), sin_sigma.asin());
    if omega <= FRAC_PI_2 - sigma {
        return PI * cos_omega * sin_sigma * sin_sigma;
    }
    if omega >= FRAC_PI_2 + sigma {
        return 0.0;
    }
    let gamma = (cos_sigma / sin_omega).clamp(-1.0, 1.0).asin();
    let (sin_gamma, cos_gamma) = gamma.sin_cos();
    let g = -2.0 * sin_omega * cos_sigma * cos_gamma + FRAC_PI_2 - gamma + sin_gamma * cos_gamma;
    let root = (sin_sigma * sin_sigma - cos_gamma * cos_gamma)
        .max(0.0)
        .sqrt();
    let arc = (cos_gamma / sin_sigma).clamp(-1.0, 1.0).asin();
    let h = cos_omega * (cos_gamma * root + sin_sigma * sin_sigma * arc);
    // The centre is above the horizon: the whole sphere, minus the part below the horizon.
    if cos_omega >= 0.0 {
        PI * cos_omega * sin_sigma * sin_sigma + g - h
    } else {
        g + h
    }
}

/// A cone of directions: the directions to a sphere.
#[derive(Debug, Clone, Copy)]
pub struct Cap {
    /// Unit length.
    pub axis: DVec3,
    /// Half its opening angle, radians, below a quarter turn.
    pub radius_rad: f64,
}

impl Cap {
    /// The cap of a sphere seen from outside.
    pub fn of_ball(to_centre: DVec3, radius: f64) -> Self {
        Self {
            axis: to_centre.normalize_or_zero(),
            radius_rad: (radius / to_centre.length()).asin(),
        }
    }

    /// Vector irradiance for radiance 1 (its dot product with a normal is the irradiance if the whole cap is above
    /// the horizon).
    pub fn flux(&self) -> DVec3 {
        self.axis * (PI * self.radius_rad.sin().powi(2))
    }

    /// Half the integral of r x dr along the rim inside another cap: the rim's contribution to the flux of their
    /// intersection (Lambert's contour integral). `half` is half the rim's angle inside, centred on the direction
    /// `towards` the other axis.
    fn rim(&self, towards: DVec3, half: f64) -> DVec3 {
        let (sin, cos) = self.radius_rad.sin_cos();
        // r = cos a + sin (x cos t + y sin t) gives r x dr = (sin^2 a - sin cos (x cos t + y sin t)) dt.
        (self.axis * (sin * sin * half)) - towards * (sin * cos * half.sin())
    }

    /// As [`Cap::flux`], for the directions in both caps: the part of one sphere that another sphere hides.
    pub fn common_flux(&self, other: &Self) -> DVec3 {
        let between = self.axis.angle_between(other.axis);
        let (a, b) = (self.radius_rad, other.radius_rad);
        if between >= a + b {
            return DVec3::ZERO;
        }
        if between <= (a - b).abs() {
            return if a < b { self.flux() } else { other.flux() };
        }
        // Angle at a cap's axis between the other axis and an intersection of the rims (spherical law of cosines).
        let half = |own: f64, others: f64| {
            ((others.cos() - own.cos() * between.cos()) / (own.sin() * between.sin()))
                .clamp(-1.0, 1.0)
                .acos()
        };
        let towards = |from: DVec3, to: DVec3| (to - from * from.dot(to)).normalize_or_zero();
        self.rim(towards(self.axis, other.axis), half(a, b))
            + other.rim(towards(other.axis, self.axis), half(b, a))
    }
}

/// Irradiance from a parallel rectangle of radiance 1 (`width` by `height`, at `distance`) at a point below its
/// corner (Howell's catalogue of configuration factors, B-4).
pub fn corner_irradiance(width: f64, height: f64, distance: f64) -> f64 {
    let (x, y) = (width / distance, height / distance);
    let part = |p: f64, q: f64| p / p.hypot(1.0) * (q / p.hypot(1.0)).atan();
    0.5 * (part(x, y) + part(y, x))
}

/// Reflectance at normal incidence of a GGX surface with alpha = 1 and no absorption, for single scattering:
/// `1 - ln 2`.
///
/// With n = v the half vector's cosine c has density 2 c dc, the reflected cosine is 2 c^2 - 1, and Smith's
/// height-correlated shadowing leaves (2 c^2 - 1) / c^2 of it for c^2 > 1/2.
pub fn ggx_head_on() -> f64 {
    1.0 - std::f64::consts::LN_2
}

/// Solid angle of a cone.
pub fn cone_solid_angle(radius_rad: f64) -> f64 {
    // 1 - cos, without cancellation.
    2.0 * TAU * (0.5 * radius_rad).sin().powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Irradiance by the midpoint rule over the directions of a cap for which `keep` is true.
    fn quadrature(cap: &Cap, normal: DVec3, keep: impl Fn(DVec3) -> bool) -> f64 {
        let (x, y) = cap.axis.any_orthonormal_pair();
        let (rings, steps) = (2000, 2000);
        let mut sum = 0.0;
        for i in 0..rings {
            let angle = cap.radius_rad * (f64::from(i) + 0.5) / f64::from(rings);
            let (sin, cos) = angle.sin_cos();
            for j in 0..steps {
                let (s, c) = (TAU * (f64::from(j) + 0.5) / f64::from(steps)).sin_cos();
                let d = cap.axis * cos + (x * c + y * s) * sin;
                if keep(d) {
                    sum += d.dot(normal).max(0.0) * sin;
                }
            }
        }
        sum * cap.radius_rad / f64::from(rings) * TAU / f64::from(steps)
    }

    /// Error of the midpoint rule at an edge that cuts cells: at most the cells along it, one ring wide, relative to
    /// the cap's irradiance.
    const CELLS: f64 = 4.0 / 2000.0;

    #[test]
    fn a_ball_light_at_every_height_over_the_horizon() {
        for (radius, distance) in [(0.1, 1.0), (0.5, 1.0), (0.99, 1.0)] {
            for step in 0..=18 {
                let angle = f64::from(step) * 10f64.to_radians();
                let to = DVec3::new(angle.sin(), 0.0, angle.cos()) * distance;
                let closed = sphere_irradiance(to, radius, DVec3::Z);
                let cap = Cap::of_ball(to, radius);
                let summed = quadrature(&cap, DVec3::Z, |_| true);
                let bound = CELLS * PI * (radius / distance).powi(2);
                assert!(
                    (closed - summed).abs() < bound,
                    "{radius} {step}: {closed} {summed}"
                );
            }
        }
    }

    #[test]
    fn what_two_balls_have_in_common() {
        let light = Cap::of_ball(DVec3::new(0.2, 0.1, 2.0), 0.3);
        for (x, radius) in [(0.0, 0.05), (0.1, 0.1), (0.2, 0.1), (0.25, 0.2), (0.5, 0.1)] {
            let other = Cap::of_ball(DVec3::new(x, 0.0, 1.0), radius);
            let normal = DVec3::new(0.3, 0.0, 1.0).normalize_or_zero();
            let closed = light.common_flux(&other).dot(normal);
            let summed = quadrature(&light, normal, |d| {
                d.angle_between(other.axis) < other.radius_rad
            });
            let bound = CELLS * light.flux().length();
            assert!(
                (closed - summed).abs() < bound,
                "{x} {radius}: {closed} {summed}"
            );
            let same = other.common_flux(&light).dot(normal);
            assert!((closed - same).abs() < 1e-15, "{x} {radius}");
        }
    }

    #[test]
    fn a_boundary_head_on_and_beyond_the_critical_angle() {
        // An error of a few roundings.
        assert!((reflectance(0.0, 1.5) - 0.04).abs() < 1e-16);
        // The laws are even functions of the angle.
        assert!((reflectance(1e-6, 1.5) - 0.04).abs() < 1e-11);
        assert_eq!(reflectance(0.8, 1.0 / 1.5), 1.0);
        // At Brewster's angle only the perpendicular polarisation remains.
        let brewster = 1.5f64.atan();
        let across = ((1.5f64 * 1.5 - 1.0) / (1.5 * 1.5 + 1.0)).powi(2);
        assert!((reflectance(brewster, 1.5) - 0.5 * across).abs() < 1e-15);
    }

    #[test]
    fn lines_meet_spheres_and_planes_where_they_should() {
        let hit = sphere(DVec3::ZERO, DVec3::Z * 2.0, DVec3::Z * 4.0, 1.0);
        assert_eq!(hit, Some([1.5, 2.5]));
        assert_eq!(sphere(DVec3::X * 1.1, DVec3::Z, DVec3::Z * 4.0, 1.0), None);
        assert_eq!(
            plane(DVec3::ZERO, DVec3::Z * 2.0, DVec3::Z * 4.0, DVec3::Z),
            Some(2.0)
        );
        assert_eq!(plane(DVec3::ZERO, DVec3::X, DVec3::Z, DVec3::Z), None);
    }
}
