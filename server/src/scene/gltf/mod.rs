//! glTF 2.0, as .gltf and .glb: node hierarchies are flattened to placed meshes, with materials and textures. Skins
//! and morph targets are used in their rest pose; animations are left out with a note. Sizes and indices are checked
//! before use. Parts that cannot be used are left out with a note; the rest of the file is still read.

mod accessor;
mod compressed;
mod container;
mod extension;
mod far;
mod format;
mod instancing;
mod lenient;
mod material;
mod nodes;
mod primitive;
mod skin;
mod specular;
mod texture;
mod uri;

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec3};

use self::accessor::Data;
use self::format::{Primitive, Root};
use self::nodes::Nodes;
use super::error::MeshError;
use super::model::{MAX_TRIANGLES, Model, Part};
use super::sanitise::sanitise;
use super::{LoadContext, Mesh};

/// Most placed meshes per file.
const MAX_PARTS: usize = 100_000;

/// A transform that reduces a volume to less than this share of it counts as flat: its inverse would be noise.
const FLAT: f64 = 1e-9;

/// As [`load_with`], without limits.
#[cfg(test)]
pub(super) fn load(bytes: &[u8], name: &str, folder: &Path) -> Result<Model, MeshError> {
    load_with(&LoadContext::default(), bytes, name, folder)
}

/// Reads a .gltf or .glb file from memory; other files that it names must be in `folder`.
pub(super) fn load_with(
    context: &LoadContext,
    bytes: &[u8],
    name: &str,
    folder: &Path,
) -> Result<Model, MeshError> {
    let opened = container::open(context, bytes, name, folder)?;
    let root = opened.root;
    let data = Data::new(context, &root, &opened.buffers, name);
    let nodes = nodes::flatten(&root);
    let mut model = Model {
        notes: opened.notes,
        ..Model::default()
    };
    model.notes.extend(nodes.notes.iter().cloned());
    note_what_is_left_out(&root, &mut model.notes);
    let mut loader = Loader {
        data: &data,
        nodes: &nodes,
        materials: material::load(&data, folder, &mut model.notes),
        geometry: HashMap::new(),
        skins: HashMap::new(),
        n_vertices: 0,
        origins: Vec::new(),
        first_problem: opened.first_problem,
        model,
    };
    for &node in &nodes.shown {
        loader.place(node)?;
    }
    loader.model.notes.extend(data.fallback_notes());
    let Loader {
        mut model,
        materials,
        first_problem,
        ..
    } = loader;
    if model.parts.is_empty() {
        // The first omission is the best explanation why nothing is left.
        return Err(first_problem.unwrap_or_else(|| nothing(name, &model.notes)));
    }
    model.materials = materials.into_iter().map(|m| m.material).collect();
    model.note_report();
    far::near_as_a_whole(&mut model);
    Ok(model)
}

/// The error for a file without any usable part, with the notes on what was left out.
fn nothing(name: &str, notes: &[String]) -> MeshError {
    const MOST: usize = 3;
    let mut problem = "expected triangles in its scene, got none".to_owned();
    let why: Vec<&str> = notes.iter().map(String::as_str).take(MOST).collect();
    if !why.is_empty() {
        problem.push_str(&format!(" ({})", why.join("; ")));
    }
    MeshError::new(name, problem)
}

fn note_what_is_left_out(root: &Root, notes: &mut Vec<String>) {
    let left_out = [
        (root.animations.len(), "animations"),
        (root.skins.len(), "skins (meshes keep their rest pose)"),
        (root.cameras.len(), "cameras"),
    ];
    for (n, what) in left_out.into_iter().filter(|(n, _)| *n > 0) {
        notes.push(format!("left out: {n} {what}"));
    }
    let unknown = extension::left_out(root);
    if !unknown.is_empty() {
        notes.push(format!("extensions left out: {}", unknown.join(", ")));
    }
}

struct Loader<'a> {
    data: &'a Data<'a>,
    nodes: &'a Nodes,
    materials: Vec<material::Loaded>,
    /// Meshes by their sources; `None` for meshes without a usable triangle.
    geometry: HashMap<Geometry, Option<usize>>,
    /// Joint matrices of each skin; `None` for skins that cannot be used.
    skins: HashMap<usize, Option<Vec<Option<DAffine3>>>>,
    n_vertices: usize,
    /// Origin of each of the model's meshes, in the file's coordinates of that mesh.
    origins: Vec<DVec3>,
    /// Why the first part was left out.
    first_problem: Option<MeshError>,
    model: Model,
}

