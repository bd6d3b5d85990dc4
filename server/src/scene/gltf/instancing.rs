//! EXT_mesh_gpu_instancing: one mesh at many positions.

use std::collections::HashMap;

use glam::{DAffine3, DVec3};

use super::super::error::MeshError;
use super::accessor::Data;
use super::nodes;

/// Most instances of one node.
const MAX_INSTANCES: usize = 100_000;

/// Transforms of the instances of a node, in the node's space.
pub(super) fn read(
    data: &Data<'_>,
    attributes: &HashMap<String, usize>,
    node: usize,
) -> Result<Vec<DAffine3>, MeshError> {
    let at = |name: &str| format!("nodes[{node}].EXT_mesh_gpu_instancing.{name}");
    let get = |name: &str| attributes.get(name).copied();
    let three = |name: &str| match get(name) {
        Some(index) => data.vectors::<3>(index, &at(name)),
        None => Ok(Vec::new()),
    };
    let (translations, scales) = (three("TRANSLATION")?, three("SCALE")?);
    let rotations = match get("ROTATION") {
        Some(index) => data.vectors::<4>(index, &at("ROTATION"))?,
        None => Vec::new(),
    };
    let n = translations.len().max(scales.len()).max(rotations.len());
    if n > MAX_INSTANCES {
        return Err(MeshError::at(
            data.file,
            at("attributes"),
            format!("expected at most {MAX_INSTANCES} instances, got {n}"),
        ));
    }
    Ok((0..n)
        .map(|i| {
            let vector = |values: &[[f32; 3]], default: DVec3| {
                let value = values.get(i).map(|v| DVec3::from_array(v.map(f64::from)));
                value.unwrap_or(default)
            };
            let rotation = rotations.get(i).copied().unwrap_or([0.0, 0.0, 0.0, 1.0]);
            DAffine3::from_scale_rotation_translation(
                vector(&scales, DVec3::ONE),
                nodes::unit(rotation.map(f64::from)).0,
                vector(&translations, DVec3::ZERO),
            )
        })
        .collect())
}
