//! glTF 2.0, as .gltf and .glb: node hierarchies flattened to placed meshes, with materials
//! and textures. Skins, animations and morph targets are left out with a note; what the
//! file's bytes claim is checked before it is used.

mod accessor;
mod container;
mod format;
mod material;

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DMat4, DQuat, DVec3, Vec2, Vec3};

use self::accessor::Data;
use self::format::{Node, Primitive, Root};
use super::error::MeshError;
use super::model::{MAX_TRIANGLES, Model, Part};
use super::sanitise::sanitise;
use super::{LoadContext, Mesh};

/// Most placed meshes of one file.
const MAX_PARTS: usize = 100_000;

/// As [`load_with`], without limits.
#[cfg(test)]
pub(super) fn load(bytes: &[u8], name: &str, folder: &Path) -> Result<Model, MeshError> {
    load_with(&LoadContext::default(), bytes, name, folder)
}

/// Reads a .gltf or .glb file from memory; other files it names must lie in `folder`.
pub(super) fn load_with(
    context: &LoadContext,
    bytes: &[u8],
    name: &str,
    folder: &Path,
) -> Result<Model, MeshError> {
    let (root, buffers) = container::open(context, bytes, name, folder)?;
    let data = Data {
        root: &root,
        buffers: &buffers,
        file: name,
    };
    let mut model = Model::default();
    note_what_is_left_out(&root, &mut model.notes);
    let mut loader = Loader {
        context,
        data: &data,
        materials: material::load(context, &data, folder, &mut model.notes)?,
        geometry: HashMap::new(),
        n_vertices: 0,
        model,
    };
    for (node, model_from_node) in flatten(&data)? {
        loader.place(node, model_from_node)?;
    }
    let mut model = loader.model;
    if model.parts.is_empty() {
        return Err(MeshError::new(
            name,
            "expected triangles in its scene, got none",
        ));
    }
    model.materials = loader.materials.into_iter().map(|m| m.material).collect();
    model.note_report();
    Ok(model)
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
    let unknown: Vec<&str> = root
        .extensions_used
        .iter()
        .map(String::as_str)
        .filter(|name| !container::UNDERSTOOD.contains(name))
        .collect();
    if !unknown.is_empty() {
        notes.push(format!("extensions left out: {}", unknown.join(", ")));
    }
}

/// The nodes of the file's scene and where each lies.
fn flatten<'a>(data: &Data<'a>) -> Result<Vec<(usize, DAffine3)>, MeshError> {
    let root = data.root;
    let fail = |at: String, problem: String| MeshError::at(data.file, at, problem);
    let starts: Vec<usize> = match (root.scene, root.scenes.as_slice()) {
        (Some(index), scenes) => scenes
            .get(index)
            .ok_or_else(|| {
                fail(
                    "scene".into(),
                    format!(
                        "expected less than the {} scenes, got {index}",
                        scenes.len()
                    ),
                )
            })?
            .nodes
            .clone(),
        (None, [first, ..]) => first.nodes.clone(),
        // Without scenes, every node that is nobody's child.
        (None, []) => {
            let children: HashSet<usize> = root
                .nodes
                .iter()
                .flat_map(|n| n.children.iter().copied())
                .collect();
            (0..root.nodes.len())
                .filter(|i| !children.contains(i))
                .collect()
        }
    };
    let mut visited = vec![false; root.nodes.len()];
    let mut out = Vec::new();
    // In document order: children are pushed last to first.
    let mut stack: Vec<(usize, DAffine3)> = starts
        .into_iter()
        .rev()
        .map(|i| (i, DAffine3::IDENTITY))
        .collect();
    while let Some((index, model_from_parent)) = stack.pop() {
        let node = root.nodes.get(index).ok_or_else(|| {
            fail(
                "nodes".into(),
                format!(
                    "expected less than the {} nodes, got index {index}",
                    root.nodes.len()
                ),
            )
        })?;
        // A node has one parent (glTF 2.0, 3.5.3): this ends cycles and exponential trees.
        if std::mem::replace(&mut visited[index], true) {
            return Err(fail(
                format!("nodes[{index}]"),
                "expected one parent, got more or a cycle".into(),
            ));
        }
        let local =
            local_transform(node).map_err(|problem| fail(format!("nodes[{index}]"), problem))?;
        let model_from_node = model_from_parent * local;
        if !model_from_node.is_finite() {
            return Err(fail(
                format!("nodes[{index}]"),
                "transform overflows".into(),
            ));
        }
        out.push((index, model_from_node));
        stack.extend(node.children.iter().rev().map(|&i| (i, model_from_node)));
    }
    Ok(out)
}

