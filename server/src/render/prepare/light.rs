//! Lights relative to the current camera, and the points on them that shadow rays aim at.

use glam::{Affine3A, Vec3A};

use crate::accel::Shaft;
use crate::camera::Pose;
use crate::ghost::BeamEnd;
use crate::numerics::gamma;
use crate::scene::Light;

/// A light in camera space.
#[derive(Debug, Clone, Copy)]
pub(crate) enum CameraLight {
    /// A ball; see [`Light::Sphere`].
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

    /// Unit direction from `p` to the light's centre, and the irradiance on a surface there
    /// that faces it, without occlusion. Inside a ball the distance is taken as its radius:
    /// irradiance stays finite.
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

    /// The visible disc of the light from `p`, its rim not yet known; `None` from inside it, where
    /// nothing can stand between.
    pub(crate) fn disc(&self, p: Vec3A) -> Option<LightDisc> {
        let (to_center, rim_squared, t_max) = match *self {
            Self::Sphere { center, radius, .. } => {
                let to = center - p;
                let d2 = to.length_squared();
                let r2 = radius * radius;
                // False for a NaN, too.
                if !(d2 > r2 && d2.is_finite()) {
                    return None;
                }
                // The circle of tangency: what one sees of a ball is the disc it bounds.
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

    /// GGX alpha of a lobe that shows the light as one of no extent would show it more sharply (Karis
    /// 2013). The lobe stays normalised: what is spread over a larger highlight is the same light.
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

    /// Whether rays drawn from a lobe of this GGX alpha see the light themselves, as those of a mirror
    /// do: the lobe is narrower than the light, so most of them agree. Else the shading model shows
    /// its highlight.
    pub(crate) fn is_seen_by_rays(&self, from: Vec3A, alpha: f32) -> bool {
        match *self {
            // Half the light's angle, for a facet's tilt turns what it reflects by twice as much.
            Self::Sphere { center, radius, .. } => {
                radius > 0.0 && 0.5 * radius >= alpha * (center - from).length()
            }
            Self::Directional { .. } => false,
        }
    }

    /// Whether the light has any extent to be sampled.
    pub(crate) fn is_extended(&self) -> bool {
        match *self {
            Self::Sphere { radius, .. } => radius > 0.0,
            Self::Directional { tan_radius, .. } => tan_radius > 0.0,
        }
    }

    /// Distance along a unit ray to a ball light, and its radiance: what a mirror shows of it.
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
        // Distance from the centre to the ray, from the perpendicular itself: no cancellation
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

    /// Where rays to the light end.
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

    /// Everything on the way from a ball (centre, radius) to the light.
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

/// The disc of a light seen from a point: `to_center + u x + v y` over the unit disc.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LightDisc {
    to_center: Vec3A,
    /// Zero until [`LightDisc::open`]: many points need no more than the centre.
    u: Vec3A,
    v: Vec3A,
    /// Square of its radius.
    rim_squared: f32,
    /// Ray parameter of the disc along [`LightDisc::direction`].
    pub(crate) t_max: f32,
}

impl LightDisc {
    /// Finds the disc's axes.
    pub(crate) fn open(&mut self) {
        if let Some(axis) = self.to_center.try_normalize() {
            let (u, v) = axis.any_orthonormal_pair();
            let rim = self.rim_squared.sqrt();
            (self.u, self.v) = (u * rim, v * rim);
        }
    }

    /// The point `distance` along the ray to the centre, and how far the same point of any other
    /// ray to the disc lies from it: the chord of their angle, under its tangent.
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
    // Composed in f64: a world origin far away cancels before it is rounded.
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
        // A tangent ray meets the ball at one point, at a right angle to its radius.
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
