//! Traces photons from a light to a diffuse surface.
//!
//! A photon counts if it hits its generator first and no real surface blocks the light on the way. It is then
//! reflected or refracted by the same code as the camera's rays. Russian roulette chooses one of the resulting
//! paths in proportion to their throughput, so all photons keep about the same flux, which a density estimate
//! needs. It is stored on the first diffuse surface that it hits: the front of the ghost surface, or a mesh.
//!
//! The result is Im - Ir, the change that virtual objects cause. The caustic of a purely real object is in the
//! camera's picture already. So a photon towards a modelled real generator counts only if it hits a virtual
//! object on its way; its twin, which is traced without virtual objects, is then counted as negative.

use std::ops::Range;

use glam::Vec3A;

use crate::accel::{Hit, Ray};
use crate::ghost::GhostOutcome;
use crate::numerics::{RandomKey, uniform};
use crate::render::cpu::path::{Path, PixelSample, mask_of_path, seed};
use crate::render::cpu::scatter::{absorption, scatter};
use crate::render::prepare::cone::RayCone;
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::material::sends_on;
use crate::render::prepare::surface::Surface;

use super::beam::{Beam, Emitted};
use super::map::{Chunk, GhostPhoton, MeshPhoton, kernel_radius};

/// Most surfaces that a photon can leave. A glass sphere emits all but 1e-4 of its light within four.
const MAX_BOUNCES: u32 = 8;

/// First dimension of the hash that chooses a path, one for each bounce; lower ones are used for emission.
const ROULETTE: u32 = 2;

/// A photon being traced.
#[derive(Debug, Clone, Copy)]
struct Flying {
    path: Path,
    /// Emitted flux; multiplied by the path's throughput it is the current flux.
    flux: Vec3A,
    number: u32,
    /// See [`Beam::lot`].
    lot: [u32; 2],
    /// The photon has hit a virtual object.
    changed: bool,
    /// The last surface was that of a modelled real object, which coincides with the ghost surface.
    leaves_real: bool,
}

/// Buffers of a thread.
#[derive(Default)]
pub(crate) struct PhotonScratch {
    emitted: Vec<(u32, Beam, Emitted)>,
    rays: Vec<Ray>,
    hits: Vec<Option<Hit>>,
    lit: Vec<(Surface, Flying)>,
    blocked: Vec<bool>,
    flying: Vec<Flying>,
    next: Vec<Flying>,
    ways: Vec<Path>,
    outcomes: Vec<GhostOutcome>,
    again: Vec<u32>,
    again_rays: Vec<Ray>,
    again_outcomes: Vec<GhostOutcome>,
    /// For each photon of the chunk: whether it differs from its twin.
    changed: Vec<bool>,
}

/// Traces photons to their ends.
pub(crate) fn trace_photons(
    frame: &PreparedFrame<'_>,
    beams: &[Beam],
    numbers: Range<u32>,
    scratch: &mut PhotonScratch,
    out: &mut Chunk,
) {
    out.ghost.clear();
    out.mesh.clear();
    scratch.changed.clear();
    scratch.changed.resize(numbers.len(), false);
    let first = numbers.start;
    for real in [false, true] {
        emit(beams, numbers.clone(), real, scratch);
        light_up(frame, first, real, scratch);
        for bounce in 1..=MAX_BOUNCES {
            if scratch.flying.is_empty() || !frame.go_on() {
                break;
            }
            follow(frame, first, bounce, scratch, out);
        }
        scratch.flying.clear();
    }
}

/// Emits photons; for twins, only those that are needed.
fn emit(beams: &[Beam], numbers: Range<u32>, real: bool, scratch: &mut PhotonScratch) {
    scratch.emitted.clear();
    let from = beams.partition_point(|beam| beam.first + beam.count <= numbers.start);
    for beam in &beams[from..] {
        if beam.first >= numbers.end {
            break;
        }
        if real && !beam.real {
            continue;
        }
        let own = beam.first.max(numbers.start)..(beam.first + beam.count).min(numbers.end);
        for number in own {
            if !real || scratch.changed[(number - numbers.start) as usize] {
                scratch.emitted.push((number, *beam, beam.emit(number)));
            }
        }
    }
}

