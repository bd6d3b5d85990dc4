//! Whole frames by unbiased path tracing in double precision: the reference for composites.
//!
//! The same estimator renders a real room alone (the picture that a camera would record) and the same room with the
//! objects really in it (the perfect composite), so a composite made from the first differs from the second only by
//! errors of compositing. At every point all lights are sampled ([`light`](self)) and a direction is sampled from the
//! surface ([`bsdf`](self)). Light found by both techniques is weighted by the balance heuristic (Veach 1997, section
//! 9.2.2), and paths end by Russian roulette, so that all bounces are included. Every pixel has the standard error of
//! its mean, and each sample has its own random stream, so the picture does not depend on the number of threads.
//!
//! Shares no code with the renderer under test.

mod bsdf;
mod light;
mod random;
mod tree;
mod world;

#[cfg(test)]
mod tests;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use ghostlight::camera::{Intrinsics, Pose};

pub use bsdf::Reflectance;
pub use tree::{Patch, PatchHit, Tree};
pub use world::{Colour, Facet, Light, Material, Paint, World};

use bsdf::Bsdf;
use random::Random;

/// Offset of ray origins from a surface as a share of the largest coordinate: 10^6 times the rounding error of a hit
/// in f64, and in a room a hundredth of a micrometre.
const OFFSET: f64 = 1e-9;

/// Number of bounces after which Russian roulette begins.
const ROULETTE_FROM: u32 = 3;

/// A mean over independent samples.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Estimate {
    /// Linear radiance.
    pub mean: DVec3,
    /// Standard error of the mean, from the variance of the samples.
    pub standard_error: DVec3,
}

