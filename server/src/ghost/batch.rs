//! Many rays at once: clipped sixteen at a time, walked in lockstep, and what neither settles
//! traced one by one.

use std::cell::RefCell;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd};

use super::group::{GROUP, Group, LANES, Ones};
use super::waiting::Walk;
use super::{GhostHit, GhostOutcome, GhostSurface};
use crate::accel::Ray;

/// A group of rays under way.
pub(super) struct Batch {
    pub(super) group: Group,
    pub(super) walk: Walk,
}

impl Batch {
    pub(super) const EMPTY: Self = Self {
        group: Group::EMPTY,
        walk: Walk::EMPTY,
    };
}

thread_local! {
    /// Kept from call to call: clearing it takes longer than tracing a few dozen rays.
    static BATCH: RefCell<Box<Batch>> = RefCell::new(Box::new(Batch::EMPTY));
}

impl GhostSurface {
    /// False, with nothing of worth in `out`, where the processor has no vectors.
    pub(super) fn trace_rays(&self, rays: &[Ray], out: &mut [GhostOutcome]) -> bool {
        let groups = rays.chunks(GROUP).zip(out.chunks_mut(GROUP));
        Self::trace_groups(groups, |batch, rays, out| {
            let traced = self.trace_group(batch, rays, false, out);
            self.outcomes(batch, out);
            traced
        })
    }

    /// As [`Self::trace_rays`].
    pub(super) fn occlude_rays(&self, rays: &[Ray], out: &mut [bool]) -> bool {
        let groups = rays.chunks(GROUP).zip(out.chunks_mut(GROUP));
        Self::trace_groups(groups, |batch, rays, out| {
            let traced = self.trace_group(batch, rays, true, &mut []);
            for (out, hit) in out.chunks_mut(LANES).zip(&batch.walk.found.hit) {
                for (k, out) in out.iter_mut().enumerate() {
                    *out = hit >> k & 1 != 0;
                }
            }
            traced
        })
    }

    /// Traces group by group until one is not traced; the last may have more places than rays.
    fn trace_groups<'a, T: 'a>(
        mut groups: impl Iterator<Item = (&'a [Ray], &'a mut [T])>,
        mut trace: impl FnMut(&mut Batch, &[Ray], &mut [T]) -> bool,
    ) -> bool {
        BATCH.with_borrow_mut(|batch| {
            groups.all(|(rays, out)| trace(batch, rays, &mut out[..rays.len()]))
        })
    }

    /// Traces up to a group of rays. Fills `out`, if it has room, with
    /// [`GhostOutcome::Environment`]: its memory then comes while the rays are clipped. Not
    /// inlined: it is compiled once for each instruction set, and takes long to.
    #[inline(never)]
    pub(super) fn trace_group(
        &self,
        batch: &mut Batch,
        rays: &[Ray],
        any: bool,
        out: &mut [GhostOutcome],
    ) -> bool {
        vectorize!(self.level, |simd| self
            .trace_group_simd(simd, batch, rays, any, out))
        .is_some()
    }

    #[inline(always)]
    fn trace_group_simd<S: Simd>(
        &self,
        simd: S,
        batch: &mut Batch,
        rays: &[Ray],
        any: bool,
        out: &mut [GhostOutcome],
    ) {
        let Batch { group, walk } = batch;
        walk.clear();
        let mut out = out.chunks_mut(LANES);
        for (block, rays) in rays.chunks(LANES).enumerate() {
            if let Some(out) = out.next() {
                out.fill(GhostOutcome::Environment);
            }
            group.clip(simd, &self.frustum, rays, block);
            if group.inside[block] != 0 {
                walk.enqueue(simd, self, group, block, any);
            }
        }
        self.walk_group(simd, walk, group, any);
        for &id in &walk.uncertain.ids[..walk.uncertain.n] {
            let id = usize::from(id);
            let segment = group.segment(id);
            let contact = self.first_contact_pyramid_single(self.level, &segment, any);
            if let Some(hit) = contact.hit {
                walk.found.put_hit(id, hit.s, hit.from_front);
            }
            walk.found.put_behind(id, contact.behind);
        }
    }

    #[inline(never)]
    fn outcomes(&self, batch: &Batch, out: &mut [GhostOutcome]) {
        vectorize!(self.level, |simd| self.outcomes_simd(simd, batch, out));
    }

    /// [`Self::outcome`] of a group, sixteen at a time, into places that hold
    /// [`GhostOutcome::Environment`].
    #[inline(always)]
    fn outcomes_simd<S: Simd>(&self, simd: S, batch: &Batch, out: &mut [GhostOutcome]) {
        let Batch { group, walk } = batch;
        let found = &walk.found;
        for (block, out) in out.chunks_mut(LANES).enumerate() {
            let (inside, hit) = (group.inside[block], found.hit[block]);
            let missed = inside & !hit;
            let mut unknown = group.invalid[block] | (missed & found.behind[block]);
            for lane in Ones::of(missed & !unknown & group.ends_inside[block]) {
                let k = block * LANES + lane;
                let covered = self.covered(group.u[k] + group.du[k], group.v[k] + group.dv[k]);
                unknown |= u16::from(!covered) << lane;
            }
            for lane in Ones::of(unknown) {
                // Lanes beyond the last ray are invalid.
                if let Some(out) = out.get_mut(lane) {
                    *out = GhostOutcome::Unknown;
                }
            }
            if hit == 0 {
                continue;
            }
            let [t, u, v] = group.hits(simd, block, &found.s);
            let (t, u, v) = (t.to_array(), u.to_array(), v.to_array());
            for lane in Ones::of(hit) {
                if let Some(out) = out.get_mut(lane) {
                    *out = GhostOutcome::Hit(GhostHit {
                        t: t[lane],
                        u: u[lane],
                        v: v[lane],
                        from_front: found.from_front[block] >> lane & 1 != 0,
                    });
                }
            }
        }
    }
}