/// Traces photons from the light to their generators and one step on.
fn light_up(frame: &PreparedFrame<'_>, first: u32, real: bool, scratch: &mut PhotonScratch) {
    let PhotonScratch {
        emitted,
        rays,
        hits,
        lit,
        blocked,
        flying,
        ways,
        changed,
        ..
    } = scratch;
    rays.clear();
    rays.extend(emitted.iter().map(|(_, _, photon)| Ray {
        origin: photon.origin,
        direction: photon.direction,
        t_min: 0.0,
        t_max: f32::INFINITY,
    }));
    frame
        .scene
        .intersect_all(rays, |_| mask_of_path(real), hits);
    rays.clear();
    lit.clear();
    for (&(number, beam, photon), hit) in emitted.iter().zip(&*hits) {
        let Some(hit) = hit else { continue };
        if hit.instance != beam.generator {
            let object = &frame.scene.objects[hit.instance as usize];
            changed[(number - first) as usize] |= !object.ghost;
            continue;
        }
        let surface = frame
            .scene
            .surface(hit, photon.direction, RayCone::default());
        // With the same offset as shadow rays towards real occluders.
        let origin = surface.leave(-photon.direction);
        rays.push(Ray {
            origin,
            direction: -photon.direction,
            t_min: frame.sensed.lift(origin),
            t_max: if photon.parallel {
                f32::INFINITY
            } else {
                hit.t
            },
        });
        let [i, beam_id] = beam.lot(number);
        let sample = PixelSample {
            place: 0,
            weight: 1.0,
            random: RandomKey::new(i, beam_id, 0),
        };
        let path = seed(&surface, sample, real);
        lit.push((
            surface,
            Flying {
                path,
                flux: photon.flux,
                number,
                lot: beam.lot(number),
                changed: !beam.real,
                leaves_real: beam.real,
            },
        ));
    }
    blocked.clear();
    blocked.resize(rays.len(), false);
    frame.sensed.ghost.occluded_batch(rays, blocked);
    flying.clear();
    for ((surface, photon), _) in lit.iter().zip(&*blocked).filter(|(_, blocked)| !**blocked) {
        send_on(frame, surface, photon, 0, ways, flying);
    }
}

/// Traces every photon to its next surface.
fn follow(
    frame: &PreparedFrame<'_>,
    first: u32,
    bounce: u32,
    scratch: &mut PhotonScratch,
    out: &mut Chunk,
) {
    let PhotonScratch {
        rays,
        hits,
        flying,
        next,
        ways,
        outcomes,
        changed,
        ..
    } = scratch;
    rays.clear();
    rays.extend(flying.iter().map(|photon| Ray {
        origin: photon.path.origin,
        direction: photon.path.direction,
        t_min: 0.0,
        t_max: f32::INFINITY,
    }));
    // Either all photons of a batch are twins, or none.
    let mask = mask_of_path(flying[0].path.real);
    frame.scene.intersect_all(rays, |_| mask, hits);
    for ((ray, photon), hit) in rays.iter_mut().zip(&*flying).zip(&*hits) {
        if photon.leaves_real {
            ray.t_min = frame.sensed.lift(ray.origin);
        }
        if let Some(hit) = hit {
            // The ghost surface coincides with modelled real objects to within the sensor's noise.
            let on_real = frame.scene.objects[hit.instance as usize].ghost;
            let p = ray.origin + ray.direction * hit.t;
            ray.t_max = hit.t - if on_real { frame.sensed.lift(p) } else { 0.0 };
        }
    }
    outcomes.clear();
    outcomes.resize(rays.len(), GhostOutcome::Unknown);
    frame.sensed.ghost.trace_batch(rays, outcomes);
    leave_the_noise(
        frame,
        rays,
        outcomes,
        &mut scratch.again,
        &mut scratch.again_rays,
        &mut scratch.again_outcomes,
    );
    next.clear();
    for (((ray, photon), hit), outcome) in rays.iter().zip(&*flying).zip(&*hits).zip(&*outcomes) {
        let landed = match outcome {
            GhostOutcome::Hit(ghost) if ghost.from_front => {
                Some(ray.origin + ray.direction * ghost.t)
            }
            GhostOutcome::Hit(_) => None,
            _ if photon.leaves_real => None,
            _ => buried(frame, ray),
        };
        let flux = photon.flux * photon.path.throughput;
        if let Some(p) = landed {
            rest_on_real(frame, photon, p, flux, out);
            continue;
        }
        let Some(hit) = hit else { continue };
        if matches!(outcome, GhostOutcome::Hit(_)) {
            continue;
        }
        let surface = frame.scene.surface(hit, ray.direction, RayCone::default());
        let object = &frame.scene.objects[hit.instance as usize];
        let material = frame.scene.material(&surface);
        let mut photon = *photon;
        photon.leaves_real = object.ghost;
        if !object.ghost {
            photon.changed = true;
            changed[(photon.number - first) as usize] = true;
        }
        let kept = absorption(material, &surface, hit.t);
        photon.path.throughput *= kept;
        let flux = flux * kept;
        let diffuse = (1.0 - surface.metallic) * (1.0 - material.transmission);
        if diffuse > 0.0 {
            if object.ghost {
                rest_on_real(frame, &photon, surface.position, flux, out);
            }
            if photon.changed && !photon.path.real && flux.is_finite() {
                out.mesh.push(MeshPhoton {
                    position: surface.position,
                    direction: surface.incoming,
                    flux,
                    instance: hit.instance,
                });
            }
        }
        if bounce < MAX_BOUNCES {
            send_on(frame, &surface, &photon, bounce, ways, next);
        }
    }
    std::mem::swap(flying, next);
}

