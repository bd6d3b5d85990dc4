//! Many meshes in camera space: instances, their boxes, and the tree over them, rebuilt per frame.

use std::sync::Arc;

use fearless_simd::{Level, Simd, prelude::*};
use glam::Vec3A;

use super::candidates::Candidates;
use super::instance::{Instance, TlasInstance, place};
use super::packet::{Eight, Sixteen, Width};
use super::packet_query::{
    GroupQuery, PacketQuery, any, nearest, nearest_of_group, packets_of_group,
};
use super::ray::SpaceRay;
use super::split::{AT_ONCE, BinaryTree};
use super::wide::{self, Target};
use super::{
    Blas, Hit, HitFilter, HitPacket, NO_HIT, PacketFilter, Ray, RayPacket, Shaft, scalar, shaft,
};
use crate::numerics::UNIT_ROUNDOFF;

/// Widening of a camera-space box relative to `|origin| + |scene|`, per unit of the worst
/// instance's condition number k = |A| |A^-1| (maximum norms).
///
/// A hit lies in a leaf's box widened by 16 u (object space, `ray::PAD`), which A carries to at
/// most 16 k u. The object-space ray is off by the transform's roundings: 6 u for the origin (each entry rounded,
/// a product, three sums), 5 u for the direction over its whole length, again times k. The slab test
/// adds 4 u. Sum 31 u; 48 leaves room for second-order terms.
const PAD: f32 = 48.0 * UNIT_ROUNDOFF;

/// Instances in a leaf of the tree: up to this many are a plain loop.
const LEAF_SIZE: u32 = 4;

/// The tree is halved at medians, so even 2^32 instances make it 32 deep; the walk keeps one
/// sibling per level.
pub(super) const STACK: usize = 40;

/// Runs a kernel compiled for the level's instruction set, with the packet width that suits it;
/// `None` where there is none but plain code: that of processors older than SSE4.2 (2008) and of
/// the fallback, for which emulated vectors would be slower than the reference.
macro_rules! vectorize {
    ($level:expr, |$simd:ident, $width:ident| $kernel:expr) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            Level::Avx512($simd) => {
                type $width = Sixteen;
                Some($simd.vectorize(
                    #[inline(always)]
                    || $kernel,
                ))
            }
            #[cfg(target_arch = "x86_64")]
            Level::Avx2($simd) => {
                type $width = Eight;
                Some($simd.vectorize(
                    #[inline(always)]
                    || $kernel,
                ))
            }
            #[cfg(target_arch = "x86_64")]
            Level::Sse4_2($simd) => {
                type $width = Eight;
                Some($simd.vectorize(
                    #[inline(always)]
                    || $kernel,
                ))
            }
            #[cfg(target_arch = "aarch64")]
            Level::Neon($simd) => {
                type $width = Eight;
                Some($simd.vectorize(
                    #[inline(always)]
                    || $kernel,
                ))
            }
            _ => None,
        }
    };
}

/// All instances of a frame.
#[derive(Debug)]
pub struct Tlas {
    level: Level,
    pub(super) instances: Vec<Instance>,
    pub(super) tree: BinaryTree,
    /// [`PAD`] times the worst condition number.
    pub(super) pad: f32,
    /// Largest camera-space coordinate of any box.
    pub(super) extent: f32,
}

impl Default for Tlas {
    fn default() -> Self {
        Self::new()
    }
}

impl Tlas {
    /// No instances yet; the best instruction set of this machine.
    pub fn new() -> Self {
        Self::with_level(Level::new())
    }

    /// No instances yet; the given instruction set.
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

    /// Replaces all instances. Allocates only while their number exceeds all earlier ones.
    pub fn rebuild(&mut self, instances: &[TlasInstance]) {
        self.rebuild_while(instances, || true);
    }

    /// [`Tlas::rebuild`] while `go_on`, asked every few thousand instances, says so; false, and nothing is
    /// there to be hit, if it does not.
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

    /// Number of instances, skipped ones included.
    pub fn len(&self) -> usize {
        self.instances.len()
    }

    /// Whether there are no instances.
    pub fn is_empty(&self) -> bool {
        self.instances.is_empty()
    }

    /// Camera-space box of an instance, conservative; `None` if no ray can hit it.
    pub fn bounds(&self, instance: u32) -> Option<(Vec3A, Vec3A)> {
        self.instances.get(instance as usize)?.bounds
    }

