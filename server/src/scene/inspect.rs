//! Content of a scene document or a mesh file, and notes on unusual content.

use std::fmt;
use std::path::Path;

use glam::{DMat3, DQuat};
use serde::Serialize;

use super::document::{PlaceFrame, SceneDocument};
use super::error::{MeshError, SceneError};
use super::mesh_file::is_mesh;
use super::model::Model;
use super::{Environment, LoadContext, Material};

/// The result of an inspection.
#[derive(Debug, Clone, Serialize)]
pub struct SceneInspection {
    /// The inspected file.
    pub file: String,
    /// Its objects; a mesh file counts as one.
    pub objects: Vec<ObjectInspection>,
    /// Lights of the document, as text.
    pub lights: Vec<String>,
    /// Environment map, as text.
    pub environment: Option<String>,
    /// Notes on unusual content, one sentence each.
    pub notes: Vec<String>,
}

/// One object.
#[derive(Debug, Clone, Serialize)]
pub struct ObjectInspection {
    /// Its name.
    pub name: String,
    /// Its mesh file.
    pub mesh: String,
    /// Its placement, as text.
    pub place: String,
    /// Number of stored meshes.
    pub meshes: usize,
    /// Number of placed meshes (a mesh may be placed several times).
    pub parts: usize,
    /// Number of drawn triangles.
    pub triangles: usize,
    /// Number of stored triangles.
    pub triangles_stored: usize,
    /// Names of materials, with their notable properties.
    pub materials: Vec<String>,
    /// Number of textures.
    pub textures: usize,
    /// Number of placed meshes with vertex colours.
    pub vertex_colored: usize,
    /// Smallest corner in the mesh's own units.
    pub min: [f64; 3],
    /// Largest corner.
    pub max: [f64; 3],
    /// Whether the object is a modelled ghost.
    pub ghost: bool,
}

/// Inspects a scene document (.json) or a mesh file.
pub fn inspect_scene(path: &Path) -> Result<SceneInspection, SceneError> {
    let file = path.display().to_string();
    if is_mesh(path) {
        let model = Model::load_with(&LoadContext::default(), path)?;
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        return Ok(SceneInspection {
            objects: vec![ObjectInspection::new(&name, &file, "not placed", &model)],
            lights: Vec::new(),
            environment: None,
            notes: model.notes,
            file,
        });
    }
    let (document, base_dir) = SceneDocument::load(path)?;
    let context = LoadContext::default();
    let mut notes = Vec::new();
    let mut objects = Vec::new();
    for (i, object) in document.objects.iter().enumerate() {
        let model = Model::load_with(&context, &base_dir.join(&object.mesh)).map_err(
            |source: MeshError| SceneError::Mesh {
                file: file.clone(),
                path: format!("objects[{i}].mesh"),
                source,
            },
        )?;
        let name = SceneDocument::name_of(object);
        let at = |[u, v]: [f64; 2]| format!("({:.0} %, {:.0} %)", 100.0 * u, 100.0 * v);
        let place = match (object.place.effective_frame(), object.place.pixel) {
            (PlaceFrame::Surface, _) => format!(
                "on the level surface nearest to {} of the picture",
                at(object.place.picture.unwrap_or(super::LOWER_MIDDLE))
            ),
            (PlaceFrame::Pixel, None) if object.place.picture.is_some() => format!(
                "on the surface at {} of the picture",
                at(object.place.picture.unwrap_or_default())
            ),
            (PlaceFrame::World, _) => format!("at {:?} m in the world", object.place.translation),
            (PlaceFrame::FirstCamera, _) => {
                format!(
                    "at {:?} m before the first camera",
                    object.place.translation
                )
            }
            (PlaceFrame::Pixel, Some([u, v])) => format!("on the surface at pixel ({u}, {v})"),
            (PlaceFrame::Pixel, None) => "on the surface at a pixel not given yet".to_owned(),
        };
        let mut inspection = ObjectInspection::new(&name, &object.mesh, &place, &model);
        inspection.ghost = object.ghost;
        if let Some(spec) = &object.material {
            let mut names: Vec<String> = match model.materials.as_slice() {
                [] => vec![describe(&spec.apply(&Material::default()))],
                own => own.iter().map(|own| describe(&spec.apply(own))).collect(),
            };
            names.dedup();
            inspection.materials = names;
        }
        objects.push(inspection);
        notes.extend(
            model
                .notes
                .into_iter()
                .map(|note| format!("{name}: {note}")),
        );
    }
    let mut environment = None;
    if let Some(spec) = &document.environment {
        let map = base_dir.join(&spec.map);
        let (map, odd) =
            Environment::load(&map, spec.intensity as f32, DQuat::IDENTITY).map_err(|reason| {
                SceneError::Field {
                    file: file.clone(),
                    path: "environment.map".to_owned(),
                    problem: format!("{}: {reason}", map.display()),
                }
            })?;
        notes.extend(odd.into_iter().map(|note| format!("environment: {note}")));
        environment = Some(format!(
            "{}, {}x{}, mean radiance {:.3}",
            spec.map,
            map.width,
            map.height,
            map.mean_radiance()
        ));
    }
    if objects.is_empty() {
        notes.push(
            "there are no objects: the camera's picture is passed through unchanged".to_owned(),
        );
    }
    Ok(SceneInspection {
        objects,
        lights: document
            .lights
            .iter()
            .map(|light| format!("{:?}", light.kind).to_lowercase())
            .collect(),
        environment,
        notes,
        file,
    })
}

