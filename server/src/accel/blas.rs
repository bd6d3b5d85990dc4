//! One mesh ready for rays: its triangles in leaf order under a binary tree (packets, scalar
//! reference) and an eight-wide one (single rays) that share their leaves.

use glam::{Vec3, Vec3A};

use super::build::{BuildError, BuildLimits, LEAF_SIZE, prepare};
use super::sah;
use super::split::BinaryTree;
use super::wide::STACK;
use crate::scene::Mesh;

/// Marks a child as a leaf; the rest is its index into the blocks.
pub(super) const LEAF: u32 = 1 << 31;
/// A child that is not there.
pub(super) const NONE: u32 = u32::MAX;

/// The triangles of one leaf, component by component. Absent ones are NaN, which fail any test.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(16))]
pub(super) struct Block {
    /// `[corner][axis][triangle]`.
    pub(super) corners: [[[f32; LEAF_SIZE]; 3]; 3],
    /// Numbers in the mesh.
    pub(super) ids: [u32; LEAF_SIZE],
}

impl Block {
    /// The corners of one triangle.
    #[inline(always)]
    pub(super) fn triangle(&self, k: usize) -> [[f32; 3]; 3] {
        self.corners.map(|corner| corner.map(|axis| axis[k]))
    }
}

/// An inner node of the binary tree, with its children's boxes: one cache line.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct PairNode {
    pub(super) low: [[f32; 3]; 2],
    pub(super) high: [[f32; 3]; 2],
    /// Node index, `LEAF` and block index, or `NONE`.
    pub(super) children: [u32; 2],
    /// Triangles of a child that is a leaf.
    pub(super) counts: [u32; 2],
}

/// A node of the eight-wide tree: four cache lines.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct WideNode {
    /// `[axis][low, high][child]`; an absent child is empty.
    pub(super) planes: [[[f32; 8]; 2]; 3],
    /// As in [`PairNode`].
    pub(super) children: [u32; 8],
}

/// A mesh that rays can be traced against. Built once and shared between instances.
#[derive(Debug, Default)]
pub struct Blas {
    /// The mesh's own origin lies at minus this.
    pub(super) centre: Vec3,
    /// Bounds around the centre; meaningless without triangles.
    pub(super) low: Vec3A,
    pub(super) high: Vec3A,
    /// Largest coordinate of the bounds.
    pub(super) extent: f32,
    pub(super) blocks: Vec<Block>,
    pub(super) pairs: Vec<PairNode>,
    pub(super) wide: Vec<WideNode>,
    triangles: usize,
}

/// A tree as the kernels walk it.
struct Layout {
    blocks: Vec<Block>,
    pairs: Vec<PairNode>,
    wide: Vec<WideNode>,
    low: Vec3A,
    high: Vec3A,
}

impl Blas {
    /// Builds the trees. Time is bounded by n log n in the number of triangles, whatever they are.
    ///
    /// Triangles without area are left out (no ray hits them), and so are those with the same
    /// corners as an earlier one. Hits report numbers in `mesh.triangles` all the same.
    pub fn build(mesh: &Mesh, limits: BuildLimits) -> Result<Self, BuildError> {
        let prepared = prepare(mesh, limits)?;
        let tree = sah::build(&prepared.corners);
        let Some(layout) = layout(&tree, &prepared.corners, &prepared.ids) else {
            // No triangle is left: nothing to hit.
            return Ok(Self::default());
        };
        Ok(Self {
            centre: prepared.centre,
            low: layout.low,
            high: layout.high,
            extent: layout.low.abs().max(layout.high.abs()).max_element(),
            blocks: layout.blocks,
            pairs: layout.pairs,
            wide: layout.wide,
            triangles: prepared.ids.len(),
        })
    }

    /// Number of distinct triangles that rays can hit.
    pub fn triangles(&self) -> usize {
        self.triangles
    }

    /// Bounds in the mesh's own space, conservative; `None` if nothing can be hit.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let (low, high) = (Vec3::from(self.low), Vec3::from(self.high));
        // Subtracting the centre and adding it back may each round inwards by half a unit.
        let slack = (self.centre.abs() + low.abs().max(high.abs())) * f32::EPSILON;
        (self.triangles > 0).then(|| (low + self.centre - slack, high + self.centre + slack))
    }

    /// Memory held, bytes.
    pub fn memory(&self) -> usize {
        std::mem::size_of_val(&self.blocks[..])
            + std::mem::size_of_val(&self.pairs[..])
            + std::mem::size_of_val(&self.wide[..])
    }
}