/// A rendered picture, rows from the top.
#[derive(Debug, Clone)]
pub struct Picture {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` pixels.
    pub pixels: Vec<Estimate>,
}

/// The first hit of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FirstHit {
    /// Ray parameter.
    pub t: f64,
    /// [`Facet::thing`].
    pub thing: u32,
}

/// A [`World`] prepared for ray tracing.
pub struct Tracer<'a> {
    world: &'a World,
    tree: Tree,
    /// Per patch: the index of its light.
    light_of_patch: Vec<Option<usize>>,
}

/// Renders a world with `samples` paths per pixel, uniformly distributed over the pixel's area.
pub fn render(
    world: &World,
    intrinsics: &Intrinsics,
    pose: &Pose,
    samples: u32,
    seed: u64,
) -> Picture {
    let tracer = world.tracer();
    let width = intrinsics.width;
    let pixels = (0..intrinsics.n_pixels())
        .into_par_iter()
        .map(|pixel| {
            let (x, y) = (pixel as u32 % width, pixel as u32 / width);
            mean_of(samples, |sample| {
                let mut random = Random::new(seed, pixel as u64, u64::from(sample));
                let (du, dv) = (random.unit() - 0.5, random.unit() - 0.5);
                let towards = intrinsics.unproject(f64::from(x) + du, f64::from(y) + dv, 1.0);
                let direction = (pose.rotation * towards).normalize_or_zero();
                tracer.path(pose.translation, direction, &mut random)
            })
        })
        .collect();
    Picture {
        width,
        height: intrinsics.height,
        pixels,
    }
}

/// Mean and standard error of independent samples.
fn mean_of(samples: u32, sample: impl Fn(u32) -> DVec3) -> Estimate {
    let n = f64::from(samples.max(1));
    let (mut mean, mut squares) = (DVec3::ZERO, DVec3::ZERO);
    // Welford 1962: avoids a difference of large sums.
    for k in 0..samples {
        let x = sample(k);
        let away = x - mean;
        mean += away / f64::from(k + 1);
        squares += away * (x - mean);
    }
    let variance = squares / (n - 1.0).max(1.0);
    Estimate {
        mean,
        standard_error: DVec3::from_array((variance / n).to_array().map(f64::sqrt)),
    }
}

impl Tracer<'_> {
    /// Radiance along one ray; `place` selects the random streams.
    pub fn radiance(
        &self,
        origin: DVec3,
        direction: DVec3,
        samples: u32,
        [seed, place]: [u64; 2],
    ) -> Estimate {
        mean_of(samples, |sample| {
            let mut random = Random::new(seed, place, u64::from(sample));
            self.path(origin, direction.normalize_or_zero(), &mut random)
        })
    }

    /// The first surface along a ray.
    pub fn first_hit(&self, origin: DVec3, direction: DVec3) -> Option<FirstHit> {
        let hit = self.tree.nearest(origin, direction, f64::INFINITY)?;
        Some(FirstHit {
            t: hit.t,
            thing: self.world.facets[hit.patch].thing,
        })
    }

    /// Whether a surface is strictly between two points.
    pub fn is_blocked(&self, from: DVec3, to: DVec3) -> bool {
        let way = to - from;
        self.tree
            .blocked(from + way * OFFSET, way, 1.0 - 2.0 * OFFSET)
    }

    /// One path: an unbiased sample of the radiance along a unit ray.
    fn path(&self, mut origin: DVec3, mut direction: DVec3, random: &mut Random) -> DVec3 {
        let world = self.world;
        let (mut sum, mut throughput) = (DVec3::ZERO, DVec3::ONE);
        // Where the last direction was sampled, and its density; `None` for camera rays and mirror rays, which light
        // sampling could not have found.
        let mut drawn: Option<(DVec3, f64)> = None;
        // Weight of a light's radiance if a sampled direction hits the light.
        let weight = |drawn: Option<(DVec3, f64)>, k: usize, direction: DVec3, end: DVec3| {
            drawn.map_or(1.0, |(from, density)| {
                let distance = from.distance(end);
                density / (density + self.aim_density(k, from, direction, distance))
            })
        };
        for bounce in 0u32.. {
            let hit = self.tree.nearest(origin, direction, f64::INFINITY);
            let t = hit.map_or(f64::INFINITY, |hit| hit.t);
            if bounce > 0
                && let Some((k, t)) = self.nearest_ball(origin, direction, t)
            {
                if let Light::Ball { radiance, .. } = world.lights[k] {
                    let end = origin + direction * t;
                    sum += throughput * radiance * weight(drawn, k, direction, end);
                }
                break;
            }
            let Some(hit) = hit else {
                sum += throughput * world.surroundings;
                break;
            };
            let facet = &world.facets[hit.patch];
            let patch = &world.patches[hit.patch];
            let material = &world.materials[facet.material];
            let point = patch.origin + patch.e1 * hit.u + patch.e2 * hit.v;
            let place = DVec2::new(hit.u, hit.v);
            let outward = patch.e1.cross(patch.e2).normalize_or_zero();
            let outside = outward.dot(direction) < 0.0;
            if let Some(emission) = &material.emission
                && outside
            {
                let share = match self.light_of_patch[hit.patch] {
                    Some(k) => weight(drawn, k, direction, point),
                    None => 1.0,
                };
                sum += throughput * emission.at(facet, place) * share;
            }
            if !outside && material.reflectance.transmission > 0.0 && !material.reflectance.thin {
                throughput *= material.kept_per_metre.powf(hit.t);
            }
            let smooth = facet.normals.map_or(outward, |[a, b, c]| {
                (a * (1.0 - hit.u - hit.v) + b * hit.u + c * hit.v).normalize_or_zero()
            });
            let mut reflectance = material.reflectance;
            reflectance.base *= material.colour.at(facet, place);
            // The colour of a metal is that of its specular reflection; the metallic share is the share that does not
            // diffuse.
            reflectance.f0 += (reflectance.base - material.reflectance.base)
                * (1.0 - material.reflectance.diffuse);
            let bsdf = Bsdf::new(reflectance, -direction, [outward, smooth]);
            let off = OFFSET * point.abs().max_element().max(1.0);
            let leave = |towards: DVec3| point + outward * off.copysign(outward.dot(towards));

            let lights = if bsdf.is_singular() {
                0
            } else {
                world.lights.len()
            };
            for k in 0..lights {
                let Some(aim) = self.aim(k, point, random) else {
                    continue;
                };
                let (value, density) = bsdf.evaluate(aim.direction);
                if value != DVec3::ZERO && self.sees(leave(aim.direction), off, &aim) {
                    let cosine = bsdf.cosine(aim.direction);
                    sum += throughput * value * aim.radiance * (cosine / (aim.density + density));
                }
            }
            let Some(sampled) = bsdf.sample(random) else {
                break;
            };
            throughput *= sampled.weight;
            if bounce >= ROULETTE_FROM {
                let survives = throughput.max_element().min(0.95);
                if random.unit() >= survives {
                    break;
                }
                throughput /= survives;
            }
            if throughput == DVec3::ZERO {
                break;
            }
            drawn = sampled.density.map(|density| (point, density));
            direction = sampled.direction;
            origin = leave(direction);
        }
        sum
    }
}
