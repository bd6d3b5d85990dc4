//! Emits photons: light that falls on objects that cause caustics.
//!
//! *Caustic generators* are the objects that reflect or refract light into few directions: metals of low
//! roughness and transmissive objects, both virtual and modelled real ones. Photons are emitted from every light,
//! only towards generators, through a disc around the bounding sphere of each. Their number is proportional to
//! the flux that the generator passes on; they are stratified and jittered (Kan and Kaufmann 2012, "High-Quality
//! Reflections, Refractions, and Caustics in Augmented Reality", section 3.2).
//!
//! A photon counts only for the generator that it hits first, so light is not counted twice if spheres overlap. A
//! photon depends only on its number in its beam, and discs are aligned with world axes. So the caustics of a
//! static scene are static, whatever the camera, the frame or the number of threads.
//!
//! Limits: the few percent of light reflected by opaque dielectrics (plastic, varnish) are left out, and so are
//! pairs of light and generator whose share of all light is less than one photon.

use std::f32::consts::{PI, TAU};

use glam::{Mat3A, Vec3A};

use crate::numerics::{hash, luminance, uniform, unit_float};
use crate::render::prepare::bsdf::f0_of_ior;
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::light::CameraLight;
use crate::render::prepare::material::bends_light;
use crate::render::prepare::scene::SceneQuery;

/// Sine of the angle that light and bounding sphere together may subtend. Above it, light is emitted in all
/// directions instead, because the disc that catches every ray grows as 1 / sqrt(1 - sine^2); here to 2.3 radii.
const WIDEST_SINE: f32 = 0.9;

/// How a beam's rays are drawn.
#[derive(Debug, Clone, Copy)]
enum Shape {
    /// From a sphere light (centre, radius) through a disc around the generator.
    Cone { center: Vec3A, radius: f32 },
    /// From a sphere light in all directions, because it touches the generator's sphere, or nearly.
    AllAround { center: Vec3A, radius: f32 },
    /// Parallel light through a disc, from so far away that no object is behind the start.
    Parallel { tan_radius: f32, from_m: f32 },
}

/// The light from one light to one generator. Camera space.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Beam {
    /// Instance that its photons must hit first.
    pub(crate) generator: u32,
    /// The generator models a real object.
    pub(crate) real: bool,
    /// Number of the beam.
    id: u32,
    /// Number of its first photon, and its count of photons.
    pub(crate) first: u32,
    pub(crate) count: u32,
    /// Photons are in a grid of cells with this many columns.
    columns: u32,
    shape: Shape,
    /// The disc's centre and radius, and unit vectors: towards the light, and two in the disc's plane.
    disc_center: Vec3A,
    disc_radius: f32,
    axis: Vec3A,
    u: Vec3A,
    v: Vec3A,
    /// Intensity of a sphere light, or irradiance of parallel light.
    strength: Vec3A,
    /// Approximate luminance of the flux that the generator passes on.
    power: f32,
}

/// A photon at its light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Emitted {
    pub(crate) origin: Vec3A,
    /// Unit vector.
    pub(crate) direction: Vec3A,
    /// Watts per channel.
    pub(crate) flux: Vec3A,
    /// Whether the light is infinitely far away.
    pub(crate) parallel: bool,
}

