//! Triangles and parallelograms in a BVH with median splits: slow and simple, and tested against trying every patch.

use glam::DVec3;

/// A parallelogram `origin + u e1 + v e2`, or its half with u + v <= 1.
#[derive(Debug, Clone, Copy)]
pub struct Patch {
    /// Corner, metres.
    pub origin: DVec3,
    /// First edge; `e1 x e2` points outside.
    pub e1: DVec3,
    /// Second edge.
    pub e2: DVec3,
    /// Whether it is only a triangle.
    pub triangle: bool,
}

/// The intersection of a line with a patch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PatchHit {
    /// Ray parameter.
    pub t: f64,
    /// Index of the patch.
    pub patch: usize,
    /// Coordinate along `e1`.
    pub u: f64,
    /// Coordinate along `e2`.
    pub v: f64,
}

impl Patch {
    /// Intersection by Cramer's rule.
    fn intersect(&self, origin: DVec3, direction: DVec3) -> Option<(f64, f64, f64)> {
        let across = direction.cross(self.e2);
        let volume = self.e1.dot(across);
        if volume == 0.0 {
            return None;
        }
        let from = origin - self.origin;
        let u = from.dot(across) / volume;
        let around = from.cross(self.e1);
        let v = direction.dot(around) / volume;
        let far = if self.triangle { u + v } else { u.max(v) };
        (u >= 0.0 && v >= 0.0 && far <= 1.0).then(|| (self.e2.dot(around) / volume, u, v))
    }

    /// Smallest and largest corner.
    fn bounds(&self) -> (DVec3, DVec3) {
        let (b, c) = (self.origin + self.e1, self.origin + self.e2);
        let d = if self.triangle { c } else { b + self.e2 };
        (
            self.origin.min(b).min(c).min(d),
            self.origin.max(b).max(c).max(d),
        )
    }
}

/// Boxes are padded by this share of the largest coordinate, so that rounding (a few 2^-53 of it in either test)
/// never puts a hit outside the box of its patch.
const PAD: f64 = 1e-12;

/// Largest number of patches in a leaf.
const LEAF: usize = 4;

/// Median splits of 2^62 patches are 62 levels deep, and the traversal keeps one sibling per level.
const DEPTH: usize = 64;

#[derive(Debug)]
struct Node {
    low: DVec3,
    high: DVec3,
    /// Leaf: index of its first patch in `order`. Inner node: the right child; the left one comes next.
    first: usize,
    /// Number of patches of a leaf; 0 marks an inner node.
    count: usize,
    /// Split axis of an inner node.
    axis: usize,
}

/// A BVH over patches.
#[derive(Debug, Default)]
pub struct Tree {
    patches: Vec<Patch>,
    order: Vec<usize>,
    nodes: Vec<Node>,
}

impl Tree {
    /// Builds the BVH over all patches.
    pub fn new(patches: Vec<Patch>) -> Self {
        let mut tree = Self {
            order: (0..patches.len()).collect(),
            patches,
            nodes: Vec::new(),
        };
        if !tree.patches.is_empty() {
            tree.split(0, tree.patches.len());
        }
        tree
    }

    /// The patches, as given.
    pub fn patches(&self) -> &[Patch] {
        &self.patches
    }

    fn split(&mut self, from: usize, to: usize) {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &i in &self.order[from..to] {
            let (l, h) = self.patches[i].bounds();
            (low, high) = (low.min(l), high.max(h));
        }
        let pad = low.abs().max(high.abs()).max_element() * PAD;
        let node = self.nodes.len();
        self.nodes.push(Node {
            low: low - pad,
            high: high + pad,
            first: from,
            count: to - from,
            axis: 0,
        });
        if to - from <= LEAF {
            return;
        }
        let size = (high - low).to_array();
        let axis = (0..3).fold(0, |a, b| if size[b] > size[a] { b } else { a });
        let (patches, middle) = (&self.patches, (from + to) / 2);
        let centre = |i: usize| {
            let (l, h) = patches[i].bounds();
            l[axis] + h[axis]
        };
        self.order[from..to].select_nth_unstable_by(middle - from, |&a, &b| {
            centre(a).total_cmp(&centre(b)).then(a.cmp(&b))
        });
        self.split(from, middle);
        self.nodes[node].first = self.nodes.len();
        self.nodes[node].count = 0;
        self.nodes[node].axis = axis;
        self.split(middle, to);
    }

    /// The nearest patch with 0 < t < `t_max`; ties go to the lowest index.
    pub fn nearest(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<PatchHit> {
        let inverse = direction.recip();
        // A ray within a face of a padded box, for which 0 / 0 occurs, touches nothing inside.
        let enters = |node: &Node, limit: f64| {
            let (a, b) = (
                (node.low - origin) * inverse,
                (node.high - origin) * inverse,
            );
            a.min(b).max_element().max(0.0) <= a.max(b).min_element().min(limit)
        };
        let (mut best, mut limit) = (None::<PatchHit>, t_max);
        let mut stack = [0usize; DEPTH];
        let mut waiting = usize::from(!self.nodes.is_empty());
        while waiting > 0 {
            waiting -= 1;
            let index = stack[waiting];
            let node = &self.nodes[index];
            if !enters(node, limit) {
                continue;
            }
            if node.count == 0 {
                let children = [node.first, index + 1];
                // The near half is visited first.
                let near_last = if direction[node.axis] < 0.0 {
                    [children[1], children[0]]
                } else {
                    children
                };
                stack[waiting..waiting + 2].copy_from_slice(&near_last);
                waiting += 2;
                continue;
            }
            for &patch in &self.order[node.first..node.first + node.count] {
                if let Some((t, u, v)) = self.patches[patch].intersect(origin, direction)
                    && t > 0.0
                    && (t < limit || (t == limit && best.is_some_and(|b| patch < b.patch)))
                {
                    limit = t;
                    best = Some(PatchHit { t, patch, u, v });
                }
            }
        }
        best
    }

    /// Whether there is any hit with 0 < t < `t_max`.
    pub fn blocked(&self, origin: DVec3, direction: DVec3, t_max: f64) -> bool {
        self.nearest(origin, direction, t_max).is_some()
    }

    /// [`Tree::nearest`] without the BVH.
    pub fn nearest_of_all(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<PatchHit> {
        let hits = self.patches.iter().enumerate().filter_map(|(patch, p)| {
            let (t, u, v) = p.intersect(origin, direction)?;
            (t > 0.0 && t < t_max).then_some(PatchHit { t, patch, u, v })
        });
        hits.min_by(|a, b| a.t.total_cmp(&b.t).then(a.patch.cmp(&b.patch)))
    }
}
