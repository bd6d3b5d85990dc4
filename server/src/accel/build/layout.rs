//! Memory layout of a BVH: nodes and leaf triangles are stored in cells of half a cache line, so that neither spans
//! more cache lines than necessary. Each node is followed by its leaves.

use bytemuck::{Pod, Zeroable};

/// Most triangles in a leaf, and in the vector test of a leaf.
pub(crate) const LEAF_SIZE: usize = 4;

/// Most triangles of a BVH, so that its cells can still be addressed by 29 bits.
pub(crate) const MOST_TRIANGLES: usize = 1 << 25;

/// Size of the traversal stack; the BVH is built so that no traversal needs more (`collapse`).
pub(crate) const STACK: usize = 96;

/// Unit of memory of a BVH.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(32))]
pub(crate) struct Cell([u32; 8]);

/// Cells of a node.
pub(crate) const NODE: usize = size_of::<WideNode>() / size_of::<Cell>();
/// Cells of a block.
pub(crate) const BLOCK: usize = size_of::<Block>() / size_of::<Cell>();

/// Marks a child as a leaf. The next two bits are its number of triangles minus one, the remaining bits are the index
/// of its first cell.
pub(crate) const LEAF: u32 = 1 << 31;
/// Marks an absent child.
pub(crate) const NONE: u32 = u32::MAX;

const CELL_BITS: u32 = 29;
const CELL_MASK: u32 = (1 << CELL_BITS) - 1;

/// The triangles of one leaf, structure of arrays. Absent triangles are NaN, which fails every test.
#[derive(Debug, Clone, Copy, Pod, Zeroable)]
#[repr(C, align(32))]
pub(crate) struct Block {
    /// `[corner][axis][triangle]`.
    pub(crate) corners: [[[f32; LEAF_SIZE]; 3]; 3],
    /// Triangle indices in the mesh.
    pub(crate) ids: [u32; LEAF_SIZE],
}

impl Block {
    /// A block without triangles.
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
    /// Per child: first cell of a node, or [`LEAF`] with its fields, or [`NONE`].
    pub(crate) children: [u32; 8],
}

impl WideNode {
    /// A node without children.
    pub(crate) const EMPTY: Self = Self {
        planes: [[[f32::INFINITY; 8], [f32::NEG_INFINITY; 8]]; 3],
        children: [NONE; 8],
    };
}

/// The child reference of a leaf.
pub(crate) fn leaf(first: usize, count: u32) -> u32 {
    // Worst case: one leaf per triangle, and one node per leaf.
    const { assert!(MOST_TRIANGLES * (NODE + BLOCK) < 1 << CELL_BITS && LEAF_SIZE == 4) };
    LEAF | (count - 1) << CELL_BITS | first as u32
}

/// Number of triangles of a leaf child.
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

/// The triangles of a leaf child.
#[inline(always)]
pub(crate) fn block(cells: &[Cell], leaf: u32) -> &Block {
    let first = (leaf & CELL_MASK) as usize;
    &bytemuck::cast_slice(&cells[first..first + BLOCK])[0]
}

/// The first bytes of a child of either kind, as many as the larger kind has.
#[inline(always)]
pub(crate) fn bytes(cells: &[Cell], child: u32) -> Option<&[Cell; NODE]> {
    let first = (child & CELL_MASK) as usize;
    cells.get(first..first + NODE)?.try_into().ok()
}
