//! A tree by the surface area heuristic over bins (Wald 2007, "On fast Construction of SAH-based
//! Bounding Volume Hierarchies"), in time n log n whatever the boxes look like: levels in which
//! the heuristic may split lopsidedly are limited to twice log2 n, below that halves are cut at
//! medians.

use glam::Vec3A;

use super::layout::{LEAF_SIZE, MOST_TRIANGLES};
use super::split::{BinaryNode, BinaryTree};
use crate::accel::space::largest_axis;

/// Bins per axis. Nodes with few boxes use fewer.
const BINS: usize = 32;

/// Deepest leaf of any tree, in edges from the root, which bounds the stacks of all walks. Twice
/// log2 n levels are cut by cost, and at most log2 n halve what is left.
pub(crate) const MAX_DEPTH: usize = 3 * MOST_TRIANGLES.ilog2() as usize;

/// Low and high corner.
type Bounds = (Vec3A, Vec3A);

const EMPTY: Bounds = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);

/// A box to be sorted into the tree, moved as a whole so that memory is read in order.
#[derive(Clone, Copy)]
struct Item {
    low: Vec3A,
    high: Vec3A,
    id: u32,
}

impl Item {
    fn bounds(&self) -> Bounds {
        (self.low, self.high)
    }

    /// Twice the centre.
    fn centre(&self) -> Vec3A {
        self.low + self.high
    }
}

fn union(a: Bounds, b: Bounds) -> Bounds {
    (a.0.min(b.0), a.1.max(b.1))
}

/// Half the surface of a box that is not empty.
pub(crate) fn half_area((low, high): Bounds) -> f32 {
    let d = high - low;
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// What so many triangles cost: by themselves, and by the leaves that they fill or begin.
fn work(count: usize) -> f32 {
    (count + count.next_multiple_of(LEAF_SIZE)) as f32
}

/// Where to cut: items whose bin on `axis` is below `bin` go left.
#[derive(Clone, Copy)]
struct Plane {
    axis: usize,
    bin: usize,
}

/// The bins of a node: even steps over its centres.
struct Grid {
    low: Vec3A,
    steps: Vec3A,
    bins: usize,
}

impl Grid {
    fn new((low, high): Bounds, count: usize) -> Self {
        let bins = (2 * count).min(BINS);
        Self {
            low,
            // Where all centres agree the step is infinite and they fall into bin 0: 0 * inf is
            // NaN, which converts to 0.
            steps: Vec3A::splat(bins as f32) / (high - low),
            bins,
        }
    }

    fn bin(&self, item: &Item, axis: usize) -> usize {
        let at = (item.centre()[axis] - self.low[axis]) * self.steps[axis];
        (at as usize).min(self.bins - 1)
    }
}

/// The cut that costs least: area times work, both sides together. `None` if no cut has boxes
/// on both sides.
fn cheapest(items: &[Item], grid: &Grid) -> Option<Plane> {
    let mut bins = [[(EMPTY, 0_usize); BINS]; 3];
    for item in items {
        for (axis, bins) in bins.iter_mut().enumerate() {
            let bin = &mut bins[grid.bin(item, axis)];
            *bin = (union(bin.0, item.bounds()), bin.1 + 1);
        }
    }
    let mut best: Option<(f32, Plane)> = None;
    for (axis, bins) in bins.iter().enumerate() {
        let mut left = [0.0_f32; BINS];
        let (mut bounds, mut count) = (EMPTY, 0);
        for bin in 1..grid.bins {
            bounds = union(bounds, bins[bin - 1].0);
            count += bins[bin - 1].1;
            left[bin] = if count == 0 {
                f32::INFINITY
            } else {
                half_area(bounds) * work(count)
            };
        }
        (bounds, count) = (EMPTY, 0);
        for bin in (1..grid.bins).rev() {
            bounds = union(bounds, bins[bin].0);
            count += bins[bin].1;
            if count == 0 {
                continue;
            }
            let cost = left[bin] + half_area(bounds) * work(count);
            if cost < best.map_or(f32::INFINITY, |best| best.0) {
                best = Some((cost, Plane { axis, bin }));
            }
        }
    }
    best.map(|best| best.1)
}

/// Moves the items left of the plane to the front; returns how many there are.
fn partition(items: &mut [Item], grid: &Grid, plane: Plane) -> usize {
    let mut left = 0;
    let mut right = items.len();
    while left < right {
        if grid.bin(&items[left], plane.axis) < plane.bin {
            left += 1;
        } else {
            right -= 1;
            items.swap(left, right);
        }
    }
    left
}

/// A tree over the triangles' boxes, at most [`MAX_DEPTH`] deep and parents before children, with leaves of up to [`LEAF_SIZE`].
pub(crate) fn build(corners: &[[Vec3A; 3]]) -> BinaryTree {
    let mut items: Vec<Item> = corners
        .iter()
        .zip(0..)
        .map(|([a, b, c], id)| Item {
            low: a.min(*b).min(*c),
            high: a.max(*b).max(*c),
            id,
        })
        .collect();
    let mut nodes = Vec::with_capacity(items.len());
    let blank = BinaryNode {
        low: EMPTY.0,
        high: EMPTY.1,
        first: 0,
        count: 0,
    };
    let deepest = 2 * items.len().next_power_of_two().ilog2();
    // Node, its range of items, its depth.
    let mut pending = Vec::new();
    if !items.is_empty() {
        nodes.push(blank);
        pending.push((0, 0, items.len(), 0));
    }
    while let Some((node, start, end, depth)) = pending.pop() {
        let part = &mut items[start..end];
        let (mut bounds, mut centres) = (EMPTY, EMPTY);
        for item in &*part {
            bounds = union(bounds, item.bounds());
            centres = union(centres, (item.centre(), item.centre()));
        }
        let entry: &mut BinaryNode = &mut nodes[node];
        (entry.low, entry.high) = bounds;
        if part.len() <= LEAF_SIZE {
            (entry.first, entry.count) = (start as u32, part.len() as u32);
            continue;
        }
        let grid = Grid::new(centres, part.len());
        let plane = (depth < deepest).then(|| cheapest(part, &grid)).flatten();
        let left = match plane {
            Some(plane) => partition(part, &grid, plane),
            None => {
                let axis = largest_axis((centres.1 - centres.0).to_array());
                let middle = part.len() / 2;
                // The number breaks ties, so the tree is the same whatever the order was.
                part.select_nth_unstable_by(middle, |a, b| {
                    let (x, y) = (a.centre()[axis], b.centre()[axis]);
                    x.total_cmp(&y).then(a.id.cmp(&b.id))
                });
                middle
            }
        };
        let children = nodes.len();
        nodes[node].first = children as u32;
        nodes.extend([blank, blank]);
        pending.push((children + 1, start + left, end, depth + 1));
        pending.push((children, start, start + left, depth + 1));
    }
    BinaryTree::from_parts(nodes, items.iter().map(|item| item.id).collect())
}
