//! Light in the room, baked once: irradiance at every site, from sampled lights and several diffuse bounces.
//!
//! Each pass gathers, over the hemisphere of every site, the light that the previous pass computed for the
//! surfaces that its rays hit (final gathering, Jensen 1996), so noise does not accumulate with bounces. Sites
//! inside another object (the desk under a book) see back faces. They take the light of their neighbours;
//! otherwise interpolation would draw a dark fringe around every object.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3, Vec2, Vec3};
use rayon::prelude::*;

use super::geometry::{Geometry, Site};
use super::texture::Pattern;
use ghostlight::numerics::{hash, uniform};

/// A light of the room.
#[derive(Debug, Clone, Copy)]
pub(super) enum RoomLight {
    /// A uniformly emitting sphere.
    Sphere {
        /// Name in the manifest.
        name: &'static str,
        /// World metres.
        centre: DVec3,
        /// Metres.
        radius: f64,
        /// Radiant intensity, W/sr.
        intensity: Vec3,
        /// Whether it is a surface of the room; otherwise it is visible in reflections only.
        in_room: bool,
    },
    /// A rectangle that emits on the side of `e1 x e2`.
    Rectangle {
        /// Name in the manifest.
        name: &'static str,
        /// One corner, world metres.
        origin: DVec3,
        /// First edge.
        e1: DVec3,
        /// Second edge.
        e2: DVec3,
        /// Radiance of the pattern's white, W/(m2 sr).
        radiance: Vec3,
        /// The emitted pattern.
        pattern: Pattern,
    },
}

/// Number of rays and passes for baking.
#[derive(Debug, Clone, Copy)]
pub(super) struct BakeQuality {
    /// Side of the grid of shadow rays for each light.
    pub(super) shadow_side: u32,
    /// Side of the grid of gather rays in all but the last pass.
    pub(super) gather_side: u32,
    /// The same in the last pass.
    pub(super) final_side: u32,
    /// Number of bounces.
    pub(super) passes: u32,
}

/// Offset of ray origins from the surface, metres: f64 rounding is far smaller, and the thinnest object in the
/// room is twenty times as thick.
pub(super) const OFFSET_M: f64 = 2e-5;

/// A site is buried if at least this share of its rays hit back faces. Sites on a crease between two solids see
/// some; an enclosed site sees little else.
const BURIED_SHARE: f32 = 0.25;

/// Rounds of smoothing of indirect light, which has no sharp edges at the spacing of sites.
const SMOOTHINGS: u32 = 4;

/// Two unit vectors that complete a unit vector to a right-handed basis (Duff et al. 2017).
pub(super) fn basis(n: DVec3) -> (DVec3, DVec3) {
    let sign = 1f64.copysign(n.z);
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (
        DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        DVec3::new(b, sign + n.y * n.y * a, -n.y),
    )
}

/// Jittered grid points in the unit square, the samples of one site.
#[derive(Clone, Copy)]
struct Jitter(u32);

impl Jitter {
    /// Seeded by position, so that coinciding sites on a seam agree.
    fn new(site: &Site, seed: u32) -> Self {
        let word = |x: f64| ((x * 65_536.0).round() as i64) as u32;
        let p = hash(
            word(site.position.x),
            word(site.position.y),
            word(site.position.z),
        );
        let n = hash(
            word(site.normal.x),
            word(site.normal.y),
            word(site.normal.z),
        );
        Self(hash(p, n, seed))
    }

    fn square(self, i: u32, j: u32, side: u32, dimension: u32) -> DVec2 {
        let k = j * side + i;
        let random = |d: u32| f64::from(uniform(self.0, k, dimension + d));
        DVec2::new(f64::from(i) + random(0), f64::from(j) + random(1)) / f64::from(side)
    }
}

