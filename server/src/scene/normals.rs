//! Computes vertex normals for meshes that have none.
//!
//! Corners at one position share a normal if their triangles are connected across edges whose two sides differ by
//! less than the crease angle. The normal is the mean of the triangles' normals weighted by the angle at the corner
//! (Thürmer and Wüthrich 1998, "Computing Vertex Normals from Polygonal Facets"), which does not depend on the
//! triangulation of a flat face.

use std::collections::HashMap;

use glam::{DVec3, Vec3};
use rayon::slice::ParallelSliceMut;

use super::Mesh;
use super::sanitise::{area_vector, position_ids};

/// Edges with a larger angle stay sharp, degrees. Heuristic: the coarsest smooth bodies in use (teapots of a few
/// thousand triangles, eight- to ten-sided tubes) have smaller angles, boxes and cylinder ends larger ones.
pub const CREASE_ANGLE_DEG: f64 = 40.0;

/// Computes vertex normals of a sanitised mesh; vertices on creases are split.
pub(super) fn smooth(mut mesh: Mesh) -> Mesh {
    let n_triangles = mesh.triangles.len();
    let faces: Vec<DVec3> = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
            area_vector(a, b, c).normalize_or_zero()
        })
        .collect();
    let mut classes = Classes::new(n_triangles * 3);
    for (a, b) in smooth_edges(&mesh, &faces) {
        // Edge k runs from corner k to the next corner; the neighbour across the edge has it reversed.
        classes.join(a, next_corner(b));
        classes.join(next_corner(a), b);
    }
    let mut sums = vec![DVec3::ZERO; n_triangles * 3];
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let p = triangle.map(|i| mesh.positions[i as usize].as_dvec3());
        for k in 0..3 {
            let angle = (p[(k + 1) % 3] - p[k]).angle_between(p[(k + 2) % 3] - p[k]);
            let class = classes.find((t * 3 + k) as u32);
            sums[class as usize] += faces[t] * angle;
        }
    }
    // A vertex keeps its index for the first class that uses it; other classes get copies.
    let mut owner = vec![u32::MAX; mesh.positions.len()];
    let mut copies = HashMap::new();
    mesh.normals = vec![Vec3::Y; mesh.positions.len()];
    for (t, &face) in faces.iter().enumerate() {
        for k in 0..3 {
            let index = mesh.triangles[t][k];
            let class = classes.find((t * 3 + k) as u32);
            let target = if owner[index as usize] == u32::MAX || owner[index as usize] == class {
                owner[index as usize] = class;
                index
            } else {
                *copies.entry((index, class)).or_insert_with(|| {
                    mesh.positions.push(mesh.positions[index as usize]);
                    mesh.normals.push(Vec3::Y);
                    if let Some(&uv) = mesh.uvs.get(index as usize) {
                        mesh.uvs.push(uv);
                    }
                    if let Some(&color) = mesh.colors.get(index as usize) {
                        mesh.colors.push(color);
                    }
                    (mesh.positions.len() - 1) as u32
                })
            };
            mesh.triangles[t][k] = target;
            // Normals of opposite faces can cancel out: then the triangle's own normal is used.
            mesh.normals[target as usize] = sums[class as usize]
                .try_normalize()
                .unwrap_or(face)
                .as_vec3();
        }
    }
    mesh
}

fn next_corner(corner: u32) -> u32 {
    if corner % 3 == 2 {
        corner - 2
    } else {
        corner + 1
    }
}

