//! Skins in their rest pose: each vertex is placed by its joints (the joint's transform in the model times the
//! inverse bind matrix, weighted), and the transform of the mesh's node is ignored (glTF 2.0, section 3.7.3.3).

use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};

use super::super::Mesh;
use super::super::error::MeshError;
use super::accessor::Data;

/// Most sets of four joints per vertex.
pub(super) const MAX_SETS: u32 = 4;

/// Joints and weights of each vertex.
#[derive(Default)]
pub(super) struct Influences {
    /// By set and vertex.
    pub(super) joints: Vec<Vec<[f32; 4]>>,
    pub(super) weights: Vec<Vec<[f32; 4]>>,
}

/// Unusual content of a skinned mesh.
#[derive(Default, Clone, Copy)]
pub(super) struct Oddities {
    /// Vertices without a weight, which are placed by the first joint.
    pub(super) n_unweighted: usize,
    /// Influences of joints that do not exist.
    pub(super) n_without_joint: usize,
}

/// Per joint: model space from bind pose; `None` for joints that cannot be placed.
pub(super) fn joint_matrices(
    data: &Data<'_>,
    skin: usize,
    model_from_node: &[Option<DAffine3>],
    notes: &mut Vec<String>,
) -> Result<Vec<Option<DAffine3>>, MeshError> {
    let at = format!("skins[{skin}]");
    let entry = data.root.skins.get(skin).ok_or_else(|| {
        MeshError::at(
            data.file,
            &at,
            format!("there are {} skins", data.root.skins.len()),
        )
    })?;
    let inverse_binds = match entry.inverse_bind_matrices {
        Some(index) => data.vectors::<16>(index, &format!("{at}.inverseBindMatrices"))?,
        None => Vec::new(),
    };
    let mut n_unusable = 0;
    let matrices = entry
        .joints
        .iter()
        .enumerate()
        .map(|(i, &joint)| {
            let model_from_joint = model_from_node.get(joint).copied().flatten();
            let joint_from_bind = match (entry.inverse_bind_matrices, inverse_binds.get(i)) {
                (None, _) => Some(DAffine3::IDENTITY),
                (Some(_), columns) => columns.map(|columns| {
                    // Its last row is 0 0 0 1, apart from rounding.
                    DAffine3::from_mat4(DMat4::from_cols_array(&columns.map(f64::from)))
                }),
            };
            let matrix = model_from_joint
                .zip(joint_from_bind)
                .map(|(model_from_joint, joint_from_bind)| model_from_joint * joint_from_bind)
                .filter(DAffine3::is_finite);
            n_unusable += usize::from(matrix.is_none());
            matrix
        })
        .collect();
    if n_unusable > 0 {
        notes.push(format!(
            "{at}: {n_unusable} joints left out: they have no transform or no inverse bind matrix"
        ));
    }
    Ok(matrices)
}

/// Moves a mesh from its bind pose to the pose of the joints.
pub(super) fn apply(
    mesh: &mut Mesh,
    influences: &Influences,
    joints: &[Option<DAffine3>],
) -> Oddities {
    let mut odd = Oddities::default();
    let has_normals = mesh.normals.len() == mesh.positions.len();
    let mut n_mirrored = 0;
    for v in 0..mesh.positions.len() {
        let mut sum = [DVec3::ZERO; 4];
        let mut total = 0.0;
        for (set_joints, set_weights) in influences.joints.iter().zip(&influences.weights) {
            for (joint, weight) in set_joints[v].into_iter().zip(set_weights[v]) {
                // Negative weights and NaN are ignored.
                if weight > 0.0 && weight.is_finite() {
                    match joints.get(joint as usize).copied().flatten() {
                        Some(matrix) => {
                            add(&mut sum, &matrix, f64::from(weight));
                            total += f64::from(weight);
                        }
                        None => odd.n_without_joint += 1,
                    }
                }
            }
        }
        if total <= 0.0 {
            odd.n_unweighted += 1;
            let first = influences
                .joints
                .first()
                .map_or(0, |set| set[v][0] as usize);
            let Some(matrix) = joints.get(first).copied().flatten() else {
                continue;
            };
            add(&mut sum, &matrix, 1.0);
            total = 1.0;
        }
        let [x, y, z, translation] = sum.map(|column| column / total);
        let linear = DMat3::from_cols(x, y, z);
        let moved = linear * mesh.positions[v].as_dvec3() + translation;
        mesh.positions[v] = moved.as_vec3();
        n_mirrored += usize::from(linear.determinant() < 0.0);
        if has_normals {
            // Equal to the inverse transpose up to a positive factor, without a division by zero.
            let cofactors = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
            let sign = linear.determinant().signum();
            let normal = cofactors * mesh.normals[v].as_dvec3() * sign;
            mesh.normals[v] = normal.try_normalize().map_or(Vec3::ZERO, |n| n.as_vec3());
        }
    }
    // A mirroring pose flips the triangles, so they are flipped back, as for a mirrored node.
    if 2 * n_mirrored > mesh.positions.len() {
        for triangle in &mut mesh.triangles {
            triangle.swap(1, 2);
        }
    }
    odd
}

fn add(sum: &mut [DVec3; 4], matrix: &DAffine3, weight: f64) {
    let columns = [
        matrix.matrix3.x_axis,
        matrix.matrix3.y_axis,
        matrix.matrix3.z_axis,
        matrix.translation,
    ];
    for (sum, column) in sum.iter_mut().zip(columns) {
        *sum += column * weight;
    }
}
