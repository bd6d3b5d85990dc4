//! A binary BVH by median splits of the box centres along the widest axis. Its depth is at most log2 of the number of
//! boxes, for any input. Allocates nothing once its vectors have grown.

use glam::Vec3A;

use crate::accel::space::largest_axis;

/// Boxes processed between two calls of `go_on`: well under a millisecond of work.
pub(crate) const AT_ONCE: usize = 1 << 12;

/// A node of a binary tree.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BinaryNode {
    pub(crate) low: Vec3A,
    pub(crate) high: Vec3A,
    /// Inner node: index of the first of its two children, which are neighbours.
    /// Leaf: first index into `order`.
    pub(crate) first: u32,
    /// Number of primitives of a leaf; 0 for an inner node.
    pub(crate) count: u32,
}

/// A binary BVH over AABBs; the root is node 0.
#[derive(Debug, Clone, Default)]
pub(crate) struct BinaryTree {
    pub(crate) nodes: Vec<BinaryNode>,
    /// Primitive indices, leaf by leaf.
    pub(crate) order: Vec<u32>,
    /// Nodes still to be split: node, range of `order`.
    pending: Vec<(u32, u32, u32)>,
}

impl BinaryTree {
    /// Rebuilds the BVH over the primitives below `count` for which `bounds` returns a box. Once `go_on` returns
    /// false, the result is false and the BVH is empty.
    pub(crate) fn rebuild_while(
        &mut self,
        count: u32,
        leaf_size: u32,
        bounds: impl Fn(u32) -> Option<(Vec3A, Vec3A)>,
        go_on: impl Fn() -> bool,
    ) -> bool {
        self.nodes.clear();
        self.order.clear();
        self.pending.clear();
        self.order
            .extend((0..count).filter(|&i| bounds(i).is_some()));
        if self.order.is_empty() {
            return true;
        }
        let empty = (Vec3A::splat(f32::INFINITY), Vec3A::splat(f32::NEG_INFINITY));
        let bounds = |i: u32| bounds(i).unwrap_or(empty);
        let blank = BinaryNode {
            low: empty.0,
            high: empty.1,
            first: 0,
            count: 0,
        };
        self.nodes.push(blank);
        self.pending.push((0, 0, self.order.len() as u32));
        let mut looked_at = 0;
        while let Some((node, start, end)) = self.pending.pop() {
            looked_at += (end - start) as usize;
            if looked_at >= AT_ONCE {
                looked_at = 0;
                if !go_on() {
                    self.nodes.clear();
                    self.order.clear();
                    return false;
                }
            }
            let part = &mut self.order[start as usize..end as usize];
            let (mut low, mut high) = empty;
            let (mut centre_low, mut centre_high) = empty;
            for &i in part.iter() {
                let (l, h) = bounds(i);
                low = low.min(l);
                high = high.max(h);
                centre_low = centre_low.min(l + h);
                centre_high = centre_high.max(l + h);
            }
            let entry = &mut self.nodes[node as usize];
            (entry.low, entry.high) = (low, high);
            if end - start <= leaf_size {
                (entry.first, entry.count) = (start, end - start);
                continue;
            }
            let axis = largest_axis((centre_high - centre_low).to_array());
            let centre = |i: u32| {
                let (l, h) = bounds(i);
                l[axis] + h[axis]
            };
            let middle = part.len() / 2;
            // Ties are broken by primitive index, so the result does not depend on the input order.
            part.select_nth_unstable_by(middle, |&i, &j| {
                centre(i).total_cmp(&centre(j)).then(i.cmp(&j))
            });
            let children = self.nodes.len() as u32;
            self.nodes[node as usize].first = children;
            self.nodes.extend([blank, blank]);
            let middle = start + middle as u32;
            self.pending.push((children, start, middle));
            self.pending.push((children + 1, middle, end));
        }
        true
    }
}
