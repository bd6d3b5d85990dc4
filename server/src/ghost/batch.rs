//! Many rays at once: clipped sixteen at a time, walked in lockstep, and what neither settles
//! traced one by one.

use fearless_simd::{Level, Simd};

use super::group::{GROUP, Group, LANES};
use super::lockstep::Walk;
use super::{Contact, GhostOutcome, GhostSurface};
use crate::accel::Ray;

/// A group of rays under way.
struct Batch {
    group: Group,
    walk: Walk,
}

impl GhostSurface {
    pub(super) fn trace_rays(&self, rays: &[Ray], out: &mut [GhostOutcome]) -> bool {
        self.trace_groups(rays, false, |at, rays, group, contacts| {
            for (k, ((ray, out), contact)) in
                rays.iter().zip(&mut out[at..]).zip(contacts).enumerate()
            {
                let bit = |bits: &[u16]| bits[k / LANES] >> (k % LANES) & 1 != 0;
                *out = if bit(&group.inside) {
                    self.outcome(&group.segment(k, ray), contact)
                } else if bit(&group.invalid) {
                    GhostOutcome::Unknown
                } else {
                    GhostOutcome::Environment
                };
            }
        })
    }

    pub(super) fn occlude_rays(&self, rays: &[Ray], out: &mut [bool]) -> bool {
        self.trace_groups(rays, true, |at, rays, _, contacts| {
            for (out, contact) in out[at..].iter_mut().zip(&contacts[..rays.len()]) {
                *out = contact.hit.is_some();
            }
        })
    }

    /// Traces rays in groups and reports each group: its place, rays, segments and contacts.
    /// False, with nothing reported, where the processor has no vectors.
    fn trace_groups(
        &self,
        rays: &[Ray],
        any: bool,
        mut report: impl FnMut(usize, &[Ray], &Group, &[Contact; GROUP]),
    ) -> bool {
        let mut batch = Batch {
            group: Group::EMPTY,
            walk: Walk::EMPTY,
        };
        rays.chunks(GROUP).enumerate().all(|(k, rays)| {
            let traced = self.trace_group(&mut batch, rays, any);
            if traced {
                report(k * GROUP, rays, &batch.group, &batch.walk.contacts);
            }
            traced
        })
    }

    /// Not inlined: it is compiled once for each instruction set, and takes long to.
    #[inline(never)]
    fn trace_group(&self, batch: &mut Batch, rays: &[Ray], any: bool) -> bool {
        vectorize!(self.level, |simd| self
            .trace_group_simd(simd, batch, rays, any))
        .is_some()
    }

    #[inline(always)]
    fn trace_group_simd<S: Simd>(&self, simd: S, batch: &mut Batch, rays: &[Ray], any: bool) {
        let Batch { group, walk } = batch;
        walk.clear();
        for (block, rays) in rays.chunks(LANES).enumerate() {
            group.clip(simd, &self.frustum, rays, block);
            if group.inside[block] != 0 {
                walk.enqueue(simd, self, group, block, any);
            }
        }
        self.walk_group(simd, walk, group, rays, any);
        for &id in &walk.uncertain.ids[..walk.uncertain.n] {
            let id = usize::from(id);
            let segment = group.segment(id, &rays[id]);
            walk.contacts[id] = self.first_contact_pyramid_single(self.level, &segment, any);
        }
    }
}
