//! Builds a mesh from the polygons of OBJ and PLY files: invalid polygons are left out and counted, the others are
//! triangulated, and a mesh far from the origin is moved near it.

mod cut;
pub(super) mod origin;

use std::collections::HashMap;

use glam::{DVec3, Vec2, Vec3, Vec4};

use self::cut::Cutter;
use super::error::MeshError;
use super::load::Scratch;
use super::odd::Odd;
use super::sanitise::{SanitiseReport, coordinate_problem, sanitise_keeping};
use super::{Mesh, normals};

/// Marks a corner without texture coordinate or normal.
pub(super) const NONE: u32 = u32::MAX;

/// Marks a corner with an invalid vertex index.
pub(super) const BAD: u32 = u32::MAX - 1;

/// Memory per triangle while a mesh is built, bytes: three corners in a hash table, the indices, and their source,
/// for sorting.
const BYTES_PER_TRIANGLE: usize = 300;

/// Memory per position, bytes: in f64, and once more in the mesh.
const BYTES_PER_VERTEX: usize = 48;

/// Lists of attributes, and polygons whose corners refer to them.
#[derive(Debug, Default)]
pub(super) struct Polygons {
    /// In f64, because surveyed coordinates may be far from their origin.
    pub(super) positions: Vec<DVec3>,
    pub(super) uvs: Vec<Vec2>,
    pub(super) normals: Vec<Vec3>,
    /// Linear; one per position, or empty.
    pub(super) colors: Vec<Vec4>,
    /// Linear; one per face, or empty. Used if there are no vertex colours.
    pub(super) face_colors: Vec<Vec4>,
    /// Position, texture coordinate and normal index of each corner of all faces.
    corners: Vec<[u32; 3]>,
    /// End of each face's corners.
    ends: Vec<u32>,
}

/// The mesh built from them.
#[derive(Debug)]
pub(super) struct Built {
    /// Sanitised, with normals.
    pub(super) mesh: Mesh,
    /// The source face of each triangle, ascending.
    pub(super) faces: Vec<u32>,
    pub(super) report: SanitiseReport,
}

impl Polygons {
    pub(super) fn n_faces(&self) -> usize {
        self.ends.len()
    }

    /// Number of triangles of all faces.
    pub(super) fn n_triangles(&self) -> usize {
        self.corners.len() - 2 * self.ends.len()
    }

    /// Adds a face of at least three corners.
    pub(super) fn push(&mut self, corners: &[[u32; 3]]) {
        debug_assert!(corners.len() >= 3);
        self.corners.extend_from_slice(corners);
        self.ends.push(self.corners.len() as u32);
    }

    fn corners_of(&self, face: u32) -> std::ops::Range<usize> {
        let face = face as usize;
        let start = face.checked_sub(1).map_or(0, |before| self.ends[before]);
        start as usize..self.ends[face] as usize
    }

    /// Approximate memory of the lists, bytes.
    pub(super) fn bytes(&self) -> usize {
        size_of::<DVec3>() * self.positions.len()
            + size_of::<Vec2>() * self.uvs.len()
            + size_of::<Vec3>() * self.normals.len()
            + size_of::<Vec4>() * (self.colors.len() + self.face_colors.len())
            + size_of::<[u32; 3]>() * self.corners.len()
            + size_of::<u32>() * self.ends.len()
    }

