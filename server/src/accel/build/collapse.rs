//! Collapses the binary BVH to an eight-wide BVH at the least cost (Ylitie, Karras, Laine 2017, "Efficient Incoherent
//! Ray Traversal on GPUs Through Compressed Wide BVHs", section 3.2).

use super::layout::{BLOCK, Block, Cell, NODE, NONE, STACK, WideNode, leaf};
use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::sah::{self, Node};
use super::sanitise::Prepared;
use crate::simd::Pages;

/// Children of a wide node.
const WIDTH: usize = 8;

/// Binary nodes below which a subtree is one task: about half a millisecond of work.
const TASK: usize = 1 << 13;

/// Cost of testing a leaf's triangles; testing the eight boxes of a node costs 1. All leaves are kept, so it affects
/// only the order of children.
const LEAF_COST: f32 = 0.7;

/// Collapse costs of a subtree of the binary BVH.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Subtree {
    /// Least cost if the subtree becomes at most `i + 1` children of a wide node.
    costs: [f32; WIDTH - 1],
    /// Longest path down to a leaf, edges.
    height: u32,
}

impl Subtree {
    /// For one node; `below` holds the subtrees of the nodes from `first` on, including its children.
    fn new(node: &Node, below: &[Self], first: usize) -> Self {
        let area = node.half_area();
        if node.count > 0 {
            return Self {
                costs: [area * LEAF_COST; WIDTH - 1],
                height: 0,
            };
        }
        let child = node.first as usize - first;
        let (left, right) = (&below[child], &below[child + 1]);
        let mut costs = [area + left.distribute(right, WIDTH).0; WIDTH - 1];
        for i in 1..WIDTH - 1 {
            costs[i] = costs[i - 1].min(left.distribute(right, i + 1).0);
        }
        let height = 1 + left.height.max(right.height);
        Self { costs, height }
    }

    /// The cheapest split of `slots` children between both sides of a node: its cost, and the number of slots of this
    /// side.
    fn distribute(&self, right: &Self, slots: usize) -> (f32, usize) {
        let mut best = (f32::INFINITY, 1);
        for k in 1..slots {
            let cost = self.costs[k - 1] + right.costs[slots - k - 1];
            if cost < best.0 {
                best = (cost, k);
            }
        }
        best
    }

    /// Fills `out` for the nodes from `first` on, as many as `out` has room for: two siblings and their descendants.
    fn fill(nodes: &[Node], first: usize, out: &mut [Self]) {
        let last = first + out.len();
        let alone = if out.len() > TASK {
            // Descendants of the first child are stored before descendants of the second.
            let second = &nodes[first + 1];
            let middle = if second.count == 0 {
                second.first as usize
            } else {
                last
            };
            let (left, right) = out[2..].split_at_mut(middle - first - 2);
            rayon::join(
                || Self::fill(nodes, first + 2, left),
                || Self::fill(nodes, middle, right),
            );
            2
        } else {
            out.len()
        };
        // Children are stored after their parents.
        for i in (0..alone).rev() {
            out[i] = Self::new(&nodes[first + i], out, first);
        }
    }
}

/// A node of the binary tree that becomes a child of a wide one.
#[derive(Clone, Copy)]
struct Child {
    index: u32,
    /// Its descendants end before this node.
    end: u32,
}

/// A wide node before it is written.
struct Family {
    /// Its children in the binary tree.
    children: [u32; WIDTH],
    /// The child references stored in the wide node, cells counted from the first cell of the part.
    names: [u32; WIDTH],
}

/// Root of a part of the wide BVH.
struct Start {
    child: Child,
    /// Stack entries of a traversal when it reaches this node.
    waiting: usize,
    /// Family and slot that refer to this node.
    parent: (usize, usize),
}

/// A part of the wide BVH: its nodes in memory order.
struct Part {
    families: Vec<Family>,
    cells: usize,
    /// Subtrees that become parts of their own.
    left_out: Vec<Start>,
}

/// Inputs for choosing children.
struct Collapse<'a> {
    nodes: &'a [Node],
    subtrees: Pages<Subtree>,
}

impl<'a> Collapse<'a> {
    fn new(nodes: &'a [Node]) -> Self {
        let mut subtrees = Pages::zeroed(nodes.len());
        Subtree::fill(nodes, 1, &mut subtrees[1..]);
        subtrees[0] = Subtree::new(&nodes[0], &subtrees, 0);
        Self { nodes, subtrees }
    }

    /// Splits an inner node into at most `slots` children (`slots` is at least 2).
    fn split(&self, node: Child, slots: usize, children: &mut Vec<Child>) {
        let first = self.nodes[node.index as usize].first;
        let (left, right) = (first as usize, first as usize + 1);
        let (_, k) = self.subtrees[left].distribute(&self.subtrees[right], slots);
        let middle = if self.nodes[right].count == 0 {
            self.nodes[right].first
        } else {
            node.end
        };
        let child = |index, end| Child { index, end };
        self.choose(child(first, middle), k, children);
        self.choose(child(first + 1, node.end), slots - k, children);
    }

    /// Replaces a subtree by at most `slots` children, at the least cost.
    fn choose(&self, node: Child, mut slots: usize, children: &mut Vec<Child>) {
        let costs = &self.subtrees[node.index as usize].costs;
        while slots > 1 && costs[slots - 1] >= costs[slots - 2] {
            slots -= 1;
        }
        if slots == 1 {
            children.push(node);
        } else {
            self.split(node, slots, children);
        }
    }

