//! A room with objects in it, path traced; and the product's composite from the room without them.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::sync::Arc;

use anyhow::{Context, Result};
use glam::{DAffine3, DQuat, DVec3};
use rayon::prelude::*;

use super::tally::Tally;
use crate::compare::Lab;
use crate::oracle::path::{self, Picture, Tracer, World};
use crate::synth::{Depth, Lighting, TruthRoom};
use ghostlight::camera::{Intrinsics, Pose};
use ghostlight::frame::{ColorImage, RgbdFrame};
use ghostlight::numerics::srgb_from_linear;
use ghostlight::render::{Aov, AovImage, Engine, RenderSettings};
use ghostlight::scene::{Environment, Instance, Light, Material, Mesh, Preset, Scene};
use ghostlight::shapes;

/// An object on the desk.
pub(super) struct Thing {
    /// Name of its material.
    pub(super) name: &'static str,
    mesh: Arc<Mesh>,
    material: Material,
    /// Position on the desk, metres from the centre of its free part: right, away.
    at: [f64; 2],
}

/// What to render.
pub(super) struct Plan {
    pub(super) name: String,
    pub(super) things: Vec<Thing>,
    lighting: Lighting,
    size: (u32, u32),
    /// Paths per pixel of the ground truth.
    samples: u32,
}

/// The five materials of the experiment, as presets.
const MATERIALS: [(&str, Preset); 5] = [
    ("mirror", Preset::Mirror),
    ("glass", Preset::Glass),
    ("matte", Preset::Matte),
    ("plastic", Preset::Plastic),
    ("brushed metal", Preset::BrushedMetal),
];

/// Picture size of a full run, pixels.
const FULL_SIZE: (u32, u32) = (320, 240);

/// Paths per pixel of a full run.
const FULL_SAMPLES: u32 = 128;

impl Plan {
    /// One ball of each material, side by side.
    pub(super) fn every_material(lighting: Lighting, size: (u32, u32), samples: u32) -> Self {
        // Fine enough that flat facets do not show in reflections: normals are smooth.
        let mesh = Arc::new(shapes::sphere(0.055, 4));
        let places = [
            [-0.13, 0.07],
            [0.0, 0.09],
            [0.13, 0.07],
            [-0.07, -0.06],
            [0.07, -0.06],
        ];
        let things = MATERIALS.into_iter().zip(places);
        let of = match lighting {
            Lighting::Open => "open sky",
            Lighting::Lamps => "lamps",
            Lighting::Daylight => "daylight",
        };
        Self {
            name: format!("five balls, {of}"),
            things: things
                .map(|((name, preset), at)| Thing {
                    name,
                    mesh: mesh.clone(),
                    material: preset.material(),
                    at,
                })
                .collect(),
            lighting,
            size,
            samples,
        }
    }

    /// One teapot.
    fn teapot(name: &'static str, preset: Preset) -> Self {
        Self {
            name: format!("{name} teapot, open sky"),
            things: vec![Thing {
                name,
                mesh: Arc::new(shapes::teapot(8)),
                material: preset.material(),
                at: [0.0, 0.0],
            }],
            lighting: Lighting::Open,
            size: FULL_SIZE,
            samples: FULL_SAMPLES,
        }
    }

    /// Every plan of a full run.
    pub(super) fn full() -> Vec<Self> {
        [Lighting::Open, Lighting::Lamps, Lighting::Daylight]
            .map(|lighting| Self::every_material(lighting, FULL_SIZE, FULL_SAMPLES))
            .into_iter()
            .chain(MATERIALS.map(|(name, preset)| Self::teapot(name, preset)))
            .collect()
    }
}

/// A frame rendered by the product.
pub(super) struct Composite {
    pub(super) color: ColorImage,
    /// Coverage of each pixel by virtual objects, 0..=255.
    pub(super) mask: Vec<u8>,
}

/// A rendered plan.
pub(super) struct Stage {
    pub(super) name: String,
    room: TruthRoom,
    intrinsics: Intrinsics,
    pose: Pose,
    /// The camera's picture of the empty room.
    pub(super) camera: ColorImage,
    /// The room with the objects in it.
    pub(super) truth: Picture,
    scene: Scene,
    probe: Environment,
    /// Number of the object at each pixel's centre, 0 for the room.
    things: Vec<u32>,
    /// Whether an object is between a pixel's surface point and any part of a lamp.
    shadowed: Vec<bool>,
    engine: Engine,
}

/// How much nearer than the recording's camera this camera is, metres.
const CLOSER_M: f64 = 0.35;

/// Pictures of empty rooms, each rendered once.
#[derive(Default)]
pub(super) struct Rooms {
    /// Lighting, size and samples, and the camera's picture for them.
    known: Vec<(Lighting, (u32, u32), u32, ColorImage)>,
}