/// Scatters a photon at a surface that it hit after `bounce` others, if it survives.
fn send_on(
    frame: &PreparedFrame<'_>,
    surface: &Surface,
    photon: &Flying,
    bounce: u32,
    ways: &mut Vec<Path>,
    flying: &mut Vec<Flying>,
) {
    let material = frame.scene.material(surface);
    if !sends_on(material, surface.metallic, surface.roughness) {
        return;
    }
    ways.clear();
    // One ray for a rough reflection, as after the first bounce.
    scatter(material, surface, &photon.path, bounce, 1, ways);
    let carried = photon.path.throughput.max_element();
    let [i, beam] = photon.lot;
    let mut chance = uniform(i, beam, ROULETTE + bounce) * carried;
    for way in ways.iter() {
        let carries = way.throughput.max_element();
        if chance < carries {
            let mut photon = *photon;
            photon.path = *way;
            photon.path.throughput *= carried / carries;
            flying.push(photon);
            return;
        }
        chance -= carries;
    }
}

/// Stores a photon on the ghost surface, or where that should be.
fn rest_on_real(
    frame: &PreparedFrame<'_>,
    photon: &Flying,
    position: Vec3A,
    flux: Vec3A,
    out: &mut Chunk,
) {
    // A twin counts only where the photons differ.
    let counts = photon.path.real || photon.changed;
    if counts && flux.is_finite() && position.z > 0.0 {
        out.ghost.push(GhostPhoton {
            position,
            direction: photon.path.direction,
            flux: if photon.path.real { -flux } else { flux },
            radius: kernel_radius(&frame.sensed.pinhole, out.radius_m, position.z),
        });
    }
}
/// Re-traces rays that hit the ghost surface from behind within the noise: a photon that leaves the foot of an
/// object starts below bumps caused by noise.
fn leave_the_noise(
    frame: &PreparedFrame<'_>,
    rays: &[Ray],
    outcomes: &mut [GhostOutcome],
    again: &mut Vec<u32>,
    again_rays: &mut Vec<Ray>,
    again_outcomes: &mut Vec<GhostOutcome>,
) {
    again.clear();
    again_rays.clear();
    for (i, (ray, outcome)) in rays.iter().zip(&*outcomes).enumerate() {
        if let GhostOutcome::Hit(ghost) = outcome
            && !ghost.from_front
            && ghost.t < frame.sensed.lift(ray.origin)
        {
            again.push(i as u32);
            again_rays.push(Ray {
                t_min: frame.sensed.lift(ray.origin),
                ..*ray
            });
        }
    }
    again_outcomes.clear();
    again_outcomes.resize(again.len(), GhostOutcome::Unknown);
    frame.sensed.ghost.trace_batch(again_rays, again_outcomes);
    for (&i, &outcome) in again.iter().zip(&*again_outcomes) {
        outcomes[i as usize] = outcome;
    }
}

/// Where a photon is stored that starts behind the ghost surface by no more than noise and moves farther behind:
/// the foot of an object is slightly inside the surface on which it stands.
fn buried(frame: &PreparedFrame<'_>, ray: &Ray) -> Option<Vec3A> {
    let behind = |p: Vec3A| {
        if p.z <= 0.0 {
            return None;
        }
        let (u, v) = frame.sensed.pinhole.project(p);
        let z = frame.sensed.ghost.depth_at(u, v)?;
        Some((p.z - z, frame.sensed.pinhole.ray_direction(u, v) * z))
    };
    let lift = frame.sensed.lift(ray.origin);
    let (depth, p) = behind(ray.origin)?;
    if !(depth > 0.0 && depth <= lift) {
        return None;
    }
    let (deeper, _) = behind(ray.origin + ray.direction * lift)?;
    (deeper > depth).then_some(p)
}
