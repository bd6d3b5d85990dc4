//! Splits meshes into parts of a model, one per material.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, Vec3};

use super::model::{Model, Part};
use super::mtl::UvTransform;
use super::{Material, Mesh};

impl Model {
    /// Adds a mesh as one part.
    pub(super) fn push_part(&mut self, mesh: Mesh, material: Option<usize>) {
        self.parts.push(Part {
            mesh: self.meshes.len(),
            material,
            model_from_mesh: DAffine3::IDENTITY,
        });
        self.meshes.push(Arc::new(mesh));
    }

    /// Adds a mesh as one part per material of its triangles. `uvs` contains each material's change of texture
    /// coordinates. Vertex colours are the base colour of parts without a material; a texture replaces them.
    pub(super) fn push_by_material(
        &mut self,
        mesh: Mesh,
        of_triangle: &[Option<usize>],
        uvs: &[UvTransform],
    ) {
        let mut groups: Vec<(Option<usize>, Vec<[u32; 3]>)> = Vec::new();
        let mut group_of: HashMap<Option<usize>, usize> = HashMap::new();
        for (triangle, &material) in mesh.triangles.iter().zip(of_triangle) {
            let group = *group_of.entry(material).or_insert_with(|| {
                groups.push((material, Vec::new()));
                groups.len() - 1
            });
            groups[group].1.push(*triangle);
        }
        let meshes = match groups.as_slice() {
            [(material, _)] => vec![(*material, mesh)],
            _ => groups
                .into_iter()
                .map(|(material, triangles)| (material, mesh.subset(triangles)))
                .collect(),
        };
        let mut n_textured = 0;
        for (material, mut mesh) in meshes {
            if let Some(transform) = material.and_then(|i| uvs.get(i)) {
                transform.apply_to(&mut mesh.uvs);
            }
            let textured = material.is_some_and(|i| self.materials[i].base_color_texture.is_some());
            if textured && !mesh.colors.is_empty() {
                // Scans store the same colours twice: in the texture and in the vertices.
                mesh.colors = Vec::new();
                n_textured += 1;
            }
            let material = match material {
                None if !mesh.colors.is_empty() => Some(self.push_vertex_colored()),
                material => material,
            };
            self.push_part(mesh, material);
        }
        if n_textured > 0 {
            self.notes.push(format!(
                "vertex colours left out of {n_textured} parts: they have a texture"
            ));
        }
    }

    /// The material of parts that have only vertex colours, which become the base colour.
    pub(super) fn push_vertex_colored(&mut self) -> usize {
        self.materials.push(Material {
            name: "vertex colours".to_owned(),
            base_color: Vec3::ONE,
            ..Material::default()
        });
        self.materials.len() - 1
    }
}

impl Mesh {
    /// A mesh of some of the triangles, with only the vertices that they use.
    fn subset(&self, mut triangles: Vec<[u32; 3]>) -> Self {
        let mut renamed = HashMap::new();
        let mut subset = Self::default();
        for index in triangles.iter_mut().flatten() {
            let old = *index as usize;
            *index = *renamed.entry(old).or_insert_with(|| {
                subset.positions.push(self.positions[old]);
                subset.normals.extend(self.normals.get(old));
                subset.uvs.extend(self.uvs.get(old));
                subset.colors.extend(self.colors.get(old));
                (subset.positions.len() - 1) as u32
            });
        }
        subset.triangles = triangles;
        subset
    }
}
