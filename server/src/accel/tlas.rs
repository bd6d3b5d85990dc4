//! Many meshes in camera space: instances, their AABBs, and the BVH over them, rebuilt every frame.

use std::sync::Arc;

use fearless_simd::Level;
use glam::Vec3A;

use super::build::split::{AT_ONCE, BinaryTree};
use super::instance::{Instance, TlasInstance, place};
use crate::numerics::UNIT_ROUNDOFF;

/// Padding of a camera-space box relative to `|origin| + |scene|`, per unit of the largest condition number k = |A|
/// |A^-1| of the instances (maximum norms).
///
/// A hit lies in a leaf's box padded by 16 u (object space, `space::PAD`), which A maps to at most 16 k u. The
/// object-space ray is off by the transform's roundings: 6 u for the origin (each entry rounded, a product, three
/// sums), and 5 u for the direction over its whole length, again times k. The slab test adds 4 u. The sum is 31 u; 48
/// leaves room for second-order terms.
const PAD: f32 = 48.0 * UNIT_ROUNDOFF;

/// Instances in a leaf of the BVH: up to this many are a plain loop.
const LEAF_SIZE: u32 = 4;

/// The BVH uses median splits, so even 2^32 instances make it only 32 levels deep; the traversal keeps one sibling
/// per level.
pub(crate) const STACK: usize = 40;

/// All instances of a frame.
#[derive(Debug)]
pub struct Tlas {
    pub(crate) level: Level,
    pub(crate) instances: Vec<Instance>,
    pub(crate) tree: BinaryTree,
    /// [`PAD`] times the largest condition number.
    pub(crate) pad: f32,
    /// Largest camera-space coordinate of any box.
    pub(crate) extent: f32,
}

impl Default for Tlas {
    fn default() -> Self {
        Self::new()
    }
}

impl Tlas {
    /// An empty TLAS that uses the best instruction set of this machine.
    pub fn new() -> Self {
        Self::with_level(Level::new())
    }

    /// An empty TLAS that uses the given instruction set.
    pub fn with_level(level: Level) -> Self {
        Self {
            level,
            instances: Vec::new(),
            tree: BinaryTree::default(),
            pad: 0.0,
            extent: 0.0,
        }
    }

    /// The instruction set in use.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Replaces all instances. Allocates only if there are more instances than ever before.
    pub fn rebuild(&mut self, instances: &[TlasInstance]) {
        self.rebuild_while(instances, || true);
    }

    /// As [`Tlas::rebuild`], but calls `go_on` every few thousand instances. If it returns false, the result is false
    /// and the TLAS is empty.
    pub fn rebuild_while(&mut self, instances: &[TlasInstance], go_on: impl Fn() -> bool) -> bool {
        self.instances.clear();
        let mut condition = 1.0_f64;
        let mut extent = 0.0_f32;
        for (i, source) in instances.iter().enumerate() {
            if i % AT_ONCE == AT_ONCE - 1 && !go_on() {
                self.instances.clear();
                break;
            }
            let placed = place(source);
            let (columns, bounds) = match placed {
                Some(placed) => {
                    condition = condition.max(placed.condition);
                    let (low, high) = placed.bounds;
                    extent = extent.max(low.abs().max(high.abs()).max_element());
                    (placed.columns, Some(placed.bounds))
                }
                None => ([Vec3A::ZERO; 4], None),
            };
            self.instances.push(Instance {
                blas: Arc::clone(&source.blas),
                columns,
                mask: source.mask,
                filtered: source.filtered,
                bounds,
            });
        }
        self.pad = PAD * condition as f32;
        self.extent = extent;
        let placed = &self.instances;
        let bounds = |i: u32| placed[i as usize].bounds;
        let whole = self
            .tree
            .rebuild_while(placed.len() as u32, LEAF_SIZE, bounds, go_on);
        if !whole {
            self.instances.clear();
        }
        self.instances.len() == instances.len()
    }

    /// Number of instances, including skipped ones.
    pub fn len(&self) -> usize {
        self.instances.len()
    }

    /// Whether there are no instances.
    pub fn is_empty(&self) -> bool {
        self.instances.is_empty()
    }

    /// AABB of an instance in camera space, conservative; `None` if no ray can hit it.
    pub fn bounds(&self, instance: u32) -> Option<(Vec3A, Vec3A)> {
        self.instances.get(instance as usize)?.bounds
    }
}
