//! The room for the path tracer ([`crate::oracle::path`]): the same surfaces, colours and lamps as in the
//! recording, with nothing baked. Radiance is scaled to the camera's pixel values.

use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};

use super::caster::Hit;
use super::geometry::{Material, Sites};
use super::light::RoomLight;
use super::path::Path;
use super::render::{EXPOSURE, View};
use super::room::{self, Room};
use super::sensor;
use crate::oracle::path::{self as oracle, Colour, Facet, Reflectance, World};
use ghostlight::camera::{CameraError, Intrinsics, Pose};
use ghostlight::frame::DepthImage;
use ghostlight::scene;

/// What lights the room.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lighting {
    /// One sphere lamp high above the desk, and a uniform sky in place of the ceiling: only the lamp is small and
    /// bright, so that few paths give a converged result.
    Open,
    /// The sphere lamps alone, as at night: lights that a scene document can describe exactly.
    Lamps,
    /// The lamps, the window and the monitor.
    Daylight,
}

/// The lamp of [`Lighting::Open`]: centre (world metres), radius (metres), radiant intensity.
const OPEN_LAMP: (DVec3, f64, Vec3) = (
    DVec3::new(-0.45, -0.80, 2.14),
    0.13,
    Vec3::new(5.5, 5.2, 4.5),
);

/// Radiance of the sky of [`Lighting::Open`].
const OPEN_SKY: DVec3 = DVec3::new(0.20, 0.22, 0.25);

/// How a depth map is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Depth {
    /// Exact depth of every pixel.
    Exact,
    /// Depth measured by the simulated sensor, with this factor on its noise and quantum, and with its holes.
    Sensed(f64),
}

/// The room of the recording, for the oracle to render.
pub struct TruthRoom {
    room: Arc<Room>,
    world: World,
    lights: Vec<scene::Light>,
}

impl TruthRoom {
    /// The part of a room's surface that virtual objects may stand on, world metres.
    pub const FREE_SPOT: DVec3 = room::FREE_SPOT;

    /// Builds the room.
    pub fn new(lighting: Lighting) -> Self {
        let room = Arc::new(room::build(1.0));
        let geometry = &room.geometry;
        let mut world = World::default();
        // Patterns are evaluated in the room's own coordinates.
        for (material, own) in geometry.materials.iter().enumerate() {
            let room = room.clone();
            let pattern = own.pattern;
            let paint = Colour::Painted(Arc::new(move |patch: u32, place: DVec2| {
                let hit = Hit {
                    t: 0.0,
                    patch,
                    u: place.x,
                    v: place.y,
                    back: false,
                };
                let p = room.geometry.surface(&hit, DVec3::ZERO);
                let scale = match room.geometry.materials[material].emission {
                    Some(radiance) => radiance * EXPOSURE,
                    None => Vec3::ONE,
                };
                (pattern.colour(p.uv, p.m) * scale).as_dvec3()
            }));
            world.materials.push(convert(own, paint, lighting));
        }
        for (i, (patch, facet)) in geometry
            .caster
            .patches()
            .iter()
            .zip(&geometry.facets)
            .enumerate()
        {
            let material = usize::from(facet.material);
            let own = &geometry.materials[material];
            let shines = own.emission.is_some();
            let is_ceiling = facet.normal == DVec3::NEG_Z && patch.origin.z == room::CEILING_Z;
            if is_ceiling && lighting == Lighting::Open {
                continue;
            }
            let normals = match facet.sites {
                // A sphere lamp is a light of its own, so the facets that represent it are left out.
                Sites::Corners { .. } if shines => continue,
                Sites::Corners { sites, .. } => {
                    Some(sites.map(|site| geometry.sites[site as usize].normal))
                }
                Sites::Grid { .. } => None,
            };
            if shines && lighting == Lighting::Daylight {
                let patch = world.patches.len();
                world.lights.push(oracle::Light::Patch { patch });
            }
            world.patches.push(oracle::Patch {
                origin: patch.origin,
                e1: patch.e1,
                e2: patch.e2,
                triangle: patch.triangle,
            });
            world.facets.push(Facet {
                material,
                normals,
                paint: i as u32,
                thing: 0,
            });
        }
        let lamps: Vec<(DVec3, f64, Vec3)> = match lighting {
            Lighting::Open => {
                world.surroundings = OPEN_SKY;
                vec![OPEN_LAMP]
            }
            Lighting::Lamps | Lighting::Daylight => {
                let own = room.lights.iter().filter_map(|light| match *light {
                    RoomLight::Sphere {
                        centre,
                        radius,
                        intensity,
                        ..
                    } => Some((centre, radius, intensity * EXPOSURE)),
                    RoomLight::Rectangle { .. } => None,
                });
                own.collect()
            }
        };
        let mut lights = Vec::new();
        for (centre, radius, intensity) in lamps {
            world.lights.push(oracle::Light::Ball {
                centre,
                radius,
                radiance: intensity.as_dvec3() / (std::f64::consts::PI * radius * radius),
            });
            lights.push(scene::Light::Sphere {
                position: centre,
                radius_m: radius,
                intensity,
            });
        }
        Self {
            room,
            world,
            lights,
        }
    }

    /// Surfaces, materials and lights. Objects can be added to a copy of it.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The lamps as lights of a scene document.
    pub fn lights(&self) -> &[scene::Light] {
        &self.lights
    }

