//! Coarser levels of detail of large meshes, for objects so small in the frame that the difference is invisible.
//!
//! Simplified by quadric error (Garland and Heckbert 1998, *Simplifying Surfaces with Color and Texture using Quadric
//! Error Metrics*): positions, normals, texture coordinates and vertex colours together, each level from the previous
//! one. Closed meshes stay closed.

use bytemuck::cast_slice;
use meshopt::{
    SimplifyOptions, SimplifyVertex, VertexDataAdapter, simplify_with_attributes_and_locks,
};

use super::Mesh;
use super::sanitise::position_ids;

/// Ratio of triangles between a level and the next.
const STEP: usize = 4;

/// Fewest triangles of a level: fewer hardly make frames faster.
const LEAST: usize = 8192;

/// Most edge visits of the simplifier for any mesh: a tenth of a second.
const MOST_LOOKS: u64 = 100_000_000;

/// Additional edge visits per triangle: ten times the need of a mesh with six triangles per vertex.
const LOOKS_PER_TRIANGLE: u64 = 180;

/// Largest error of a level relative to the previous one, as a share of the mesh's extent; coarser levels are
/// dropped.
const LARGEST_ERROR: f32 = 0.02;

/// Coarser levels of a mesh, finest first; empty for a small mesh or one that would take the simplifier too long
/// ([`takes_forever`]). Stops early if `go_on` returns false.
pub(crate) fn coarser(mesh: &Mesh, go_on: &dyn Fn() -> bool) -> Vec<Mesh> {
    let mut levels: Vec<Mesh> = Vec::new();
    loop {
        let finer = levels.last().unwrap_or(mesh);
        let target = finer.triangles.len() / STEP;
        if target < LEAST || !go_on() || takes_forever(finer) {
            break;
        }
        match simplified(finer, target) {
            Some(coarse) if (target / 2..=2 * target).contains(&coarse.triangles.len()) => {
                levels.push(coarse);
            }
            // Simplification is stuck at seams, borders or loose triangles, or degenerates.
            _ => break,
        }
    }
    levels
}

/// Whether a mesh is large enough for coarser levels, but would take the simplifier too long.
///
/// For every edge, the simplifier visits all edges of a vertex, so a vertex costs the square of its number of
/// triangles: little for six, hours for the centre of a fan of a million.
pub(crate) fn takes_forever(mesh: &Mesh) -> bool {
    let n_triangles = mesh.triangles.len();
    if n_triangles / STEP < LEAST {
        return false;
    }
    // Vertices at the same position count as one, as in the simplifier.
    let ids = position_ids(&mesh.positions);
    let mut valence = vec![0u64; mesh.positions.len()];
    for &corner in mesh.triangles.iter().flatten() {
        valence[ids[corner as usize] as usize] += 1;
    }
    let looks: u64 = valence.iter().map(|n| n * n).sum();
    looks > MOST_LOOKS + LOOKS_PER_TRIANGLE * n_triangles as u64
}

