//! Rays from places on the ghost surface towards virtual objects, packed together across places.

use glam::Vec3A;

use crate::accel::{Hit, HitPacket, Ray, RayPacket};

use crate::render::prepare::mask::MASK_SHADOW_ANY;
use crate::render::prepare::occluder::{LEAST_SHARE, MAX_OCCLUDERS};
use crate::simd::{LANES, LaneMask};

use super::input::{AmbientInput, Place};

/// Objects that can take less than this share of a point's light are far off.
const FAR_SHARE: f32 = 1.0 / 16.0;

/// Balls that fill more than this of the half sphere around their direction are sampled by the cosine
/// to the normal instead: cosine of the half angle.
const WIDE_COSINE: f32 = 0.5;

/// A ray that met something virtual.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OccluderHit {
    /// Which place cast it.
    pub(crate) place: u32,
    /// In the order they were found.
    number: u32,
    pub(crate) direction: Vec3A,
    /// Irradiance per radiance.
    pub(crate) weight: f32,
    pub(crate) hit: Hit,
    /// Something real is in between.
    pub(crate) hidden: bool,
}

/// A packet that is filled by rays of neighbouring places.
#[derive(Default)]
struct Bundle {
    rays: RayPacket,
    n: usize,
    /// Of each ray: its place, irradiance per radiance, and the balls that it is for.
    owners: [(u32, f32, u8); LANES],
}

/// Directions that rays of a place are drawn from.
struct Cone {
    axis: Vec3A,
    /// Of the half angle; `None` for the half sphere around the axis, by the cosine to it.
    cosine: Option<f32>,
    /// Balls that they are for, a bit each.
    balls: u8,
}

/// Casts rays, and keeps what they met.
#[derive(Default)]
pub(crate) struct Caster {
    /// By place, once it has finished.
    pub(crate) met: Vec<OccluderHit>,
    /// By ball, and one for rays to what is all around a place.
    bundles: [Bundle; MAX_OCCLUDERS + 1],
    hits: HitPacket,
    /// Rays cast since it was last taken.
    pub(crate) n_rays: u64,
}

impl Caster {
    /// Casts rays from a place into the directions that objects can fill; returns a lower bound on the
    /// distance to them.
    pub(crate) fn cast_from(
        &mut self,
        input: AmbientInput<'_>,
        index: u32,
        place: &Place,
        samples: usize,
    ) -> f32 {
        let mut nearest_m = f32::INFINITY;
        // Balls that are around the place, or nearly: their rays are the same.
        let (mut wide, mut wide_bound) = (0, 0.0_f32);
        for (k, ball) in input.frame.occluders.balls.iter().enumerate() {
            let to = ball.center - place.point;
            let squared = to.length_squared();
            nearest_m = nearest_m.min((squared.sqrt() - ball.radius).max(0.0));
            let bound = ball.form_factor_bound(place.point, place.normal);
            if bound < LEAST_SHARE {
                continue;
            }
            let sine_squared = ball.radius * ball.radius / squared;
            let cosine = (1.0 - sine_squared).max(0.0).sqrt();
            // False for a NaN.
            if sine_squared < 1.0 && cosine > WIDE_COSINE {
                let cone = Cone {
                    axis: to / squared.sqrt(),
                    cosine: Some(cosine),
                    balls: 1 << k,
                };
                self.cast(input, index, place, &cone, rays_for(bound, samples));
            } else {
                wide |= 1 << k;
                wide_bound = wide_bound.max(bound);
            }
        }
        if wide != 0 {
            let cone = Cone {
                axis: place.normal,
                cosine: None,
                balls: wide,
            };
            let n = rays_for(wide_bound, samples);
            self.cast(input, index, place, &cone, n);
        }
        nearest_m
    }

    /// Casts rays from a place into a cone.
    fn cast(&mut self, input: AmbientInput<'_>, index: u32, place: &Place, cone: &Cone, n: usize) {
        let (u, v) = cone.axis.any_orthonormal_pair();
        // Rays to one ball go together, and those to what is around.
        let bundle = match cone.cosine {
            Some(_) => cone.balls.trailing_zeros() as usize,
            None => MAX_OCCLUDERS,
        };
        for part in 0..n.div_ceil(LANES) {
            // The first four, eight or sixteen points of a part are stratified.
            let here = (n - part * LANES).min(LANES);
            let points = input
                .frame
                .ambient_samples
                .part(place.lattice.0, place.lattice.1, part);
            for &[s, t] in points.iter().take(here) {
                let phi = std::f32::consts::TAU * s;
                // Even over the cone's solid angle, or by the cosine over the half sphere.
                let along = match cone.cosine {
                    Some(cosine) => 1.0 - t * (1.0 - cosine),
                    None => t.sqrt(),
                };
                let aside = (1.0 - along * along).max(0.0).sqrt();
                let direction =
                    u * (aside * phi.cos()) + v * (aside * phi.sin()) + cone.axis * along;
                let to_normal = direction.dot(place.normal);
                if to_normal <= 0.0 {
                    continue;
                }
                let weight = match cone.cosine {
                    Some(cosine) => to_normal * std::f32::consts::TAU * (1.0 - cosine),
                    None => std::f32::consts::PI,
                };
                let of = &mut self.bundles[bundle];
                let lane = of.n;
                of.rays.set(
                    lane,
                    &Ray {
                        origin: place.point,
                        direction,
                        t_min: 0.0,
                        t_max: f32::INFINITY,
                    },
                );
                of.owners[lane] = (index, weight / n as f32, cone.balls);
                of.n += 1;
                if of.n == LANES {
                    self.trace(input, bundle);
                }
            }
        }
    }

    /// Traces the rays of a bundle and empties it.
    fn trace(&mut self, input: AmbientInput<'_>, k: usize) {
        let bundle = &mut self.bundles[k];
        if bundle.n == 0 {
            return;
        }
        let active = (u32::MAX >> (u32::BITS - bundle.n as u32)) as u16;
        self.n_rays += bundle.n as u64;
        bundle.n = 0;
        input
            .frame
            .scene
            .intersect_packet(&bundle.rays, active, MASK_SHADOW_ANY, &mut self.hits);
        for lane in LaneMask(active) {
            let Some(hit) = self.hits.get(lane) else {
                continue;
            };
            let (place, weight, balls) = bundle.owners[lane];
            // Balls overlap: each direction counts for the ball of what is met first.
            let ball = input
                .frame
                .occluders
                .of(input.frame.scene.object_of(hit.instance).0);
            if ball.is_some_and(|ball| balls & 1 << ball != 0) {
                self.met.push(OccluderHit {
                    place,
                    number: self.met.len() as u32,
                    direction: bundle.rays.get(lane).direction,
                    weight,
                    hit,
                    hidden: false,
                });
            }
        }
    }

    /// Traces what is left in bundles, and puts what was met in the order of places.
    pub(crate) fn finish(&mut self, input: AmbientInput<'_>) {
        for k in 0..self.bundles.len() {
            self.trace(input, k);
        }
        self.met.sort_unstable_by_key(|met| (met.place, met.number));
    }
}

/// Rays towards a ball that can take a share of light of at most `bound`: a far one fills its cone, so
/// that fewer are as exact.
fn rays_for(bound: f32, samples: usize) -> usize {
    if bound >= FAR_SHARE {
        samples
    } else if bound >= 0.4 * FAR_SHARE {
        (samples / 4).max(8).min(samples)
    } else {
        (samples / 8).max(4).min(samples)
    }
}