/// The key of a mesh: primitives with the same key share it, even with different materials.
#[derive(PartialEq, Eq, Hash, Clone)]
struct Geometry {
    mode: u32,
    indices: Option<usize>,
    /// Accessors by attribute, sorted by name.
    attributes: Vec<(String, usize)>,
    draco: Option<usize>,
    skin: Option<usize>,
    /// Targets with non-zero weight: accessors by attribute, and the bits of the weight.
    morphs: Vec<(Vec<(String, usize)>, u64)>,
    /// Set of texture coordinates, and the bits of the transform baked into them.
    uvs: (u32, [u32; 5]),
}

impl Loader<'_> {
    /// Leaves a part out, with a note.
    fn skip(&mut self, error: MeshError) {
        let at = error.at.as_deref().unwrap_or("the file");
        self.model
            .notes
            .push(format!("{at} left out: {}", error.problem));
        self.first_problem.get_or_insert(error);
    }

    /// Places the meshes of a node. Errors are exceeded limits, which reject the file.
    fn place(&mut self, node: usize) -> Result<(), MeshError> {
        let root = self.data.root;
        let (Some(mesh_index), Some(model_from_node)) =
            (root.nodes[node].mesh, self.nodes.model_from_node[node])
        else {
            return Ok(());
        };
        let Some(mesh) = root.meshes.get(mesh_index) else {
            self.skip(MeshError::at(
                self.data.file,
                format!("nodes[{node}].mesh"),
                format!(
                    "expected less than the {} meshes, got {mesh_index}",
                    root.meshes.len()
                ),
            ));
            return Ok(());
        };
        let skin = root.nodes[node].skin.filter(|&skin| self.load_skin(skin));
        let weights = root.nodes[node].weights.as_ref().unwrap_or(&mesh.weights);
        let transforms = match (skin, &root.nodes[node].extensions.instancing) {
            // Vertices of a skinned mesh are placed by the joints alone.
            (Some(_), _) => vec![DAffine3::IDENTITY],
            (None, Some(instancing)) => {
                match instancing::read(self.data, &instancing.attributes, node) {
                    Ok(instances) => instances
                        .into_iter()
                        .map(|node_from_instance| model_from_node * node_from_instance)
                        .collect(),
                    Err(error) => {
                        self.skip(error);
                        return Ok(());
                    }
                }
            }
            (None, None) => vec![model_from_node],
        };
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            let at = format!("meshes[{mesh_index}].primitives[{p}]");
            let material = self.material(primitive, &at);
            if material.is_some_and(|index| self.materials[index].invisible) {
                continue;
            }
            let Some(mesh) = self.mesh(primitive, material, weights, skin, &at)? else {
                continue;
            };
            for &model_from_mesh in &transforms {
                if !model_from_mesh.is_finite() {
                    self.model
                        .notes
                        .push(format!("nodes[{node}]: an instance left out: it overflows"));
                    continue;
                }
                let moved = DAffine3::from_translation(self.origins[mesh]);
                let model_from_mesh = model_from_mesh * moved;
                let is_flat = is_flat(&model_from_mesh);
                let mesh = match is_flat {
                    false => Some(mesh),
                    true => self.flattened(mesh, &model_from_mesh, node)?,
                };
                let Some(mesh) = mesh else { continue };
                let model_from_mesh = match is_flat {
                    false => model_from_mesh,
                    true => DAffine3::from_translation(self.origins[mesh]),
                };
                if self.model.parts.len() >= MAX_PARTS {
                    return Err(MeshError::at(
                        self.data.file,
                        "nodes",
                        format!("expected at most {MAX_PARTS} placed meshes, got more"),
                    ));
                }
                self.model.parts.push(Part {
                    mesh,
                    material,
                    model_from_mesh,
                });
            }
        }
        Ok(())
    }

    /// The material of a primitive; a missing material is noted.
    fn material(&mut self, primitive: &Primitive, at: &str) -> Option<usize> {
        let n = self.data.root.materials.len();
        match primitive.material {
            Some(index) if index < n => return Some(index),
            Some(index) => self.model.notes.push(format!(
                "{at}.material left out: expected less than the {n} materials, got {index}"
            )),
            None => {}
        }
        // Vertex colours without a material multiply white.
        let is_colored = primitive.attributes.contains_key("COLOR_0");
        (is_colored && self.materials.len() > n).then_some(n)
    }

    /// Whether a skin can be used; stores its matrices.
    fn load_skin(&mut self, skin: usize) -> bool {
        if !self.skins.contains_key(&skin) {
            let model_from_node = &self.nodes.model_from_node;
            let notes = &mut self.model.notes;
            let matrices = match skin::joint_matrices(self.data, skin, model_from_node, notes) {
                Ok(matrices) => Some(matrices).filter(|m| m.iter().any(Option::is_some)),
                Err(error) => {
                    self.skip(error);
                    None
                }
            };
            if matrices.is_none() {
                self.model.notes.push(format!(
                    "skins[{skin}] has no joints: its meshes are placed by their nodes"
                ));
            }
            self.skins.insert(skin, matrices);
        }
        self.skins[&skin].is_some()
    }

    /// The mesh of a primitive, read only once. Errors are exceeded limits.
    fn mesh(
        &mut self,
        primitive: &Primitive,
        material: Option<usize>,
        weights: &[f64],
        skin: Option<usize>,
        at: &str,
    ) -> Result<Option<usize>, MeshError> {
        if primitive.mode() < 4 {
            let note = format!("{at} left out: points or lines");
            if !self.model.notes.contains(&note) {
                self.model.notes.push(note);
            }
            return Ok(None);
        }
        let mapping = material
            .map(|index| self.materials[index].mapping)
            .unwrap_or_default();
        let sorted = |attributes: &HashMap<String, usize>| {
            let mut list: Vec<_> = attributes.iter().map(|(k, v)| (k.clone(), *v)).collect();
            list.sort();
            list
        };
        let key = Geometry {
            mode: primitive.mode(),
            indices: primitive.indices,
            attributes: sorted(&primitive.attributes),
            draco: primitive.extensions.draco.as_ref().map(|d| d.buffer_view),
            skin,
            morphs: primitive
                .targets
                .iter()
                .zip(weights)
                .filter(|(_, weight)| **weight != 0.0)
                .map(|(target, weight)| (sorted(target), weight.to_bits()))
                .collect(),
            uvs: (mapping.set, mapping.bits()),
        };
        if let Some(&known) = self.geometry.get(&key) {
            return Ok(known);
        }
        let slot = self.read(primitive, mapping, weights, skin, at)?;
        self.geometry.insert(key, slot);
        Ok(slot)
    }

    fn read(
        &mut self,
        primitive: &Primitive,
        mapping: material::Mapping,
        weights: &[f64],
        skin: Option<usize>,
        at: &str,
    ) -> Result<Option<usize>, MeshError> {
        let context = self.data.context;
        let mut scratch = context.scratch("triangles, while they are read");
        scratch.hold_for(self.data.file, self.working_bytes(primitive))?;
        let joints = skin.and_then(|skin| self.skins[&skin].as_deref());
        let source = primitive::Source {
            data: self.data,
            primitive,
            mapping,
            weights,
            joints,
            at,
        };
        let read = source.read();
        match read {
            Ok(read) => {
                self.model.notes.extend(read.notes);
                self.store(read.mesh, read.origin, at, read.first_problem)
            }
            Err(error) => {
                self.skip(error);
                Ok(None)
            }
        }
    }

    /// Stores a mesh if any of it is visible.
    fn store(
        &mut self,
        mesh: Mesh,
        origin: DVec3,
        at: &str,
        first_problem: Option<(String, String)>,
    ) -> Result<Option<usize>, MeshError> {
        self.n_vertices += mesh.positions.len();
        let n_triangles = self.model.n_stored() + mesh.triangles.len();
        // A small file may refer to the same data many times, so the stored triangles are bounded.
        if n_triangles > MAX_TRIANGLES || self.n_vertices > 2 * MAX_TRIANGLES {
            return Err(MeshError::at(
                self.data.file,
                at,
                format!(
                    "expected at most {MAX_TRIANGLES} triangles and twice as many vertices in all, got more"
                ),
            ));
        }
        let label = format!("{}: {at}", self.data.file);
        let n_in = mesh.triangles.len();
        if n_in == 0
            && let Some((at, problem)) = first_problem
        {
            self.first_problem
                .get_or_insert(MeshError::at(&label, at, problem));
            return Ok(None);
        }
        let has_area = mesh.triangles.iter().any(|t| {
            let [a, b, c] = t.map(|i| mesh.positions.get(i as usize).copied().unwrap_or_default());
            (b - a).cross(c - a).try_normalize().is_some()
        });
        match sanitise(mesh, &label) {
            Ok((mesh, report)) => {
                self.model.report.add(&report);
                self.model.meshes.push(Arc::new(mesh));
                self.origins.push(origin);
                Ok(Some(self.model.meshes.len() - 1))
            }
            Err(error) if has_area => Err(error),
            Err(_) => {
                self.model.notes.push(match n_in {
                    0 => format!("{at} left out: it has no triangles"),
                    n => format!("{at} left out: none of its {n} triangles has area"),
                });
                Ok(None)
            }
        }
    }

    /// A mesh transformed to model space by a singular transform: a flat mesh, such as a shadow blob or a decal.
    fn flattened(
        &mut self,
        mesh: usize,
        model_from_mesh: &DAffine3,
        node: usize,
    ) -> Result<Option<usize>, MeshError> {
        let mut flat = Mesh::clone(&self.model.meshes[mesh]);
        let context = self.data.context;
        let mut scratch = context.scratch("triangles, while they are read");
        scratch.hold_for(self.data.file, 4 * flat.bytes() as usize)?;
        let move_one = |p: &Vec3| model_from_mesh.transform_point3(p.as_dvec3());
        let positions: Vec<DVec3> = flat.positions.iter().map(move_one).collect();
        let origin = far::moved_near(&mut flat, &positions);
        // Without vertex normals, the triangles' own normals are used.
        flat.normals = Vec::new();
        let at = format!("nodes[{node}]");
        let slot = self.store(flat, origin, &at, None)?;
        if slot.is_some() {
            self.model
                .notes
                .push(format!("{at}: its transform makes it flat"));
        }
        Ok(slot)
    }

    /// Memory to read and sanitise a primitive: vertices and indices as declared (but at most as many as its bytes
    /// can hold: a wrong count must be an error of the primitive, not of the budget), their attributes, and lists for
    /// sorting them.
    fn working_bytes(&self, primitive: &Primitive) -> usize {
        let accessors = &self.data.root.accessors;
        let count = |index: &usize| {
            let Some(accessor) = accessors.get(*index) else {
                return 0;
            };
            let most = match accessor.buffer_view {
                Some(view) => self.data.view(view, "").map_or(0, <[u8]>::len),
                None => 2 * MAX_TRIANGLES,
            };
            accessor.count.min(most)
        };
        let n_vertices = primitive.attributes.get("POSITION").map_or(0, count);
        let n_corners = primitive.indices.as_ref().map_or(n_vertices, count);
        let n_triangles = match primitive.mode() {
            4 => n_corners / 3,
            _ => n_corners,
        };
        let n_sets = primitive.attributes.len();
        n_vertices
            .saturating_mul(96 + 16 * n_sets)
            .saturating_add(n_corners.saturating_mul(4))
            .saturating_add(n_triangles.saturating_mul(48))
    }
}

/// Whether a transform reduces volumes to (almost) nothing, independent of its scale.
fn is_flat(transform: &DAffine3) -> bool {
    let m = transform.matrix3;
    let lengths = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::length);
    let longest = lengths.into_iter().fold(0.0, f64::max);
    let shortest = lengths.into_iter().fold(f64::INFINITY, f64::min);
    let volume: f64 = lengths.into_iter().product();
    // A scale of 0 on one axis, or a shear that collapses the volume.
    shortest <= FLAT * longest || m.determinant().abs() <= FLAT * volume
}

#[cfg(test)]
mod tests;
