//! From document to runtime scene: files are read once, placements become world transforms.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DAffine3, DMat3, DQuat, DVec3, Vec3};

use super::document::{LightFrame, LightKind, LightSpec, Object, PlaceFrame, SceneDocument};
use super::environment_spec::EnvironmentSpec;
use super::error::{MeshError, SceneError};
use super::inside;
use super::key_light::key_light;
use super::model::Model;
use super::place::{self, Placed};
use super::spot::Ground;
use super::triple::Triple;
use super::{Environment, Instance, Light, LoadContext, Scene};
use crate::camera::Pose;
use crate::frame::RgbdFrame;

mod prepare;

use prepare::{Prepared, metres};

/// A real surface that things can be stood on.
pub trait Surface {
    /// The plane that fits the surface within `radius_px` of pixel (u, v): a point and the
    /// unit normal that faces the camera, both in camera axes, metres; `None` in a hole.
    fn plane_at(&self, u: f32, v: f32, radius_px: f32) -> Option<(DVec3, DVec3)>;
}

/// What a scene is placed into.
#[derive(Clone, Copy)]
pub struct ResolveOptions<'a> {
    /// Pixel that stands the first object on the real surface there, whatever its document
    /// says; a translation is kept only if the document placed it by pixel too.
    pub place_pixel: Option<[f64; 2]>,
    /// The first frame: its camera and size are what placements refer to.
    pub first_frame: &'a RgbdFrame,
    /// The real surface that the first frame sees.
    pub surface: &'a dyn Surface,
}

/// A scene, and what is known of its objects beside their instances.
pub struct Resolved {
    /// Ready to be rendered.
    pub scene: Scene,
    /// What was odd, one sentence each.
    pub notes: Vec<String>,
    /// How each object of the document stands, in its order.
    pub standings: Vec<Standing>,
}

/// How an object stands.
#[derive(Debug, Clone, Copy)]
pub struct Standing {
    /// The direction it stands up in, world axes, unit length.
    pub up: DVec3,
    /// Nothing was measured where it was put: it stands at the nearest place where something was.
    pub nearest: bool,
}

/// Largest extents that things in a room have, metres (heuristic).
pub const PLAUSIBLE_M: std::ops::RangeInclusive<f64> = 0.02..=1.0;

/// Largest extent that a mesh is brought to which was named without a size and has none that is
/// plausible, metres.
pub const FIT_SIZE_M: f64 = 0.25;

/// Most placed meshes of a scene.
const MAX_INSTANCES: usize = 200_000;

/// Radius of a sphere light that names none, metres: a bulb.
const DEFAULT_RADIUS_M: f64 = 0.05;

/// Half the angle that the sun fills, degrees.
const SUN_RADIUS_DEG: f64 = 0.27;

/// An environment's up follows the surface that objects stand on only if that is nearer than
/// this to the camera's own up, degrees: farther, it is a wall (heuristic).
const MAX_TILT_DEG: f64 = 60.0;

impl SceneDocument {
    /// As [`Self::resolve_with`], without limits.
    pub fn resolve(
        &self,
        base_dir: &Path,
        options: &ResolveOptions<'_>,
    ) -> Result<(Scene, Vec<String>), SceneError> {
        let context = LoadContext::default();
        let resolved = self.resolve_with(base_dir, options, &context)?;
        Ok((resolved.scene, resolved.notes))
    }

    /// Loads every file and places every object.
    pub fn resolve_with(
        &self,
        base_dir: &Path,
        options: &ResolveOptions<'_>,
        context: &LoadContext,
    ) -> Result<Resolved, SceneError> {
        let resolved = self.resolve_within(base_dir, options, context);
        // Whatever a loader made of a refusal, and whatever else is wrong: it comes first.
        context.check().map_err(|source| SceneError::Load {
            file: self.file.clone(),
            source,
        })?;
        resolved
    }

