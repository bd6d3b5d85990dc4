//! A tree in memory: nodes and the triangles of leaves side by side in cells of half a cache
//! line, so that neither spans more lines than it must, each node followed by its leaves.

use bytemuck::{Pod, Zeroable};

/// Most triangles in a leaf, and in the vector test of a leaf.
pub(crate) const LEAF_SIZE: usize = 4;

/// So many that trees of them are still addressed by 29 bits.
pub(crate) const MOST_TRIANGLES: usize = 1 << 25;

/// Entries of a walk's stack; the tree is made so that no walk needs more (`collapse`).
pub(crate) const STACK: usize = 96;

/// What trees are made of.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(32))]
pub(crate) struct Cell([u32; 8]);

/// Cells of a node.
pub(crate) const NODE: usize = size_of::<WideNode>() / size_of::<Cell>();
/// Cells of a block.
pub(crate) const BLOCK: usize = size_of::<Block>() / size_of::<Cell>();

/// Marks a child as a leaf. The next two bits are its number of triangles less one, the rest is
/// its first cell.
pub(crate) const LEAF: u32 = 1 << 31;
/// A child that is not there.
pub(crate) const NONE: u32 = u32::MAX;

const CELL_BITS: u32 = 29;
const CELL_MASK: u32 = (1 << CELL_BITS) - 1;

/// The triangles of one leaf, component by component. Absent ones are NaN, which fail any test.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(32))]
pub(crate) struct Block {
    /// `[corner][axis][triangle]`.
    pub(crate) corners: [[[f32; LEAF_SIZE]; 3]; 3],
    /// Numbers in the mesh.
    pub(crate) ids: [u32; LEAF_SIZE],
}

impl Block {
    /// No triangles.
    pub(crate) const EMPTY: Self = Self {
        corners: [[[f32::NAN; LEAF_SIZE]; 3]; 3],
        ids: [NONE; LEAF_SIZE],
    };

    /// The corners of one triangle.
    #[inline(always)]
    pub(crate) fn triangle(&self, k: usize) -> [[f32; 3]; 3] {
        self.corners.map(|corner| corner.map(|axis| axis[k]))
    }
}

/// A node of the eight-wide tree.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(32))]
pub(crate) struct WideNode {
    /// `[axis][low, high][child]`; an absent child is empty.
    pub(crate) planes: [[[f32; 8]; 2]; 3],
    /// First cell of a node, [`LEAF`] and what goes with it, or [`NONE`].
    pub(crate) children: [u32; 8],
}

impl WideNode {
    /// No children.
    pub(crate) const EMPTY: Self = Self {
        planes: [[[f32::INFINITY; 8], [f32::NEG_INFINITY; 8]]; 3],
        children: [NONE; 8],
    };
}

/// The name of a leaf among children.
pub(crate) fn leaf(first: usize, count: u32) -> u32 {
    // A leaf for each triangle, a node for each leaf.
    const { assert!(MOST_TRIANGLES * (NODE + BLOCK) < 1 << CELL_BITS && LEAF_SIZE == 4) };
    LEAF | (count - 1) << CELL_BITS | first as u32
}

/// Number of triangles of a child that is a leaf.
#[inline(always)]
pub(crate) fn triangles(leaf: u32) -> usize {
    (leaf >> CELL_BITS & 3) as usize + 1
}

/// The node at a cell.
#[inline(always)]
pub(crate) fn node(cells: &[Cell], child: u32) -> &WideNode {
    let first = (child & CELL_MASK) as usize;
    &bytemuck::cast_slice(&cells[first..first + NODE])[0]
}

/// The triangles of a child that is a leaf.
#[inline(always)]
pub(crate) fn block(cells: &[Cell], leaf: u32) -> &Block {
    let first = (leaf & CELL_MASK) as usize;
    &bytemuck::cast_slice(&cells[first..first + BLOCK])[0]
}

/// The first bytes of a child, whatever it is: as much as the larger of both.
#[inline(always)]
pub(crate) fn bytes(cells: &[Cell], child: u32) -> Option<&[Cell; NODE]> {
    let first = (child & CELL_MASK) as usize;
    cells.get(first..first + NODE)?.try_into().ok()
}
