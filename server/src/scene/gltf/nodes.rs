//! Flattens the node hierarchy: visible nodes and their transforms. An invalid node is left out with its children;
//! the others are kept.

use std::collections::HashSet;

use glam::{DAffine3, DMat4, DQuat, DVec3, DVec4};

use super::format::{Node, Root};

/// Largest deviation of a rotation's length from 1 without a note: exporters round (heuristic).
const UNIT_TOLERANCE: f64 = 0.05;

/// The transforms of all nodes.
pub(super) struct Nodes {
    /// Nodes of the scene, in document order.
    pub(super) shown: Vec<usize>,
    /// Model space from the node's space; `None` if undefined.
    pub(super) model_from_node: Vec<Option<DAffine3>>,
    /// Notes on unusual content.
    pub(super) notes: Vec<String>,
}

/// Visits the file's scene, then all other nodes (joints may be outside of the scene).
pub(super) fn flatten(root: &Root) -> Nodes {
    let mut nodes = Nodes {
        shown: Vec::new(),
        model_from_node: vec![None; root.nodes.len()],
        notes: Vec::new(),
    };
    let children: HashSet<usize> = root
        .nodes
        .iter()
        .flat_map(|n| n.children.iter().copied())
        .collect();
    let roots = || {
        (0..root.nodes.len())
            .filter(|i| !children.contains(i))
            .collect::<Vec<usize>>()
    };
    let starts = match (root.scene, &root.scenes[..]) {
        (Some(index), scenes) if index < scenes.len() => scenes[index].nodes.clone(),
        (index, [first, ..]) => {
            if let Some(index) = index {
                nodes.notes.push(format!(
                    "scene: expected less than the {} scenes, got {index}: the first is shown",
                    root.scenes.len()
                ));
            }
            first.nodes.clone()
        }
        (_, []) => roots(),
    };
    let mut visited = vec![false; root.nodes.len()];
    let mut shown = Vec::new();
    nodes.walk(root, starts, &mut visited, &mut shown, true);
    let has_mesh = |shown: &[usize]| shown.iter().any(|&i| root.nodes[i].mesh.is_some());
    let mut rest = Vec::new();
    let others = roots().into_iter().filter(|&i| !visited[i]).collect();
    nodes.walk(root, others, &mut visited, &mut rest, false);
    if !has_mesh(&shown) && has_mesh(&rest) {
        nodes
            .notes
            .push("its scene is empty: all nodes are shown".to_owned());
        shown = rest;
    }
    // Some files place the coarser levels of detail beside the finest.
    let coarser: HashSet<usize> = root
        .nodes
        .iter()
        .filter_map(|node| node.extensions.lod.as_ref())
        .flat_map(|lod| lod.ids.iter().copied())
        .collect();
    let mut named = root.extensions_used.iter().chain(&root.extensions_required);
    if !coarser.is_empty() || named.any(|name| name == "MSFT_lod") {
        nodes
            .notes
            .push("MSFT_lod: only the finest version is used".to_owned());
    }
    shown.retain(|i| !coarser.contains(i));
    nodes.shown = shown;
    nodes
}

impl Nodes {
    /// Visits the trees under `starts` in document order; `aloud`: note problems.
    fn walk(
        &mut self,
        root: &Root,
        starts: Vec<usize>,
        visited: &mut [bool],
        out: &mut Vec<usize>,
        aloud: bool,
    ) {
        // Children are pushed in reverse order.
        let mut stack: Vec<(usize, DAffine3, bool)> = starts
            .into_iter()
            .rev()
            .map(|i| (i, DAffine3::IDENTITY, true))
            .collect();
        while let Some((index, model_from_parent, is_visible)) = stack.pop() {
            let mut note = |note: String| {
                if aloud {
                    self.notes.push(note);
                }
            };
            let Some(node) = root.nodes.get(index) else {
                note(format!(
                    "nodes[{index}] left out: there are {} nodes",
                    root.nodes.len()
                ));
                continue;
            };
            // A node has one parent (glTF 2.0, 3.5.3): checking this prevents cycles and exponential trees.
            if std::mem::replace(&mut visited[index], true) {
                note(format!(
                    "nodes[{index}] is used only once: expected one parent, got several or a cycle"
                ));
                continue;
            }
            let local = match local_transform(node) {
                Ok((local, None)) => local,
                Ok((local, Some(odd))) => {
                    note(format!("nodes[{index}]: {odd}"));
                    local
                }
                Err(problem) => {
                    note(format!("nodes[{index}] left out: {problem}"));
                    continue;
                }
            };
            let model_from_node = model_from_parent * local;
            if !model_from_node.is_finite() {
                note(format!("nodes[{index}] left out: transform overflows"));
                continue;
            }
            let visibility = node.extensions.visibility.as_ref();
            let is_visible = is_visible && visibility.is_none_or(|v| v.visible);
            if is_visible {
                out.push(index);
            } else if node.mesh.is_some() {
                note(format!("nodes[{index}] left out: it is hidden"));
            }
            self.model_from_node[index] = Some(model_from_node);
            let children = node.children.iter().rev();
            stack.extend(children.map(|&i| (i, model_from_node, is_visible)));
        }
    }
}

/// A node's own transform, and a note if it is unusual.
fn local_transform(node: &Node) -> Result<(DAffine3, Option<String>), String> {
    let mut odd = None;
    let transform = match node.matrix {
        Some(columns) => {
            let m = DMat4::from_cols_array(&columns);
            let w = m.row(3).w;
            if m.row(3).truncate() != DVec3::ZERO || w == 0.0 {
                return Err("matrix: expected an affine transform, got a projection".into());
            }
            DAffine3::from_mat4(m * (1.0 / w))
        }
        None => {
            let rotation = node.rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
            let (rotation, problem) = unit(rotation);
            odd = problem;
            DAffine3::from_scale_rotation_translation(
                DVec3::from_array(node.scale.unwrap_or([1.0; 3])),
                rotation,
                DVec3::from_array(node.translation.unwrap_or_default()),
            )
        }
    };
    if transform.is_finite() {
        Ok((transform, odd))
    } else {
        Err("transform: expected finite numbers".into())
    }
}

/// The normalised rotation, and a note if it was unusual.
pub(super) fn unit(rotation: [f64; 4]) -> (DQuat, Option<String>) {
    // Scaled first, so that squares neither overflow nor underflow.
    let largest = DVec4::from_array(rotation).abs().max_element();
    let scaled = DVec4::from_array(rotation) / largest;
    let Some(unit) = scaled.try_normalize() else {
        return (
            DQuat::IDENTITY,
            Some("rotation of length 0 taken as none".to_owned()),
        );
    };
    let length = scaled.length() * largest;
    let odd = (length - 1.0).abs() > UNIT_TOLERANCE;
    (
        DQuat::from_vec4(unit),
        odd.then(|| format!("rotation of length {length:.3} brought to 1")),
    )
}