    fn resolve_within(
        &self,
        base_dir: &Path,
        options: &ResolveOptions<'_>,
        context: &LoadContext,
    ) -> Result<Resolved, SceneError> {
        self.check()?;
        if options.place_pixel.is_some() && self.objects.is_empty() {
            return Err(self.field("objects", "expected an object to place, got none".into()));
        }
        let mut resolver = Resolver {
            context,
            document: self,
            base_dir,
            models: HashMap::new(),
            materials: HashMap::new(),
            scene: Scene::default(),
            notes: Vec::new(),
            n_triangles: 0,
        };
        let todo = resolver.prepare(options)?;
        let grounds = resolver.grounds(&todo, options)?;
        let mut first_normal = None;
        let mut standings = Vec::with_capacity(todo.len());
        for (i, (prepared, ground)) in todo.into_iter().zip(grounds).enumerate() {
            let (normal, standing) = resolver.object(i, prepared, ground, options)?;
            first_normal = first_normal.or(normal);
            standings.push(standing);
        }
        let pose = &options.first_frame.pose;
        resolver.scene.lights = self
            .lights
            .iter()
            .map(|light| light.resolve(pose))
            .collect();
        if let Some(environment) = &self.environment {
            resolver.environment(environment, pose, first_normal)?;
        } else if let (true, Some(first)) =
            (self.lights.is_empty(), resolver.scene.instances.first())
        {
            let target = first.world_from_object.translation;
            // A wall's normal is no up: within reach of the camera's own, or that.
            let upright = |n: &DVec3| -n.y >= MAX_TILT_DEG.to_radians().cos();
            let up = first_normal.filter(upright).unwrap_or(-DVec3::Y);
            resolver
                .scene
                .lights
                .push(key_light(options.first_frame, target, up));
            resolver.notes.push(
                "The scene names no light: a soft lamp above its first object is assumed, as bright as the \
                 first picture suggests."
                    .to_owned(),
            );
        }
        Ok(Resolved {
            scene: resolver.scene,
            notes: resolver.notes,
            standings,
        })
    }

    fn field(&self, path: impl Into<String>, problem: String) -> SceneError {
        SceneError::Field {
            file: self.file.clone(),
            path: path.into(),
            problem,
        }
    }

    /// What an object is called in messages.
    pub fn name_of(object: &Object) -> String {
        object.name.clone().unwrap_or_else(|| {
            Path::new(&object.mesh).file_stem().map_or_else(
                || object.mesh.clone(),
                |stem| stem.to_string_lossy().into_owned(),
            )
        })
    }
}

/// A model whose meshes are in the scene from `first_mesh` on.
struct Loaded {
    model: Arc<Model>,
    first_mesh: usize,
    /// In the model's own axes.
    bounds: (DVec3, DVec3),
}

/// What makes two parts' materials the same: model, material within it, and the bits of the
/// scale if the material has a length that scales.
type MaterialKey = (PathBuf, Option<usize>, u64);

struct Resolver<'a> {
    context: &'a LoadContext,
    document: &'a SceneDocument,
    base_dir: &'a Path,
    models: HashMap<PathBuf, Loaded>,
    materials: HashMap<MaterialKey, u32>,
    scene: Scene,
    notes: Vec<String>,
    n_triangles: usize,
}

