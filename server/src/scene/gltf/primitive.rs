//! The geometry of one primitive: attributes from accessors or from Draco, morph targets and skins in the rest pose,
//! and triangles except those that cannot be drawn.

use glam::{DAffine3, DVec3, Vec2, Vec3, Vec4};

use super::super::error::MeshError;
use super::super::sanitise::coordinate_problem;
use super::super::{Mesh, draco};
use super::accessor::Data;
use super::far;
use super::format::Primitive;
use super::material::Mapping;
use super::skin::{self, Influences};

/// A primitive and all inputs that determine its vertices.
pub(super) struct Source<'a> {
    pub(super) data: &'a Data<'a>,
    pub(super) primitive: &'a Primitive,
    pub(super) mapping: Mapping,
    /// Weights of its morph targets; missing ones are 0.
    pub(super) weights: &'a [f64],
    /// Per joint: model space from bind pose. `None` without a skin.
    pub(super) joints: Option<&'a [Option<DAffine3>]>,
    /// Position in the file, for messages.
    pub(super) at: &'a str,
}

/// The readable part of a primitive's mesh.
pub(super) struct Read {
    pub(super) mesh: Mesh,
    /// Origin of the mesh, in the file's coordinates.
    pub(super) origin: DVec3,
    /// Notes on unusual content.
    pub(super) notes: Vec<String>,
    /// Position and problem of the first triangle that was left out.
    pub(super) first_problem: Option<(String, String)>,
}