impl Beam {
    /// The light of `light` on a generator in a sphere; `None` if there is none. `scene_m` is the largest
    /// distance of any object from the sphere's centre.
    fn new(
        light: &CameraLight,
        (ball, radius): (Vec3A, f32),
        scene_m: f32,
        world_from_camera: Mat3A,
    ) -> Option<Self> {
        if !(ball.is_finite() && radius.is_finite() && radius > 0.0) {
            return None;
        }
        let (shape, axis, disc_radius, strength, share) = match *light {
            CameraLight::Sphere {
                center,
                radius: light_radius,
                intensity,
            } => {
                if !center.is_finite() {
                    return None;
                }
                let to = center - ball;
                let distance = to.length();
                let sine = (radius + light_radius) / distance;
                // False for NaN, which a light exactly in the centre gives.
                if sine < WIDEST_SINE {
                    let disc_radius = radius / (1.0 - sine * sine).sqrt();
                    let shape = Shape::Cone {
                        center,
                        radius: light_radius,
                    };
                    let solid_angle = PI * (disc_radius / distance).powi(2);
                    (shape, to / distance, disc_radius, intensity, solid_angle)
                } else {
                    let shape = Shape::AllAround {
                        center,
                        radius: light_radius,
                    };
                    (shape, Vec3A::Z, radius, intensity, 4.0 * PI)
                }
            }
            CameraLight::Directional {
                to_light,
                tan_radius,
                irradiance,
            } => {
                let disc_radius = radius * (1.0 + tan_radius * tan_radius).sqrt();
                let shape = Shape::Parallel {
                    tan_radius,
                    from_m: scene_m + disc_radius,
                };
                let area = PI * disc_radius * disc_radius;
                (shape, to_light, disc_radius, irradiance, area)
            }
        };
        let power = luminance(strength) * share;
        if !(power > 0.0 && power.is_finite() && axis.is_finite()) {
            return None;
        }
        let in_world = (world_from_camera * axis).try_normalize()?;
        let (u, v) = in_world.any_orthonormal_pair();
        let camera_from_world = world_from_camera.transpose();
        Some(Self {
            generator: 0,
            real: false,
            id: 0,
            first: 0,
            count: 0,
            columns: 1,
            shape,
            disc_center: ball,
            disc_radius,
            axis,
            u: camera_from_world * u,
            v: camera_from_world * v,
            strength,
            power,
        })
    }

    /// Cross-section through which its photons pass, m2.
    pub(crate) fn cross_section(&self) -> f32 {
        PI * self.disc_radius * self.disc_radius
    }

    /// Assigns about `photons` numbers from `first` on, filling a whole grid of cells; returns the next number.
    fn number(&mut self, first: u32, photons: u32) -> u32 {
        self.first = first;
        self.columns = photons.isqrt().max(1);
        self.count = photons / self.columns * self.columns;
        first + self.count
    }

    /// Seed of the random numbers of photon `number`: its index in this beam, so that the sizes of other beams do
    /// not matter.
    pub(crate) fn lot(&self, number: u32) -> [u32; 2] {
        [number - self.first, self.id]
    }

    /// Emits photon `number` of this beam.
    pub(crate) fn emit(&self, number: u32) -> Emitted {
        let [i, id] = self.lot(number);
        let rows = self.count / self.columns;
        let s = ((i % self.columns) as f32 + uniform(i, id, 0)) / self.columns as f32;
        let t = ((i / self.columns) as f32 + uniform(i, id, 1)) / rows as f32;
        // Points on the light in an order in which any few successive points are spread out: a Kronecker sequence
        // (Roberts 2018, R2), in integers so that it stays exact.
        let spread = |step: u32, dimension: u32| {
            let x = i.wrapping_mul(step).wrapping_add(hash(id, 0, dimension));
            unit_float(x)
        };
        let (a, b) = (spread(3_242_174_889, 0), spread(2_447_445_414, 1));
        let share = self.strength / self.count as f32;
        let across = |[x, y]: [f32; 2]| self.u * x + self.v * y;
        let through = || self.disc_center + across(disc(s, t)) * self.disc_radius;
        let disc_area = PI * self.disc_radius * self.disc_radius;
        match self.shape {
            Shape::Cone { center, radius } => {
                let through = through();
                let to = center - through;
                let distance = to.length();
                let axis = to / distance;
                // Uniform in the solid angle of the light as seen from the disc, because the radiance of a sphere
                // light is constant. 1 - cos = sin^2 / (1 + cos) keeps its precision for small lights.
                let sin2 = (radius / distance).powi(2).min(1.0);
                let cap = sin2 / (1.0 + (1.0 - sin2).sqrt());
                let off = a * cap;
                let sine = (off * (2.0 - off)).max(0.0).sqrt();
                let (x, y) = axis.any_orthonormal_pair();
                let (sin, cos) = (TAU * b).sin_cos();
                let to_light = axis * (1.0 - off) + (x * cos + y * sin) * sine;
                let half_chord2 = radius * radius - (distance * sine).powi(2);
                let t = distance * (1.0 - off) - half_chord2.max(0.0).sqrt();
                // Radiance times solid angle: I / (pi r^2) * 2 pi cap.
                let irradiance = 2.0 / (distance * distance * (1.0 + (1.0 - sin2).sqrt()));
                Emitted {
                    origin: through + to_light * t,
                    direction: -to_light,
                    flux: share * (irradiance * to_light.dot(self.axis).max(0.0) * disc_area),
                    parallel: false,
                }
            }
            Shape::AllAround { center, radius } => {
                let z = 1.0 - 2.0 * s;
                let ring = (1.0 - z * z).max(0.0).sqrt();
                let (sin, cos) = (TAU * t).sin_cos();
                let direction = across([ring * cos, ring * sin]) + self.axis * z;
                let (x, y) = direction.any_orthonormal_pair();
                let [dx, dy] = disc(a, b);
                let rise = (1.0 - dx * dx - dy * dy).max(0.0).sqrt();
                Emitted {
                    origin: center + (x * dx + y * dy + direction * rise) * radius,
                    direction,
                    flux: share * (4.0 * PI),
                    parallel: false,
                }
            }
            Shape::Parallel { tan_radius, from_m } => {
                let aside = across(disc(a, b)) * tan_radius;
                let to_light = self.axis + aside;
                let to_light = to_light / to_light.length();
                Emitted {
                    origin: through() + to_light * from_m,
                    direction: -to_light,
                    flux: share * disc_area,
                    parallel: true,
                }
            }
        }
    }
}

