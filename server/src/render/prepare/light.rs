//! Lights relative to the current camera, and the points on them at which shadow rays are aimed.

use glam::{Affine3A, Vec3A};

use crate::accel::Shaft;
use crate::camera::Pose;
use crate::ghost::BeamEnd;
use crate::numerics::gamma;
use crate::scene::Light;

/// A light in camera space.
#[derive(Debug, Clone, Copy)]
pub(crate) enum CameraLight {
    /// A sphere; see [`Light::Sphere`].
    Sphere {
        center: Vec3A,
        radius: f32,
        intensity: Vec3A,
    },
    /// Parallel light; `to_light` is a unit vector.
    Directional {
        to_light: Vec3A,
        tan_radius: f32,
        irradiance: Vec3A,
    },
}

impl CameraLight {
    pub(crate) fn new(light: &Light, camera_from_world: &Pose) -> Self {
        match *light {
            Light::Sphere {
                position,
                radius_m,
                intensity,
            } => Self::Sphere {
                center: camera_from_world.transform_point(position).as_vec3a(),
                radius: radius_m as f32,
                intensity: intensity.into(),
            },
            Light::Directional {
                direction,
                angular_radius_rad,
                irradiance,
            } => Self::Directional {
                to_light: -(camera_from_world.rotation * direction).as_vec3a(),
                tan_radius: angular_radius_rad.tan() as f32,
                irradiance: irradiance.into(),
            },
        }
    }

    /// Unit direction from `p` to the light's centre, and the unoccluded irradiance on a surface at `p` that
    /// faces it. Inside a sphere light the radius is used as distance, so that irradiance stays finite.
    pub(crate) fn illuminate(&self, p: Vec3A) -> (Vec3A, Vec3A) {
        match *self {
            Self::Sphere {
                center,
                radius,
                intensity,
            } => {
                let to = center - p;
                let distance_squared = to.length_squared();
                let Some(direction) = to.try_normalize() else {
                    return (Vec3A::Z, Vec3A::ZERO);
                };
                let floor = (radius * radius).max(f32::MIN_POSITIVE);
                (direction, intensity / distance_squared.max(floor))
            }
            Self::Directional {
                to_light,
                irradiance,
                ..
            } => (to_light, irradiance),
        }
    }

    /// The visible disc of the light from `p`, with the rim not yet computed; `None` inside the light, where
    /// nothing can be in between.
    pub(crate) fn disc(&self, p: Vec3A) -> Option<LightDisc> {
        let (to_center, rim_squared, t_max) = match *self {
            Self::Sphere { center, radius, .. } => {
                let to = center - p;
                let d2 = to.length_squared();
                let r2 = radius * radius;
                // False for NaN as well.
                if !(d2 > r2 && d2.is_finite()) {
                    return None;
                }
                // The circle of tangency: the disc that it bounds is the visible part of a sphere.
                let nearer = 1.0 - r2 / d2;
                (to * nearer, r2 * nearer, 1.0)
            }
            Self::Directional {
                to_light,
                tan_radius,
                ..
            } => (to_light, tan_radius * tan_radius, f32::INFINITY),
        };
        Some(LightDisc {
            to_center,
            rim_squared,
            t_max,
            ..LightDisc::default()
        })
    }

    /// GGX alpha widened by the extent of the light, so that a point light seen with it looks like this light
    /// seen with `alpha` (Karis 2013). The lobe stays normalised: a larger highlight has the same total light.
    pub(crate) fn widened_alpha(&self, from: Vec3A, alpha: f32) -> f32 {
        let half_angle = match *self {
            Self::Sphere { center, radius, .. } => {
                let distance = (center - from).length();
                radius / distance.max(radius.max(f32::MIN_POSITIVE))
            }
            Self::Directional { tan_radius, .. } => tan_radius,
        };
        (alpha + 0.5 * half_angle).min(1.0)
    }

    /// Whether rays sampled from a lobe of this GGX alpha see the light themselves, like those of a mirror: the
    /// lobe is narrower than the light, so most rays agree. Otherwise the shading model adds the highlight.
    pub(crate) fn is_seen_by_rays(&self, from: Vec3A, alpha: f32) -> bool {
        match *self {
            // Half the light's angle, because tilting a facet rotates its reflection by twice the angle.
            Self::Sphere { center, radius, .. } => {
                radius > 0.0 && 0.5 * radius >= alpha * (center - from).length()
            }
            Self::Directional { .. } => false,
        }
    }

    /// Whether the light has an extent to be sampled.
    pub(crate) fn is_extended(&self) -> bool {
        match *self {
            Self::Sphere { radius, .. } => radius > 0.0,
            Self::Directional { tan_radius, .. } => tan_radius > 0.0,
        }
    }

    /// Distance along a unit ray to a sphere light, and its radiance, for mirrors.
    pub(crate) fn intersect(&self, origin: Vec3A, direction: Vec3A) -> Option<(f32, Vec3A)> {
        let Self::Sphere {
            center,
            radius,
            intensity,
        } = *self
        else {
            return None;
        };
        if radius <= 0.0 {
            return None;
        }
        let to = center - origin;
        let along = to.dot(direction);
        if along <= 0.0 {
            return None;
        }
        // The distance of the ray from the centre is computed from the perpendicular, which avoids cancellation
        // of large squares (Haines et al. 2019, Precision improvements for ray/sphere intersection).
        let perpendicular = (to - direction * along).length_squared();
        let half_chord_squared = radius * radius - perpendicular;
        if half_chord_squared <= 0.0 {
            return None;
        }
        let t = along - half_chord_squared.sqrt();
        let radiance = intensity / (std::f32::consts::PI * radius * radius);
        (t > 0.0).then_some((t, radiance))
    }

