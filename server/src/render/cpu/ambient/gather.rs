//! The change of ambient light at one point, from rays towards virtual objects.

use glam::Vec3A;

use crate::accel::{Hit, Ray};

use crate::numerics::luminance;
use crate::render::prepare::bsdf::{fresnel_schlick, reflect};
use crate::render::prepare::mask::MASK_SHADOW_ANY;

use super::cast::{Caster, OccluderHit};
use super::input::{AmbientInput, Place};

/// Most lamps whose visibility is tested; further ones count as visible. Bounds the cost of a point.
const MOST_LAMPS: usize = 16;

/// Change of ambient light above which it matters that virtual objects receive less light as well.
const CLOSE_SHARE: f32 = 0.05;

/// Heuristic: the light that objects reflect onto a real surface is at most this share of the surface's own
/// light, not counting emission. A surface that a lamp only grazes has little light in the model, and would be
/// too bright if the lamp's position is estimated and its own normal is noisy.
const MOST_SENT: f32 = 0.15;

/// The gathered light of a point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gathered {
    /// Irradiance that virtual objects add; negative if they remove more.
    pub(crate) delta: Vec3A,
    /// Irradiance with real objects only; zero, because it is not computed, if nothing changes.
    pub(crate) real: Vec3A,
    /// Distance to the nearest virtual object, or a lower bound on it.
    pub(crate) nearest_m: f32,
}

impl Gathered {
    const NONE: Self = Self {
        delta: Vec3A::ZERO,
        real: Vec3A::ZERO,
        nearest_m: f32::INFINITY,
    };
}

/// Buffers of a thread.
#[derive(Default)]
pub(crate) struct GatherScratch {
    /// The points, and their results in the same order.
    pub(crate) places: Vec<Place>,
    pub(crate) gathered: Vec<Gathered>,
    pub(crate) caster: Caster,
    rays: Vec<Ray>,
    blocked: Vec<bool>,
}

/// Computes the change at all points of `scratch`, with `samples` rays for a sphere of objects that is near, and
/// fewer for one that can occlude little. All points together, because the ghost surface is fastest for many rays
/// at once.
pub(crate) fn gather(input: AmbientInput<'_>, samples: usize, scratch: &mut GatherScratch) {
    let places = std::mem::take(&mut scratch.places);
    scratch.caster.met.clear();
    scratch.gathered.clear();
    for (i, place) in (0..).zip(&places) {
        if !input.frame.go_on() {
            break;
        }
        let nearest_m = scratch.caster.cast_from(input, i, place, samples);
        scratch.gathered.push(Gathered {
            nearest_m,
            ..Gathered::NONE
        });
    }
    scratch.caster.finish(input);
    find_hidden(input, &places, scratch);
    cast_to_lamps(input, &places, scratch);
    let GatherScratch {
        caster,
        rays,
        blocked,
        gathered,
        ..
    } = scratch;
    let mut asked = rays.iter().zip(blocked.iter());
    // For a cancelled frame the results are meaningless, but there is one for every point.
    gathered.resize(places.len(), Gathered::NONE);
    for met in caster.met.chunk_by(|a, b| a.place == b.place) {
        if !input.frame.go_on() {
            break;
        }
        let i = met[0].place as usize;
        let distances = met.iter().map(|met| met.hit.t);
        gathered[i].nearest_m = distances.fold(f32::INFINITY, f32::min);
        sum_up(input, &places[i], met, &mut asked, &mut gathered[i]);
    }
    scratch.places = places;
}

