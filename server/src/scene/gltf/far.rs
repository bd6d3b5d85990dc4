//! Meshes far from the origin, such as surveyed coordinates: at millions of metres f32 resolves only decimetres.
//! Meshes are moved near the origin, and their transforms, in double precision, move them back. A model that is far
//! away as a whole is moved with a note, as in other formats.

use glam::DVec3;

use super::super::Mesh;
use super::super::model::Model;
use super::super::polygons::origin;

/// A model that is farther than this from its origin is moved as a whole. Transforms in double precision would be
/// exact there, but no camera is there (heuristic).
const SURVEYED: f64 = 1e5;

/// Moves a mesh by an offset of whole numbers if it is far away; returns its old origin.
pub(super) fn near(mesh: &mut Mesh) -> DVec3 {
    let position = |&i: &u32| Some(mesh.positions.get(i as usize)?.as_dvec3());
    let used = mesh.triangles.iter().flatten().filter_map(position);
    let offset = origin::offset(used.filter(|p| p.is_finite()));
    if offset != DVec3::ZERO {
        for p in &mut mesh.positions {
            *p = (p.as_dvec3() - offset).as_vec3();
        }
    }
    offset
}

/// As [`near`], for a mesh whose vertices get new positions.
pub(super) fn moved_near(mesh: &mut Mesh, positions: &[DVec3]) -> DVec3 {
    let position = |&i: &u32| positions.get(i as usize).copied();
    let used = mesh.triangles.iter().flatten().filter_map(position);
    let offset = origin::offset(used.filter(|p| p.is_finite()));
    mesh.positions = positions.iter().map(|&p| (p - offset).as_vec3()).collect();
    offset
}

/// Moves the whole model if it is far away, with a note.
pub(super) fn near_as_a_whole(model: &mut Model) {
    let corners: Vec<DVec3> = model
        .parts
        .iter()
        .filter_map(|part| Some((part, model.meshes[part.mesh].bounds()?)))
        .flat_map(|(part, (low, high))| {
            (0..8).map(move |i| {
                let side = |k: usize| if i >> k & 1 == 0 { low[k] } else { high[k] };
                let corner = DVec3::new(side(0).into(), side(1).into(), side(2).into());
                part.model_from_mesh.transform_point3(corner)
            })
        })
        .filter(|corner| corner.is_finite())
        .collect();
    let farthest = corners.iter().map(|corner| corner.abs().max_element());
    let offset = origin::offset(corners.iter().copied());
    if offset == DVec3::ZERO || farthest.fold(0.0, f64::max) < SURVEYED {
        return;
    }
    for part in &mut model.parts {
        part.model_from_mesh.translation -= offset;
    }
    model.notes.push(origin::note(offset));
}