    /// The end of a beam of rays to the light.
    pub(crate) fn beam_end(&self) -> BeamEnd {
        match *self {
            Self::Sphere { center, radius, .. } => BeamEnd::Ball(center, radius),
            Self::Directional {
                to_light,
                tan_radius,
                ..
            } => BeamEnd::Towards(to_light, tan_radius),
        }
    }

    /// The volume between a sphere (centre, radius) and the light.
    pub(crate) fn shaft(&self, from: (Vec3A, f32)) -> Shaft {
        match *self {
            Self::Sphere { center, radius, .. } => Shaft::between(from, (center, radius)),
            Self::Directional {
                to_light,
                tan_radius,
                ..
            } => Shaft::towards(from, to_light, tan_radius),
        }
    }
}

/// The disc of a light as seen from a point: `to_center + u x + v y` over the unit disc.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LightDisc {
    to_center: Vec3A,
    /// Zero until [`LightDisc::open`], because for many points the centre is enough.
    u: Vec3A,
    v: Vec3A,
    /// Square of its radius.
    rim_squared: f32,
    /// Ray parameter of the disc along [`LightDisc::direction`].
    pub(crate) t_max: f32,
}

impl LightDisc {
    /// Computes the disc's axes.
    pub(crate) fn open(&mut self) {
        if let Some(axis) = self.to_center.try_normalize() {
            let (u, v) = axis.any_orthonormal_pair();
            let rim = self.rim_squared.sqrt();
            (self.u, self.v) = (u * rim, v * rim);
        }
    }

    /// The point at `distance` along the ray to the centre, and a bound on its distance from the same point of
    /// any other ray to the disc: the chord of the angle between them is below its tangent.
    pub(crate) fn start_of_rays(&self, origin: Vec3A, distance: f32) -> (Vec3A, f32) {
        let inverse = self.to_center.length_recip();
        (
            origin + self.to_center * (distance * inverse),
            distance * inverse * self.rim_squared.sqrt() * (1.0 + gamma(8)),
        )
    }

    /// Ray direction to the disc's point (x, y); the disc lies at parameter `t_max`.
    #[inline]
    pub(crate) fn direction(&self, [x, y]: [f32; 2]) -> Vec3A {
        self.to_center + self.u * x + self.v * y
    }
}

/// Rigid transform of a pose as a camera-space affine map.
pub(crate) fn camera_from_object(
    camera_from_world: &Pose,
    world_from_object: &glam::DAffine3,
) -> Affine3A {
    // Composed in f64, so that a distant world origin cancels before rounding to f32.
    (camera_from_world.to_affine() * *world_from_object).as_affine3a()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};

    fn ball(center: Vec3A, radius: f32) -> CameraLight {
        CameraLight::Sphere {
            center,
            radius,
            intensity: Vec3A::ONE,
        }
    }

    #[test]
    fn the_disc_is_the_circle_of_tangency() {
        let light = ball(Vec3A::new(0.0, 0.0, 2.0), 0.5);
        let mut disc = light.disc(Vec3A::ZERO).unwrap();
        disc.open();
        let rim = disc.direction([1.0, 0.0]);
        // A tangent ray touches the sphere at one point, at a right angle to the radius.
        assert!((rim - Vec3A::new(0.0, 0.0, 2.0)).length() - 0.5 < 1e-6);
        assert!(rim.dot(rim - Vec3A::new(0.0, 0.0, 2.0)).abs() < 1e-6);
        assert!(
            light.disc(Vec3A::new(0.0, 0.1, 1.8)).is_none(),
            "inside the light"
        );
        assert!(
            light.disc(Vec3A::new(0.0, 0.0, 2.0)).is_none(),
            "at its centre"
        );
    }

    #[test]
    fn light_at_or_in_the_shaded_point_stays_finite() {
        for p in [
            Vec3A::ZERO,
            Vec3A::new(0.0, 0.0, 1e-20),
            Vec3A::new(0.0, 0.05, 0.0),
        ] {
            for radius in [0.0, 0.1] {
                let (direction, irradiance) = ball(Vec3A::ZERO, radius).illuminate(p);
                assert!(
                    direction.is_finite() && irradiance.is_finite(),
                    "{p} {radius}: {irradiance}"
                );
            }
        }
    }

    #[test]
    fn a_directional_light_turns_with_the_camera() {
        let pose = Pose::from_rows(
            [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
            [5.0, 0.0, 0.0],
        )
        .unwrap();
        let light = Light::Directional {
            direction: DVec3::X,
            angular_radius_rad: 0.0,
            irradiance: Vec3::ONE,
        };
        let CameraLight::Directional { to_light, .. } = CameraLight::new(&light, &pose.inverse())
        else {
            panic!()
        };
        assert!(
            (to_light - Vec3A::new(0.0, 0.0, -1.0)).length() < 1e-6,
            "{to_light}"
        );
    }
}