/// Combines the rays of a point.
fn sum_up<'r>(
    input: AmbientInput<'_>,
    place: &Place,
    met: &[OccluderHit],
    asked: &mut impl Iterator<Item = (&'r Ray, &'r bool)>,
    gathered: &mut Gathered,
) {
    let around = input.surroundings.irradiance(place.normal).max(Vec3A::ZERO);
    let (real, mixed) = lamps(input, place, asked);
    gathered.real = around + real;
    let seen = || met.iter().filter(|met| !met.hidden);
    let before =
        |met: &OccluderHit| input.surroundings.ambient_radiance(met.direction) * met.weight;
    let taken: Vec3A = seen().map(before).sum();
    let send = |left: Vec3A| {
        let scene = Scene::On(Floor {
            normal: place.normal,
            radiance: input.frame.sensed.color_at(place.x, place.y)
                * left.clamp(Vec3A::ZERO, Vec3A::ONE),
            around,
        });
        let now = |met: &OccluderHit| {
            let ray = Ray {
                origin: place.point,
                direction: met.direction,
                t_min: 0.0,
                t_max: met.hit.t,
            };
            scene.sent(input, &ray, &met.hit) * met.weight
        };
        seen().map(now).sum::<Vec3A>() - taken
    };
    // The real surface at this point reflects light to objects close to it, scaled by the share of its light that
    // remains: in the first pass with the shadows of lamps, in the second also with the change of ambient light.
    let left = |delta: Vec3A| {
        (around + delta + mixed) / gathered.real.max(Vec3A::splat(f32::MIN_POSITIVE))
    };
    let mut delta = send(left(Vec3A::ZERO));
    if delta.abs().max_element() > CLOSE_SHARE * around.max_element() {
        delta = send(left(delta));
    }
    let glow = |met: &OccluderHit| {
        let (instance, _) = input.frame.scene.object_of(met.hit.instance);
        input.frame.scene.objects[instance as usize].mean.emissive * met.weight
    };
    let most = seen().map(glow).sum::<Vec3A>() + gathered.real * MOST_SENT;
    let delta = delta.min(most);
    if delta.is_finite() && gathered.real.is_finite() {
        gathered.delta = delta;
    }
}

/// Finds hits that are hidden from their point by a real surface.
fn find_hidden(input: AmbientInput<'_>, places: &[Place], scratch: &mut GatherScratch) {
    let GatherScratch {
        caster: Caster { met, .. },
        rays,
        blocked,
        ..
    } = scratch;
    rays.clear();
    rays.extend(met.iter().map(|met| {
        // Within the sensor's noise of both ends the ghost surface is ignored: the point is on it, and objects
        // that stand on it end there.
        let (origin, lift) = lifted(input, &places[met.place as usize]);
        Ray {
            origin,
            direction: met.direction,
            t_min: lift,
            t_max: (met.hit.t - lift).max(lift),
        }
    }));
    blocked.clear();
    blocked.resize(rays.len(), false);
    input.frame.sensed.ghost.occluded_batch(rays, blocked);
    for (met, blocked) in met.iter_mut().zip(blocked) {
        met.hidden = *blocked;
    }
}

/// Start of rays from a point, offset by the sensor's noise, and the offset.
fn lifted(input: AmbientInput<'_>, place: &Place) -> (Vec3A, f32) {
    let lift = input.frame.sensed.lift(place.point);
    (place.point + place.normal * lift, lift)
}

/// Casts a ray to the centre of each lamp from every point that has hits, and finds those blocked by a real
/// surface.
fn cast_to_lamps(input: AmbientInput<'_>, places: &[Place], scratch: &mut GatherScratch) {
    let GatherScratch {
        caster: Caster { met, .. },
        rays,
        blocked,
        ..
    } = scratch;
    rays.clear();
    for met in met.chunk_by(|a, b| a.place == b.place) {
        let place = &places[met[0].place as usize];
        let (origin, lift) = lifted(input, place);
        for light in input.frame.lights.iter().take(MOST_LAMPS) {
            if let Some(disc) = light.disc(place.point) {
                let direction = disc.direction([0.0; 2]);
                rays.push(Ray {
                    origin,
                    direction,
                    t_min: lift / direction.length().max(f32::MIN_POSITIVE),
                    t_max: disc.t_max,
                });
            }
        }
    }
    blocked.clear();
    blocked.resize(rays.len(), false);
    input.frame.sensed.ghost.occluded_batch(rays, blocked);
}

