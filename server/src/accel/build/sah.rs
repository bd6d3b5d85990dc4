//! A binary BVH by the surface area heuristic over bins (Wald 2007, "On fast Construction of SAH-based Bounding
//! Volume Hierarchies"), in O(n log n) time for any input: at most 2 log2 n levels are split by the heuristic, which
//! may be unbalanced; below them nodes are split at the median. The first levels of a large mesh sort the cells of a
//! grid instead of triangles (`cells`). Subtrees are built in parallel; the result does not depend on the number of
//! threads.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3, Vec3A, Vec4Swizzles};
use rayon::prelude::*;

use super::bins::{Bins, Bounds, Boxed, Item, bounds_of, cut};
use super::cells::{self, Cells};
use super::layout::{LEAF_SIZE, MOST_TRIANGLES};
use crate::accel::space::largest_axis;
use crate::simd::Pages;

/// Depth of the deepest leaf of any BVH, in edges from the root; it bounds the traversal stacks. At most 2 log2 n
/// levels are split by cost, and at most log2 n median splits follow.
pub(crate) const MAX_DEPTH: usize = 3 * MOST_TRIANGLES.ilog2() as usize;

/// Triangles below which a subtree is one task: about a millisecond of work.
pub(super) const TASK: usize = 1 << 12;

/// A node of the binary BVH.
#[derive(Debug, Clone, Copy, PartialEq, Pod, Zeroable)]
#[repr(C, align(16))]
pub(super) struct Node {
    pub(super) low: Vec3,
    /// Inner node: index of the first of its two children, which are neighbours.
    /// Leaf: first index into the order of triangles.
    pub(super) first: u32,
    pub(super) high: Vec3,
    /// Number of triangles of a leaf; 0 for an inner node.
    pub(super) count: u32,
}

impl Node {
    fn new(bounds: Bounds, first: usize, count: usize) -> Self {
        Self {
            low: bounds.low.xyz(),
            first: first as u32,
            high: bounds.high.xyz(),
            count: count as u32,
        }
    }