    /// Nearest hit with `t_min <= t <= t_max` on instances that share a bit with `mask`. Among
    /// equal `t` the lowest instance, then the lowest triangle.
    pub fn intersect(&self, ray: &Ray, mask: u8) -> Option<Hit> {
        self.find(self.level, ray, mask, false, None)
    }

    /// Whether anything lies between `t_min` and `t_max`.
    pub fn occluded(&self, ray: &Ray, mask: u8) -> bool {
        self.find(self.level, ray, mask, true, None).is_some()
    }

    /// [`Tlas::intersect`] that asks `filter` about hits on filtered instances.
    pub fn intersect_filtered(&self, ray: &Ray, mask: u8, filter: HitFilter<'_>) -> Option<Hit> {
        self.find(self.level, ray, mask, false, Some(filter))
    }

    /// [`Tlas::occluded`] that asks `filter` about hits on filtered instances.
    pub fn occluded_filtered(&self, ray: &Ray, mask: u8, filter: HitFilter<'_>) -> bool {
        self.find(self.level, ray, mask, true, Some(filter))
            .is_some()
    }

    /// [`Tlas::intersect`] in plain code.
    pub fn intersect_scalar(&self, ray: &Ray, mask: u8) -> Option<Hit> {
        self.find(Level::fallback(), ray, mask, false, None)
    }

    /// [`Tlas::occluded`] in plain code.
    pub fn occluded_scalar(&self, ray: &Ray, mask: u8) -> bool {
        self.find(Level::fallback(), ray, mask, true, None)
            .is_some()
    }

    /// [`Tlas::intersect_filtered`] in plain code.
    pub fn intersect_filtered_scalar(
        &self,
        ray: &Ray,
        mask: u8,
        filter: HitFilter<'_>,
    ) -> Option<Hit> {
        self.find(Level::fallback(), ray, mask, false, Some(filter))
    }

    /// [`Tlas::intersect`] for the lanes whose bit is set in `active`; overwrites all of `hits`.
    pub fn intersect_packet(&self, rays: &RayPacket, active: u16, mask: u8, hits: &mut HitPacket) {
        self.find_packet(rays, active, mask, None, Some(hits));
    }

    /// [`Tlas::intersect_packet`] that asks `filter` about hits on filtered instances.
    pub fn intersect_packet_filtered(
        &self,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        filter: PacketFilter<'_>,
        hits: &mut HitPacket,
    ) {
        self.find_packet(rays, active, mask, Some(filter), Some(hits));
    }

    /// [`Tlas::intersect_packet`] for any number of packets, fastest where neighbours see much the
    /// same, like the 4x4 blocks of a tile one after the other.
    ///
    /// # Panics
    ///
    /// If there are not as many `active` and `hits` as packets.
    pub fn intersect_packets(
        &self,
        rays: &[RayPacket],
        active: &[u16],
        mask: u8,
        hits: &mut [HitPacket],
    ) {
        self.find_packets(rays, active, mask, None, hits);
    }

    /// [`Tlas::intersect_packets`] that asks `filter` about hits on filtered instances; lane `l` of
    /// packet `p` is lane `16 p + l` to it.
    ///
    /// # Panics
    ///
    /// If there are not as many `active` and `hits` as packets.
    pub fn intersect_packets_filtered(
        &self,
        rays: &[RayPacket],
        active: &[u16],
        mask: u8,
        filter: PacketFilter<'_>,
        hits: &mut [HitPacket],
    ) {
        self.find_packets(rays, active, mask, Some(filter), hits);
    }

    /// [`Tlas::occluded`] for the lanes whose bit is set in `active`; their bits are set in the
    /// result where something is in the way.
    pub fn occluded_packet(&self, rays: &RayPacket, active: u16, mask: u8) -> u16 {
        self.find_packet(rays, active, mask, None, None)
    }

    /// [`Tlas::occluded_packet`] that asks `filter` about hits on filtered instances.
    pub fn occluded_packet_filtered(
        &self,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        filter: PacketFilter<'_>,
    ) -> u16 {
        self.find_packet(rays, active, mask, Some(filter), None)
    }