/// Maps the unit square to the unit disc, preserving areas and neighbourhoods (Shirley and Chiu 1997).
fn disc(s: f32, t: f32) -> [f32; 2] {
    let (x, y) = (2.0 * s - 1.0, 2.0 * t - 1.0);
    let (radius, turn) = if x.abs() > y.abs() {
        (x, 0.25 * PI * (y / x))
    } else if y != 0.0 {
        (y, 0.5 * PI - 0.25 * PI * (x / y))
    } else {
        return [0.0; 2];
    };
    let (sin, cos) = turn.sin_cos();
    [radius * cos, radius * sin]
}

/// Distributes about `photons` photons over all pairs of light and generator; returns how many are used. Only
/// beams with photons are stored, so there are at most as many beams as photons, however many pairs there are.
pub(crate) fn plan_beams(frame: &PreparedFrame<'_>, photons: u32, beams: &mut Vec<Beam>) -> u32 {
    beams.clear();
    let mut power = 0.0_f64;
    for_beams(frame, |beam| power += f64::from(beam.power));
    let (mut next, mut id) = (0, 0);
    for_beams(frame, |mut beam| {
        beam.id = id;
        id += 1;
        let share = f64::from(photons) * f64::from(beam.power) / power;
        next = beam.number(next, share as u32);
        if beam.count > 0 {
            beams.push(beam);
        }
    });
    next
}

/// Calls `each` with the beam of every pair of generator and light that has one, in order.
fn for_beams(frame: &PreparedFrame<'_>, mut each: impl FnMut(Beam)) {
    let world_from_camera = frame.world_from_camera;
    let scene = &frame.scene;
    for (instance, object) in scene.objects.iter().enumerate() {
        let Some(ball) = object.caustic_ball else {
            continue;
        };
        let instance = instance as u32;
        if scene.tlas.bounds(instance).is_none() {
            continue;
        }
        if !frame.go_on() {
            return;
        }
        let ball = scene.placed[instance as usize].ball(ball);
        let material = &scene.materials[object.material as usize];
        let reflected = if bends_light(material) {
            1.0
        } else {
            let metal = luminance(material.base_color.into()) * material.metallic;
            metal.max(f0_of_ior(material.ior))
        };
        let scene_m = reach_from(scene, ball.0);
        for light in frame.lights {
            if let Some(mut beam) = Beam::new(light, ball, scene_m, world_from_camera) {
                beam.generator = instance;
                beam.real = object.ghost;
                beam.power *= reflected;
                each(beam);
            }
        }
    }
}