/// The mesh simplified to `target` triangles, or as near as its topology allows.
fn simplified(mesh: &Mesh, target: usize) -> Option<Mesh> {
    let positions = VertexDataAdapter::new(cast_slice(&mesh.positions), 12, 0).ok()?;
    // The error of a normal is weighted as a displacement by the mesh's extent, and so is the error of a texture
    // coordinate.
    let mut attributes = Vec::new();
    let has = |n: usize| n == mesh.positions.len();
    let (has_normals, has_uvs) = (has(mesh.normals.len()), has(mesh.uvs.len()));
    let has_colors = has(mesh.colors.len());
    for i in 0..mesh.positions.len() {
        if has_normals {
            attributes.extend(mesh.normals[i].to_array());
        }
        if has_uvs {
            attributes.extend(mesh.uvs[i].to_array());
        }
        if has_colors {
            attributes.extend(mesh.colors[i].to_array());
        }
    }
    let n_attributes =
        3 * usize::from(has_normals) + 2 * usize::from(has_uvs) + 4 * usize::from(has_colors);
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

/// A mesh of the given triangles, with only the vertices that they use.
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
        colors: pick(&mesh.colors, &kept),
        triangles,
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;
    use crate::shapes;

    fn all_coarser(mesh: &Mesh) -> Vec<Mesh> {
        coarser(mesh, &|| true)
    }

    /// `n` triangles around one vertex; with `welded` they share it, else each has its own copy.
    fn fan(n: u32, welded: bool) -> Mesh {
        let at = |i: u32| {
            let (sin, cos) = (i as f32 / n as f32 * std::f32::consts::TAU).sin_cos();
            Vec3::new(cos, 0.01 * (i % 7) as f32, sin)
        };
        let mut mesh = Mesh {
            positions: (0..n).map(at).chain([Vec3::Y]).collect(),
            triangles: (0..n).map(|i| [n, i, (i + 1) % n]).collect(),
            ..Mesh::default()
        };
        if !welded {
            let corners = mesh.triangles.iter().flatten();
            mesh.positions = corners.map(|&i| mesh.positions[i as usize]).collect();
            mesh.triangles = (0..n).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        }
        mesh
    }

    #[test]
    fn a_fan_has_no_coarser_levels_and_ordinary_meshes_do() {
        for welded in [true, false] {
            let mesh = fan(4 * LEAST as u32, welded);
            assert!(takes_forever(&mesh));
            assert!(all_coarser(&mesh).is_empty());
        }
        // Too small for any level, so it is not too slow either.
        assert!(!takes_forever(&fan(LEAST as u32, true)));
        // A torus with six triangles per vertex, and one whose ring shrinks to a point.
        let mut mesh = crate::shapes::ripples(512, 256);
        assert!(!takes_forever(&mesh));
        for p in &mut mesh.positions[..256] {
            *p = Vec3::ZERO;
        }
        assert!(!takes_forever(&mesh));
    }

    #[test]
    fn simplifying_ends_when_nobody_wants_it() {
        let mesh = crate::shapes::ripples(512, 256);
        let left = std::cell::Cell::new(1);
        let go_on = || left.replace(left.get() - 1) > 0;
        assert_eq!(coarser(&mesh, &go_on).len(), 1);
    }

    /// Number of times that each directed edge occurs, with vertices identified by position.
    fn edges(mesh: &Mesh) -> HashMap<([u32; 3], [u32; 3]), u32> {
        let key = |i: u32| mesh.positions[i as usize].to_array().map(f32::to_bits);
        let mut edges = HashMap::new();
        for [a, b, c] in &mesh.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *edges.entry((key(*from), key(*to))).or_default() += 1;
            }
        }
        edges
    }

    #[test]
    fn levels_are_a_quarter_each_of_the_same_vertices_and_closed_where_the_mesh_is() {
        assert!(all_coarser(&shapes::teapot(16)).is_empty());
        let mesh = crate::shapes::ripples(512, 256);
        let levels = all_coarser(&mesh);
        assert_eq!(levels.len(), 2);
        let mut finer = &mesh;
        for level in &levels {
            let (n, before) = (level.triangles.len(), finer.triangles.len());
            assert!(n <= before / 4 && n > before / 5, "{n} of {before}");
            let vertices: std::collections::HashSet<_> = finer
                .positions
                .iter()
                .map(|p| p.to_array().map(f32::to_bits))
                .collect();
            let known = |p: &Vec3| vertices.contains(&p.to_array().map(f32::to_bits));
            assert!(level.positions.iter().all(known));
            let edges = edges(level);
            for (&(from, to), &times) in &edges {
                assert_eq!((times, edges.get(&(to, from))), (1, Some(&1)));
            }
            finer = level;
        }
    }

    #[test]
    fn normals_texture_coordinates_and_colours_stay_with_their_vertices() {
        let mut mesh = shapes::teapot(32);
        mesh.uvs = mesh
            .positions
            .iter()
            .map(|p| glam::Vec2::new(p.x, p.z))
            .collect();
        // Smooth colours, so that the mesh can be simplified at all.
        let color = |p: &Vec3| glam::Vec4::new(0.01 * p.x, 0.01 * p.y, 0.01 * p.z, 1.0);
        mesh.colors = mesh.positions.iter().map(color).collect();
        let level = &all_coarser(&mesh)[0];
        assert_eq!(level.colors.len(), level.positions.len());
        for (p, c) in level.positions.iter().zip(&level.colors) {
            assert_eq!(*c, color(p));
        }
        assert_eq!(level.normals.len(), level.positions.len());
        for (p, uv) in level.positions.iter().zip(&level.uvs) {
            assert_eq!([p.x, p.z], uv.to_array());
        }
        assert!(
            level
                .normals
                .iter()
                .all(|n| (n.length() - 1.0).abs() < 1e-5)
        );
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

        /// Loose triangles, shared corners, no area, all in one place: every result is a valid mesh.
        #[test]
        fn any_mesh_is_simplified_to_a_mesh_or_not_at_all(
            seed in any::<u32>(),
            n_vertices in 3u32..40_000,
            steps in prop_oneof![Just(1u32), Just(64), Just(1 << 20)],
        ) {
            let random = |i: u32, k: u32| crate::numerics::uniform(seed ^ i, k, 7);
            let place = |x: f32| (x * steps as f32).floor() / steps as f32 * 1e6;
            let mesh = Mesh {
                positions: (0..n_vertices)
                    .map(|i| Vec3::new(place(random(i, 0)), place(random(i, 1)), place(random(i, 2))))
                    .collect(),
                triangles: (0..4 * LEAST as u32 + 1)
                    .map(|i| [3, 4, 5].map(|k| (random(i, k) * n_vertices as f32) as u32 % n_vertices))
                    .collect(),
                ..Mesh::default()
            };
            for level in all_coarser(&mesh) {
                prop_assert!(level.triangles.len() < mesh.triangles.len());
                prop_assert!(level.triangles.len() >= LEAST / 2);
                let n = level.positions.len() as u32;
                prop_assert!(level.triangles.iter().flatten().all(|&i| i < n));
            }
        }
    }
}
