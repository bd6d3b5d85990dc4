//! A tree by the surface area heuristic over bins (Wald 2007, "On fast Construction of SAH-based
//! Bounding Volume Hierarchies"), in time n log n whatever the boxes look like: levels in which
//! the heuristic may split lopsidedly are limited to twice log2 n, below that halves are cut at
//! medians. Subtrees are built in parallel; the tree is the same on any number of threads.

use glam::{Vec3A, Vec4, Vec4Swizzles};
use rayon::prelude::*;

use super::layout::{LEAF_SIZE, MOST_TRIANGLES};
use super::split::{BinaryNode, BinaryTree};
use crate::accel::space::largest_axis;

/// Bins per axis. Nodes with few boxes use fewer.
const BINS: usize = 32;

/// Deepest leaf of any tree, in edges from the root, which bounds the stacks of all walks. Twice
/// log2 n levels are cut by cost, and at most log2 n halve what is left.
pub(crate) const MAX_DEPTH: usize = 3 * MOST_TRIANGLES.ilog2() as usize;

/// Boxes below which a subtree is one task: about a millisecond's worth.
const TASK: usize = 1 << 12;

/// Boxes above which the bins of a single node are filled in parallel, this many a task.
const BIN_TASK: usize = 1 << 15;

/// Low and high corner. The fourth component is not used.
#[derive(Clone, Copy)]
struct Bounds {
    low: Vec4,
    high: Vec4,
}

impl Bounds {
    const EMPTY: Self = Self {
        low: Vec4::INFINITY,
        high: Vec4::NEG_INFINITY,
    };

    #[inline(always)]
    fn union(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }

