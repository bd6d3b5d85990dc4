//! Tests whether a point is inside a model.

use glam::{DAffine3, DVec3};

use super::model::Model;

/// Ray directions that are not along an axis, because such rays often hit edges.
const DIRECTIONS: [DVec3; 3] = [
    DVec3::new(0.5317, 0.7211, 0.4441),
    DVec3::new(-0.6089, 0.4813, 0.6303),
    DVec3::new(0.2969, -0.6373, -0.7111),
];

/// Whether a point of the world is inside a placed model: true if the majority of three rays cross an odd number of
/// triangles. Meshes with holes give some wrong answers.
pub(super) fn contains(model: &Model, world_from_model: DAffine3, point: DVec3) -> bool {
    let votes = DIRECTIONS.iter().filter(|&&direction| {
        let crossed: usize = model
            .parts
            .iter()
            .map(|part| {
                let mesh_from_world = (world_from_model * part.model_from_mesh).inverse();
                let origin = mesh_from_world.transform_point3(point);
                let along = mesh_from_world.transform_vector3(direction);
                let mesh = &model.meshes[part.mesh];
                let corner = |i: u32| mesh.positions[i as usize].as_dvec3();
                let triangles = mesh.triangles.iter();
                triangles
                    .filter(|t| crosses(origin, along, t.map(corner)))
                    .count()
            })
            .sum();
        crossed % 2 == 1
    });
    votes.count() >= 2
}

/// Whether a ray hits a triangle in front of its origin (Moeller and Trumbore 1997).
fn crosses(origin: DVec3, direction: DVec3, [a, b, c]: [DVec3; 3]) -> bool {
    let (ab, ac) = (b - a, c - a);
    let p = direction.cross(ac);
    let determinant = ab.dot(p);
    let from = origin - a;
    let u = from.dot(p) / determinant;
    let q = from.cross(ab);
    let v = direction.dot(q) / determinant;
    // False for a determinant of 0: the quotients are infinite or NaN.
    u >= 0.0 && v >= 0.0 && u + v <= 1.0 && ac.dot(q) / determinant > 0.0
}
