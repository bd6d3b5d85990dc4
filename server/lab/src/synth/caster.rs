//! Intersects rays with the room: parallelograms and triangles in a binary BVH.
//!
//! Boxes are tested in f32, surfaces in f64, so that the exact depth of a recording has an error far below a
//! depth unit. No code is shared with the product's own acceleration structures, because a recording that serves
//! as ground truth must not have the same faults.

use glam::{DVec3, Vec3A};

/// A parallelogram or triangle, `origin + u e1 + v e2`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patch {
    /// One corner, world metres.
    pub(super) origin: DVec3,
    /// First edge; `e1 x e2` points outwards.
    pub(super) e1: DVec3,
    /// Second edge.
    pub(super) e2: DVec3,
    /// A triangle: only the part where u + v <= 1.
    pub(super) triangle: bool,
}

/// The intersection of a ray with a patch.
#[derive(Debug, Clone, Copy)]
pub(super) struct Hit {
    /// Ray parameter.
    pub(super) t: f64,
    /// Index of the patch.
    pub(super) patch: u32,
    /// Along `e1`, 0..=1.
    pub(super) u: f64,
    /// Along `e2`, 0..=1.
    pub(super) v: f64,
    /// Whether the ray hit the inner side.
    pub(super) back: bool,
}

impl Patch {
    /// Moeller and Trumbore 1997 in f64, for both shapes.
    #[inline]
    fn intersect(&self, origin: DVec3, direction: DVec3, t_min: f64, t_max: f64) -> Option<Hit> {
        let p = direction.cross(self.e2);
        let det = self.e1.dot(p);
        if det == 0.0 {
            return None;
        }
        let inverse = 1.0 / det;
        let s = origin - self.origin;
        let u = s.dot(p) * inverse;
        if !(0.0..=1.0).contains(&u) {
            return None;
        }
        let q = s.cross(self.e1);
        let v = direction.dot(q) * inverse;
        if v < 0.0 || (if self.triangle { u + v } else { v }) > 1.0 {
            return None;
        }
        let t = self.e2.dot(q) * inverse;
        (t > t_min && t < t_max).then_some(Hit {
            t,
            patch: 0,
            u,
            v,
            back: det < 0.0,
        })
    }

    fn bounds(&self) -> (Vec3A, Vec3A) {
        let (a, b, c) = (self.origin, self.origin + self.e1, self.origin + self.e2);
        let (mut lo, mut hi) = (a.min(b).min(c), a.max(b).max(c));
        if !self.triangle {
            lo = lo.min(b + self.e2);
            hi = hi.max(b + self.e2);
        }
        let pad = DVec3::splat(BOX_PAD_M);
        ((lo - pad).as_vec3a(), (hi + pad).as_vec3a())
    }
}

/// Boxes grow by this on every side, metres. In a room of 8 m an f32 box test has an error of at most four
/// roundings of 8 m, `8 gamma(4)` = 2e-6 m; ten times that is still too small to see.
const BOX_PAD_M: f64 = 2e-5;

/// A leaf with this many patches or fewer is not split.
const LEAF: usize = 3;

/// Depth from which nodes are split at the median, so that the traversal stack is large enough.
const MAX_SAH_DEPTH: usize = 36;

/// `MAX_SAH_DEPTH` and one level per halving of u32's range.
const STACK: usize = MAX_SAH_DEPTH + 32;

#[derive(Debug, Clone, Copy)]
struct Node {
    lo: Vec3A,
    hi: Vec3A,
    /// Leaf: index of its first patch. Inner node: index of the right child; the left child follows its parent.
    first: u32,
    /// Patches of a leaf; 0 for an inner node.
    count: u32,
}

/// The BVH.
#[derive(Debug)]
pub(super) struct Caster {
    nodes: Vec<Node>,
    /// Patches in leaf order.
    patches: Vec<Patch>,
    /// For each patch in leaf order, its index in the input.
    ids: Vec<u32>,
}

impl Caster {
    /// Builds the BVH with a binned surface-area heuristic (Wald 2007).
    pub(super) fn new(patches: &[Patch]) -> Self {
        let bounds: Vec<_> = patches.iter().map(Patch::bounds).collect();
        let mut ids: Vec<u32> = (0..patches.len() as u32).collect();
        let mut nodes = Vec::with_capacity(patches.len());
        if !ids.is_empty() {
            build(&mut nodes, &bounds, &mut ids, 0, 0);
        }
        Self {
            nodes,
            patches: ids.iter().map(|&i| patches[i as usize]).collect(),
            ids,
        }
    }