    /// The recording's camera at another resolution.
    pub fn intrinsics(&self, width: u32, height: u32) -> Result<Intrinsics, CameraError> {
        super::nominal_camera()?.scaled_to(width, height)
    }

    /// Pose of the recording's camera at a time, seconds.
    pub fn pose(&self, time_s: f64) -> Pose {
        Path::new(super::SynthOptions::default().seed).pose(time_s)
    }

    /// A depth map.
    pub fn depth(&self, intrinsics: &Intrinsics, pose: &Pose, depth: Depth) -> DepthImage {
        let view = View {
            intrinsics: *intrinsics,
            pose: *pose,
        };
        let geometry = &self.room.geometry;
        let exact = sensor::exact_depth(geometry, &view);
        let z_m = match depth {
            Depth::Exact => exact.z_m,
            Depth::Sensed(level) => sensor::sense_at(geometry, &view, &exact, 0, level),
        };
        let z_m = z_m.into_iter().map(|z| z as f32).collect();
        DepthImage::from_metres(intrinsics.width, intrinsics.height, z_m)
    }
}

fn convert(own: &Material, paint: Colour, lighting: Lighting) -> oracle::Material {
    let f0 = f64::from(own.f0);
    let gloss = f64::from(own.gloss_rad);
    let shines = own.emission.is_some();
    oracle::Material {
        reflectance: Reflectance {
            // Emitting surfaces do not reflect diffusely.
            base: if shines { DVec3::ZERO } else { DVec3::ONE },
            diffuse: 1.0,
            f0: DVec3::splat(f0),
            // Like the recording, reduces the rise at grazing angles on rough surfaces.
            f90: if f0 > 0.0 {
                (1.0 - 2.5 * gloss).max(f0)
            } else {
                0.0
            },
            // A reflected lobe with standard deviation g per axis corresponds to one of g / 2 for the microfacet
            // normals. Beckmann's alpha, and approximately GGX's, is sqrt(2) times that.
            alpha: gloss * std::f64::consts::FRAC_1_SQRT_2,
            transmission: 0.0,
            ior: 1.0,
            thin: false,
        },
        emission: (shines && lighting == Lighting::Daylight).then(|| paint.clone()),
        colour: if shines {
            Colour::Flat(DVec3::ONE)
        } else {
            paint
        },
        kept_per_metre: DVec3::ONE,
        vertex_colours: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::oracle::path::{Estimate, render};

    #[test]
    fn the_oracle_sees_the_room_where_the_recording_does() {
        let truth = TruthRoom::new(Lighting::Lamps);
        let intrinsics = truth.intrinsics(80, 60).unwrap();
        let pose = truth.pose(0.7);
        let exact = truth.depth(&intrinsics, &pose, Depth::Exact);
        let tracer = truth.world().tracer();
        let mut differ = 0;
        for (i, &z) in exact.z_m.iter().enumerate() {
            let towards = intrinsics.unproject((i % 80) as f64, (i / 80) as f64, 1.0);
            let hit = tracer
                .first_hit(pose.translation, pose.rotation * towards)
                .unwrap();
            // More than the rounding of the f32 value in a depth map.
            if (hit.t - f64::from(z)).abs() > f64::from(f32::EPSILON) * hit.t {
                differ += 1;
            }
        }
        // The sphere of the lamp is a surface in the recording only.
        assert!(differ < 80 * 60 / 100, "{differ}");
        let silent = truth.depth(&intrinsics, &pose, Depth::Sensed(0.0));
        let both = silent
            .z_m
            .iter()
            .zip(&exact.z_m)
            .filter(|(a, _)| !a.is_nan());
        assert!(both.clone().count() > 3_000);
        assert!(both.clone().all(|(a, b)| a == b));
        // Noise grows with the level.
        let spread = |level: f64| {
            let noisy = truth.depth(&intrinsics, &pose, Depth::Sensed(level));
            let mut off: Vec<f32> = noisy
                .z_m
                .iter()
                .zip(&exact.z_m)
                .filter(|(a, _)| !a.is_nan())
                .map(|(a, b)| (a - b).abs())
                .collect();
            off.sort_by(f32::total_cmp);
            off[off.len() / 2]
        };
        let [half, one, two] = [0.5, 1.0, 2.0].map(spread);
        assert!(
            half > 0.0 && one > 1.5 * half && two > 1.5 * one,
            "{half} {one} {two}"
        );
    }

    #[test]
    fn the_window_adds_light() {
        let mean = |lighting| {
            let truth = TruthRoom::new(lighting);
            let intrinsics = truth.intrinsics(16, 12).unwrap();
            let picture = render(truth.world(), &intrinsics, &truth.pose(0.0), 400, 1);
            let pixels = picture.pixels;
            let n = pixels.len() as f64;
            let variance = |p: &Estimate| p.standard_error.y.powi(2);
            Estimate {
                mean: pixels.iter().map(|p| p.mean).sum::<DVec3>() / n,
                standard_error: DVec3::splat(pixels.iter().map(variance).sum::<f64>().sqrt() / n),
            }
        };
        let (lamps, day) = (mean(Lighting::Lamps), mean(Lighting::Daylight));
        let noise = lamps.standard_error.y.hypot(day.standard_error.y);
        assert!(day.mean.y > lamps.mean.y + 5.0 * noise, "{lamps:?} {day:?}");
        // The camera's exposure is meant for this brightness.
        assert!(lamps.mean.y > 0.05 && day.mean.y < 0.5, "{lamps:?} {day:?}");
    }
}
