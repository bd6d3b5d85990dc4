//! The change of ambient light at one point, by rays towards what is virtual.

use glam::Vec3A;

use crate::accel::{Hit, Ray};

use crate::numerics::luminance;
use crate::render::prepare::bsdf::{fresnel_schlick, reflect};
use crate::render::prepare::mask::MASK_SHADOW_ANY;

use super::cast::{Caster, OccluderHit};
use super::input::{AmbientInput, Place};

/// Lamps whose visibility is asked for; further ones count as seen. Bounds the cost of a point.
const MOST_LAMPS: usize = 16;

/// Change of ambient light from which on it counts that things are also lit by less.
const CLOSE_SHARE: f32 = 0.05;

/// Heuristic: what objects reflect adds at most this share of the light that a real surface has, glow not
/// counted. A surface that a lamp only grazes has little of it as far as is known, and would shine where
/// the lamp's place is a guess and its own normal noise.
const MOST_SENT: f32 = 0.15;

/// The answer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Gathered {
    /// Irradiance that virtual objects add; negative where they take more away.
    pub(crate) delta: Vec3A,
    /// Irradiance with real things only; zero, not looked for, where nothing changes.
    pub(crate) real: Vec3A,
    /// Distance to the nearest thing virtual, or a lower bound on it.
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
    /// Who asks, and the answers in the same order.
    pub(crate) places: Vec<Place>,
    pub(crate) gathered: Vec<Gathered>,
    pub(crate) caster: Caster,
    rays: Vec<Ray>,
    blocked: Vec<bool>,
}

/// Asks for the change at all places of `scratch`, with `samples` rays for a ball of objects that is near,
/// and fewer for one that can take little. All places together, for the ghost surface answers many
/// rays at once fastest.
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
    // A frame that was given up has answers for all, of no worth.
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

/// What the rays of a place say together.
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
    // What the real surface here sends up again lights things close to it, by what is left of its own
    // light: that of the lamps first, then that of both.
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

/// Finds what something real hides from the place that cast it.
fn find_hidden(input: AmbientInput<'_>, places: &[Place], scratch: &mut GatherScratch) {
    let GatherScratch {
        caster: Caster { met, .. },
        rays,
        blocked,
        ..
    } = scratch;
    rays.clear();
    rays.extend(met.iter().map(|met| {
        // Within the sensor's noise of both ends the surface is not to be trusted: the point lies on
        // it, and what stands on it ends there.
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

/// Where rays from a place start past the sensor's noise, and how far that is.
fn lifted(input: AmbientInput<'_>, place: &Place) -> (Vec3A, f32) {
    let lift = input.frame.sensed.lift(place.point);
    (place.point + place.normal * lift, lift)
}

/// Casts a ray to the middle of each lamp from every place that met something, and finds which of
/// them something real blocks.
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

/// Irradiance of lamps, by one ray to the middle of each: with real things only, and with everything.
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

/// The real surface at a point, as what is close to it sees it.
pub(crate) struct Floor {
    normal: Vec3A,
    /// With virtual objects there.
    radiance: Vec3A,
    /// Ambient irradiance on it with nothing virtual.
    around: Vec3A,
}

/// What lights a virtual thing that a ray met.
pub(crate) enum Scene {
    /// A real surface below it, and the surroundings above.
    On(Floor),
    /// The surroundings.
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

    /// Radiance that something virtual sends back along a ray: what it emits, diffuses, mirrors and lets
    /// through, its material taken as even over the whole object. A heuristic of one bounce: lamps light
    /// all of it that faces them, so objects that shadow each other send too much.
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
