//! Makes meshes from files safe for acceleration structures.
//!
//! BVH builders and traversals fail on infinite vertices (a panic), on thousands of identical triangles (a BVH of
//! that depth) and on triangles without area (no normal). After [`sanitise`] none of these are left, and all changes
//! are counted.

use std::collections::HashMap;
use std::fmt;

use glam::{DVec3, Vec3};
use rayon::slice::ParallelSliceMut;
use serde::Serialize;

use super::Mesh;
use super::error::MeshError;

/// Bound on the size of each vertex coordinate, in the mesh's own units: beyond it f32 resolves less than 0.06 units,
/// too little for watertight traversal of details.
pub const MAX_COORDINATE: f32 = 1e6;

/// Counts of the problems that [`sanitise`] repaired.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct SanitiseReport {
    /// Number of triangles of the input.
    pub triangles_in: usize,
    /// Number of triangles without area, which were dropped.
    pub degenerate: usize,
    /// Number of triangles with the same three corners (and facing) as an earlier one, which were dropped.
    pub duplicate: usize,
    /// Number of normals that were zero or not finite, and were recomputed from adjacent triangles.
    pub normals_recomputed: usize,
    /// Number of texture coordinates that were not finite, and were set to 0.
    pub uvs_reset: usize,
    /// Number of vertex colours that were not in 0..=1, and were clamped.
    pub colors_reset: usize,
}

impl SanitiseReport {
    /// Whether the mesh is unchanged.
    pub fn is_clean(&self) -> bool {
        self.degenerate
            + self.duplicate
            + self.normals_recomputed
            + self.uvs_reset
            + self.colors_reset
            == 0
    }

    /// Adds the counts of another mesh of the same file.
    pub fn add(&mut self, other: &Self) {
        self.triangles_in += other.triangles_in;
        self.degenerate += other.degenerate;
        self.duplicate += other.duplicate;
        self.normals_recomputed += other.normals_recomputed;
        self.uvs_reset += other.uvs_reset;
        self.colors_reset += other.colors_reset;
    }
}

impl fmt::Display for SanitiseReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let counts = [
            (self.degenerate, "triangles without area dropped"),
            (self.duplicate, "repeated triangles dropped"),
            (self.normals_recomputed, "unusable normals recomputed"),
            (
                self.uvs_reset,
                "texture coordinates that are not finite set to 0",
            ),
            (
                self.colors_reset,
                "vertex colours outside of 0 to 1 set to the nearest",
            ),
        ];
        let mut separator = "";
        for (n, what) in counts.into_iter().filter(|(n, _)| *n > 0) {
            write!(f, "{separator}{n} {what}")?;
            separator = ", ";
        }
        Ok(())
    }
}

/// A mesh with all guarantees of [`Mesh`], or an error. `name` is for messages: the file, and the part of it if there
/// are several.
pub fn sanitise(mesh: Mesh, name: &str) -> Result<(Mesh, SanitiseReport), MeshError> {
    let (mesh, report, _) = sanitise_keeping(mesh, name)?;
    Ok((mesh, report))
}

/// As [`sanitise`]; also returns the indices of the kept triangles, in order.
pub(super) fn sanitise_keeping(
    mut mesh: Mesh,
    name: &str,
) -> Result<(Mesh, SanitiseReport, Vec<u32>), MeshError> {
    let n = mesh.positions.len();
    if mesh.triangles.len() > u32::MAX as usize || n > u32::MAX as usize {
        return Err(MeshError::new(
            name,
            "expected fewer than 2^32 triangles and vertices",
        ));
    }
    for (i, p) in mesh.positions.iter_mut().enumerate() {
        if let Some(problem) = coordinate_problem(*p) {
            return Err(MeshError::at(name, format!("vertex {i}"), problem));
        }
        // -0.0 + 0.0 is 0.0: from here on, equal positions have equal bits.
        *p += Vec3::ZERO;
    }
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        if let Some(&index) = triangle.iter().find(|&&index| index as usize >= n) {
            return Err(MeshError::at(
                name,
                format!("triangle {i}"),
                format!("vertex index {index}: expected less than the {n} vertices"),
            ));
        }
    }
    let mut report = SanitiseReport {
        triangles_in: mesh.triangles.len(),
        ..SanitiseReport::default()
    };
    let kept = kept_triangles(&mesh, &mut report);
    if kept.is_empty() {
        return Err(MeshError::new(
            name,
            match report.triangles_in {
                0 => "expected triangles, got none".to_owned(),
                n => format!("expected triangles with area, got {n} without"),
            },
        ));
    }
    if kept.len() < mesh.triangles.len() {
        mesh.triangles = kept.iter().map(|&i| mesh.triangles[i as usize]).collect();
    }
    if mesh.uvs.len() != n {
        mesh.uvs = Vec::new();
    }
    for uv in &mut mesh.uvs {
        if !uv.is_finite() {
            *uv = glam::Vec2::ZERO;
            report.uvs_reset += 1;
        }
    }
    if mesh.colors.len() != n {
        mesh.colors = Vec::new();
    }
    for color in &mut mesh.colors {
        let usable = color.to_array().map(|x| match x.is_nan() {
            true => 0.0,
            false => x.clamp(0.0, 1.0),
        });
        if usable != color.to_array() {
            report.colors_reset += 1;
        }
        *color = usable.into();
    }
    if mesh.normals.len() != n {
        mesh.normals = Vec::new();
    }
    repair_normals(&mut mesh, &mut report);
    Ok((mesh, report, kept))
}