fn local_transform(node: &Node) -> Result<DAffine3, String> {
    let transform = match node.matrix {
        Some(columns) => {
            let m = DMat4::from_cols_array(&columns);
            if m.row(3).to_array() != [0.0, 0.0, 0.0, 1.0] {
                return Err("matrix: expected an affine transform, got a projection".into());
            }
            DAffine3::from_mat4(m)
        }
        None => {
            let rotation = DQuat::from_array(node.rotation);
            let length = rotation.length();
            // Exporters round to a few digits (heuristic). NaN lies in no interval.
            if !(0.95..=1.05).contains(&length) {
                return Err(format!(
                    "rotation: expected a unit quaternion, got length {length}"
                ));
            }
            DAffine3::from_scale_rotation_translation(
                DVec3::from_array(node.scale),
                rotation.normalize(),
                DVec3::from_array(node.translation),
            )
        }
    };
    if transform.is_finite() {
        Ok(transform)
    } else {
        Err("transform: expected finite numbers".into())
    }
}

struct Loader<'a> {
    context: &'a LoadContext,
    data: &'a Data<'a>,
    materials: Vec<material::Loaded>,
    /// Meshes by what they are made of; `None` for those without a triangle left.
    geometry: HashMap<Geometry, Option<usize>>,
    n_vertices: usize,
    model: Model,
}

/// What makes two primitives the same mesh, whatever their materials.
#[derive(PartialEq, Eq, Hash, Clone, Copy)]
struct Geometry {
    mode: u32,
    positions: usize,
    normals: Option<usize>,
    uvs: Option<usize>,
    indices: Option<usize>,
    /// Bits of the texture transform baked into the coordinates.
    uv_transform: [u32; 5],
}