impl Source<'_> {
    /// Reads the mesh; an error is about the primitive as a whole.
    pub(super) fn read(&self) -> Result<Read, MeshError> {
        if self.primitive.mode() > 6 {
            return Err(MeshError::at(
                self.data.file,
                self.at,
                format!("mode: expected 0 to 6, got {}", self.primitive.mode()),
            ));
        }
        let mut notes = Vec::new();
        let draco = self.draco(&mut notes)?;
        let draco = draco.as_ref();
        let fail = |problem: &str| MeshError::at(self.data.file, self.at, problem);
        let positions = self
            .vectors::<3>("POSITION", draco)?
            .ok_or_else(|| fail("attributes: expected POSITION, got none"))?;
        let n = positions.len();
        let mut optional = |name: &str, values: Result<Option<Vec<[f32; 4]>>, MeshError>| {
            let problem = match values {
                Ok(Some(values)) if values.len() == n => return values,
                Ok(None) => return Vec::new(),
                Ok(Some(values)) => {
                    format!("expected one per position ({n}), got {}", values.len())
                }
                Err(error) => error.problem,
            };
            notes.push(format!("{}.attributes.{name} left out: {problem}", self.at));
            Vec::new()
        };
        let normals = optional("NORMAL", self.vectors::<3>("NORMAL", draco).map(padded));
        let name = format!("TEXCOORD_{}", self.mapping.set);
        let uvs = optional(&name, self.vectors::<2>(&name, draco).map(padded));
        let colors = optional("COLOR_0", self.colors(draco));
        let mut influences = Influences::default();
        for set in 0..if self.joints.is_some() {
            skin::MAX_SETS
        } else {
            0
        } {
            let name = format!("JOINTS_{set}");
            let joints = optional(&name, self.vectors::<4>(&name, draco));
            let name = format!("WEIGHTS_{set}");
            let weights = optional(&name, self.vectors::<4>(&name, draco));
            if joints.is_empty() || weights.is_empty() {
                break;
            }
            influences.joints.push(joints);
            influences.weights.push(weights);
        }
        let mut mesh = Mesh {
            positions: positions.into_iter().map(Vec3::from).collect(),
            normals: normals
                .into_iter()
                .map(|[x, y, z, _]| Vec3::new(x, y, z))
                .collect(),
            uvs: uvs
                .into_iter()
                .map(|[u, v, ..]| self.mapping.apply(Vec2::new(u, v)))
                .collect(),
            colors: colors.into_iter().map(Vec4::from).collect(),
            triangles: match draco {
                Some(draco) => draco.triangles(),
                None => self.triangles(n, &mut notes)?,
            },
        };
        self.morph(&mut mesh, &mut notes);
        if let Some(joints) = self.joints {
            if influences.joints.is_empty() {
                notes.push(format!(
                    "{}: its skin is not applied: JOINTS_0 or WEIGHTS_0 is missing",
                    self.at
                ));
            }
            let odd = skin::apply(&mut mesh, &influences, joints);
            if odd.n_unweighted > 0 {
                notes.push(format!(
                    "{}: {} vertices without a weight are placed by the first joint",
                    self.at, odd.n_unweighted
                ));
            }
            if odd.n_without_joint > 0 {
                notes.push(format!(
                    "{}: {} weights left out: their joints do not exist",
                    self.at, odd.n_without_joint
                ));
            }
        }
        let origin = far::near(&mut mesh);
        let first_problem = drop_unusable(&mut mesh, self.at, &mut notes);
        Ok(Read {
            mesh,
            origin,
            notes,
            first_problem,
        })
    }

    /// The primitive's Draco data. Files may contain an uncompressed copy for other readers.
    fn draco(&self, notes: &mut Vec<String>) -> Result<Option<draco::Decoded>, MeshError> {
        let Some(extension) = &self.primitive.extensions.draco else {
            return Ok(None);
        };
        let at = format!("{}.KHR_draco_mesh_compression", self.at);
        let decoded = self
            .data
            .view(extension.buffer_view, &at)
            .and_then(|bytes| {
                draco::decode(self.data.context, bytes)
                    .map_err(|problem| MeshError::at(self.data.file, &at, problem))
            });
        let accessor = self.primitive.attributes.get("POSITION");
        let has_fallback = accessor
            .and_then(|&index| self.data.root.accessors.get(index))
            .is_some_and(|accessor| accessor.buffer_view.is_some());
        match decoded {
            Ok(decoded) => Ok(Some(decoded)),
            Err(error) if has_fallback => {
                notes.push(format!(
                    "{at}: {}: its uncompressed data are used",
                    error.problem
                ));
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// An attribute of `N`-vectors, if present.
    fn vectors<const N: usize>(
        &self,
        name: &str,
        draco: Option<&draco::Decoded>,
    ) -> Result<Option<Vec<[f32; N]>>, MeshError> {
        let index = self.primitive.attributes.get(name).copied();
        let extension = self.primitive.extensions.draco.as_ref();
        let id = extension.and_then(|extension| extension.attributes.get(name));
        if let (Some(draco), Some(&id)) = (draco, id) {
            let accessor = index.and_then(|index| self.data.root.accessors.get(index));
            let is_normalized = accessor.is_some_and(|accessor| accessor.normalized);
            return match draco.attribute::<N>(id, is_normalized) {
                Some(values) => Ok(Some(values)),
                None => Err(MeshError::at(
                    self.data.file,
                    format!("{}.attributes.{name}", self.at),
                    format!("Draco: attribute {id} is not in its data"),
                )),
            };
        }
        index
            .map(|index| {
                self.data
                    .vectors::<N>(index, &format!("{}.attributes.{name}", self.at))
            })
            .transpose()
    }

    fn colors(&self, draco: Option<&draco::Decoded>) -> Result<Option<Vec<[f32; 4]>>, MeshError> {
        let extension = self.primitive.extensions.draco.as_ref();
        let id = extension.and_then(|extension| extension.attributes.get("COLOR_0"));
        if let (Some(draco), Some(&id)) = (draco, id) {
            let has_alpha = draco.width(id) == Some(4);
            let colors = draco.attribute::<4>(id, true);
            return Ok(colors.map(|mut colors| {
                if !has_alpha {
                    colors.iter_mut().for_each(|color| color[3] = 1.0);
                }
                colors
            }));
        }
        let index = self.primitive.attributes.get("COLOR_0");
        index
            .map(|&index| {
                self.data
                    .colors(index, &format!("{}.attributes.COLOR_0", self.at))
            })
            .transpose()
    }

    fn triangles(
        &self,
        n_positions: usize,
        notes: &mut Vec<String>,
    ) -> Result<Vec<[u32; 3]>, MeshError> {
        let (indices, restart) = match self.primitive.indices {
            Some(index) => (
                self.data.indices(index, &format!("{}.indices", self.at))?,
                Some(self.data.restart_index(index)),
            ),
            None => ((0..n_positions as u32).collect(), None),
        };
        let strips = indices.split(|&i| Some(i) == restart);
        Ok(match self.primitive.mode() {
            4 => {
                let rest = indices.len() % 3;
                if rest > 0 {
                    notes.push(format!(
                        "{}: the last {rest} of its {} indices make no triangle",
                        self.at,
                        indices.len()
                    ));
                }
                indices.as_chunks::<3>().0.to_vec()
            }
            5 => strips.flat_map(strip).collect(),
            _ => strips.flat_map(fan).collect(),
        })
    }

    /// Adds the morph targets with their default weights.
    fn morph(&self, mesh: &mut Mesh, notes: &mut Vec<String>) {
        for (t, target) in self.primitive.targets.iter().enumerate() {
            let weight = self.weights.get(t).copied().unwrap_or(0.0) as f32;
            if weight == 0.0 || !weight.is_finite() {
                continue;
            }
            for (name, values) in [
                ("POSITION", &mut mesh.positions),
                ("NORMAL", &mut mesh.normals),
            ] {
                let Some(&index) = target.get(name).filter(|_| !values.is_empty()) else {
                    continue;
                };
                let at = format!("{}.targets[{t}].{name}", self.at);
                let problem = match self.data.vectors::<3>(index, &at) {
                    Ok(offsets) if offsets.len() == values.len() => {
                        for (value, offset) in values.iter_mut().zip(offsets) {
                            *value += weight * Vec3::from(offset);
                        }
                        continue;
                    }
                    Ok(offsets) => format!(
                        "expected one per position ({}), got {}",
                        values.len(),
                        offsets.len()
                    ),
                    Err(error) => error.problem,
                };
                notes.push(format!("{at} left out: {problem}"));
            }
        }
    }
}

fn padded<const N: usize>(values: Option<Vec<[f32; N]>>) -> Option<Vec<[f32; 4]>> {
    let pad = |value: [f32; N]| std::array::from_fn(|k| value.get(k).copied().unwrap_or(0.0));
    values.map(|values| values.into_iter().map(pad).collect())
}

/// Every other triangle of a strip has the opposite orientation.
fn strip(indices: &[u32]) -> Vec<[u32; 3]> {
    let turn = |(i, t): (usize, &[u32])| match i % 2 {
        0 => [t[0], t[1], t[2]],
        _ => [t[1], t[0], t[2]],
    };
    indices.windows(3).enumerate().map(turn).collect()
}

fn fan(indices: &[u32]) -> Vec<[u32; 3]> {
    match indices {
        [first, others @ ..] => others
            .windows(2)
            .map(|pair| [*first, pair[0], pair[1]])
            .collect(),
        [] => Vec::new(),
    }
}

/// Removes triangles with missing or infinite corners, and resets unused infinite vertices. Returns the first removed
/// triangle and its problem.
fn drop_unusable(mesh: &mut Mesh, at: &str, notes: &mut Vec<String>) -> Option<(String, String)> {
    let n = mesh.positions.len();
    let bad: Vec<bool> = mesh
        .positions
        .iter()
        .map(|&p| coordinate_problem(p).is_some())
        .collect();
    let (mut n_outside, mut n_nowhere) = (0usize, 0usize);
    let mut first = None;
    let mut t = 0;
    let positions = &mesh.positions;
    mesh.triangles.retain(|triangle| {
        t += 1;
        if let Some(&index) = triangle.iter().find(|&&i| i as usize >= n) {
            n_outside += 1;
            first.get_or_insert_with(|| {
                (
                    format!("triangle {}", t - 1),
                    format!("vertex index {index}: expected less than the {n} vertices"),
                )
            });
            return false;
        }
        if let Some(&index) = triangle.iter().find(|&&i| bad[i as usize]) {
            n_nowhere += 1;
            first.get_or_insert_with(|| {
                let problem = coordinate_problem(positions[index as usize]);
                (format!("vertex {index}"), problem.unwrap_or_default())
            });
            return false;
        }
        true
    });
    for (n, why) in [
        (n_outside, "their vertices are not there"),
        (
            n_nowhere,
            "their vertices are not finite or over 1e6 in size",
        ),
    ] {
        if n > 0 {
            notes.push(format!("{at}: {n} triangles left out: {why}"));
        }
    }
    for (position, _) in mesh.positions.iter_mut().zip(&bad).filter(|(_, bad)| **bad) {
        *position = Vec3::ZERO;
    }
    first
}