/// The problem of a position, if any.
pub(super) fn coordinate_problem(p: Vec3) -> Option<String> {
    let bad = p
        .to_array()
        .into_iter()
        .find(|x| x.is_nan() || x.abs() >= MAX_COORDINATE)?;
    Some(format!(
        "expected finite coordinates under {MAX_COORDINATE:e} in size, got {bad}"
    ))
}

/// Twice the area vector of a triangle; exact except for the final rounding of each component, because differences
/// and products of f32 fit into f64.
pub(super) fn area_vector(a: Vec3, b: Vec3, c: Vec3) -> DVec3 {
    let (a, b, c) = (a.as_dvec3(), b.as_dvec3(), c.as_dvec3());
    (b - a).cross(c - a)
}

/// For each vertex, the first vertex at the same position: unindexed triangles repeat positions under new indices.
/// Sorted instead of hashed: twice as fast for a million vertices, and without slow inputs.
pub(super) fn position_ids(positions: &[Vec3]) -> Vec<u32> {
    let mut order: Vec<([u32; 3], u32)> = positions
        .iter()
        .enumerate()
        .map(|(i, p)| (p.to_array().map(f32::to_bits), i as u32))
        .collect();
    // The index makes every key unique, so the order does not depend on threads.
    order.par_sort_unstable();
    let mut ids = vec![0; positions.len()];
    for same in order.chunk_by(|a, b| a.0 == b.0) {
        for &(_, i) in same {
            ids[i as usize] = same[0].1;
        }
    }
    ids
}

fn kept_triangles(mesh: &Mesh, report: &mut SanitiseReport) -> Vec<u32> {
    let ids = position_ids(&mesh.positions);
    let mut keys: Vec<([u32; 3], u32)> = Vec::with_capacity(mesh.triangles.len());
    for (i, triangle) in mesh.triangles.iter().enumerate() {
        let [a, b, c] = triangle.map(|index| ids[index as usize]);
        let [pa, pb, pc] = triangle.map(|index| mesh.positions[index as usize]);
        // Dropped if the renderer could not compute its normal in f32.
        let area = area_vector(pa, pb, pc).as_vec3();
        if a == b || b == c || c == a || area.try_normalize().is_none() {
            report.degenerate += 1;
            continue;
        }
        // Rotated so that the smallest index comes first, which keeps the facing.
        let key = if a < b && a < c {
            [a, b, c]
        } else if b < c {
            [b, c, a]
        } else {
            [c, a, b]
        };
        keys.push((key, i as u32));
    }
    keys.par_sort_unstable();
    let mut kept: Vec<u32> = keys
        .chunk_by(|a, b| a.0 == b.0)
        .map(|same| same[0].1)
        .collect();
    report.duplicate = keys.len() - kept.len();
    kept.par_sort_unstable();
    kept
}

