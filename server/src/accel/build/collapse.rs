//! The eight-wide tree that a binary one collapses to at least cost (Ylitie, Karras, Laine 2017,
//! "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", section 3.2).

use super::layout::{BLOCK, Block, Cell, NODE, NONE, STACK, WideNode, leaf};
use bytemuck::{Pod, Zeroable};
use rayon::prelude::*;

use super::sah::{self, Node};
use super::sanitise::Prepared;
use crate::simd::Pages;

/// Children of a wide node.
const WIDTH: usize = 8;

/// Nodes of the binary tree below which a subtree is one task: about half a millisecond's worth.
const TASK: usize = 1 << 13;

/// Cost of testing a leaf's triangles, a node's eight boxes being 1. All leaves stay, so it tells
/// only in which order children come.
const LEAF_COST: f32 = 0.7;

/// What is known of a subtree of the binary tree.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
struct Subtree {
    /// Least cost as at most `i + 1` children of some wide node.
    costs: [f32; WIDTH - 1],
    /// Longest way down to a leaf, edges.
    height: u32,
}

impl Subtree {
    /// Of a node; `below` is what is known of the nodes from `first` on, among them its children.
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

    /// The split of `slots` children between both sides of a node that costs least: the cost, and
    /// how many go to this side.
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

    /// Of all nodes from `first` on, as many as `out` has room for: two children and what is below
    /// them.
    fn fill(nodes: &[Node], first: usize, out: &mut [Self]) {
        let last = first + out.len();
        let alone = if out.len() > TASK {
            // What is below the first child comes before what is below the second.
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
        // Children come after their parents.
        for i in (0..alone).rev() {
            out[i] = Self::new(&nodes[first + i], out, first);
        }
    }
}

/// A node of the binary tree that becomes a child of a wide one.
#[derive(Clone, Copy)]
struct Child {
    index: u32,
    /// What is below it ends before this node.
    end: u32,
}

/// A wide node to be.
struct Family {
    /// Its children in the binary tree.
    children: [u32; WIDTH],
    /// What the wide node will call them, cells counted from the first of the part.
    names: [u32; WIDTH],
}

/// Where a part of the wide tree begins.
struct Start {
    child: Child,
    /// Entries already on the stack of a walk that comes here.
    waiting: usize,
    /// Family and slot that lead here.
    parent: (usize, usize),
}

/// A part of the wide tree: nodes in the order in which they will lie in memory.
struct Part {
    families: Vec<Family>,
    cells: usize,
    /// Subtrees left to other parts.
    left_out: Vec<Start>,
}

/// What is needed to choose children.
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

    /// Takes an inner node apart into as many as `slots` children (at least 2).
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

    /// A subtree as at most `slots` children, cheapest.
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

    /// The wide nodes from `start` on, but for subtrees of at most `left_out` nodes.
    ///
    /// Every child but the one walked into may wait on the stack. Even if all nodes had two
    /// children, a subtree of height h would add h waiting entries, so a node takes apart no more
    /// than leaves room for that: then entries waiting plus height stay below [`STACK`] all the way
    /// down, as they are at the root.
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
                // A single leaf still gets a node above it, so that kernels start at one.
                children.push(start.child);
            } else {
                let height = self.subtrees[start.child.index as usize].height as usize;
                let room = start.waiting + WIDTH + height < STACK;
                self.split(start.child, if room { WIDTH } else { 2 }, &mut children);
            }
            // Walks that look for any hit take the last first: there a ray is soon stopped, or soon
            // through.
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

/// Collapses the binary tree and lays it out: the nodes of large subtrees, then small subtrees one
/// after the other. Each node is followed by its leaves, then by what is below its last child.
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

/// Writes nodes and leaves in the order in which their places were given out. `first` is the
/// place of the first cell.
fn write(part: &Part, first: u32, cells: &mut [Cell], tree: &sah::Tree, prepared: &Prepared<'_>) {
    let mut rest = cells;
    // Takes the cells of the next value.
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
            // The cell is in the lowest bits of a leaf's name too.
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