/// Pairs of corners that begin the two sides of a smooth edge. An edge with one triangle is a border. With more than
/// two triangles, or with two sides of the same direction, it is ambiguous which triangles are connected, so the edge
/// counts as sharp.
fn smooth_edges(mesh: &Mesh, faces: &[DVec3]) -> Vec<(u32, u32)> {
    let ids = position_ids(&mesh.positions);
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(mesh.triangles.len() * 3);
    for (t, triangle) in mesh.triangles.iter().enumerate() {
        let id = triangle.map(|i| ids[i as usize]);
        for k in 0..3 {
            let (a, b) = (id[k], id[(k + 1) % 3]);
            edges.push((a.min(b), a.max(b), (t * 3 + k) as u32));
        }
    }
    // The corner makes every key unique, so the order does not depend on threads.
    edges.par_sort_unstable();
    let cos_crease = CREASE_ANGLE_DEG.to_radians().cos();
    let start =
        |corner: u32| ids[mesh.triangles[corner as usize / 3][corner as usize % 3] as usize];
    edges
        .chunk_by(|a, b| (a.0, a.1) == (b.0, b.1))
        .filter_map(|sides| match *sides {
            [(_, _, a), (_, _, b)]
                if start(a) != start(b)
                    && faces[a as usize / 3].dot(faces[b as usize / 3]) > cos_crease =>
            {
                Some((a, b))
            }
            _ => None,
        })
        .collect()
}

/// Disjoint sets of corners; each set is represented by its smallest member.
struct Classes(Vec<u32>);

impl Classes {
    fn new(n: usize) -> Self {
        Self((0..n as u32).collect())
    }

    fn find(&mut self, mut x: u32) -> u32 {
        while self.0[x as usize] != x {
            // Path halving.
            self.0[x as usize] = self.0[self.0[x as usize] as usize];
            x = self.0[x as usize];
        }
        x
    }

    fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.0[a.max(b) as usize] = a.min(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A closed prism with `n` sides around y, without normals.
    fn prism(n: u32) -> Mesh {
        let ring = |y: f32| {
            (0..n).map(move |i| {
                let (s, c) = (i as f32 / n as f32 * std::f32::consts::TAU).sin_cos();
                Vec3::new(c, y, s)
            })
        };
        let positions: Vec<Vec3> = ring(0.0)
            .chain(ring(1.0))
            .chain([Vec3::ZERO, Vec3::Y])
            .collect();
        let mut triangles = Vec::new();
        for i in 0..n {
            let j = (i + 1) % n;
            triangles.extend([[i, n + i, n + j], [i, n + j, j]]);
            triangles.extend([[2 * n, i, j], [2 * n + 1, n + j, n + i]]);
        }
        Mesh {
            positions,
            triangles,
            ..Mesh::default()
        }
    }

    #[test]
    fn a_tube_is_smooth_around_and_sharp_at_its_ends() {
        let mesh = smooth(prism(16));
        // Each rim vertex is split in two: one for the side and one for the cap.
        assert_eq!(mesh.positions.len(), 32 * 2 + 2);
        for t in &mesh.triangles {
            let p = t.map(|i| mesh.positions[i as usize]);
            let face = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            for &i in t {
                let normal = mesh.normals[i as usize];
                let expected = if face.y.abs() > 0.5 {
                    face
                } else {
                    let p = mesh.positions[i as usize];
                    Vec3::new(p.x, 0.0, p.z)
                };
                // The angle weights make it radial, apart from f32 rounding.
                assert!((normal - expected).length() < 1e-6, "{normal} {expected}");
            }
        }
    }

    #[test]
    fn a_six_sided_prism_keeps_all_its_edges() {
        let mesh = smooth(prism(6));
        for t in &mesh.triangles {
            let p = t.map(|i| mesh.positions[i as usize]);
            let face = (p[1] - p[0]).cross(p[2] - p[0]).normalize_or_zero();
            for &i in t {
                assert!((mesh.normals[i as usize] - face).length() < 1e-6);
            }
        }
    }

    #[test]
    fn a_soup_is_smoothed_across_its_copies_of_a_vertex() {
        let tube = prism(16);
        let soup = Mesh {
            positions: tube
                .triangles
                .iter()
                .flatten()
                .map(|&i| tube.positions[i as usize])
                .collect(),
            triangles: (0..tube.triangles.len() as u32)
                .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                .collect(),
            ..Mesh::default()
        };
        let (welded, soup) = (smooth(tube), smooth(soup));
        for (a, b) in welded.triangles.iter().zip(&soup.triangles) {
            for k in 0..3 {
                assert_eq!(welded.normals[a[k] as usize], soup.normals[b[k] as usize]);
            }
        }
    }
}