impl RoomLight {
    /// Irradiance from this light over one grid of shadow rays, and whether these rays disagreed about
    /// visibility.
    fn sample(
        &self,
        geometry: &Geometry,
        site: &Site,
        jitter: Jitter,
        side: u32,
        dimension: u32,
    ) -> (Vec3, bool) {
        let origin = site.position + site.normal * OFFSET_M;
        let (mut sum, mut lit, mut dark) = (Vec3::ZERO, 0u32, 0u32);
        let mut count = |visible: bool| {
            if visible {
                lit += 1;
            } else {
                dark += 1;
            }
        };
        match *self {
            Self::Sphere {
                centre,
                radius,
                intensity,
                ..
            } => {
                let to = centre - origin;
                let distance = to.length();
                if distance <= radius {
                    return (Vec3::ZERO, false);
                }
                let axis = to / distance;
                let (x, y) = basis(axis);
                let sin2 = (radius / distance).powi(2);
                // 1 - cos without cancellation for small angles.
                let spread = sin2 / (1.0 + (1.0 - sin2).sqrt());
                let radiance = intensity / (PI * radius * radius) as f32;
                for j in 0..side {
                    for i in 0..side {
                        let s = jitter.square(i, j, side, dimension);
                        let cos = 1.0 - spread * s.x;
                        let sin = (1.0 - cos * cos).max(0.0).sqrt();
                        let (sp, cp) = (TAU * s.y).sin_cos();
                        let direction = axis * cos + x * (sin * cp) + y * (sin * sp);
                        let facing = direction.dot(site.normal);
                        if facing <= 0.0 {
                            continue;
                        }
                        // Ends just before the sphere, which may itself be a surface.
                        let reach = distance - radius * 1.02;
                        let visible = !geometry.caster.occluded(origin, direction, 0.0, reach);
                        count(visible);
                        if visible {
                            sum += radiance * (facing * TAU * spread) as f32;
                        }
                    }
                }
            }
            Self::Rectangle {
                origin: corner,
                e1,
                e2,
                radiance,
                pattern,
                ..
            } => {
                let area_normal = e1.cross(e2);
                for j in 0..side {
                    for i in 0..side {
                        let s = jitter.square(i, j, side, dimension);
                        let to = corner + e1 * s.x + e2 * s.y - origin;
                        let facing = to.dot(site.normal);
                        let shining = -to.dot(area_normal);
                        if facing <= 0.0 || shining <= 0.0 {
                            continue;
                        }
                        let visible = !geometry.caster.occluded(origin, to, 0.0, 1.0 - 1e-6);
                        count(visible);
                        if visible {
                            let colour = pattern.colour(s.as_vec2(), Vec2::ZERO);
                            // The lower bound limits the peak right beside the light.
                            let d2 = to.length_squared().max(1e-4);
                            sum += radiance * colour * (facing * shining / (d2 * d2)) as f32;
                        }
                    }
                }
            }
        }
        (sum / (side * side) as f32, lit > 0 && dark > 0)
    }
}

/// Direct irradiance: with a few rays first, and with many where those disagreed.
fn direct(geometry: &Geometry, lights: &[RoomLight], site: &Site, side: u32) -> Vec3 {
    let jitter = Jitter::new(site, 1);
    let mut sum = Vec3::ZERO;
    for (k, light) in lights.iter().enumerate() {
        let dimension = 16 * k as u32;
        let first = (side / 3).max(4);
        let (rough, penumbra) = light.sample(geometry, site, jitter, first, dimension);
        sum += if penumbra {
            light.sample(geometry, site, jitter, side, dimension + 8).0
        } else {
            rough
        };
    }
    sum
}

/// Interpolated irradiance.
pub(super) fn irradiance(baked: &[Vec3], weights: &[(u32, f32); 4]) -> Vec3 {
    weights
        .iter()
        .fold(Vec3::ZERO, |sum, &(i, w)| sum + baked[i as usize] * w)
}

/// Indirect irradiance, and the share of rays that hit back faces.
fn gather(
    geometry: &Geometry,
    previous: &[Vec3],
    site: &Site,
    side: u32,
    pass: u32,
) -> (Vec3, f32) {
    let jitter = Jitter::new(site, 100 + pass);
    let origin = site.position + site.normal * OFFSET_M;
    let (x, y) = basis(site.normal);
    let (mut sum, mut backs) = (Vec3::ZERO, 0u32);
    for j in 0..side {
        for i in 0..side {
            let s = jitter.square(i, j, side, 0);
            let (r, (sp, cp)) = (s.x.sqrt(), (TAU * s.y).sin_cos());
            let direction = site.normal * (1.0 - s.x).max(0.0).sqrt() + x * (r * cp) + y * (r * sp);
            let Some(hit) = geometry
                .caster
                .intersect(origin, direction, 0.0, f64::INFINITY)
            else {
                continue;
            };
            if hit.back {
                backs += 1;
                continue;
            }
            let material = geometry.material(&hit);
            let p = geometry.surface(&hit, origin + direction * hit.t);
            if let Some(emission) = material.emission {
                if !material.sampled_light {
                    sum += material.pattern.colour(p.uv, p.m) * emission * std::f32::consts::PI;
                }
                continue;
            }
            sum += material.pattern.colour(p.uv, p.m) * irradiance(previous, &p.weights);
        }
    }
    let n = (side * side) as f32;
    (sum / n, backs as f32 / n)
}

/// The neighbours of each site, as ranges of one array.
struct Neighbours {
    starts: Vec<u32>,
    sites: Vec<u32>,
}

