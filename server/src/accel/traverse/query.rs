//! Ray queries against the instances of a frame: each query runs on the best kernel for it, with the instruction set
//! of the [`Tlas`].

use fearless_simd::{Level, Simd, prelude::*};

use super::candidates::Candidates;
use super::packet::query::{
    GroupQuery, PacketQuery, any, nearest, nearest_of_group, packets_of_group,
};
use super::scalar;
use super::single::{self, Target};
use crate::accel::blas::Blas;
use crate::accel::ray::{Hit, HitFilter, HitPacket, NO_HIT, PacketFilter, Ray, RayPacket};
use crate::accel::space::SpaceRay;
use crate::accel::tlas::Tlas;
use crate::simd::{Width, vectorize};

impl Tlas {
    /// Closest hit with `t_min <= t <= t_max` on instances that share a bit with `mask`. Ties in `t` go to the lowest
    /// instance, then to the lowest triangle.
    pub fn intersect(&self, ray: &Ray, mask: u8) -> Option<Hit> {
        self.find(self.level, ray, mask, false, None)
    }

    /// Whether there is any hit between `t_min` and `t_max`.
    pub fn occluded(&self, ray: &Ray, mask: u8) -> bool {
        self.find(self.level, ray, mask, true, None).is_some()
    }

    /// As [`Tlas::intersect`]; calls `filter` for hits on filtered instances.
    pub fn intersect_filtered(&self, ray: &Ray, mask: u8, filter: HitFilter<'_>) -> Option<Hit> {
        self.find(self.level, ray, mask, false, Some(filter))
    }

    /// As [`Tlas::occluded`]; calls `filter` for hits on filtered instances.
    pub fn occluded_filtered(&self, ray: &Ray, mask: u8, filter: HitFilter<'_>) -> bool {
        self.find(self.level, ray, mask, true, Some(filter))
            .is_some()
    }

    /// [`Tlas::intersect`] in scalar code.
    pub fn intersect_scalar(&self, ray: &Ray, mask: u8) -> Option<Hit> {
        self.find(Level::fallback(), ray, mask, false, None)
    }

    /// [`Tlas::occluded`] in scalar code.
    pub fn occluded_scalar(&self, ray: &Ray, mask: u8) -> bool {
        self.find(Level::fallback(), ray, mask, true, None)
            .is_some()
    }

    /// [`Tlas::intersect_filtered`] in scalar code.
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

    /// As [`Tlas::intersect_packet`]; calls `filter` for hits on filtered instances.
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

    /// [`Tlas::intersect_packet`] for any number of packets. Fastest if neighbouring packets have similar rays, such
    /// as the 4x4 blocks of a tile in order.
    ///
    /// # Panics
    ///
    /// If `active` or `hits` has another length than the packets.
    pub fn intersect_packets(
        &self,
        rays: &[RayPacket],
        active: &[u16],
        mask: u8,
        hits: &mut [HitPacket],
    ) {
        self.find_packets(rays, active, mask, None, hits);
    }

    /// As [`Tlas::intersect_packets`]; calls `filter` for hits on filtered instances, with lane `16 p + l` for lane
    /// `l` of packet `p`.
    ///
    /// # Panics
    ///
    /// If `active` or `hits` has another length than the packets.
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

    /// [`Tlas::occluded`] for the lanes whose bit is set in `active`; the result has the bits of the occluded lanes.
    pub fn occluded_packet(&self, rays: &RayPacket, active: u16, mask: u8) -> u16 {
        self.find_packet(rays, active, mask, None, None)
    }

    /// As [`Tlas::occluded_packet`]; calls `filter` for hits on filtered instances.
    pub fn occluded_packet_filtered(
        &self,
        rays: &RayPacket,
        active: u16,
        mask: u8,
        filter: PacketFilter<'_>,
    ) -> u16 {
        self.find_packet(rays, active, mask, Some(filter), None)
    }

    /// Traces one ray; with `any`, the first hit found is sufficient.
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

    /// Traces sixteen rays; without `hits`, any hit is sufficient. Returns the lanes that hit.
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

    /// Nearest hits of packets, in whole groups as far as possible.
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

    /// [`Tlas::find_packet`] in scalar code: lane by lane.
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

/// Number of lanes of a vector.
#[inline(always)]
fn lanes_of<S: Simd, W: Width<S>>(_: S) -> usize {
    W::F::LEN
}

/// Traverses one mesh with the given instruction set; see [`single::walk`].
fn walk(level: Level, blas: &Blas, ray: &SpaceRay, target: Target<'_>, best: &mut Hit) -> bool {
    let vectorized = vectorize!(level, |simd| single::walk(
        simd,
        blas,
        ray,
        single::StackEntry::ROOT.child,
        target,
        best
    ));
    vectorized.unwrap_or_else(|| scalar::walk(blas, ray, target, best))
}