    /// One ray; with `any` the first hit found will do.
    fn find(
        &self,
        level: Level,
        ray: &Ray,
        mask: u8,
        any: bool,
        filter: Option<HitFilter<'_>>,
    ) -> Option<Hit> {
        let mut best = Hit {
            t: ray.t_max,
            instance: NO_HIT,
            triangle: NO_HIT,
            u: 0.0,
            v: 0.0,
        };
        let mut candidates = Candidates::new(self, ray, mask)?;
        while let Some(index) = candidates.next(best.t) {
            let instance = &self.instances[index as usize];
            if let Some(space) = instance.enter(ray) {
                let target = Target {
                    instance: index,
                    filter: filter.filter(|_| instance.filtered),
                    any,
                };
                if walk(level, &instance.blas, &space, target, &mut best) && any {
                    break;
                }
            }
        }
        (best.instance != NO_HIT).then_some(best)
    }

    /// Sixteen rays; any hit will do if there is no place for `hits`. Returns the lanes that hit.
    fn find_packet(
        &self,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        filter: Option<PacketFilter<'_>>,
        mut hits: Option<&mut HitPacket>,
    ) -> u16 {
        let query = PacketQuery {
            tlas: self,
            rays,
            active,
            mask,
            filter,
        };
        let vectorized = match &mut hits {
            Some(hits) => vectorize!(self.level, |simd, Width| nearest::<_, Width>(
                simd, query, hits
            )),
            None => vectorize!(self.level, |simd, Width| any::<_, Width>(simd, query)),
        };
        vectorized.unwrap_or_else(|| self.find_lanes(query, hits))
    }

    /// Nearest hits of packets, a group at a time while they last.
    fn find_packets(
        &self,
        rays: &[RayPacket],
        active: &[u16],
        mask: u8,
        filter: Option<PacketFilter<'_>>,
        hits: &mut [HitPacket],
    ) {
        assert!(rays.len() == active.len() && rays.len() == hits.len());
        let grouped = vectorize!(self.level, |simd, Width| {
            let size = packets_of_group(lanes_of::<_, Width>(simd));
            let whole = rays.len() / size * size;
            for first in (0..whole).step_by(size) {
                let query = GroupQuery {
                    tlas: self,
                    rays: &rays[first..first + size],
                    active: &active[first..first + size],
                    mask,
                    filter,
                    first_lane: 16 * first,
                };
                nearest_of_group::<_, Width>(simd, query, &mut hits[first..first + size]);
            }
            whole
        });
        for packet in grouped.unwrap_or(0)..rays.len() {
            let ask = |lane: usize, hit: &Hit| {
                filter.is_none_or(|filter| filter(16 * packet + lane, hit))
            };
            let filter: Option<PacketFilter<'_>> = filter.is_some().then_some(&ask);
            self.find_packet(
                &rays[packet],
                active[packet],
                mask,
                filter,
                Some(&mut hits[packet]),
            );
        }
    }

    /// [`Tlas::find_packet`] in plain code: lane by lane.
    fn find_lanes(&self, query: PacketQuery<'_>, mut hits: Option<&mut HitPacket>) -> u16 {
        let any = hits.is_none();
        if let Some(hits) = &mut hits {
            **hits = HitPacket::default();
        }
        let mut found = 0;
        for lane in (0..16).filter(|lane| query.active >> lane & 1 != 0) {
            let ask = |hit: &Hit| query.filter.is_none_or(|filter| filter(lane, hit));
            let filter: Option<HitFilter<'_>> = query.filter.is_some().then_some(&ask);
            let ray = query.rays.get(lane);
            if let Some(hit) = self.find(self.level, &ray, query.mask, any, filter) {
                found |= 1 << lane;
                if let Some(hits) = &mut hits {
                    hits.set(lane, hit);
                }
            }
        }
        found
    }
}

/// Lanes of a vector.
#[inline(always)]
fn lanes_of<S: Simd, W: Width<S>>(_: S) -> usize {
    W::F::LEN
}

/// Walks one mesh on the given instruction set; see [`wide::walk`].
fn walk(level: Level, blas: &Blas, ray: &SpaceRay, target: Target<'_>, best: &mut Hit) -> bool {
    let vectorized = vectorize!(level, |simd, _Width| wide::walk(
        simd,
        blas,
        ray,
        wide::Waiting::ROOT.child,
        target,
        best
    ));
    vectorized.unwrap_or_else(|| scalar::walk(blas, ray, target, best))
}

/// Whether a shaft may touch a triangle of one mesh; see [`shaft::walk`].
pub(super) fn walk_shaft(level: Level, blas: &Blas, shaft: &Shaft) -> bool {
    let vectorized = vectorize!(level, |simd, _Width| shaft::walk(simd, blas, shaft));
    vectorized.unwrap_or_else(|| shaft::walk_plain(blas, shaft))
}