    /// The patches in their input order.
    pub(super) fn patches(&self) -> Vec<Patch> {
        let mut patches = self.patches.clone();
        for (patch, &id) in self.patches.iter().zip(&self.ids) {
            patches[id as usize] = *patch;
        }
        patches
    }

    /// The nearest hit with `t_min < t < t_max`.
    pub(super) fn intersect(
        &self,
        origin: DVec3,
        direction: DVec3,
        t_min: f64,
        t_max: f64,
    ) -> Option<Hit> {
        self.walk::<false>(origin, direction, t_min, t_max)
    }

    /// Whether anything is hit with `t_min < t < t_max`.
    pub(super) fn occluded(&self, origin: DVec3, direction: DVec3, t_min: f64, t_max: f64) -> bool {
        self.walk::<true>(origin, direction, t_min, t_max).is_some()
    }

    #[inline]
    fn walk<const ANY: bool>(
        &self,
        origin: DVec3,
        direction: DVec3,
        t_min: f64,
        mut t_max: f64,
    ) -> Option<Hit> {
        if self.nodes.is_empty() {
            return None;
        }
        let origin32 = origin.as_vec3a();
        // A zero component would give 0 * inf = NaN on a face of a box; 1e-20 moves the ray by less than any
        // padding over any distance.
        let inverse = Vec3A::from_array(direction.to_array().map(|d| {
            let d = d as f32;
            1.0 / if d.abs() < 1e-20 { 1e-20 } else { d }
        }));
        let enter = |node: &Node, t_max: f32| -> Option<f32> {
            let a = (node.lo - origin32) * inverse;
            let b = (node.hi - origin32) * inverse;
            let near = a.min(b).max_element().max(0.0);
            let far = a.max(b).min_element().min(t_max);
            (near <= far).then_some(near)
        };
        let mut best: Option<Hit> = None;
        let mut stack = [(0u32, 0.0f32); STACK];
        let mut depth = 0;
        let mut current = enter(&self.nodes[0], t_max as f32).map(|_| 0u32);
        loop {
            let Some(index) = current else {
                loop {
                    if depth == 0 {
                        return best;
                    }
                    depth -= 1;
                    let (node, near) = stack[depth];
                    if f64::from(near) <= t_max {
                        current = Some(node);
                        break;
                    }
                }
                continue;
            };
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for i in node.first..node.first + node.count {
                    if let Some(hit) =
                        self.patches[i as usize].intersect(origin, direction, t_min, t_max)
                    {
                        if ANY {
                            return Some(hit);
                        }
                        t_max = hit.t;
                        best = Some(Hit {
                            patch: self.ids[i as usize],
                            ..hit
                        });
                    }
                }
                current = None;
                continue;
            }
            // Rounded up so that a surface exactly at t_max is included.
            let limit = (t_max as f32).next_up();
            let (left, right) = (index + 1, node.first);
            let a = enter(&self.nodes[left as usize], limit);
            let b = enter(&self.nodes[right as usize], limit);
            current = match (a, b) {
                (None, None) => None,
                (Some(_), None) => Some(left),
                (None, Some(_)) => Some(right),
                (Some(a), Some(b)) => {
                    let (near, far, t) = if a <= b {
                        (left, right, b)
                    } else {
                        (right, left, a)
                    };
                    stack[depth] = (far, t);
                    depth += 1;
                    Some(near)
                }
            };
        }
    }
}

fn half_area(lo: Vec3A, hi: Vec3A) -> f32 {
    let d = (hi - lo).max(Vec3A::ZERO);
    d.x * d.y + d.y * d.z + d.z * d.x
}