    /// Triangulates, welds and sanitises; adds notes on unusual content to `notes`.
    pub(super) fn build(
        mut self,
        name: &str,
        notes: &mut Vec<String>,
        scratch: &mut Scratch<'_>,
    ) -> Result<Built, MeshError> {
        let more =
            BYTES_PER_TRIANGLE * self.n_triangles() + BYTES_PER_VERTEX * self.positions.len();
        scratch.hold_for(name, self.bytes() + more)?;
        let mut odd = Odd::default();
        let mut faces = self.usable_faces(&mut odd);
        let near = self.near(&mut faces, &mut odd, notes);
        notes.extend(odd.into_notes());
        let (triangles, sources) = self.cut(&faces, notes);
        let (mesh, had_normals) = self.weld(near, &triangles);
        drop(triangles);
        let no_triangles = mesh.triangles.is_empty();
        let (mut mesh, report, kept) = sanitise_keeping(mesh, name).map_err(|mut error| {
            // If nothing is left, the first note on omitted faces is the error.
            if let (true, Some(note)) = (no_triangles, notes.first()) {
                error.problem = format!("{}: {note}", error.problem);
            }
            error
        })?;
        if !had_normals {
            mesh = normals::smooth(mesh);
        }
        Ok(Built {
            faces: kept.iter().map(|&i| sources[i as usize]).collect(),
            mesh,
            report,
        })
    }

    /// The faces whose corners are valid vertices. Invalid texture coordinates and normals are removed from their
    /// corners.
    fn usable_faces(&mut self, odd: &mut Odd) -> Vec<u32> {
        let n = self.positions.len();
        let n_uvs = self.uvs.len() as u32;
        let n_normals = self.normals.len() as u32;
        // A corner without a valid normal gets one later; other corners keep theirs.
        let mut no_normal = NONE;
        let mut faces = Vec::with_capacity(self.n_faces());
        for face in 0..self.n_faces() as u32 {
            let range = self.corners_of(face);
            let mut usable = true;
            for [p, t, normal] in &mut self.corners[range] {
                match self.positions.get(*p as usize) {
                    None => {
                        usable = false;
                        let got = match *p {
                            BAD => "another one".to_owned(),
                            p => (u64::from(p) + 1).to_string(),
                        };
                        odd.add("faces left out: corners that are no vertices", || {
                            format!("face {}: expected a vertex of {n}, got {got}", face + 1)
                        });
                    }
                    Some(at) if !at.is_finite() => {
                        usable = false;
                        odd.add("faces left out: corners that are nowhere", || {
                            let [x, y, z] = at.to_array();
                            format!("face {}: vertex {} at ({x}, {y}, {z})", face + 1, *p + 1)
                        });
                    }
                    Some(_) => {}
                }
                if *t != NONE && *t >= n_uvs {
                    odd.add("texture coordinates left out that are not there", || {
                        format!("face {}: expected one of {n_uvs}", face + 1)
                    });
                    *t = NONE;
                }
                if *normal != NONE && *normal >= n_normals {
                    odd.add("normals left out that are not there", || {
                        format!("face {}: expected one of {n_normals}", face + 1)
                    });
                    if no_normal == NONE && n_normals > 0 {
                        no_normal = n_normals;
                        self.normals.push(Vec3::ZERO);
                    }
                    *normal = no_normal;
                }
                if !usable {
                    break;
                }
            }
            if usable {
                faces.push(face);
            }
        }
        faces
    }

    /// The positions, moved near the origin if necessary; faces that are still too far away are removed.
    fn near(&self, faces: &mut Vec<u32>, odd: &mut Odd, notes: &mut Vec<String>) -> Vec<Vec3> {
        let used = faces
            .iter()
            .flat_map(|&face| &self.corners[self.corners_of(face)])
            .map(|corner| self.positions[corner[0] as usize]);
        let offset = origin::offset(used);
        if offset != DVec3::ZERO {
            notes.push(origin::note(offset));
        }
        let near = |p: &DVec3| (*p - offset).as_vec3();
        let problem = |face: u32| {
            self.corners[self.corners_of(face)]
                .iter()
                .find_map(|corner| coordinate_problem(near(&self.positions[corner[0] as usize])))
        };
        faces.retain(|&face| match problem(face) {
            None => true,
            Some(problem) => {
                odd.add("faces left out: corners that are too far away", || {
                    format!("face {}: {problem}", face + 1)
                });
                false
            }
        });
        // Unused vertices are replaced, so that they are not checked.
        let spare = faces.first().map_or(Vec3::ZERO, |&face| {
            let corner = self.corners[self.corners_of(face).start];
            near(&self.positions[corner[0] as usize])
        });
        self.positions
            .iter()
            .map(near)
            .map(|p| coordinate_problem(p).map_or(p, |_| spare))
            .collect()
    }

