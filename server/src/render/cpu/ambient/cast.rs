//! Rays from points of the ghost surface towards virtual objects, packed together across points.

use glam::Vec3A;

use crate::accel::{Hit, HitPacket, Ray, RayPacket};

use crate::render::prepare::mask::MASK_SHADOW_ANY;
use crate::render::prepare::occluder::{LEAST_SHARE, MAX_OCCLUDERS};
use crate::simd::{LANES, LaneMask};

use super::input::{AmbientInput, Place};

/// Objects that can occlude less than this share of a point's light count as far.
const FAR_SHARE: f32 = 1.0 / 16.0;

/// Cosine of the half angle of a cone. Objects in wider cones are sampled over the hemisphere, proportionally to
/// the cosine to the normal, instead.
const WIDE_COSINE: f32 = 0.5;

/// A ray that hit a virtual object.
#[derive(Debug, Clone, Copy)]
pub(crate) struct OccluderHit {
    /// Index of the point that cast it.
    pub(crate) place: u32,
    /// Order of the hits of a point.
    number: u32,
    pub(crate) direction: Vec3A,
    /// Irradiance per radiance of the ray.
    pub(crate) weight: f32,
    pub(crate) hit: Hit,
    /// A real surface is between the point and the hit.
    pub(crate) hidden: bool,
}

/// A packet that is filled with rays of neighbouring points.
#[derive(Default)]
struct Bundle {
    rays: RayPacket,
    n: usize,
    /// For each ray: its point, irradiance per radiance, and the occluder spheres for which it was cast.
    owners: [(u32, f32, u8); LANES],
}

/// The directions from which the rays of a point are drawn.
struct Cone {
    axis: Vec3A,
    /// Cosine of the half angle; `None` for the hemisphere around the axis, sampled by the cosine to it.
    cosine: Option<f32>,
    /// Occluder spheres for which the rays are cast, one bit each.
    balls: u8,
}

/// Casts rays and stores their hits.
#[derive(Default)]
pub(crate) struct Caster {
    /// The hits, sorted by point after [`Self::finish`].
    pub(crate) met: Vec<OccluderHit>,
    /// One for each occluder sphere, and one for rays over the whole hemisphere.
    bundles: [Bundle; MAX_OCCLUDERS + 1],
    hits: HitPacket,
    /// Rays cast since the count was last read.
    pub(crate) n_rays: u64,
}

impl Caster {
    /// Casts rays from a point in the directions in which objects can be; returns a lower bound on the distance
    /// to them.
    pub(crate) fn cast_from(
        &mut self,
        input: AmbientInput<'_>,
        index: u32,
        place: &Place,
        samples: usize,
    ) -> f32 {
        let mut nearest_m = f32::INFINITY;
        // Spheres that contain the point, or nearly: they share the same rays.
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
            // False for NaN.
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

    /// Casts rays from a point into a cone.
    fn cast(&mut self, input: AmbientInput<'_>, index: u32, place: &Place, cone: &Cone, n: usize) {
        let (u, v) = cone.axis.any_orthonormal_pair();
        // Rays to one sphere are packed together, and so are those over the hemisphere.
        let bundle = match cone.cosine {
            Some(_) => cone.balls.trailing_zeros() as usize,
            None => MAX_OCCLUDERS,
        };
        for part in 0..n.div_ceil(LANES) {
            // The first four, eight or sixteen samples of a part are stratified.
            let here = (n - part * LANES).min(LANES);
            let points = input
                .frame
                .ambient_samples
                .part(place.lattice.0, place.lattice.1, part);
            for &[s, t] in points.iter().take(here) {
                let phi = std::f32::consts::TAU * s;
                // Uniform over the cone's solid angle, or cosine-weighted over the hemisphere.
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

    /// Traces the rays of a bundle, and empties it.
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
            // Spheres overlap, so each direction counts only for the sphere of the object that is hit first.
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

    /// Traces the remaining rays, and sorts the hits by point.
    pub(crate) fn finish(&mut self, input: AmbientInput<'_>) {
        for k in 0..self.bundles.len() {
            self.trace(input, k);
        }
        self.met.sort_unstable_by_key(|met| (met.place, met.number));
    }
}

/// Number of rays towards a sphere that can occlude a share of light of at most `bound`. A far sphere fills its
/// cone, so fewer rays give the same accuracy.
fn rays_for(bound: f32, samples: usize) -> usize {
    if bound >= FAR_SHARE {
        samples
    } else if bound >= 0.4 * FAR_SHARE {
        (samples / 4).max(8).min(samples)
    } else {
        (samples / 8).max(4).min(samples)
    }
}