/// Lays a tree out for the kernels; `None` if it is empty.
fn layout(tree: &BinaryTree, corners: &[[Vec3A; 3]], ids: &[u32]) -> Option<Layout> {
    let root = tree.nodes.first()?;
    let mut laid = Layout {
        blocks: Vec::with_capacity(tree.nodes.len() / 2 + 1),
        pairs: Vec::with_capacity(tree.nodes.len() / 2 + 1),
        wide: Vec::with_capacity(tree.nodes.len() / 8 + 1),
        low: root.low,
        high: root.high,
    };
    // Leaves get their blocks in the order a depth-first walk meets them.
    let mut child_of = vec![NONE; tree.nodes.len()];
    let mut pending = vec![0_u32];
    while let Some(index) = pending.pop() {
        let node = &tree.nodes[index as usize];
        if node.count == 0 {
            child_of[index as usize] = laid.pairs.len() as u32;
            laid.pairs.push(PairNode {
                low: [[0.0; 3]; 2],
                high: [[0.0; 3]; 2],
                children: [node.first, node.first + 1],
                counts: [0; 2],
            });
            pending.push(node.first + 1);
            pending.push(node.first);
        } else {
            child_of[index as usize] = LEAF | laid.blocks.len() as u32;
            let range = node.first as usize..(node.first + node.count) as usize;
            laid.blocks.push(block(&tree.order[range], corners, ids));
        }
    }
    for pair in &mut laid.pairs {
        for side in 0..2 {
            let index = pair.children[side] as usize;
            let node = &tree.nodes[index];
            pair.low[side] = node.low.to_array();
            pair.high[side] = node.high.to_array();
            pair.children[side] = child_of[index];
            pair.counts[side] = node.count;
        }
    }
    if laid.pairs.is_empty() {
        // A single leaf still gets a node above it, so that kernels start at one. Its absent
        // sibling has no triangles, and a box where no ray comes.
        let far = [2e18; 3];
        laid.pairs.push(PairNode {
            low: [root.low.to_array(), far],
            high: [root.high.to_array(), far],
            children: [LEAF, NONE],
            counts: [root.count, 0],
        });
    }
    laid.wide = widen(tree, &child_of);
    Some(laid)
}

fn block(order: &[u32], corners: &[[Vec3A; 3]], ids: &[u32]) -> Block {
    let mut block = Block {
        corners: [[[f32::NAN; LEAF_SIZE]; 3]; 3],
        ids: [NONE; LEAF_SIZE],
    };
    for (k, &i) in order.iter().enumerate() {
        for (corner, p) in corners[i as usize].iter().enumerate() {
            for axis in 0..3 {
                block.corners[corner][axis][k] = p[axis];
            }
        }
        block.ids[k] = ids[i as usize];
    }
    block
}

/// Collapses the binary tree: a wide node takes its largest inner child apart until it has eight
/// children or only leaves, or until the nearest-first walk below could outgrow its stack.
///
/// Every child but the one walked into may wait on the stack. Even if all nodes had two children,
/// a subtree of height h would add h waiting entries, so a node takes apart no more than leaves
/// room for that: then entries waiting plus height stay below [`STACK`] all the way down, as they
/// are at the root.
fn widen(tree: &BinaryTree, child_of: &[u32]) -> Vec<WideNode> {
    const { assert!(sah::MAX_DEPTH < STACK) };
    let area = |index: u32| {
        let node = &tree.nodes[index as usize];
        let d = node.high - node.low;
        d.x * d.y + d.y * d.z + d.z * d.x
    };
    // Children come after their parents.
    let mut heights = vec![0_usize; tree.nodes.len()];
    for (index, node) in tree.nodes.iter().enumerate().rev() {
        if node.count == 0 {
            let first = node.first as usize;
            heights[index] = 1 + heights[first].max(heights[first + 1]);
        }
    }
    let mut wide: Vec<WideNode> = Vec::new();
    // Binary node, the slot of its parent that waits for its index, entries already on the stack.
    let mut pending = vec![(0_u32, None::<(usize, usize)>, 0_usize)];
    while let Some((index, parent, below)) = pending.pop() {
        let this = wide.len();
        if let Some((node, slot)) = parent {
            wide[node].children[slot] = this as u32;
        }
        let mut children = vec![index];
        while children.len() < 8 {
            let height = children.iter().map(|&c| heights[c as usize]).max();
            if children.len() > 1 && below + children.len() + height.unwrap_or(0) >= STACK {
                break;
            }
            let largest = (0..children.len())
                .filter(|&i| tree.nodes[children[i] as usize].count == 0)
                .max_by(|&i, &j| area(children[i]).total_cmp(&area(children[j])));
            let Some(largest) = largest else { break };
            let first = tree.nodes[children[largest] as usize].first;
            children[largest] = first;
            children.push(first + 1);
        }
        let waiting = below + children.len() - 1;
        let mut node = WideNode {
            planes: [[[f32::INFINITY; 8], [f32::NEG_INFINITY; 8]]; 3],
            children: [NONE; 8],
        };
        for (slot, &child) in children.iter().enumerate() {
            let source = &tree.nodes[child as usize];
            for axis in 0..3 {
                node.planes[axis][0][slot] = source.low[axis];
                node.planes[axis][1][slot] = source.high[axis];
            }
            if source.count == 0 {
                pending.push((child, Some((this, slot)), waiting));
            } else {
                node.children[slot] = child_of[child as usize];
            }
        }
        wide.push(node);
    }
    wide
}