/// Largest distance of any mesh from a point.
fn reach_from(scene: &SceneQuery<'_>, p: Vec3A) -> f32 {
    let bounds = (0..scene.objects.len()).filter_map(|i| scene.tlas.bounds(i as u32));
    bounds
        .map(|(low, high)| (p - low).abs().max((high - p).abs()).length())
        .fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball_light(z: f32, radius: f32) -> CameraLight {
        CameraLight::Sphere {
            center: Vec3A::new(0.0, 0.0, z),
            radius,
            intensity: Vec3A::splat(2.0),
        }
    }

    fn beam(light: &CameraLight, radius: f32, photons: u32) -> Beam {
        let mut beam = Beam::new(light, (Vec3A::ZERO, radius), 5.0, Mat3A::IDENTITY).unwrap();
        assert_eq!(beam.number(7, photons), 7 + beam.count);
        beam
    }

    /// Flux through a sphere: the sum over emitted photons whose line passes through it.
    fn caught(beam: &Beam, radius: f32) -> f64 {
        (beam.first..beam.first + beam.count)
            .map(|i| beam.emit(i))
            .filter(|p| {
                let along = (-p.origin.dot(p.direction)).max(0.0);
                (p.origin + p.direction * along).length() < radius
            })
            .map(|p| f64::from(p.flux.x))
            .sum()
    }

    /// The share of a point light's flux is the solid angle of the cone of tangents, from any distance and for
    /// every way of drawing photons; from inside the sphere it is the whole flux.
    #[test]
    fn a_ball_catches_its_solid_angle_of_a_point_light() {
        for (z, radius) in [
            (10.0, 0.1),
            (1.0, 0.3),
            (1.0, 0.89),
            (1.0, 0.95),
            (0.5, 1.0),
        ] {
            let n = 40_000;
            let got = caught(&beam(&ball_light(z, 0.0), radius, n), radius) / 2.0;
            let sine = f64::from((radius / z).min(1.0));
            let cap = if radius < z {
                2.0 * std::f64::consts::PI * (1.0 - (1.0 - sine * sine).sqrt())
            } else {
                4.0 * std::f64::consts::PI
            };
            // Cells on the rim are inside or outside: some 4 sqrt(n) of them, whose errors are independent.
            let bound = 4.0 * (4.0 * f64::from(n).sqrt()).sqrt() / f64::from(n);
            assert!(
                (got / cap - 1.0).abs() < bound.max(2e-3),
                "{z} {radius}: {got} {cap}"
            );
        }
    }

    /// Flux from one sphere to another, coaxial and far apart: radiance times the product of their projected
    /// areas divided by the squared distance, up to the square of their sizes over distance.
    #[test]
    fn a_large_light_sends_as_much_as_its_radiance_says() {
        let (z, light_radius, radius) = (2.0, 0.3, 0.1);
        let got = caught(&beam(&ball_light(z, light_radius), radius, 200_000), radius);
        let expected = 2.0 * std::f64::consts::PI * f64::from(radius * radius / (z * z));
        let sizes = f64::from((light_radius + radius) / z).powi(2);
        assert!(
            (got / expected - 1.0).abs() < sizes,
            "{got} against {expected}"
        );
    }

    #[test]
    fn parallel_light_falls_on_the_projected_area() {
        for tan_radius in [0.0, 0.2] {
            let light = CameraLight::Directional {
                to_light: Vec3A::Y,
                tan_radius,
                irradiance: Vec3A::splat(3.0),
            };
            let got = caught(&beam(&light, 0.5, 90_000), 0.5);
            let expected = 3.0 * std::f64::consts::PI * 0.25;
            // Up to the cosine of the tilt, which a uniform disc of tangents ignores.
            let tilt = f64::from(tan_radius * tan_radius);
            assert!(
                (got / expected - 1.0).abs() < 2e-3 + tilt,
                "{got} against {expected}"
            );
        }
    }

    #[test]
    fn what_cannot_be_lit_has_no_beam() {
        let of = |light: CameraLight, ball| Beam::new(&light, ball, 1.0, Mat3A::IDENTITY).is_some();
        assert!(of(ball_light(1.0, 0.1), (Vec3A::ZERO, 0.1)));
        assert!(!of(ball_light(1.0, 0.1), (Vec3A::ZERO, 0.0)));
        assert!(!of(ball_light(1.0, 0.1), (Vec3A::ZERO, f32::NAN)));
        assert!(!of(ball_light(f32::NAN, 0.1), (Vec3A::ZERO, 0.1)));
        // In the exact centre: in all directions.
        assert!(of(ball_light(0.0, 0.0), (Vec3A::ZERO, 0.1)));
    }
}