impl ObjectInspection {
    fn new(name: &str, mesh: &str, place: &str, model: &Model) -> Self {
        let (min, max) = model.bounds_under(DMat3::IDENTITY).unwrap_or_default();
        let textures = model
            .materials
            .iter()
            .flat_map(|m| {
                [
                    &m.base_color_texture,
                    &m.metallic_roughness_texture,
                    &m.normal_texture,
                    &m.emissive_texture,
                    &m.occlusion_texture,
                ]
            })
            .flatten()
            .map(|texture| std::sync::Arc::as_ptr(texture) as usize)
            .collect::<std::collections::HashSet<_>>()
            .len();
        Self {
            name: name.to_owned(),
            mesh: mesh.to_owned(),
            place: place.to_owned(),
            meshes: model.meshes.len(),
            parts: model.parts.len(),
            triangles: model.n_drawn(),
            triangles_stored: model.n_stored(),
            materials: model.materials.iter().map(describe).collect(),
            textures,
            vertex_colored: model
                .parts
                .iter()
                .filter(|part| !model.meshes[part.mesh].colors.is_empty())
                .count(),
            min: min.to_array(),
            max: max.to_array(),
            ghost: false,
        }
    }
}

fn describe(material: &Material) -> String {
    let name = if material.name.is_empty() {
        "unnamed"
    } else {
        &material.name
    };
    let kind = if material.transmission > 0.0 {
        format!(
            "transmits {:.2}, ior {:.2}",
            material.transmission, material.ior
        )
    } else if material.metallic > 0.5 {
        format!("metal, roughness {:.2}", material.roughness)
    } else {
        format!("dielectric, roughness {:.2}", material.roughness)
    };
    let shines = if material.emissive.max_element() > 0.0 {
        ", emits light"
    } else {
        ""
    };
    format!("{name} ({kind}{shines})")
}

impl fmt::Display for SceneInspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {} objects", self.file, self.objects.len())?;
        for object in &self.objects {
            let ghost = if object.ghost { ", ghost" } else { "" };
            writeln!(
                f,
                "  {} ({}): {}{ghost}",
                object.name, object.mesh, object.place
            )?;
            writeln!(
                f,
                "    {} triangles in {} parts ({} triangles in {} meshes stored), {} textures",
                object.triangles,
                object.parts,
                object.triangles_stored,
                object.meshes,
                object.textures
            )?;
            if object.vertex_colored > 0 {
                writeln!(f, "    vertex colours in {} parts", object.vertex_colored)?;
            }
            let corner = |c: [f64; 3]| format!("({:.4}, {:.4}, {:.4})", c[0], c[1], c[2]);
            writeln!(
                f,
                "    from {} to {}",
                corner(object.min),
                corner(object.max)
            )?;
            for material in &object.materials {
                writeln!(f, "    material {material}")?;
            }
        }
        if !self.lights.is_empty() {
            writeln!(f, "  lights: {}", self.lights.join(", "))?;
        }
        if let Some(environment) = &self.environment {
            writeln!(f, "  environment: {environment}")?;
        }
        for note in &self.notes {
            writeln!(f, "  note: {note}")?;
        }
        Ok(())
    }
}