impl Neighbours {
    fn new(n_sites: usize, links: &[[u32; 2]]) -> Self {
        let mut starts = vec![0u32; n_sites + 1];
        for i in links.iter().flatten() {
            starts[*i as usize + 1] += 1;
        }
        for i in 0..n_sites {
            starts[i + 1] += starts[i];
        }
        let mut next = starts.clone();
        let mut sites = vec![0u32; links.len() * 2];
        for &[a, b] in links {
            for (from, to) in [(a, b), (b, a)] {
                sites[next[from as usize] as usize] = to;
                next[from as usize] += 1;
            }
        }
        Self { starts, sites }
    }

    fn of(&self, i: usize) -> &[u32] {
        &self.sites[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// Mean over the neighbours that are known and have a similar normal.
    fn mean(&self, geometry: &Geometry, values: &[Vec3], known: &[bool], i: usize) -> Option<Vec3> {
        let normal = geometry.sites[i].normal;
        let (sum, n) = self
            .of(i)
            .iter()
            .filter(|&&k| known[k as usize] && geometry.sites[k as usize].normal.dot(normal) > 0.8)
            .fold((Vec3::ZERO, 0u32), |(s, n), &k| {
                (s + values[k as usize], n + 1)
            });
        (n > 0).then(|| sum / n as f32)
    }

    /// Gives unknown sites the mean of their known neighbours, ring by ring.
    fn fill(&self, geometry: &Geometry, values: &mut [Vec3], known: &[bool]) {
        let mut known = known.to_vec();
        // Interpolation reaches only a few rings.
        for _ in 0..6 {
            let found: Vec<(usize, Vec3)> = (0..values.len())
                .into_par_iter()
                .filter(|&i| !known[i])
                .filter_map(|i| Some((i, self.mean(geometry, values, &known, i)?)))
                .collect();
            for (i, value) in found {
                values[i] = value;
                known[i] = true;
            }
        }
    }

    /// The mean of each site's value and its neighbours' mean.
    fn smooth(&self, geometry: &Geometry, values: &[Vec3], known: &[bool]) -> Vec<Vec3> {
        (0..values.len())
            .into_par_iter()
            .map(|i| match self.mean(geometry, values, known, i) {
                Some(mean) if known[i] => (values[i] + mean) * 0.5,
                _ => values[i],
            })
            .collect()
    }
}

/// Bakes irradiance, W/m2, at every site. `step` is called after each block of sites.
pub(super) fn bake(
    geometry: &Geometry,
    lights: &[RoomLight],
    quality: BakeQuality,
    step: &(dyn Fn(u64) + Sync),
) -> Vec<Vec3> {
    let sites = &geometry.sites;
    let ticked = |i: usize| {
        if i.is_multiple_of(1024) {
            step(1024);
        }
    };
    let mut straight: Vec<Vec3> = sites
        .par_iter()
        .enumerate()
        .map(|(i, site)| {
            ticked(i);
            direct(geometry, lights, site, quality.shadow_side)
        })
        .collect();
    let neighbours = Neighbours::new(sites.len(), &geometry.links);
    let mut known = vec![true; sites.len()];
    let mut total = straight.clone();
    for pass in 0..quality.passes {
        let last = pass + 1 == quality.passes;
        let side = if last {
            quality.final_side
        } else {
            quality.gather_side
        };
        let gathered: Vec<(Vec3, f32)> = sites
            .par_iter()
            .enumerate()
            .map(|(i, site)| {
                ticked(i);
                gather(geometry, &total, site, side, pass)
            })
            .collect();
        for (known, (_, backs)) in known.iter_mut().zip(&gathered) {
            *known = *backs < BURIED_SHARE;
        }
        let mut bounced: Vec<Vec3> = gathered.into_iter().map(|(light, _)| light).collect();
        for _ in 0..SMOOTHINGS {
            bounced = neighbours.smooth(geometry, &bounced, &known);
        }
        if pass == 0 {
            neighbours.fill(geometry, &mut straight, &known);
            // Smoothed once: without it, the edge of a shadow between two sites would show their spacing.
            straight = neighbours.smooth(geometry, &straight, &vec![true; sites.len()]);
        }
        total = straight
            .iter()
            .zip(&bounced)
            .map(|(a, b)| *a + *b)
            .collect();
        neighbours.fill(geometry, &mut total, &known);
    }
    total
}

/// Total of [`bake`]'s progress: sites times passes, with direct light as one more pass.
pub(super) fn bake_steps(geometry: &Geometry, quality: BakeQuality) -> u64 {
    (geometry.sites.len() as u64).next_multiple_of(1024) * u64::from(quality.passes + 1)
}
