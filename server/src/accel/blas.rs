//! One mesh ready for rays: its triangles in leaf order under an eight-wide tree.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec3A};

use super::build::{BuildError, BuildLimits, LEAF_SIZE, MOST_TRIANGLES, prepare};
use super::collapse::collapse;
use super::pages::Pages;
use super::sah;
use super::split::BinaryTree;
use crate::scene::Mesh;

/// Marks a child as a leaf. The next two bits are its number of triangles less one, the rest is
/// its index into the blocks.
pub(super) const LEAF: u32 = 1 << 31;
const COUNT_SHIFT: u32 = 29;
/// A child that is not there.
pub(super) const NONE: u32 = u32::MAX;

/// The triangles of one leaf, component by component. Absent ones are NaN, which fail any test.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(32))]
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

/// A node of the eight-wide tree: four cache lines.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(64))]
pub(super) struct WideNode {
    /// `[axis][low, high][child]`; an absent child is empty.
    pub(super) planes: [[[f32; 8]; 2]; 3],
    /// Node index, [`LEAF`] and what goes with it, or [`NONE`].
    pub(super) children: [u32; 8],
    /// Number of children; they come first.
    pub(super) count: u32,
    pub(super) padding: [u32; 7],
}

impl WideNode {
    /// No children.
    pub(super) const EMPTY: Self = Self {
        planes: [[[f32::INFINITY; 8], [f32::NEG_INFINITY; 8]]; 3],
        children: [NONE; 8],
        count: 0,
        padding: [0; 7],
    };
}

/// The name of a leaf among children.
fn leaf(block: usize, count: u32) -> u32 {
    const { assert!(MOST_TRIANGLES <= 1 << COUNT_SHIFT && LEAF_SIZE <= 4) };
    LEAF | (count - 1) << COUNT_SHIFT | block as u32
}

/// Index of the block and number of triangles of a child that is a leaf.
#[inline(always)]
pub(super) fn unpack(leaf: u32) -> (usize, usize) {
    let block = leaf & ((1 << COUNT_SHIFT) - 1);
    (block as usize, (leaf >> COUNT_SHIFT & 3) as usize + 1)
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
    pub(super) blocks: Pages<Block>,
    pub(super) wide: Pages<WideNode>,
    triangles: usize,
}

impl Blas {
    /// Builds the trees. Time is bounded by n log n in the number of triangles, whatever they are.
    ///
    /// Triangles without area are left out (no ray hits them), and so are those with the same
    /// corners as an earlier one. Hits report numbers in `mesh.triangles` all the same.
    pub fn build(mesh: &Mesh, limits: BuildLimits) -> Result<Self, BuildError> {
        let prepared = prepare(mesh, limits)?;
        let tree = sah::build(&prepared.corners);
        let Some(root) = tree.nodes.first() else {
            // No triangle is left: nothing to hit.
            return Ok(Self::default());
        };
        let (blocks, child_of) = lay_out(&tree, &prepared.corners, &prepared.ids);
        Ok(Self {
            centre: prepared.centre,
            low: root.low,
            high: root.high,
            extent: root.low.abs().max(root.high.abs()).max_element(),
            blocks,
            wide: Pages::copied(&collapse(&tree, &child_of)),
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
        std::mem::size_of_val(&self.blocks[..]) + std::mem::size_of_val(&self.wide[..])
    }
}

/// Puts the triangles into blocks, in the order in which a depth-first walk meets the leaves, and
/// names the leaf at each node of the tree.
fn lay_out(tree: &BinaryTree, corners: &[[Vec3A; 3]], ids: &[u32]) -> (Pages<Block>, Vec<u32>) {
    let leaves = tree.nodes.iter().filter(|node| node.count > 0).count();
    let mut pages = Pages::zeroed(leaves);
    let blocks: &mut [Block] = &mut pages;
    let mut laid = 0;
    let mut child_of = vec![NONE; tree.nodes.len()];
    let mut pending = vec![0_u32];
    while let Some(index) = pending.pop() {
        let node = &tree.nodes[index as usize];
        if node.count == 0 {
            pending.push(node.first + 1);
            pending.push(node.first);
        } else {
            child_of[index as usize] = leaf(laid, node.count);
            let range = node.first as usize..(node.first + node.count) as usize;
            blocks[laid] = block(&tree.order[range], corners, ids);
            laid += 1;
        }
    }
    (pages, child_of)
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
