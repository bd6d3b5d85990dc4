//! The plain reference: one ray over the binary tree, children in any order, no vectors.

use super::Hit;
use super::blas::{Blas, LEAF};
use super::ray::SpaceRay;
use super::sah::MAX_DEPTH;
use super::triangle;
use super::wide::Target;
use glam::Vec3A;

/// Walks the mesh; returns whether a hit was taken. With `target.any`, the first one ends it.
pub(super) fn walk(blas: &Blas, ray: &SpaceRay, target: Target<'_>, best: &mut Hit) -> bool {
    if blas.pairs.is_empty() {
        return false;
    }
    let mut found = false;
    let mut stack = [0_u32; MAX_DEPTH + 2];
    let mut height = 1;
    while height > 0 {
        height -= 1;
        let node = &blas.pairs[stack[height] as usize];
        for side in 0..2 {
            let (near, far) = ray.slabs.cross(
                Vec3A::from_array(node.low[side]),
                Vec3A::from_array(node.high[side]),
            );
            if near.max(ray.slabs.t_min) > far.min(best.t) {
                continue;
            }
            let child = node.children[side];
            if child & LEAF == 0 {
                stack[height] = child;
                height += 1;
                continue;
            }
            for k in 0..node.counts[side] as usize {
                let block = &blas.blocks[(child & !LEAF) as usize];
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