    /// Collects the wide nodes from `start` on, except subtrees of at most `left_out` binary nodes.
    ///
    /// Every child except the one being visited may be on the traversal stack. If all nodes had two children, a
    /// subtree of height h would add h stack entries. So a node is split into more than two children only if this
    /// leaves enough room: stack entries plus height stay below [`STACK`] on the whole path, as they do at the root.
    fn part(&self, start: Start, left_out: usize) -> Part {
        const { assert!(sah::MAX_DEPTH < STACK) };
        let mut part = Part {
            families: Vec::new(),
            cells: 0,
            left_out: Vec::new(),
        };
        let mut children = Vec::with_capacity(WIDTH);
        let mut pending = vec![start];
        while let Some(start) = pending.pop() {
            let node = &self.nodes[start.child.index as usize];
            children.clear();
            if node.count > 0 {
                // A single leaf still gets a parent node, because kernels start at a node.
                children.push(start.child);
            } else {
                let height = self.subtrees[start.child.index as usize].height as usize;
                let room = start.waiting + WIDTH + height < STACK;
                self.split(start.child, if room { WIDTH } else { 2 }, &mut children);
            }
            // Any-hit traversal visits the last child first: there a ray soon finds a hit, or soon leaves.
            children.sort_by(|x, y| {
                let cost = |child: &Child| self.subtrees[child.index as usize].costs[0];
                cost(y).total_cmp(&cost(x))
            });
            let (family, slot) = start.parent;
            if let Some(parent) = part.families.get_mut(family) {
                parent.names[slot] = part.cells as u32;
            }
            let number = part.families.len();
            let mut family = Family {
                children: [NONE; WIDTH],
                names: [NONE; WIDTH],
            };
            part.cells += NODE;
            for (slot, &child) in children.iter().enumerate() {
                family.children[slot] = child.index;
                let node = &self.nodes[child.index as usize];
                if node.count > 0 {
                    family.names[slot] = leaf(part.cells, node.count);
                    part.cells += BLOCK;
                    continue;
                }
                let start = Start {
                    child,
                    waiting: start.waiting + children.len() - 1,
                    parent: (number, slot),
                };
                if (child.end - node.first) as usize <= left_out {
                    part.left_out.push(start);
                } else {
                    pending.push(start);
                }
            }
            part.families.push(family);
        }
        part
    }
}

/// Collapses the binary BVH and lays it out: the nodes of large subtrees, then the small subtrees one after the
/// other. Each node is followed by its leaves, then by the descendants of its last child.
pub(super) fn collapse(tree: &sah::Tree, prepared: &Prepared<'_>) -> Pages<Cell> {
    let plan = Collapse::new(&tree.nodes);
    let root = Start {
        child: Child {
            index: 0,
            end: tree.nodes.len() as u32,
        },
        waiting: 0,
        parent: (NONE as usize, 0),
    };
    let mut top = plan.part(root, TASK);
    let starts = std::mem::take(&mut top.left_out);
    let parents: Vec<(usize, usize)> = starts.iter().map(|start| start.parent).collect();
    let parts = starts.into_par_iter().with_max_len(1).map(|start| {
        let parent = (NONE as usize, 0);
        plan.part(Start { parent, ..start }, 0)
    });
    let parts: Vec<Part> = parts.collect();
    let mut total = top.cells;
    for (part, (family, slot)) in parts.iter().zip(parents) {
        top.families[family].names[slot] = total as u32;
        total += part.cells;
    }
    let mut pages = Pages::zeroed(total);
    let mut first = 0;
    let mut rest = &mut pages[..];
    let mut places = Vec::with_capacity(1 + parts.len());
    for part in std::iter::once(&top).chain(&parts) {
        let cells;
        (cells, rest) = std::mem::take(&mut rest).split_at_mut(part.cells);
        places.push((part, first, cells));
        first += part.cells;
    }
    let places = places.into_par_iter().with_max_len(1);
    places.for_each(|(part, first, cells)| {
        write(part, first as u32, cells, tree, prepared);
    });
    pages
}

/// Writes nodes and leaves in the order in which their cells were assigned. `first` is the index of the first cell.
fn write(part: &Part, first: u32, cells: &mut [Cell], tree: &sah::Tree, prepared: &Prepared<'_>) {
    let mut rest = cells;
    // Writes a value into the next cells.
    let mut write = |value: &[Cell]| {
        let (first, others) = std::mem::take(&mut rest).split_at_mut(value.len());
        first.copy_from_slice(value);
        rest = others;
    };
    for family in &part.families {
        let children = family.children.iter().take_while(|&&child| child != NONE);
        let mut node = WideNode::EMPTY;
        for (slot, &child) in children.clone().enumerate() {
            let source = &tree.nodes[child as usize];
            for axis in 0..3 {
                node.planes[axis][0][slot] = source.low[axis];
                node.planes[axis][1][slot] = source.high[axis];
            }
            // The cell index is in the lowest bits of a leaf reference too.
            node.children[slot] = family.names[slot] + first;
        }
        write(bytemuck::cast_slice(std::slice::from_ref(&node)));
        for &child in children {
            let source = &tree.nodes[child as usize];
            if source.count > 0 {
                let range = source.first as usize..(source.first + source.count) as usize;
                let block = block_of(&tree.order[range], prepared);
                write(bytemuck::cast_slice(std::slice::from_ref(&block)));
            }
        }
    }
}

/// The triangles of a leaf.
fn block_of(order: &[u32], prepared: &Prepared<'_>) -> Block {
    let mut block = Block::EMPTY;
    for (k, &i) in order.iter().enumerate() {
        for (corner, p) in prepared.corners(i as usize).iter().enumerate() {
            for axis in 0..3 {
                block.corners[corner][axis][k] = p[axis];
            }
        }
        block.ids[k] = prepared.ids[i as usize];
    }
    block
}