    /// Half the surface area.
    pub(super) fn half_area(&self) -> f32 {
        let d = self.high - self.low;
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// A binary BVH over triangles.
pub(super) struct Tree {
    /// Root first, parents before children, descendants of the first child before descendants of the second. Empty
    /// without triangles.
    pub(super) nodes: Pages<Node>,
    /// Triangle indices, leaf by leaf.
    pub(super) order: Vec<u32>,
}

/// Splits triangles; returns the number on the left side.
fn split(items: &mut [Item], centres: Bounds, by_cost: bool, bins: &mut Bins) -> usize {
    let by_cost = if by_cost {
        cut(items, centres, bins)
    } else {
        None
    };
    by_cost.unwrap_or_else(|| {
        let axis = largest_axis((centres.high - centres.low).xyz().to_array());
        let middle = items.len() / 2;
        // Ties are broken by triangle index, so the result does not depend on the input order.
        items.select_nth_unstable_by(middle, |a, b| {
            let (x, y) = (a.centre()[axis], b.centre()[axis]);
            x.total_cmp(&y).then(a.id().cmp(&b.id()))
        });
        middle
    })
}

/// A subtree: its root, and the root's descendants in the order of the whole BVH. Child indices are relative to the
/// first descendant.
pub(super) struct Subtree {
    root: Node,
    below: Below,
}

enum Below {
    Nodes(Vec<Node>),
    Children(Box<(Subtree, Subtree)>),
}

impl Subtree {
    /// A node above two subtrees.
    pub(super) fn over(bounds: Bounds, children: (Self, Self)) -> Self {
        Self {
            root: Node::new(bounds, 0, 0),
            below: Below::Children(Box::new(children)),
        }
    }

    /// Number of nodes below the root.
    fn len(&self) -> usize {
        match &self.below {
            Below::Nodes(nodes) => nodes.len(),
            Below::Children(children) => 2 + children.0.len() + children.1.len(),
        }
    }

    /// Writes the root's descendants to `out`, whose first entry is node `first` of the BVH; returns the root.
    fn write(&self, first: usize, out: &mut [Node]) -> Node {
        let shifted = |node: &Node| Node {
            first: node.first + if node.count == 0 { first as u32 } else { 0 },
            ..*node
        };
        match &self.below {
            Below::Nodes(nodes) => {
                for (out, node) in out.iter_mut().zip(nodes) {
                    *out = shifted(node);
                }
            }
            Below::Children(children) => {
                let (pair, rest) = out.split_at_mut(2);
                let (left, right) = rest.split_at_mut(children.0.len());
                let at = first + 2;
                let middle = at + left.len();
                (pair[0], pair[1]) = rayon::join(
                    || children.0.write(at, left),
                    || children.1.write(middle, right),
                );
            }
        }
        shifted(&self.root)
    }
}

/// Parameters that are the same for all nodes.
#[derive(Clone, Copy)]
pub(super) struct Builder {
    /// Number of levels that are split by cost.
    pub(super) deepest: u32,
}

/// A node to be built.
#[derive(Clone, Copy)]
pub(super) struct Place {
    /// Number of the tree's triangles before the node's own.
    pub(super) start: usize,
    pub(super) depth: u32,
}

impl Place {
    /// Both children, with `left` triangles in the first.
    pub(super) fn children(self, left: usize) -> (Self, Self) {
        let depth = self.depth + 1;
        let start = self.start + left;
        (Self { depth, ..self }, Self { start, depth })
    }
}

impl Builder {
    /// Builds a subtree over triangles; writes their indices in leaf order.
    pub(super) fn subtree(self, items: &mut [Item], order: &mut [u32], place: Place) -> Subtree {
        if items.len() <= TASK {
            return self.task(items, order, place);
        }
        let (bounds, centres) = bounds_of(items);
        let by_cost = place.depth < self.deepest;
        if by_cost && items.len() >= cells::WORTHWHILE {
            let cells = Cells::new(items, centres);
            if let Some(mut clusters) = cells.clusters() {
                return self.over_cells(&cells, &mut clusters, order, place);
            }
        }
        let left = split(items, centres, by_cost, &mut Bins::new());
        let (a, b) = items.split_at_mut(left);
        let (order_a, order_b) = order.split_at_mut(left);
        let (place_a, place_b) = place.children(left);
        let children = rayon::join(
            || self.subtree(a, order_a, place_a),
            || self.subtree(b, order_b, place_b),
        );
        Subtree::over(bounds, children)
    }

    /// Builds a subtree on this thread alone.
    fn task(self, items: &mut [Item], order: &mut [u32], place: Place) -> Subtree {
        let mut nodes: Vec<Node> = Vec::with_capacity(items.len());
        let blank = Node::new(Bounds::EMPTY, 0, 0);
        let mut root = blank;
        let mut bins = Bins::new();
        // Node (none: the root), its range of items, its depth.
        let mut pending = vec![(usize::MAX, 0, items.len(), place.depth)];
        while let Some((node, first, end, depth)) = pending.pop() {
            let part = &mut items[first..end];
            let (bounds, centres) = bounds_of(part);
            let children = nodes.len();
            let entry = nodes.get_mut(node).unwrap_or(&mut root);
            if part.len() <= LEAF_SIZE {
                *entry = Node::new(bounds, place.start + first, part.len());
                continue;
            }
            *entry = Node::new(bounds, children, 0);
            let left = split(part, centres, depth < self.deepest, &mut bins);
            nodes.extend([blank, blank]);
            pending.push((children + 1, first + left, end, depth + 1));
            pending.push((children, first, first + left, depth + 1));
        }
        for (order, item) in order.iter_mut().zip(items) {
            *order = item.id();
        }
        Subtree {
            root,
            below: Below::Nodes(nodes),
        }
    }
}

/// Builds a BVH over the AABBs of `count` triangles with the given corners, at most [`MAX_DEPTH`] deep, with leaves
/// of up to [`LEAF_SIZE`] triangles.
pub(super) fn build(count: usize, corners: impl Fn(usize) -> [Vec3A; 3] + Sync) -> Tree {
    if count == 0 {
        return Tree {
            nodes: Pages::default(),
            order: Vec::new(),
        };
    }
    let mut items = Pages::zeroed(count);
    let numbered = items.par_iter_mut().with_min_len(TASK).enumerate();
    numbered.for_each(|(i, item)| *item = Item::new(corners(i), i as u32));
    let builder = Builder {
        deepest: 2 * count.next_power_of_two().ilog2(),
    };
    let mut order = vec![0; count];
    let tree = builder.subtree(&mut items, &mut order, Place { start: 0, depth: 0 });
    let mut nodes = Pages::zeroed(1 + tree.len());
    let (root, below) = nodes.split_at_mut(1);
    root[0] = tree.write(1, below);
    Tree { nodes, order }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::uniform;

    fn point(i: usize, size: f32) -> Vec3A {
        let at = |d: u32| (uniform(i as u32, 0, d) * size).floor();
        Vec3A::new(at(0), at(1), at(2))
    }

    /// Checks that every triangle is in exactly one leaf, every box contains its descendants, and no leaf is too
    /// deep.
    fn check(count: usize, corners: impl Fn(usize) -> [Vec3A; 3] + Sync) {
        let tree = build(count, &corners);
        let mut ids = tree.order.clone();
        ids.sort_unstable();
        assert!(ids.into_iter().eq(0..count as u32));
        let mut seen = 0;
        let mut pending = vec![(0, 0)];
        while let Some((index, depth)) = pending.pop() {
            let node = tree.nodes[index as usize];
            let holds =
                |low: Vec3, high: Vec3| low.cmpge(node.low).all() && high.cmple(node.high).all();
            assert!(depth <= MAX_DEPTH);
            if node.count == 0 {
                for child in [node.first, node.first + 1] {
                    let below = tree.nodes[child as usize];
                    assert!(child > index && holds(below.low, below.high));
                    pending.push((child, depth + 1));
                }
                continue;
            }
            assert!(node.count as usize <= LEAF_SIZE);
            seen += node.count as usize;
            for &id in &tree.order[node.first as usize..][..node.count as usize] {
                let corners = corners(id as usize).map(Vec3::from);
                assert!(corners.into_iter().all(|p| holds(p, p)));
            }
        }
        assert_eq!(seen, count);
    }

    #[test]
    fn large_trees_are_whole_however_triangles_lie() {
        let n = 3 * cells::WORTHWHILE;
        let at = |p: Vec3A, i: usize| [p, p + Vec3A::X, p + Vec3A::Y * (1 + i % 7) as f32];
        check(n, |i| at(point(i, 1000.0), i));
        // One triangle far away, so that the grid of the root has all the others in one cell.
        let far = |i: usize| if i == 7 { 1e9 } else { 0.0 };
        check(n, |i| at(point(i, 64.0) + far(i), i));
        // All at one place, on a line, and at growing distances.
        check(n, |i| at(Vec3A::ONE, i));
        check(n, |i| at(Vec3A::X * i as f32, i));
        check(n, |i| {
            at(Vec3A::splat((i as f32 / n as f32 * 60.0).exp2()), 0)
        });
    }

    /// Large enough for cells and many tasks, with many equal centres.
    #[test]
    fn the_tree_is_the_same_on_any_number_of_threads() {
        let n = 3 * cells::WORTHWHILE;
        let corners = |i: usize| {
            let p = point(i, 64.0);
            [p, p + Vec3A::X, p + Vec3A::Y * p.z]
        };
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new()
                .num_threads(threads)
                .build()
                .unwrap();
            pool.install(|| build(n, corners))
        };
        let (one, many) = (on(1), on(3));
        assert_eq!(one.order, many.order);
        assert_eq!(one.nodes[..], many.nodes[..]);
    }
}