impl Loader<'_> {
    fn place(&mut self, node: usize, model_from_node: DAffine3) -> Result<(), MeshError> {
        let root = self.data.root;
        let Some(mesh_index) = root.nodes[node].mesh else {
            return Ok(());
        };
        let mesh = root.meshes.get(mesh_index).ok_or_else(|| {
            MeshError::at(
                self.data.file,
                format!("nodes[{node}].mesh"),
                format!(
                    "expected less than the {} meshes, got {mesh_index}",
                    root.meshes.len()
                ),
            )
        })?;
        if model_from_node.matrix3.determinant() == 0.0 {
            self.model.notes.push(format!(
                "nodes[{node}] left out: its transform flattens it to nothing"
            ));
            return Ok(());
        }
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            let at = format!("meshes[{mesh_index}].primitives[{p}]");
            let material = match primitive.material {
                None => None,
                Some(index) => Some(index)
                    .filter(|&i| i < self.materials.len())
                    .map_or_else(
                        || {
                            Err(MeshError::at(
                                self.data.file,
                                format!("{at}.material"),
                                format!(
                                    "expected less than the {} materials, got {index}",
                                    self.materials.len()
                                ),
                            ))
                        },
                        |index| Ok(Some(index)),
                    )?,
            };
            if material.is_some_and(|index| self.materials[index].invisible) {
                continue;
            }
            let Some(mesh) = self.mesh(primitive, material, &at)? else {
                continue;
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
                model_from_mesh: model_from_node,
            });
        }
        Ok(())
    }

    /// The mesh of a primitive, read once however often it is used.
    fn mesh(
        &mut self,
        primitive: &Primitive,
        material: Option<usize>,
        at: &str,
    ) -> Result<Option<usize>, MeshError> {
        let fail = |problem: String| MeshError::at(self.data.file, at, problem);
        if primitive.mode < 4 {
            self.model
                .notes
                .push(format!("{at} left out: points or lines"));
            return Ok(None);
        }
        if primitive.mode > 6 {
            return Err(fail(format!(
                "mode: expected 0 to 6, got {}",
                primitive.mode
            )));
        }
        let attributes = &primitive.attributes;
        let positions = *attributes
            .get("POSITION")
            .ok_or_else(|| fail("attributes: expected POSITION, got none".into()))?;
        let mapping = material
            .map(|index| self.materials[index].mapping)
            .unwrap_or_default();
        let uvs = attributes
            .get(format!("TEXCOORD_{}", mapping.set).as_str())
            .copied();
        let key = Geometry {
            mode: primitive.mode,
            positions,
            normals: attributes.get("NORMAL").copied(),
            uvs,
            indices: primitive.indices,
            uv_transform: mapping.bits(),
        };
        if let Some(&known) = self.geometry.get(&key) {
            return Ok(known);
        }
        let mut scratch = self.context.scratch("triangles, while they are read");
        scratch.hold_for(self.data.file, self.working_bytes(&key))?;
        let mesh = self.read(&key, &mapping, at)?;
        self.n_vertices += mesh.positions.len();
        let n_triangles = self.model.n_stored() + mesh.triangles.len();
        // Small files can name the same data again and again: what is stored stays bounded.
        if n_triangles > MAX_TRIANGLES || self.n_vertices > 2 * MAX_TRIANGLES {
            return Err(fail(format!(
                "expected at most {MAX_TRIANGLES} triangles and twice as many vertices in all, got more"
            )));
        }
        let label = format!("{}: {at}", self.data.file);
        let n_in = mesh.triangles.len();
        let has_area = mesh.triangles.iter().any(|t| {
            let [a, b, c] = t.map(|i| mesh.positions.get(i as usize).copied().unwrap_or_default());
            (b - a).cross(c - a).try_normalize().is_some()
        });
        let slot = match sanitise(mesh, &label) {
            Ok((mesh, report)) => {
                self.model.report.add(&report);
                self.model.meshes.push(Arc::new(mesh));
                Some(self.model.meshes.len() - 1)
            }
            Err(error) if has_area => return Err(error),
            Err(error) if error.at.is_some() => return Err(error),
            Err(_) => {
                self.model.notes.push(format!(
                    "{at} left out: none of its {n_in} triangles has area"
                ));
                None
            }
        };
        self.geometry.insert(key, slot);
        Ok(slot)
    }

    /// What reading a primitive takes, with sanitising: vertices and indices as the file counts
    /// them, their attributes, and lists to sort them by.
    fn working_bytes(&self, key: &Geometry) -> usize {
        let accessors = &self.data.root.accessors;
        let count = |index: usize| accessors.get(index).map_or(0, |a| a.count);
        let n_vertices = count(key.positions);
        let n_corners = key.indices.map_or(n_vertices, count);
        let n_triangles = if key.mode == 4 {
            n_corners / 3
        } else {
            n_corners
        };
        n_vertices
            .saturating_mul(96)
            .saturating_add(n_corners.saturating_mul(4))
            .saturating_add(n_triangles.saturating_mul(48))
    }

    fn read(
        &self,
        key: &Geometry,
        mapping: &material::Mapping,
        at: &str,
    ) -> Result<Mesh, MeshError> {
        let data = self.data;
        let positions: Vec<Vec3> = data
            .vectors::<3>(key.positions, &format!("{at}.attributes.POSITION"))?
            .into_iter()
            .map(Vec3::from)
            .collect();
        let check = |what: &str, n: usize| {
            if n == positions.len() {
                return Ok(());
            }
            Err(MeshError::at(
                data.file,
                format!("{at}.attributes.{what}"),
                format!("expected one per position ({}), got {n}", positions.len()),
            ))
        };
        let mut normals = Vec::new();
        if let Some(index) = key.normals {
            normals = data
                .vectors::<3>(index, &format!("{at}.attributes.NORMAL"))?
                .into_iter()
                .map(Vec3::from)
                .collect();
            check("NORMAL", normals.len())?;
        }
        let mut uvs = Vec::new();
        if let Some(index) = key.uvs {
            uvs = data
                .vectors::<2>(index, &format!("{at}.attributes.TEXCOORD"))?
                .into_iter()
                .map(|uv| mapping.apply(Vec2::from(uv)))
                .collect();
            check("TEXCOORD", uvs.len())?;
        }
        let indices: Vec<u32> = match key.indices {
            Some(index) => data.indices(index, &format!("{at}.indices"))?,
            None => (0..positions.len() as u32).collect(),
        };
        let triangles = match key.mode {
            4 => indices
                .chunks_exact(3)
                .map(|t| [t[0], t[1], t[2]])
                .collect(),
            // Every other triangle of a strip runs backwards.
            5 => indices
                .windows(3)
                .enumerate()
                .map(|(i, t)| {
                    if i % 2 == 0 {
                        [t[0], t[1], t[2]]
                    } else {
                        [t[1], t[0], t[2]]
                    }
                })
                .collect(),
            _ => match indices.as_slice() {
                [first, others @ ..] => others
                    .windows(2)
                    .map(|pair| [*first, pair[0], pair[1]])
                    .collect(),
                [] => Vec::new(),
            },
        };
        Ok(Mesh {
            positions,
            normals,
            uvs,
            colors: Vec::new(),
            triangles,
        })
    }
}

#[cfg(test)]
mod tests;
