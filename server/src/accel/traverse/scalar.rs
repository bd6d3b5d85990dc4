//! The scalar reference: one ray, one box at a time in any order, without vector instructions.

use glam::Vec3A;

use super::single::Target;
use super::triangle;
use crate::accel::blas::Blas;
use crate::accel::build::layout::{self, LEAF, NONE, STACK};
use crate::accel::ray::Hit;
use crate::accel::space::SpaceRay;

impl Blas {
    /// Approximate number of nodes and leaves that a ray visits between two points of the mesh's space if it hits
    /// nothing; counts up to `most`.
    pub fn visits(&self, from: Vec3A, to: Vec3A, most: usize) -> usize {
        let (origin, along) = (from - Vec3A::from(self.centre), to - from);
        SpaceRay::new(origin, along, 0.0, self.extent)
            .map_or(0, |ray| count_visits(self, &ray, 1.0, most))
    }
}

/// Traverses the mesh; returns whether a hit was recorded. With `target.any`, the first hit ends the traversal.
pub(crate) fn walk(blas: &Blas, ray: &SpaceRay, target: Target<'_>, best: &mut Hit) -> bool {
    if blas.cells.is_empty() {
        return false;
    }
    let mut found = false;
    let mut stack = [0_u32; STACK];
    let mut height = 1;
    while height > 0 {
        height -= 1;
        let node = layout::node(&blas.cells, stack[height]);
        for (slot, &child) in node.children.iter().enumerate() {
            if child == NONE {
                continue;
            }
            let corner = |side: usize| Vec3A::from_array(node.planes.map(|axis| axis[side][slot]));
            let (near, far) = ray.slabs.cross(corner(0), corner(1));
            if near.max(ray.slabs.t_min) > far.min(best.t) {
                continue;
            }
            if child & LEAF == 0 {
                stack[height] = child;
                height += 1;
                continue;
            }
            let block = layout::block(&blas.cells, child);
            for k in 0..layout::triangles(child) {
                let Some((t, u, v)) = triangle::cross(ray, block.triangle(k)) else {
                    continue;
                };
                let hit = Hit {
                    t: t.max(near),
                    instance: target.instance,
                    triangle: block.ids[k],
                    u,
                    v,
                };
                let taken = target.take(best, ray.slabs.t_min, hit);
                found |= taken;
                if target.any && taken {
                    return true;
                }
            }
        }
    }
    found
}

/// Nodes and leaves whose boxes a ray enters before `t_max`, counted up to `most`.
fn count_visits(blas: &Blas, ray: &SpaceRay, t_max: f32, most: usize) -> usize {
    if blas.cells.is_empty() {
        return 0;
    }
    let mut stack = [0_u32; STACK];
    let (mut height, mut visits) = (1, 0);
    while height > 0 && visits < most {
        height -= 1;
        visits += 1;
        let node = layout::node(&blas.cells, stack[height]);
        for (slot, &child) in node.children.iter().enumerate() {
            if child == NONE {
                continue;
            }
            let corner = |side: usize| Vec3A::from_array(node.planes.map(|axis| axis[side][slot]));
            let (near, far) = ray.slabs.cross(corner(0), corner(1));
            if near.max(ray.slabs.t_min) > far.min(t_max) {
                continue;
            }
            if child & LEAF == 0 {
                stack[height] = child;
                height += 1;
            } else {
                visits += 1;
            }
        }
    }
    visits.min(most)
}
