//! Light sampling: points on lights, and their densities.

use std::f64::consts::TAU;

use glam::DVec3;

use super::Tracer;
use super::random::Random;
use super::world::Light;
use crate::oracle::closed;

/// A sampled point on a light.
pub(super) struct Aim {
    light: usize,
    /// Unit length.
    pub(super) direction: DVec3,
    /// Distance to the light, metres.
    pub(super) distance: f64,
    pub(super) radiance: DVec3,
    /// Density per solid angle.
    pub(super) density: f64,
}

impl Tracer<'_> {
    /// Density per solid angle with which light sampling of light `k` from `point` produces `direction`, which hits
    /// the light at `distance`. A sphere around the point is not sampled.
    pub(super) fn aim_density(
        &self,
        k: usize,
        point: DVec3,
        direction: DVec3,
        distance: f64,
    ) -> f64 {
        match self.world.lights[k] {
            Light::Ball { centre, radius, .. } => {
                let sine = radius / (centre - point).length();
                if sine < 1.0 {
                    1.0 / closed::cone_solid_angle(sine.asin())
                } else {
                    0.0
                }
            }
            Light::Patch { patch } => {
                let patch = &self.world.patches[patch];
                let across = patch.e1.cross(patch.e2).dot(direction).abs();
                distance * distance / across
            }
        }
    }

    /// Samples a point on light `k` as seen from `point`; `None` if the light faces away or encloses the point.
    pub(super) fn aim(&self, k: usize, point: DVec3, random: &mut Random) -> Option<Aim> {
        let (a, b) = (random.unit(), random.unit());
        let (direction, distance, radiance) = match self.world.lights[k] {
            Light::Ball {
                centre,
                radius,
                radiance,
            } => {
                let to = centre - point;
                let axis = to.normalize_or_zero();
                let sine = radius / to.length();
                if sine >= 1.0 {
                    return None;
                }
                // Uniform in solid angle over the cone of tangents; 1 - cos = solid angle / 2 pi.
                let spread = closed::cone_solid_angle(sine.asin()) / TAU * a;
                let sin = (spread * (2.0 - spread)).max(0.0).sqrt();
                let (x, y) = axis.any_orthonormal_pair();
                let (s, c) = (TAU * b).sin_cos();
                let direction =
                    (axis * (1.0 - spread) + x * (sin * c) + y * (sin * s)).normalize_or_zero();
                // A ray at the rim may miss within rounding: then the point on the rim is used.
                let [near, _] = closed::sphere(point, direction, centre, radius)
                    .unwrap_or([to.dot(direction); 2]);
                (direction, near, radiance)
            }
            Light::Patch { patch } => {
                let facet = &self.world.facets[patch];
                let shape = &self.world.patches[patch];
                let to = shape.origin + shape.e1 * a + shape.e2 * b - point;
                if shape.e1.cross(shape.e2).dot(to) >= 0.0 {
                    return None;
                }
                let emission = self.world.materials[facet.material].emission.as_ref()?;
                let radiance = emission.at(facet, glam::DVec2::new(a, b));
                (to.normalize_or_zero(), to.length(), radiance)
            }
        };
        Some(Aim {
            light: k,
            direction,
            distance,
            radiance,
            density: self.aim_density(k, point, direction, distance),
        })
    }

    /// The nearest sphere light along a unit ray: its index and distance.
    pub(super) fn nearest_ball(
        &self,
        origin: DVec3,
        direction: DVec3,
        t_max: f64,
    ) -> Option<(usize, f64)> {
        let balls = (0..self.world.lights.len()).filter_map(|k| {
            let t = self.ball(k, origin, direction)?;
            (t < t_max).then_some((k, t))
        });
        balls.min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Distance along a unit ray to light `k`, if it is a sphere that the ray hits.
    fn ball(&self, k: usize, origin: DVec3, direction: DVec3) -> Option<f64> {
        let Light::Ball { centre, radius, .. } = self.world.lights[k] else {
            return None;
        };
        let [near, far] = closed::sphere(origin, direction, centre, radius)?;
        // From inside, the far side is visible.
        let t = if near > 0.0 { near } else { far };
        (t > 0.0).then_some(t)
    }

    /// Whether a sampled point on a light is visible from a point. `origin` is offset from the point by `off`, and
    /// the light itself does not block.
    pub(super) fn sees(&self, origin: DVec3, off: f64, aim: &Aim) -> bool {
        let reach = aim.distance - 2.0 * off;
        let blocks = |k: usize| {
            k != aim.light
                && self
                    .ball(k, origin, aim.direction)
                    .is_some_and(|t| t < reach)
        };
        !self.tree.blocked(origin, aim.direction, reach)
            && !(0..self.world.lights.len()).any(blocks)
    }
}
