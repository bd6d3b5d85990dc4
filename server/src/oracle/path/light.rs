//! Aiming at lights: which one, where on it, and how densely.

use std::f64::consts::TAU;

use glam::DVec3;

use super::Tracer;
use super::random::Random;
use super::world::Light;
use crate::oracle::closed;

/// A place on a light, drawn.
pub(super) struct Aim {
    light: usize,
    /// Unit.
    pub(super) direction: DVec3,
    /// Metres to the light.
    pub(super) distance: f64,
    pub(super) radiance: DVec3,
    /// Per solid angle, the choice of the light included.
    pub(super) density: f64,
}

impl Tracer<'_> {
    /// How often a light is aimed at from `point`, before normalisation: about what it sends
    /// there if nothing is in the way.
    fn importance(&self, light: &Light, point: DVec3) -> f64 {
        match *light {
            Light::Ball {
                centre,
                radius,
                radiance,
            } => {
                let d2 = (centre - point).length_squared();
                if d2 <= radius * radius {
                    return 0.0;
                }
                radiance.element_sum() * radius * radius / d2
            }
            Light::Patch {
                patch,
                mean_radiance,
            } => {
                let patch = &self.world.patches[patch];
                let area = patch.e1.cross(patch.e2).length();
                let to = patch.origin + (patch.e1 + patch.e2) * 0.5 - point;
                mean_radiance.element_sum() * area / to.length_squared().max(area)
            }
        }
    }

    /// Probability of aiming at light `k` from `point`.
    fn share(&self, k: usize, point: DVec3) -> f64 {
        let importance = |light| self.importance(light, point);
        let all: f64 = self.world.lights.iter().map(importance).sum();
        if all > 0.0 {
            importance(&self.world.lights[k]) / all
        } else {
            0.0
        }
    }

    /// Density per solid angle with which [`Tracer::aim`] from `point` draws `direction`, which
    /// meets light `k` after `distance`.
    pub(super) fn aim_density(
        &self,
        k: usize,
        point: DVec3,
        direction: DVec3,
        distance: f64,
    ) -> f64 {
        let share = self.share(k, point);
        if share == 0.0 {
            return 0.0;
        }
        share
            * match self.world.lights[k] {
                Light::Ball { centre, radius, .. } => {
                    let sine = radius / (centre - point).length();
                    1.0 / closed::cone_solid_angle(sine.asin())
                }
                Light::Patch { patch, .. } => {
                    let patch = &self.world.patches[patch];
                    let across = patch.e1.cross(patch.e2).dot(direction).abs();
                    distance * distance / across
                }
            }
    }

    /// Draws a place on a light as seen from `point`; `None` if it turns its back.
    pub(super) fn aim(&self, point: DVec3, random: &mut Random) -> Option<Aim> {
        let (choice, a, b) = (random.unit(), random.unit(), random.unit());
        let mut left = choice;
        let k = (0..self.world.lights.len()).find(|&k| {
            left -= self.share(k, point);
            left < 0.0
        })?;
        let (direction, distance, radiance) = match self.world.lights[k] {
            Light::Ball {
                centre,
                radius,
                radiance,
            } => {
                let to = centre - point;
                let axis = to.normalize_or_zero();
                let sine = radius / to.length();
                // Even in solid angle over the cone of tangents; 1 - cos = solid angle / 2 pi.
                let spread = closed::cone_solid_angle(sine.asin()) / TAU * a;
                let sin = (spread * (2.0 - spread)).max(0.0).sqrt();
                let (x, y) = axis.any_orthonormal_pair();
                let (s, c) = (TAU * b).sin_cos();
                let direction =
                    (axis * (1.0 - spread) + x * (sin * c) + y * (sin * s)).normalize_or_zero();
                // A ray at the rim may pass by, within rounding: then the rim it is.
                let [near, _] = closed::sphere(point, direction, centre, radius)
                    .unwrap_or([to.dot(direction); 2]);
                (direction, near, radiance)
            }
            Light::Patch { patch, .. } => {
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

    /// The nearest ball light along a unit ray: its number and distance.
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

    /// Distance along a unit ray to light `k`, if it is a ball in its way.
    fn ball(&self, k: usize, origin: DVec3, direction: DVec3) -> Option<f64> {
        let Light::Ball { centre, radius, .. } = self.world.lights[k] else {
            return None;
        };
        let [near, far] = closed::sphere(origin, direction, centre, radius)?;
        // From inside, the far side is seen.
        let t = if near > 0.0 { near } else { far };
        (t > 0.0).then_some(t)
    }

    /// Whether nothing stands between a point and a place on a light. `origin` is off the point by
    /// `off`, and the light itself does not count.
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