    /// Triangles as positions in the list of corners, and the face of each.
    fn cut(&self, faces: &[u32], notes: &mut Vec<String>) -> (Vec<[u32; 3]>, Vec<u32>) {
        let mut cutter = Cutter::default();
        let mut triangles = Vec::with_capacity(self.n_triangles());
        let mut sources = Vec::with_capacity(self.n_triangles());
        let mut points = Vec::new();
        for &face in faces {
            let range = self.corners_of(face);
            let first = range.start as u32;
            points.clear();
            points.extend(
                self.corners[range]
                    .iter()
                    .map(|corner| self.positions[corner[0] as usize]),
            );
            for triangle in cutter.cut(&points) {
                triangles.push(triangle.map(|i| first + i));
                sources.push(face);
            }
        }
        if cutter.n_fans > 0 {
            notes.push(format!(
                "{} polygons with very many corners are triangulated as if they were convex",
                cutter.n_fans
            ));
        }
        (triangles, sources)
    }

    /// Builds one vertex per distinct corner; also returns whether every corner has a normal.
    fn weld(&self, positions: Vec<Vec3>, triangles: &[[u32; 3]]) -> (Mesh, bool) {
        let corner = |i: u32| self.corners[i as usize];
        let corners = || triangles.iter().flatten().map(|&i| corner(i));
        let use_normals = !self.normals.is_empty() && corners().all(|c| c[2] != NONE);
        let has_uvs = corners().any(|c| c[1] != NONE);
        let n = positions.len();
        // Whether an attribute uses the same indices as the positions.
        let beside = |used: bool, len: usize, k: usize| {
            !used || (len == n && corners().all(|c| c[k] == c[0]))
        };
        let by_face = self.colors.is_empty() && !self.face_colors.is_empty();
        if !by_face
            && beside(has_uvs, self.uvs.len(), 1)
            && beside(use_normals, self.normals.len(), 2)
        {
            let mesh = Mesh {
                positions,
                normals: if use_normals {
                    self.normals.clone()
                } else {
                    Vec::new()
                },
                uvs: if has_uvs {
                    self.uvs.clone()
                } else {
                    Vec::new()
                },
                colors: self.colors.clone(),
                triangles: triangles.iter().map(|t| t.map(|i| corner(i)[0])).collect(),
            };
            return (mesh, use_normals);
        }
        let mut mesh = Mesh::default();
        let mut vertices = HashMap::with_capacity(n);
        mesh.triangles.reserve(triangles.len());
        // Triangles are in the order of their faces.
        let mut face = 0;
        for triangle in triangles {
            while self.ends[face] <= triangle[0] {
                face += 1;
            }
            let face_color = by_face.then(|| self.face_colors[face]);
            let welded = triangle.map(|i| {
                let [p, t, normal] = corner(i);
                let normal = if use_normals { normal } else { NONE };
                let color = face_color.map(|color| color.to_array().map(f32::to_bits));
                *vertices.entry((p, t, normal, color)).or_insert_with(|| {
                    let p = p as usize;
                    mesh.positions.push(positions[p]);
                    if has_uvs {
                        let uv = self.uvs.get(t as usize);
                        mesh.uvs.push(uv.copied().unwrap_or_default());
                    }
                    if use_normals {
                        mesh.normals.push(self.normals[normal as usize]);
                    }
                    mesh.colors
                        .extend(face_color.or(self.colors.get(p).copied()));
                    (mesh.positions.len() - 1) as u32
                })
            });
            mesh.triangles.push(welded);
        }
        (mesh, use_normals)
    }
}

#[cfg(test)]
mod tests;