    /// Half the surface, of a box that is not empty.
    #[inline(always)]
    fn half_area(self) -> f32 {
        let d = self.high - self.low;
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// Half the surface of a box that is not empty.
pub(crate) fn half_area((low, high): (Vec3A, Vec3A)) -> f32 {
    let d = high - low;
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// A box to be sorted into the tree, moved as a whole so that memory is read in order.
///
/// The fourth component of the low corner holds the number, as a float between 2 and 32: one that
/// is not normal would slow every operation down.
#[derive(Clone, Copy)]
struct Item(Bounds);

impl Item {
    const TAG: u32 = 0x4000_0000;

    fn new([a, b, c]: [Vec3A; 3], id: u32) -> Self {
        const { assert!(MOST_TRIANGLES <= 1 << 25) };
        Self(Bounds {
            low: a.min(b).min(c).extend(f32::from_bits(Self::TAG | id)),
            high: a.max(b).max(c).extend(0.0),
        })
    }

    fn id(&self) -> u32 {
        self.0.low.w.to_bits() & !Self::TAG
    }

    /// Twice the centre.
    #[inline(always)]
    fn centre(&self) -> Vec4 {
        self.0.low + self.0.high
    }
}

/// What so many triangles cost: by themselves, and by the leaves that they fill or begin.
#[inline(always)]
fn work(count: u32) -> f32 {
    (count + count.next_multiple_of(LEAF_SIZE as u32)) as f32
}

/// Where to cut: items whose bin on `axis` is below `bin` go left.
#[derive(Clone, Copy)]
struct Plane {
    axis: usize,
    bin: usize,
}

/// The bins of a node: even steps over its centres.
#[derive(Clone, Copy)]
struct Grid {
    low: Vec4,
    steps: Vec4,
    bins: usize,
}

impl Grid {
    fn new(centres: Bounds, count: usize) -> Self {
        let bins = (2 * count).min(BINS);
        Self {
            low: centres.low,
            // Where all centres agree the step is infinite and they fall into bin 0: 0 * inf is
            // NaN, which converts to 0.
            steps: Vec4::splat(bins as f32) / (centres.high - centres.low),
            bins,
        }
    }

    #[inline(always)]
    fn bin(&self, at: f32) -> usize {
        (at as u32 as usize).min(self.bins - 1)
    }

    /// The item's bins on all axes.
    #[inline(always)]
    fn place(&self, item: &Item) -> [usize; 3] {
        let at = (item.centre() - self.low) * self.steps;
        [self.bin(at.x), self.bin(at.y), self.bin(at.z)]
    }
}

/// What fell into the bins of an axis.
#[derive(Clone, Copy)]
struct Axis {
    bounds: [Bounds; BINS],
    counts: [u32; BINS],
}

/// What fell into the bins of a node.
#[derive(Clone)]
struct Bins([Axis; 3]);

impl Bins {
    fn new() -> Self {
        let empty = Axis {
            bounds: [Bounds::EMPTY; BINS],
            counts: [0; BINS],
        };
        Self([empty; 3])
    }

    #[inline(always)]
    fn clear(&mut self, bins: usize) {
        for axis in &mut self.0 {
            axis.bounds[..bins].fill(Bounds::EMPTY);
            axis.counts[..bins].fill(0);
        }
    }

    #[inline(always)]
    fn add(&mut self, items: &[Item], grid: &Grid) {
        for item in items {
            let place = grid.place(item);
            for (axis, bin) in self.0.iter_mut().zip(place) {
                let bin = bin & (BINS - 1);
                axis.bounds[bin] = axis.bounds[bin].union(item.0);
                axis.counts[bin] += 1;
            }
        }
    }

    fn merge(mut self, other: &Self) -> Self {
        for (axis, other) in self.0.iter_mut().zip(&other.0) {
            for bin in 0..BINS {
                axis.bounds[bin] = axis.bounds[bin].union(other.bounds[bin]);
                axis.counts[bin] += other.counts[bin];
            }
        }
        self
    }

    /// The cut that costs least: area times work, both sides together. `None` if no cut has boxes
    /// on both sides. A cut before an empty bin costs what the one behind it costs, so only those
    /// before bins that hold something are looked at.
    #[inline(always)]
    fn cheapest(&self, bins: usize) -> Option<Plane> {
        let mut best = (f32::INFINITY, None);
        for (number, axis) in self.0.iter().enumerate() {
            let mut filled = 0_u32;
            for bin in 0..bins {
                filled |= u32::from(axis.counts[bin] != 0) << bin;
            }
            // What lies before each filled bin.
            let mut left = [0.0_f32; BINS];
            let (mut bounds, mut count) = (Bounds::EMPTY, 0);
            let mut todo = filled;
            while todo != 0 {
                let bin = todo.trailing_zeros() as usize & (BINS - 1);
                todo &= todo - 1;
                left[bin] = if count == 0 {
                    f32::INFINITY
                } else {
                    bounds.half_area() * work(count)
                };
                bounds = bounds.union(axis.bounds[bin]);
                count += axis.counts[bin];
            }
            (bounds, count) = (Bounds::EMPTY, 0);
            let mut todo = filled & !1;
            while todo != 0 {
                let bin = (31 - todo.leading_zeros()) as usize & (BINS - 1);
                todo &= !(1 << bin);
                bounds = bounds.union(axis.bounds[bin]);
                count += axis.counts[bin];
                let cost = left[bin] + bounds.half_area() * work(count);
                if cost < best.0 {
                    best = (cost, Some(Plane { axis: number, bin }));
                }
            }
        }
        best.1
    }
}

/// Moves the items left of the plane to the front; returns how many there are. Without a branch,
/// for which way an item goes cannot be predicted.
#[inline(always)]
fn partition(items: &mut [Item], grid: &Grid, plane: Plane) -> usize {
    let (low, step) = (grid.low[plane.axis], grid.steps[plane.axis]);
    let mut left = 0;
    for i in 0..items.len() {
        let item = items[i];
        let at = (item.centre()[plane.axis] - low) * step;
        let goes_left = grid.bin(at) < plane.bin;
        items[i] = items[left];
        items[left] = item;
        left += usize::from(goes_left);
    }
    left
}

/// Bounds of the items and of their centres.
fn bounds_of(items: &[Item]) -> (Bounds, Bounds) {
    let of = |items: &[Item]| {
        let (mut bounds, mut centres) = (Bounds::EMPTY, Bounds::EMPTY);
        for item in items {
            let centre = item.centre();
            bounds = bounds.union(item.0);
            centres = centres.union(Bounds {
                low: centre,
                high: centre,
            });
        }
        (bounds, centres)
    };
    if items.len() < 2 * BIN_TASK {
        return of(items);
    }
    items.par_chunks(BIN_TASK).map(of).reduce(
        || (Bounds::EMPTY, Bounds::EMPTY),
        |a, b| (a.0.union(b.0), a.1.union(b.1)),
    )
}

/// Splits items; returns how many go left.
fn split(items: &mut [Item], centres: Bounds, by_cost: bool, bins: &mut Bins) -> usize {
    let grid = Grid::new(centres, items.len());
    let plane = if !by_cost {
        None
    } else if items.len() < 2 * BIN_TASK {
        bins.clear(grid.bins);
        bins.add(items, &grid);
        bins.cheapest(grid.bins)
    } else {
        let of = |items: &[Item]| {
            let mut bins = Box::new(Bins::new());
            bins.add(items, &grid);
            bins
        };
        let all = items
            .par_chunks(BIN_TASK)
            .map(of)
            .reduce(|| Box::new(Bins::new()), |a, b| Box::new(a.merge(&b)));
        all.cheapest(grid.bins)
    };
    match plane {
        Some(plane) => partition(items, &grid, plane),
        None => {
            let axis = largest_axis((centres.high - centres.low).xyz().to_array());
            let middle = items.len() / 2;
            // The number breaks ties, so the tree is the same whatever the order was.
            items.select_nth_unstable_by(middle, |a, b| {
                let (x, y) = (a.centre()[axis], b.centre()[axis]);
                x.total_cmp(&y).then(a.id().cmp(&b.id()))
            });
            middle
        }
    }
}

/// A subtree: its root, and what is below it in the order of the whole tree, with children counted
/// from the first of these.
struct Subtree {
    root: BinaryNode,
    below: Below,
}

enum Below {
    Nodes(Vec<BinaryNode>),
    Children(Box<(Subtree, Subtree)>),
}

impl Subtree {
    /// Number of nodes below the root.
    fn len(&self) -> usize {
        match &self.below {
            Below::Nodes(nodes) => nodes.len(),
            Below::Children(children) => 2 + children.0.len() + children.1.len(),
        }
    }

    /// Writes what is below the root, whose place in the tree is `first`; returns the root.
    fn write(&self, first: usize, out: &mut [BinaryNode]) -> BinaryNode {
        let shifted = |node: &BinaryNode| BinaryNode {
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

/// What stays the same for all nodes.
#[derive(Clone, Copy)]
struct Builder {
    /// Levels that are cut by cost.
    deepest: u32,
}

impl Builder {
    /// A subtree over items, the first of which is number `start` of all.
    fn subtree(self, items: &mut [Item], start: usize, depth: u32) -> Subtree {
        if items.len() <= TASK {
            return self.task(items, start, depth);
        }
        let (bounds, centres) = bounds_of(items);
        let left = split(items, centres, depth < self.deepest, &mut Bins::new());
        let (a, b) = items.split_at_mut(left);
        let children = rayon::join(
            || self.subtree(a, start, depth + 1),
            || self.subtree(b, start + left, depth + 1),
        );
        Subtree {
            root: node_of(bounds, 0, 0),
            below: Below::Children(Box::new(children)),
        }
    }

    /// A subtree on this thread alone.
    fn task(self, items: &mut [Item], start: usize, depth: u32) -> Subtree {
        let mut nodes: Vec<BinaryNode> = Vec::with_capacity(items.len());
        let blank = node_of(Bounds::EMPTY, 0, 0);
        let mut root = blank;
        let mut bins = Bins::new();
        // Node (none: the root), its range of items, its depth.
        let mut pending = vec![(usize::MAX, 0, items.len(), depth)];
        while let Some((node, first, end, depth)) = pending.pop() {
            let part = &mut items[first..end];
            let (bounds, centres) = bounds_of(part);
            let children = nodes.len();
            let entry = nodes.get_mut(node).unwrap_or(&mut root);
            if part.len() <= LEAF_SIZE {
                *entry = node_of(bounds, start + first, part.len());
                continue;
            }
            *entry = node_of(bounds, children, 0);
            let left = split(part, centres, depth < self.deepest, &mut bins);
            nodes.extend([blank, blank]);
            pending.push((children + 1, first + left, end, depth + 1));
            pending.push((children, first, first + left, depth + 1));
        }
        Subtree {
            root,
            below: Below::Nodes(nodes),
        }
    }
}

fn node_of(bounds: Bounds, first: usize, count: usize) -> BinaryNode {
    BinaryNode {
        low: Vec3A::from_vec4(bounds.low),
        high: Vec3A::from_vec4(bounds.high),
        first: first as u32,
        count: count as u32,
    }
}

/// A tree over the boxes of so many triangles with the given corners, at most [`MAX_DEPTH`] deep
/// and parents before children, with leaves of up to [`LEAF_SIZE`].
pub(crate) fn build(count: usize, corners: impl Fn(usize) -> [Vec3A; 3] + Sync) -> BinaryTree {
    if count == 0 {
        return BinaryTree::default();
    }
    let mut items: Vec<Item> = (0..count)
        .into_par_iter()
        .with_min_len(TASK)
        .map(|i| Item::new(corners(i), i as u32))
        .collect();
    let builder = Builder {
        deepest: 2 * items.len().next_power_of_two().ilog2(),
    };
    let tree = builder.subtree(&mut items, 0, 0);
    let mut nodes = vec![node_of(Bounds::EMPTY, 0, 0); 1 + tree.len()];
    let (root, below) = nodes.split_at_mut(1);
    root[0] = tree.write(1, below);
    let order = items.par_iter().with_min_len(TASK).map(Item::id).collect();
    BinaryTree::from_parts(nodes, order)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::uniform;

    /// Large enough for parallel bins and many tasks, with many equal centres.
    #[test]
    fn the_tree_is_the_same_on_any_number_of_threads() {
        let n = 3 * BIN_TASK;
        let corners = |i: usize| {
            let at = |d: u32| (uniform(i as u32, 0, d) * 64.0).floor();
            let p = Vec3A::new(at(0), at(1), at(2));
            [p, p + Vec3A::X, p + Vec3A::Y * at(3)]
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
        assert_eq!(one.nodes.len(), many.nodes.len());
        for (a, b) in one.nodes.iter().zip(&many.nodes) {
            assert_eq!((a.low, a.high), (b.low, b.high));
            assert_eq!((a.first, a.count), (b.first, b.count));
        }
        let mut ids = one.order;
        ids.sort_unstable();
        assert!(ids.into_iter().eq(0..n as u32));
    }
}
