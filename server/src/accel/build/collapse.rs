//! The eight-wide tree that a binary one collapses to at least cost (Ylitie, Karras, Laine 2017,
//! "Efficient Incoherent Ray Traversal on GPUs Through Compressed Wide BVHs", section 3.2).

use super::layout::{BLOCK, Block, Cell, NODE, NONE, STACK, WideNode, leaf};
use super::sah::{self, half_area};
use super::sanitise::Prepared;
use super::split::{BinaryNode, BinaryTree};
use crate::simd::Pages;

/// Children of a wide node.
const WIDTH: usize = 8;

/// Cost of testing a leaf's triangles, a node's eight boxes being 1. All leaves stay, so it tells
/// only in which order children come.
const LEAF_COST: f32 = 0.7;

/// Least cost of a subtree as at most `i + 1` children of some wide node.
type Costs = [f32; WIDTH - 1];

/// The split of `slots` children between both sides of a node that costs least: the cost, and
/// how many go left.
fn distribute(left: &Costs, right: &Costs, slots: usize) -> (f32, usize) {
    let mut best = (f32::INFINITY, 1);
    for k in 1..slots {
        let cost = left[k - 1] + right[slots - k - 1];
        if cost < best.0 {
            best = (cost, k);
        }
    }
    best
}

/// What is needed to choose children.
struct Collapse<'a> {
    nodes: &'a [BinaryNode],
    costs: Vec<Costs>,
    /// Longest way down to a leaf, edges.
    heights: Vec<u8>,
}

impl<'a> Collapse<'a> {
    fn new(nodes: &'a [BinaryNode]) -> Self {
        const { assert!(sah::MAX_DEPTH < 256) };
        let mut costs = vec![[0.0; WIDTH - 1]; nodes.len()];
        let mut heights = vec![0; nodes.len()];
        // Children come after their parents.
        for (index, node) in nodes.iter().enumerate().rev() {
            let area = half_area((node.low, node.high));
            if node.count > 0 {
                costs[index] = [area * LEAF_COST; WIDTH - 1];
                continue;
            }
            let first = node.first as usize;
            heights[index] = 1 + u8::max(heights[first], heights[first + 1]);
            let (left, right) = (costs[first], costs[first + 1]);
            let cost = &mut costs[index];
            cost[0] = area + distribute(&left, &right, WIDTH).0;
            for i in 1..WIDTH - 1 {
                cost[i] = cost[i - 1].min(distribute(&left, &right, i + 1).0);
            }
        }
        Self {
            nodes,
            costs,
            heights,
        }
    }

    /// Takes an inner node apart into as many as `slots` children (at least 2).
    fn split(&self, index: u32, slots: usize, children: &mut Vec<u32>) {
        let first = self.nodes[index as usize].first;
        let (left, right) = (&self.costs[first as usize], &self.costs[first as usize + 1]);
        let (_, k) = distribute(left, right, slots);
        self.choose(first, k, children);
        self.choose(first + 1, slots - k, children);
    }

    /// A subtree as at most `slots` children, cheapest.
    fn choose(&self, index: u32, mut slots: usize, children: &mut Vec<u32>) {
        let costs = &self.costs[index as usize];
        while slots > 1 && costs[slots - 1] >= costs[slots - 2] {
            slots -= 1;
        }
        if slots == 1 {
            children.push(index);
        } else {
            self.split(index, slots, children);
        }
    }
}

/// Collapses the binary tree and lays it out: each node is followed by its leaves, then by what
/// is below its last child.
///
/// Every child but the one walked into may wait on the stack. Even if all nodes had two children,
/// a subtree of height h would add h waiting entries, so a node takes apart no more than leaves
/// room for that: then entries waiting plus height stay below [`STACK`] all the way down, as they
/// are at the root.
pub(crate) fn collapse(tree: &BinaryTree, prepared: &Prepared) -> Pages<Cell> {
    const { assert!(sah::MAX_DEPTH < STACK) };
    let plan = Collapse::new(&tree.nodes);
    // Children of each node to be, as numbers in the binary tree, and what the wide one calls them.
    let mut families: Vec<[u32; WIDTH]> = Vec::with_capacity(tree.nodes.len() / 8 + 1);
    let mut name_of = vec![NONE; tree.nodes.len()];
    let mut cells = 0;
    let mut children = Vec::with_capacity(WIDTH);
    // Binary node, entries already on the stack.
    let mut pending = vec![(0_u32, 0_usize)];
    while let Some((index, below)) = pending.pop() {
        children.clear();
        if tree.nodes[index as usize].count > 0 {
            // A single leaf still gets a node above it, so that kernels start at one.
            children.push(index);
        } else {
            name_of[index as usize] = cells as u32;
            let height = usize::from(plan.heights[index as usize]);
            let room = below + WIDTH + height < STACK;
            plan.split(index, if room { WIDTH } else { 2 }, &mut children);
        }
        // Walks that look for any hit take the last first: there a ray is soon stopped, or soon
        // through.
        children.sort_by(|&x, &y| {
            let cost = |child: u32| plan.costs[child as usize][0];
            cost(y).total_cmp(&cost(x))
        });
        cells += NODE;
        let mut family = [NONE; WIDTH];
        for (place, &child) in family.iter_mut().zip(&children) {
            *place = child;
            let count = tree.nodes[child as usize].count;
            if count == 0 {
                pending.push((child, below + children.len() - 1));
            } else {
                name_of[child as usize] = leaf(cells, count);
                cells += BLOCK;
            }
        }
        families.push(family);
    }
    let mut pages = Pages::zeroed(cells);
    fill(&mut pages, tree, prepared, &families, &name_of);
    pages
}

/// Writes nodes and leaves in the order in which their places were given out.
fn fill(
    mut cells: &mut [Cell],
    tree: &BinaryTree,
    prepared: &Prepared,
    families: &[[u32; WIDTH]],
    name_of: &[u32],
) {
    // Takes the cells of the next value.
    let mut write = |value: &[Cell]| {
        let (first, rest) = std::mem::take(&mut cells).split_at_mut(value.len());
        first.copy_from_slice(value);
        cells = rest;
    };
    for family in families {
        let children = family.iter().take_while(|&&child| child != NONE);
        let mut node = WideNode::EMPTY;
        for (slot, &child) in children.clone().enumerate() {
            let source = &tree.nodes[child as usize];
            for axis in 0..3 {
                node.planes[axis][0][slot] = source.low[axis];
                node.planes[axis][1][slot] = source.high[axis];
            }
            node.children[slot] = name_of[child as usize];
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
fn block_of(order: &[u32], prepared: &Prepared) -> Block {
    let mut block = Block::EMPTY;
    for (k, &i) in order.iter().enumerate() {
        for (corner, p) in prepared.corners[i as usize].iter().enumerate() {
            for axis in 0..3 {
                block.corners[corner][axis][k] = p[axis];
            }
        }
        block.ids[k] = prepared.ids[i as usize];
    }
    block
}