fn build(
    nodes: &mut Vec<Node>,
    bounds: &[(Vec3A, Vec3A)],
    ids: &mut [u32],
    first: usize,
    depth: usize,
) {
    let empty = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    let join = |a: (Vec3A, Vec3A), b: (Vec3A, Vec3A)| (a.0.min(b.0), a.1.max(b.1));
    let whole = ids.iter().fold(empty, |a, &i| join(a, bounds[i as usize]));
    let index = nodes.len();
    nodes.push(Node {
        lo: whole.0,
        hi: whole.1,
        first: first as u32,
        count: ids.len() as u32,
    });
    if ids.len() <= LEAF {
        return;
    }
    let centre = |i: u32| (bounds[i as usize].0 + bounds[i as usize].1) * 0.5;
    let (lo, hi) = ids
        .iter()
        .fold(empty, |a, &i| join(a, (centre(i), centre(i))));
    let size = hi - lo;
    let axis = (0..3)
        .max_by(|&a, &b| size[a].total_cmp(&size[b]))
        .unwrap_or(0);
    const BINS: usize = 16;
    let bin = |i: u32| {
        let x = (centre(i)[axis] - lo[axis]) / size[axis] * BINS as f32;
        (x as usize).min(BINS - 1)
    };
    let mut split = 0;
    if depth < MAX_SAH_DEPTH && size[axis] > 0.0 {
        let mut boxes = [empty; BINS];
        let mut counts = [0usize; BINS];
        for &i in ids.iter() {
            boxes[bin(i)] = join(boxes[bin(i)], bounds[i as usize]);
            counts[bin(i)] += 1;
        }
        let mut right_cost = [f32::INFINITY; BINS];
        let (mut b, mut n) = (empty, 0);
        for k in (1..BINS).rev() {
            b = join(b, boxes[k]);
            n += counts[k];
            right_cost[k] = if n > 0 {
                half_area(b.0, b.1) * n as f32
            } else {
                f32::INFINITY
            };
        }
        let (mut b, mut n, mut best) = (empty, 0, f32::INFINITY);
        for k in 1..BINS {
            b = join(b, boxes[k - 1]);
            n += counts[k - 1];
            if n > 0 {
                let cost = half_area(b.0, b.1) * n as f32 + right_cost[k];
                if cost < best {
                    (best, split) = (cost, k);
                }
            }
        }
    }
    let middle = if split > 0 {
        let mut middle = 0;
        for k in 0..ids.len() {
            if bin(ids[k]) < split {
                ids.swap(k, middle);
                middle += 1;
            }
        }
        middle
    } else {
        let middle = ids.len() / 2;
        ids.select_nth_unstable_by(middle, |&a, &b| {
            centre(a)[axis].total_cmp(&centre(b)[axis]).then(a.cmp(&b))
        });
        middle
    };
    let (left, right) = ids.split_at_mut(middle);
    build(nodes, bounds, left, first, depth + 1);
    let right_child = nodes.len() as u32;
    build(nodes, bounds, right, first + middle, depth + 1);
    nodes[index].first = right_child;
    nodes[index].count = 0;
}

#[cfg(test)]
mod tests {
    use super::*;
    use ghostlight::numerics::uniform;

    #[test]
    fn the_tree_finds_what_testing_every_patch_finds() {
        let random = |i: u32, d: u32| f64::from(uniform(i, 1, d)) * 2.0 - 1.0;
        let point = |i: u32, d: u32| DVec3::new(random(i, d), random(i, d + 1), random(i, d + 2));
        let patches: Vec<Patch> = (0..500)
            .map(|i| Patch {
                origin: point(i, 0) * 2.0,
                e1: point(i, 3) * 0.3,
                e2: point(i, 6) * 0.3,
                triangle: i % 2 == 0,
            })
            .collect();
        let caster = Caster::new(&patches);
        let mut hits = 0;
        for i in 0..20_000 {
            let origin = point(i, 10) * 3.0;
            let mut direction = point(i, 13);
            if i % 7 == 0 {
                direction.x = 0.0;
            }
            let truth = patches
                .iter()
                .enumerate()
                .filter_map(|(k, p)| {
                    p.intersect(origin, direction, 0.0, f64::INFINITY)
                        .map(|h| (h.t, k as u32))
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            let found = caster.intersect(origin, direction, 0.0, f64::INFINITY);
            assert_eq!(found.map(|h| (h.t, h.patch)), truth);
            assert_eq!(
                caster.occluded(origin, direction, 0.0, f64::INFINITY),
                truth.is_some()
            );
            hits += u32::from(truth.is_some());
        }
        assert!(hits > 2_000, "{hits} hits");
        assert!(
            Caster::new(&[])
                .intersect(DVec3::ZERO, DVec3::X, 0.0, 1.0)
                .is_none()
        );
    }
}
