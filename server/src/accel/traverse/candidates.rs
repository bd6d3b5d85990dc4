//! The instances that a single ray may hit, found by traversing the TLAS.

use glam::Vec3A;

use crate::accel::ray::Ray;
use crate::accel::space::Slabs;
use crate::accel::tlas::{STACK, Tlas};

/// The instances that one ray may hit, nearest subtrees first.
pub(crate) struct Candidates<'a> {
    tlas: &'a Tlas,
    slabs: Slabs,
    mask: u8,
    stack: [u32; STACK],
    height: usize,
    /// Remaining instances of the current leaf.
    leaf: std::slice::Iter<'a, u32>,
}

impl<'a> Candidates<'a> {
    /// `None` if the ray can hit nothing.
    #[inline(always)]
    pub(crate) fn new(tlas: &'a Tlas, ray: &Ray, mask: u8) -> Option<Self> {
        let root = tlas.tree.nodes.first()?;
        if !(ray.t_min.is_finite() && ray.t_min <= ray.t_max) {
            return None;
        }
        let slabs = Slabs::new(ray.origin, ray.direction, ray.t_min, tlas.pad, tlas.extent)?;
        // A few instances form a single leaf, visited without testing its node.
        let height = usize::from(root.count == 0);
        let leaf = tlas.tree.order[..root.count as usize].iter();
        Some(Self {
            tlas,
            slabs,
            mask,
            stack: [0; STACK],
            height,
            leaf,
        })
    }

    /// The next instance whose box the ray enters no later than `t`.
    #[inline(always)]
    pub(crate) fn next(&mut self, t: f32) -> Option<u32> {
        loop {
            for &index in self.leaf.by_ref() {
                let instance = &self.tlas.instances[index as usize];
                if instance.mask & self.mask != 0
                    && let Some((low, high)) = instance.bounds
                    && enters(&self.slabs, low, high, t).is_some()
                {
                    return Some(index);
                }
            }
            if self.height == 0 {
                return None;
            }
            self.descend(t);
        }
    }

    /// Pops the nearest node from the stack: its children are pushed, or its leaf becomes the current one.
    #[inline(never)]
    fn descend(&mut self, t: f32) {
        self.height -= 1;
        let tree = &self.tlas.tree;
        let node = &tree.nodes[self.stack[self.height] as usize];
        if node.count > 0 {
            self.leaf = tree.order[node.first as usize..(node.first + node.count) as usize].iter();
            return;
        }
        let enter = |child: u32| {
            let node = &tree.nodes[child as usize];
            enters(&self.slabs, node.low, node.high, t).map(|near| (near, child))
        };
        // The nearer child goes on top.
        let (under, top) = match (enter(node.first), enter(node.first + 1)) {
            (Some(a), Some(b)) if a.0 < b.0 => (Some(b), Some(a)),
            other => other,
        };
        for (_, child) in [under, top].into_iter().flatten() {
            self.stack[self.height] = child;
            self.height += 1;
        }
    }
}

#[inline(always)]
fn enters(slabs: &Slabs, low: Vec3A, high: Vec3A, t: f32) -> Option<f32> {
    let (near, far) = slabs.cross(low, high);
    (near.max(slabs.t_min) <= far.min(t)).then_some(near)
}
