//! Coarser versions of large meshes, for frames in which nobody can see the difference.
//!
//! Simplified by quadric error (Garland and Heckbert 1998, *Simplifying Surfaces with Color and
//! Texture using Quadric Error Metrics*), positions, normals and texture coordinates together, each
//! version from the one before. Closed meshes stay closed.

use bytemuck::cast_slice;
use meshopt::{
    SimplifyOptions, SimplifyVertex, VertexDataAdapter, simplify_with_attributes_and_locks,
};

use super::Mesh;

/// Each version has about this many times fewer triangles than the one before.
const STEP: usize = 4;

/// Fewest triangles of a version: with fewer, frames are hardly faster.
const LEAST: usize = 8192;

/// Error that a version is not to have against the one before, as a share of the mesh's extent: it
/// would be of no use.
const LARGEST_ERROR: f32 = 0.02;

/// Coarser versions of a mesh, finest first; none of a small one.
pub(crate) fn coarser(mesh: &Mesh) -> Vec<Mesh> {
    let mut versions: Vec<Mesh> = Vec::new();
    loop {
        let finer = versions.last().unwrap_or(mesh);
        let target = finer.triangles.len() / STEP;
        if target < LEAST {
            break;
        }
        match simplified(finer, target) {
            Some(coarse) if coarse.triangles.len() <= 2 * target => versions.push(coarse),
            // Stuck: what is left are seams, borders or a soup of loose triangles.
            _ => break,
        }
    }
    versions
}

/// A mesh with `target` triangles, or as near to it as its shape lets.
fn simplified(mesh: &Mesh, target: usize) -> Option<Mesh> {
    let positions = VertexDataAdapter::new(cast_slice(&mesh.positions), 12, 0).ok()?;
    // The error of a normal counts as if it acted over the mesh's extent; so does that of a texture
    // that spans it.
    let mut attributes = Vec::new();
    let has = |n: usize| n == mesh.positions.len();
    let (has_normals, has_uvs) = (has(mesh.normals.len()), has(mesh.uvs.len()));
    for i in 0..mesh.positions.len() {
        if has_normals {
            attributes.extend(mesh.normals[i].to_array());
        }
        if has_uvs {
            attributes.extend(mesh.uvs[i].to_array());
        }
    }
    let n_attributes = 3 * usize::from(has_normals) + 2 * usize::from(has_uvs);
    let weights = vec![1.0; n_attributes];
    let free = vec![SimplifyVertex::None; mesh.positions.len()];
    let indices = simplify_with_attributes_and_locks(
        cast_slice(&mesh.triangles),
        &positions,
        &attributes,
        &weights,
        n_attributes * size_of::<f32>(),
        &free,
        3 * target,
        LARGEST_ERROR,
        SimplifyOptions::None,
        None,
    );
    Some(with_triangles(mesh, &indices))
}

/// Some triangles of a mesh, with those vertices that they use.
fn with_triangles(mesh: &Mesh, indices: &[u32]) -> Mesh {
    let mut places = vec![u32::MAX; mesh.positions.len()];
    let mut kept = Vec::new();
    let triangles = indices
        .chunks_exact(3)
        .map(|corners| {
            [0, 1, 2].map(|k| {
                let place = &mut places[corners[k] as usize];
                if *place == u32::MAX {
                    *place = kept.len() as u32;
                    kept.push(corners[k] as usize);
                }
                *place
            })
        })
        .collect();
    fn pick<T: Copy>(values: &[T], kept: &[usize]) -> Vec<T> {
        kept.iter()
            .filter_map(|&i| values.get(i).copied())
            .collect()
    }
    Mesh {
        positions: pick(&mesh.positions, &kept),
        normals: pick(&mesh.normals, &kept),
        uvs: pick(&mesh.uvs, &kept),
        triangles,
    }
}