impl Resolver<'_> {
    /// Adds one object. The normal (camera axes) of the surface it stands on, if any, comes first.
    fn object(
        &mut self,
        i: usize,
        prepared: Prepared<'_>,
        ground: Option<Ground>,
        options: &ResolveOptions<'_>,
    ) -> Result<(Option<DVec3>, Standing), SceneError> {
        let path = format!("objects[{i}]");
        let Prepared {
            object,
            name,
            file,
            placement,
            pixel_field,
            turned,
        } = prepared;
        let Loaded {
            model, first_mesh, ..
        } = &self.models[&file];
        let Placed {
            world_from_model,
            surface_normal,
            instead,
        } = place::place(&placement, &turned, model, ground, options).map_err(
            |(field, problem)| match field {
                "pixel" => self.document.field(pixel_field.as_str(), problem),
                field => self
                    .document
                    .field(format!("{path}.place.{field}"), problem),
            },
        )?;
        if let Some([u, v]) = instead {
            self.notes.push(format!(
                "{name}: nothing was measured where it was put; it stands at the nearest measured pixel, ({u}, {v})."
            ));
        }
        let pose = &options.first_frame.pose;
        if !object.ghost && inside::contains(model, world_from_model, pose.translation) {
            self.notes.push(format!(
                "The camera starts inside {name}, which is {} wide: place.size_m sets its largest side.",
                metres(turned.size_m)
            ));
        }
        let camera_up = pose.rotation * DVec3::NEG_Y;
        let standing = Standing {
            up: match (placement.effective_frame(), surface_normal) {
                (PlaceFrame::World, _) => DVec3::Y,
                (_, Some(normal)) => (pose.rotation * normal).normalize_or(camera_up),
                (_, None) => camera_up,
            },
            nearest: instead.is_some(),
        };
        if self.scene.instances.len() + model.parts.len() > MAX_INSTANCES {
            return Err(self.document.field(
                path.as_str(),
                format!("expected at most {MAX_INSTANCES} placed meshes in all, got more"),
            ));
        }
        let parts: Vec<_> = model
            .parts
            .iter()
            .map(|part| {
                let own = part.material.map(|m| model.materials[m].clone());
                (
                    part.material,
                    own,
                    first_mesh + part.mesh,
                    world_from_model * part.model_from_mesh,
                )
            })
            .collect();
        // Materials of this object alone, by the file's material that they override.
        let mut overridden: HashMap<(Option<usize>, u64), u32> = HashMap::new();
        for (index, own, mesh, world_from_object) in parts {
            let determinant = world_from_object.matrix3.determinant();
            if !world_from_object.is_finite() || determinant == 0.0 || !determinant.is_finite() {
                return Err(self.document.field(
                    format!("{path}.place"),
                    "expected a transform that can be inverted, got one that collapses or overflows".into(),
                ));
            }
            let mut own = own.unwrap_or_default();
            let mut scale_bits = 0;
            if own.attenuation_distance_m.is_finite() {
                // The file's lengths are in the mesh's units.
                let scale = determinant.abs().cbrt();
                own.attenuation_distance_m *= scale as f32;
                scale_bits = scale.to_bits();
            }
            let known = match &object.material {
                Some(_) => overridden.get(&(index, scale_bits)),
                None => self.materials.get(&(file.clone(), index, scale_bits)),
            };
            let material = match known {
                Some(&known) => known,
                None => {
                    let id = self.scene.materials.len() as u32;
                    match &object.material {
                        Some(spec) => {
                            overridden.insert((index, scale_bits), id);
                            self.scene.materials.push(spec.apply(&own));
                        }
                        None => {
                            self.materials.insert((file.clone(), index, scale_bits), id);
                            self.scene.materials.push(own);
                        }
                    }
                    id
                }
            };
            self.scene.instances.push(Instance {
                name: name.clone(),
                mesh: mesh as u32,
                material,
                world_from_object,
                ghost: object.ghost,
            });
        }
        Ok((surface_normal, standing))
    }

    /// Reads a mesh file unless an earlier object did.
    fn load(&mut self, object: &Object, name: &str, path: &str) -> Result<PathBuf, SceneError> {
        let file = self.base_dir.join(&object.mesh);
        if self.models.contains_key(&file) {
            return Ok(file);
        }
        let fail = |source: MeshError| match object.bare {
            // Nobody wrote the document that names it.
            true => SceneError::MeshFile(source),
            false => SceneError::Mesh {
                file: self.document.file.clone(),
                path: format!("{path}.mesh"),
                source,
            },
        };
        let model = self.context.model(&file).map_err(fail)?;
        self.n_triangles += model.n_stored();
        let (max, got) = (self.context.max_triangles(), self.n_triangles);
        if got > max {
            return Err(SceneError::Triangles {
                file: self.document.file.clone(),
                max,
                got,
            });
        }
        self.notes
            .extend(model.notes.iter().map(|note| format!("{name}: {note}")));
        let first_mesh = self.scene.meshes.len();
        // The scene shares the vertices; placing needs them too.
        self.scene
            .meshes
            .extend(model.meshes.iter().map(Arc::clone));
        let bounds = bounds_under(&model, DMat3::IDENTITY).unwrap_or_default();
        self.models.insert(
            file.clone(),
            Loaded {
                model,
                first_mesh,
                bounds,
            },
        );
        Ok(file)
    }

    fn environment(
        &mut self,
        spec: &EnvironmentSpec,
        pose: &Pose,
        first_normal: Option<DVec3>,
    ) -> Result<(), SceneError> {
        let camera_up = DVec3::NEG_Y;
        let up = match spec.up {
            Some(up) => DVec3::from(up).normalize_or(camera_up),
            None => first_normal
                .filter(|n| n.dot(camera_up) > MAX_TILT_DEG.to_radians().cos())
                .unwrap_or(camera_up),
        };
        let camera_from_map = place::upright(up, DVec3::NEG_Z, DVec3::Y)
            * DQuat::from_rotation_y(spec.rotation_deg.to_radians());
        let file = self.base_dir.join(&spec.map);
        let (environment, notes) = Environment::load_with(
            self.context,
            &file,
            spec.intensity as f32,
            (pose.rotation * camera_from_map).normalize(),
        )
        .map_err(|reason| {
            self.document
                .field("environment.map", format!("{}: {reason}", file.display()))
        })?;
        self.notes
            .extend(notes.into_iter().map(|note| format!("environment: {note}")));
        self.scene.environment = Some(environment);
        Ok(())
    }
}

