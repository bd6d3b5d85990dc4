//! Triangle meshes for ray tracing: sanitised, indexed, in object space.

use glam::{Vec2, Vec3, Vec4};

/// An indexed triangle mesh. Loaders guarantee: every position finite with each
/// coordinate under 1e6 in size, every index in range, normals of unit length.
#[derive(Debug, Clone, Default)]
pub struct Mesh {
    /// Vertex positions, object units.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals: one per position, or empty (the triangle's own normal is used).
    pub normals: Vec<Vec3>,
    /// Texture coordinates, glTF convention (v down): one per position, or empty.
    pub uvs: Vec<Vec2>,
    /// Vertex colours, linear RGB and alpha, each 0..=1: one per position, or empty. They multiply
    /// a material's base colour.
    pub colors: Vec<Vec4>,
    /// Vertex indices of each triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Memory held, bytes.
    pub fn bytes(&self) -> u64 {
        let lists = [
            size_of_val(self.positions.as_slice()),
            size_of_val(self.normals.as_slice()),
            size_of_val(self.uvs.as_slice()),
            size_of_val(self.colors.as_slice()),
            size_of_val(self.triangles.as_slice()),
        ];
        lists.iter().sum::<usize>() as u64
    }

    /// Smallest and largest corner; `None` without triangles.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let mut corners = self
            .triangles
            .iter()
            .flatten()
            .map(|&i| self.positions[i as usize]);
        let first = corners.next()?;
        Some(corners.fold((first, first), |(lo, hi), p| (lo.min(p), hi.max(p))))
    }
}