/// Irradiance of lamps, from one ray to the centre of each: with real objects only, and with all objects.
fn lamps<'r>(
    input: AmbientInput<'_>,
    place: &Place,
    asked: &mut impl Iterator<Item = (&'r Ray, &'r bool)>,
) -> (Vec3A, Vec3A) {
    let (mut real, mut mixed) = (Vec3A::ZERO, Vec3A::ZERO);
    for (l, light) in input.frame.lights.iter().enumerate() {
        let (to_light, e) = light.illuminate(place.point);
        let e = e * place.normal.dot(to_light).max(0.0);
        let ray = (l < MOST_LAMPS && light.disc(place.point).is_some())
            .then(|| asked.next())
            .flatten();
        if e == Vec3A::ZERO || ray.is_some_and(|(_, blocked)| *blocked) {
            continue;
        }
        real += e;
        let shadowed = ray.is_some_and(|(ray, _)| input.frame.scene.occluded(ray, MASK_SHADOW_ANY));
        if !shadowed {
            mixed += e;
        }
    }
    (real, mixed)
}

/// The real surface at a point, as seen from objects close to it.
pub(crate) struct Floor {
    normal: Vec3A,
    /// Radiance with virtual objects.
    radiance: Vec3A,
    /// Ambient irradiance without virtual objects.
    around: Vec3A,
}

/// The light on a virtual object that a ray hit.
pub(crate) enum Scene {
    /// From a real surface below, and from the surroundings above.
    On(Floor),
    /// From the surroundings.
    Open,
}

impl Scene {
    /// Radiance from a direction.
    fn radiance(&self, input: AmbientInput<'_>, direction: Vec3A) -> Vec3A {
        match self {
            Self::On(floor) if direction.dot(floor.normal) < 0.0 => floor.radiance,
            _ => input.surroundings.ambient_radiance(direction),
        }
    }

    /// Ambient irradiance on a surface.
    fn irradiance(&self, input: AmbientInput<'_>, normal: Vec3A) -> Vec3A {
        match self {
            Self::On(floor) => {
                let below = 0.5 * (1.0 - normal.dot(floor.normal));
                floor.around * (1.0 - below) + floor.radiance * (std::f32::consts::PI * below)
            }
            Self::Open => input.surroundings.irradiance(normal),
        }
    }

    /// Radiance that a virtual object sends back along a ray: emission, diffuse and specular reflection, and
    /// transmission, with its material averaged over the whole object. A heuristic of one bounce: lamps light
    /// every part that faces them, so objects that shadow each other send too much.
    pub(crate) fn sent(&self, input: AmbientInput<'_>, ray: &Ray, hit: &Hit) -> Vec3A {
        let (object, normal) = input.frame.scene.facing(hit, ray.direction);
        let mean = &object.mean;
        if !input.frame.settings.ambient.bounce {
            return mean.emissive;
        }
        let cosine = -normal.dot(ray.direction);
        let mirrored = fresnel_schlick(mean.f0, cosine);
        let mut sum = mean.emissive;
        if mean.through != Vec3A::ZERO {
            let through = input.surroundings.ambient_radiance(ray.direction);
            sum += mean.through * (Vec3A::ONE - mirrored) * through;
        }
        if mean.diffuse != Vec3A::ZERO {
            let mut e = self.irradiance(input, normal);
            let position = ray.origin + ray.direction * hit.t;
            for light in input.frame.lights.iter().take(MOST_LAMPS) {
                let (to_light, of_light) = light.illuminate(position);
                e += of_light * normal.dot(to_light).max(0.0);
            }
            let entering = Vec3A::ONE - mirrored;
            sum += mean.diffuse * entering * e * std::f32::consts::FRAC_1_PI;
        }
        if luminance(mirrored) > 0.0 {
            sum += mirrored * self.radiance(input, reflect(ray.direction, normal));
        }
        sum
    }
}