impl LightSpec {
    /// In world axes. Checked before: what its kind needs is there.
    fn resolve(&self, first_camera: &Pose) -> Light {
        let frame = match self.frame {
            LightFrame::World => Pose::IDENTITY,
            LightFrame::FirstCamera => *first_camera,
        };
        let rgb = |value: Option<Triple>| {
            value.map_or(Vec3::ZERO, |Triple(rgb)| Vec3::from(rgb.map(|c| c as f32)))
        };
        match self.kind {
            LightKind::Sphere => Light::Sphere {
                position: frame.transform_point(self.position.unwrap_or_default().into()),
                radius_m: self.radius.unwrap_or(DEFAULT_RADIUS_M),
                intensity: rgb(self.intensity),
            },
            LightKind::Directional => Light::Directional {
                direction: (frame.rotation * DVec3::from(self.direction.unwrap_or_default()))
                    .normalize_or(DVec3::Y),
                angular_radius_rad: self
                    .angular_radius_deg
                    .unwrap_or(SUN_RADIUS_DEG)
                    .to_radians(),
                irradiance: rgb(self.irradiance),
            },
        }
    }
}

/// Bounds of a model under a linear map; only vertices that triangles use count.
pub(super) fn bounds_under(model: &Model, map: DMat3) -> Option<(DVec3, DVec3)> {
    let map = DAffine3::from_mat3(map);
    let mut bounds: Option<(DVec3, DVec3)> = None;
    for part in &model.parts {
        let mesh = &model.meshes[part.mesh];
        let from_mesh = map * part.model_from_mesh;
        for &index in mesh.triangles.iter().flatten() {
            let p = from_mesh.transform_point3(mesh.positions[index as usize].as_dvec3());
            bounds = Some(bounds.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))));
        }
    }
    bounds
}

#[cfg(test)]
mod tests;