/// Makes every normal a unit vector; unusable normals become the area-weighted mean of the adjacent triangles.
fn repair_normals(mesh: &mut Mesh, report: &mut SanitiseReport) {
    let mut bad = Vec::new();
    for (i, normal) in mesh.normals.iter_mut().enumerate() {
        match normal.try_normalize() {
            Some(unit) => *normal = unit,
            None => bad.push(i as u32),
        }
    }
    if bad.is_empty() {
        return;
    }
    let mut sums: HashMap<u32, DVec3> = bad.iter().map(|&i| (i, DVec3::ZERO)).collect();
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|index| mesh.positions[index as usize]);
        for index in triangle {
            if let Some(sum) = sums.get_mut(index) {
                *sum += area_vector(a, b, c);
            }
        }
    }
    report.normals_recomputed = bad.len();
    for i in bad {
        // The up direction for vertices that no triangle uses or whose triangles cancel out: any unit vector is
        // valid.
        mesh.normals[i as usize] = sums[&i]
            .try_normalize()
            .map_or(Vec3::Y, |normal| normal.as_vec3());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec2;
    use proptest::prelude::*;

    fn quad() -> Mesh {
        Mesh {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::new(1.0, 1.0, 0.0), Vec3::Y],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        }
    }

    #[test]
    fn a_clean_mesh_passes_unchanged() {
        let (mesh, report) = sanitise(quad(), "quad").unwrap();
        assert_eq!(mesh.triangles, quad().triangles);
        assert!(report.is_clean());
    }

    #[test]
    fn bad_positions_and_indices_are_named() {
        for (x, got) in [
            (f32::NAN, "NaN"),
            (f32::NEG_INFINITY, "-inf"),
            (1e6, "1000000"),
        ] {
            let mut mesh = quad();
            mesh.positions[2].y = x;
            assert_eq!(
                sanitise(mesh, "quad.obj").unwrap_err().to_string(),
                format!(
                    "quad.obj: vertex 2: expected finite coordinates under 1e6 in size, got {got}"
                )
            );
        }
        let mut mesh = quad();
        mesh.triangles[1][2] = 4;
        assert_eq!(
            sanitise(mesh, "quad.obj").unwrap_err().to_string(),
            "quad.obj: triangle 1: vertex index 4: expected less than the 4 vertices"
        );
    }

    #[test]
    fn twenty_thousand_identical_triangles_become_one() {
        // Without shared indices: every triangle has its own three vertices, one of them with -0.0.
        let corners = [Vec3::new(-0.0, 0.0, 0.0), Vec3::X, Vec3::Y];
        let mesh = Mesh {
            positions: (0..20_000).flat_map(|_| corners).collect(),
            triangles: (0..20_000u32)
                .map(|i| {
                    let t = [3 * i, 3 * i + 1, 3 * i + 2];
                    [
                        t[i as usize % 3],
                        t[(i as usize + 1) % 3],
                        t[(i as usize + 2) % 3],
                    ]
                })
                .collect(),
            ..Mesh::default()
        };
        let (mesh, report) = sanitise(mesh, "soup").unwrap();
        assert_eq!((mesh.triangles.len(), report.duplicate), (1, 19_999));
        assert_eq!(report.to_string(), "19999 repeated triangles dropped");
    }

    #[test]
    fn a_back_side_is_not_a_repetition() {
        let mut mesh = quad();
        mesh.triangles.push([2, 1, 0]);
        let (mesh, _) = sanitise(mesh, "quad").unwrap();
        assert_eq!(mesh.triangles.len(), 3);
    }

    #[test]
    fn triangles_without_area_go_and_an_empty_rest_is_an_error() {
        let mut mesh = quad();
        mesh.positions.push(Vec3::new(0.5, 0.5, 0.0));
        mesh.triangles.extend([[1, 1, 2], [0, 4, 2]]);
        let (mesh, report) = sanitise(mesh, "quad").unwrap();
        assert_eq!((mesh.triangles.len(), report.degenerate), (2, 2));
        let mut mesh = quad();
        mesh.triangles = vec![[0, 0, 1]];
        assert_eq!(
            sanitise(mesh, "q").unwrap_err().to_string(),
            "q: expected triangles with area, got 1 without"
        );
        assert!(sanitise(Mesh::default(), "q").is_err());
    }

    #[test]
    fn unusable_normals_and_uvs_are_repaired() {
        let mut mesh = quad();
        mesh.normals = vec![Vec3::ZERO, Vec3::Z * 3.0, Vec3::NAN, Vec3::Z];
        mesh.uvs = vec![Vec2::NAN, Vec2::ONE, Vec2::ONE, Vec2::ONE];
        let (mesh, report) = sanitise(mesh, "quad").unwrap();
        assert_eq!(mesh.normals, vec![Vec3::Z; 4]);
        assert_eq!((report.normals_recomputed, report.uvs_reset), (2, 1));
        assert_eq!(mesh.uvs[0], Vec2::ZERO);
    }

    proptest! {
        #[test]
        fn whatever_comes_out_keeps_the_guarantees(
            positions in prop::collection::vec(prop::array::uniform3(-2.0f32..2.0), 0..12),
            triangles in prop::collection::vec(prop::array::uniform3(0u32..12), 0..40),
        ) {
            let mesh = Mesh {
                positions: positions.iter().map(|&p| Vec3::from(p).round()).collect(),
                triangles,
                ..Mesh::default()
            };
            let n_in = mesh.triangles.len();
            if let Ok((mesh, report)) = sanitise(mesh, "m") {
                prop_assert_eq!(mesh.triangles.len() + report.degenerate + report.duplicate, n_in);
                for &[a, b, c] in &mesh.triangles {
                    let [a, b, c] = [a, b, c].map(|i| mesh.positions[i as usize]);
                    prop_assert!((b - a).cross(c - a).try_normalize().is_some());
                }
            }
        }
    }
}