/// Points on each lamp to which shadow rays are cast: more than the product's finest setting.
const LAMP_POINTS: u32 = 512;

/// Tolerance of a shadow's outline, pixels: for the error of only [`LAMP_POINTS`] points, and for the product's
/// filter.
const SHADOW_MARGIN: i64 = 4;

impl Stage {
    pub(super) fn build(lab: &Lab, plan: &Plan, rooms: &mut Rooms) -> Result<Self> {
        let room = TruthRoom::new(plan.lighting);
        let intrinsics = room.intrinsics(plan.size.0, plan.size.1)?;
        let mut pose = room.pose(1.2);
        pose.translation += pose.rotation * DVec3::Z * CLOSER_M;
        let mut scene = Scene {
            lights: room.lights().to_vec(),
            ..Scene::default()
        };
        let (mut world, mut alone) = (room.world().clone(), World::default());
        for (thing, number) in plan.things.iter().zip(1u32..) {
            let [right, away] = thing.at;
            let stands = TruthRoom::FREE_SPOT + DVec3::new(right, away, 0.0);
            // Meshes have y up, the room z.
            let place = DAffine3::from_rotation_translation(up_from_y(), stands);
            let material = || path::Material::of_scene(&thing.material);
            world.add_mesh(&thing.mesh, place, material(), number);
            alone.add_mesh(&thing.mesh, place, material(), number);
            scene.instances.push(Instance {
                name: thing.name.to_owned(),
                mesh: scene.meshes.len() as u32,
                material: scene.materials.len() as u32,
                world_from_object: place,
                ghost: false,
            });
            scene.meshes.push(thing.mesh.clone());
            scene.materials.push(thing.material.clone());
        }
        let render = |world: &World| {
            lab.pool()
                .install(|| path::render(world, &intrinsics, &pose, plan.samples, 1))
        };
        let known = rooms.known.iter().find(|(lighting, size, samples, _)| {
            (*lighting, *size, *samples) == (plan.lighting, plan.size, plan.samples)
        });
        let camera = match known {
            Some((.., camera)) => camera.clone(),
            None => {
                lab.phase(&format!("{}: the room alone", plan.name));
                let camera = image(&render(room.world()));
                let own = (plan.lighting, plan.size, plan.samples, camera.clone());
                rooms.known.push(own);
                camera
            }
        };
        lab.phase(&format!("{}: the room with things", plan.name));
        let truth = render(&world);
        let above = TruthRoom::FREE_SPOT + DVec3::Z * 0.06;
        let probe = lab
            .pool()
            .install(|| probe(&room.world().tracer(), above, lab.pick(64, 256)));
        let (tracer, alone) = (world.tracer(), alone.tracer());
        let hits: Vec<(u32, bool)> = lab.pool().install(|| {
            (0..intrinsics.n_pixels())
                .into_par_iter()
                .map(|i| look(&tracer, &alone, &intrinsics, &pose, room.lights(), i))
                .collect()
        });
        let (things, shadowed) = hits.into_iter().unzip();
        Ok(Self {
            name: plan.name.clone(),
            room,
            intrinsics,
            pose,
            camera,
            truth,
            scene,
            probe,
            things,
            shadowed,
            engine: lab.engine().clone(),
        })
    }

    /// The product's composite from the camera's picture.
    pub(super) fn composite(
        &self,
        depth: Depth,
        probe: bool,
        settings: &RenderSettings,
    ) -> Result<Composite> {
        let mut scene = self.scene.clone();
        scene.environment = probe.then(|| self.probe.clone());
        let frame = RgbdFrame {
            index: 0,
            time_ns: 0,
            color: self.camera.clone(),
            depth: self.room.depth(&self.intrinsics, &self.pose, depth),
            intrinsics: self.intrinsics,
            pose: self.pose,
        };
        let mut renderer = self.engine.renderer(&scene)?;
        let mut rendered = renderer.render(&frame, settings, &[Aov::Mask])?;
        let (_, mask) = rendered.aovs.pop().context("a mask that was asked for")?;
        let AovImage::Gray8(mask) = mask else {
            anyhow::bail!("mask: expected 8 bits per pixel");
        };
        Ok(Composite {
            color: rendered.color,
            mask,
        })
    }

    /// The ground truth as a picture.
    pub(super) fn truth_image(&self) -> ColorImage {
        image(&self.truth)
    }

    /// The standard error of the ground truth, in the form of an error.
    pub(super) fn noise_tally(&self) -> Tally {
        Tally::of_noise(self)
    }

    /// Number of the object that this pixel shows or whose outline it touches; 0 for neither.
    pub(super) fn thing(&self, i: usize) -> u32 {
        match self.things[i] {
            0 => self.around(i, 1).find(|&k| k != 0).unwrap_or(0),
            thing => thing,
        }
    }

