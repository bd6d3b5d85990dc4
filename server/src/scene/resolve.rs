//! Resolves a document to a runtime scene: reads its files once, and turns placements into world
//! transforms.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DMat3, DQuat, DVec3, Vec3};

use super::document::{LightFrame, LightKind, LightSpec, Object, SceneDocument};
use super::environment_spec::EnvironmentSpec;
use super::error::{MeshError, SceneError};
use super::inside;
use super::key_light::key_light;
use super::model::Model;
use super::object::SceneObject;
use super::place::{self, Placed, PlacementFrame};
use super::triple::Triple;
use super::{Environment, Instance, Light, LoadContext, Scene};
use crate::camera::Pose;

mod prepare;

use prepare::{Prepared, metres};

/// Range of the largest extent of objects in a room, metres (heuristic).
pub const PLAUSIBLE_M: std::ops::RangeInclusive<f64> = 0.02..=1.0;

/// Largest extent given to a mesh without a size whose own size is implausible, metres.
pub const FIT_SIZE_M: f64 = 0.25;

/// Most placed meshes of a scene.
const MAX_INSTANCES: usize = 200_000;

/// Radius of a sphere light without a radius, metres: a bulb.
const DEFAULT_RADIUS_M: f64 = 0.05;

/// Half the angle of the sun, degrees.
const SUN_RADIUS_DEG: f64 = 0.27;

/// An environment's up direction follows the surface under the objects only if its normal is within this angle of the
/// camera's up direction, degrees; otherwise the surface is a wall (heuristic).
const MAX_TILT_DEG: f64 = 60.0;

impl SceneDocument {
    /// As [`Self::resolve_with`], without limits.
    pub fn resolve(
        &self,
        base_dir: &Path,
        frame: &PlacementFrame<'_>,
    ) -> Result<(Scene, Vec<String>), SceneError> {
        self.resolve_with(base_dir, frame, &LoadContext::default())
    }

    /// Loads every file and places every object. Notes describe unusual content, one sentence each.
    pub fn resolve_with(
        &self,
        base_dir: &Path,
        frame: &PlacementFrame<'_>,
        context: &LoadContext,
    ) -> Result<(Scene, Vec<String>), SceneError> {
        let resolved = self.resolve_within(base_dir, frame, context);
        // A memory refusal or cancellation takes precedence over the error that a loader made of it.
        context.check().map_err(|source| SceneError::Load {
            file: self.file.clone(),
            source,
        })?;
        resolved
    }

    fn resolve_within(
        &self,
        base_dir: &Path,
        frame: &PlacementFrame<'_>,
        context: &LoadContext,
    ) -> Result<(Scene, Vec<String>), SceneError> {
        self.check()?;
        let mut resolver = Resolver {
            context,
            document: self,
            base_dir,
            models: HashMap::new(),
            materials: HashMap::new(),
            scene: Scene::default(),
            notes: self.notes.clone(),
            n_triangles: 0,
        };
        let prepared = resolver.prepare()?;
        let placed = resolver.place(&prepared, frame)?;
        let first_normal = placed.iter().find_map(|placed| placed.surface_normal);
        let pose = &frame.frame.pose;
        for (i, (prepared, placed)) in prepared.into_iter().zip(placed).enumerate() {
            resolver.object(i, prepared, placed, pose)?;
        }
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
            // The surface's normal or, if the surface is a wall, the camera's up direction.
            let upright = |n: &DVec3| -n.y >= MAX_TILT_DEG.to_radians().cos();
            let up = first_normal.filter(upright).unwrap_or(-DVec3::Y);
            resolver
                .scene
                .lights
                .push(key_light(frame.frame, target, up));
            resolver.notes.push(
                "The scene names no light: a soft lamp above its first object is assumed, as bright as the \
                 first picture suggests."
                    .to_owned(),
            );
        }
        Ok((resolver.scene, resolver.notes))
    }

    fn field(&self, path: impl Into<String>, problem: String) -> SceneError {
        SceneError::Field {
            file: self.file.clone(),
            path: path.into(),
            problem,
        }
    }

    /// An object's name, or else the name of its mesh file.
    pub fn name_of(object: &Object) -> String {
        object.name.clone().unwrap_or_else(|| {
            Path::new(&object.mesh).file_stem().map_or_else(
                || object.mesh.clone(),
                |stem| stem.to_string_lossy().into_owned(),
            )
        })
    }
}

/// A model whose meshes are in the scene, starting at `first_mesh`.
struct Loaded {
    model: Arc<Model>,
    first_mesh: usize,
    /// Bounds in the model's own axes.
    bounds: (DVec3, DVec3),
}

/// The key of a shared material: model, material in it, and the bits of the scale if the material contains lengths.
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
    /// Adds one object at its placement.
    fn object(
        &mut self,
        i: usize,
        prepared: Prepared<'_>,
        placed: Placed,
        pose: &Pose,
    ) -> Result<(), SceneError> {
        let path = format!("objects[{i}]");
        let Prepared {
            object,
            name,
            file,
            placement,
            oriented,
        } = prepared;
        let Loaded {
            model, first_mesh, ..
        } = &self.models[&file];
        if let Some([u, v]) = placed.nearest_px {
            self.notes.push(format!(
                "{name}: nothing was measured where it was put; it stands at the nearest measured pixel, ({u}, {v})."
            ));
        }
        let world_from_model = oriented.world_from_model(placed.world_from_oriented);
        if !object.ghost && inside::contains(model, world_from_model, pose.translation) {
            self.notes.push(format!(
                "The camera starts inside {name}, which is {} wide: place.size_m sets its largest side.",
                metres(oriented.size_m)
            ));
        }
        if self.scene.instances.len() + model.parts.len() > MAX_INSTANCES {
            return Err(self.document.field(
                path.as_str(),
                format!("expected at most {MAX_INSTANCES} placed meshes in all, got more"),
            ));
        }
        let first_instance = self.scene.instances.len();
        let model_from_mesh = model
            .parts
            .iter()
            .map(|part| part.model_from_mesh)
            .collect();
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
        // Materials of this object alone, by the material that they override.
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
                // The file's lengths are in units of the mesh.
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
        self.scene.objects.push(SceneObject {
            name,
            instances: first_instance..self.scene.instances.len(),
            placement,
            oriented,
            model_from_mesh,
            world_from_oriented: placed.world_from_oriented,
        });
        Ok(())
    }

    /// Loads a mesh file unless an earlier object did.
    fn load(&mut self, object: &Object, name: &str, path: &str) -> Result<PathBuf, SceneError> {
        let file = self.base_dir.join(&object.mesh);
        if self.models.contains_key(&file) {
            return Ok(file);
        }
        let fail = |source: MeshError| match object.bare {
            // The document was made for this mesh, so the error is about the mesh file alone.
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
        // The scene shares the vertices with the model, which placement needs as well.
        self.scene
            .meshes
            .extend(model.meshes.iter().map(Arc::clone));
        let bounds = model.bounds_under(DMat3::IDENTITY).unwrap_or_default();
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
    /// In world space. The document was checked, so all fields of this kind of light are present.
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

#[cfg(test)]
mod tests;