    /// Whether an object is between the pixel's surface and a lamp.
    pub(super) fn is_shadowed(&self, i: usize) -> bool {
        self.shadowed[i]
    }

    /// Whether the pixel shows one object and is away from its outline.
    pub(super) fn is_inside(&self, i: usize) -> bool {
        let own = self.things[i];
        own != 0 && self.around(i, 1).all(|k| k == own)
    }

    /// Whether the pixel shows the room and is away from every object's outline.
    pub(super) fn is_outside(&self, i: usize) -> bool {
        self.around(i, 1).all(|k| k == 0)
    }

    /// Whether the pixel is away from every object and shadow.
    pub(super) fn is_free(&self, i: usize) -> bool {
        self.neighbours(i, SHADOW_MARGIN)
            .all(|k| self.things[k] == 0 && !self.shadowed[k])
    }

    fn around(&self, i: usize, reach: i64) -> impl Iterator<Item = u32> {
        self.neighbours(i, reach).map(|k| self.things[k])
    }

    /// The pixels of a square around a pixel, including that pixel.
    fn neighbours(&self, i: usize, reach: i64) -> impl Iterator<Item = usize> {
        let (w, h) = (
            i64::from(self.intrinsics.width),
            i64::from(self.intrinsics.height),
        );
        let (x, y) = (i as i64 % w, i as i64 / w);
        (-reach..=reach)
            .flat_map(move |dy| (-reach..=reach).map(move |dx| (x + dx, y + dy)))
            .filter(move |&(x, y)| x >= 0 && y >= 0 && x < w && y < h)
            .map(move |(x, y)| (y * w + x) as usize)
    }
}

/// Rotates y up to z up.
fn up_from_y() -> DQuat {
    DQuat::from_rotation_x(FRAC_PI_2)
}

/// The object at a pixel's centre, and whether any object is between its surface point and a lamp.
fn look(
    tracer: &Tracer<'_>,
    alone: &Tracer<'_>,
    intrinsics: &Intrinsics,
    pose: &Pose,
    lights: &[Light],
    i: usize,
) -> (u32, bool) {
    let width = intrinsics.width as usize;
    let towards = intrinsics.unproject((i % width) as f64, (i / width) as f64, 1.0);
    let direction = pose.rotation * towards;
    let Some(hit) = tracer.first_hit(pose.translation, direction) else {
        return (0, false);
    };
    let point = pose.translation + direction * hit.t;
    let hidden = |light: &Light| {
        let Light::Sphere {
            position, radius_m, ..
        } = *light
        else {
            return false;
        };
        (0..LAMP_POINTS).any(|k| {
            // A spiral over the whole sphere gives evenly spaced, distinct points.
            let z = 1.0 - (2.0 * f64::from(k) + 1.0) / f64::from(LAMP_POINTS);
            let (s, c) = (f64::from(k) * GOLDEN_ANGLE).sin_cos();
            let r = (1.0 - z * z).sqrt();
            alone.is_blocked(point, position + DVec3::new(r * c, r * s, z) * radius_m)
        })
    };
    (hit.thing, lights.iter().any(hidden))
}

/// Angle between successive points of the spiral, radians: pi (3 - sqrt 5).
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

/// Converts a picture to 8 bits.
fn image(picture: &Picture) -> ColorImage {
    let code = |x: f64| srgb_from_linear(x as f32);
    ColorImage {
        width: picture.width,
        height: picture.height,
        rgba: picture
            .pixels
            .iter()
            .map(|p| [code(p.mean.x), code(p.mean.y), code(p.mean.z), 255])
            .collect(),
    }
}

/// An environment map of the room from a position; sphere lamps are left out, because the scene has them as
/// lights.
fn probe(tracer: &Tracer<'_>, place: DVec3, samples: u32) -> Environment {
    let (width, height) = (128u32, 64u32);
    let radiance = (0..width * height)
        .into_par_iter()
        .map(|i| {
            let phi = TAU * ((f64::from(i % width) + 0.5) / f64::from(width) - 0.5);
            let theta = PI * (f64::from(i / width) + 0.5) / f64::from(height);
            // Axes of an environment map: y up, the middle column along -z.
            let towards = DVec3::new(
                theta.sin() * phi.sin(),
                theta.cos(),
                -theta.sin() * phi.cos(),
            );
            let seen = tracer.radiance(place, up_from_y() * towards, samples, [2, u64::from(i)]);
            seen.mean.as_vec3()
        })
        .collect();
    Environment {
        width,
        height,
        radiance: Arc::new(radiance),
        world_from_map: up_from_y(),
    }
}
