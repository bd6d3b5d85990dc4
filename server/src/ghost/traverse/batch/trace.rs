//! Traces many rays at once: clipped sixteen at a time, traversed in lockstep. Segments that this does not decide
//! are traced one by one.

use std::cell::RefCell;

use fearless_simd::Simd;
use fearless_simd::prelude::*;

use super::queue::Walk;
use super::segments::{GROUP, Group, LANES};
use crate::accel::Ray;
use crate::ghost::outcome::{GhostHit, GhostOutcome};
use crate::ghost::surface::GhostSurface;
use crate::simd::{LaneMask, prefetch, vectorize};

/// Buffers for a group of rays.
pub(crate) struct Batch {
    pub(crate) group: Group,
    pub(crate) walk: Walk,
}

impl Batch {
    pub(crate) const EMPTY: Self = Self {
        group: Group::EMPTY,
        walk: Walk::EMPTY,
    };
}

thread_local! {
    /// Kept between calls: clearing it takes longer than tracing a few dozen rays.
    static BATCH: RefCell<Box<Batch>> = RefCell::new(Box::new(Batch::EMPTY));
}

impl GhostSurface {
    /// Returns false, with arbitrary values in `out`, if the processor has no vector instructions.
    pub(crate) fn trace_rays(&self, rays: &[Ray], out: &mut [GhostOutcome]) -> bool {
        Self::trace_groups(rays, out, |batch, rays, next, out| {
            let traced = self.trace_group(batch, rays, next, false, out);
            self.outcomes(batch, out);
            traced
        })
    }

    /// Like [`Self::trace_rays`].
    pub(crate) fn occlude_rays(&self, rays: &[Ray], out: &mut [bool]) -> bool {
        Self::trace_groups(rays, out, |batch, rays, next, out| {
            let traced = self.trace_group(batch, rays, next, true, &mut []);
            for (out, hit) in out.chunks_mut(LANES).zip(&batch.walk.found.hit) {
                for (k, out) in out.iter_mut().enumerate() {
                    *out = hit >> k & 1 != 0;
                }
            }
            traced
        })
    }

    /// Traces group by group until a group is not traced. Each call also gets the next group. `out` may be longer
    /// than `rays`.
    fn trace_groups<T>(
        rays: &[Ray],
        out: &mut [T],
        mut trace: impl FnMut(&mut Batch, &[Ray], &[Ray], &mut [T]) -> bool,
    ) -> bool {
        let groups = rays.chunks(GROUP);
        let next = groups.clone().skip(1).chain([&[][..]]);
        BATCH.with_borrow_mut(|batch| {
            groups
                .zip(next)
                .zip(out.chunks_mut(GROUP))
                .all(|((rays, next), out)| trace(batch, rays, next, &mut out[..rays.len()]))
        })
    }

    /// Traces up to a group of rays. Fills `out`, if it has room, with [`GhostOutcome::Environment`], so that its
    /// memory is loaded while the rays are clipped; so are the rays of the `next` group. Not inlined: it is
    /// compiled once for each instruction set, and that takes long.
    #[inline(never)]
    pub(crate) fn trace_group(
        &self,
        batch: &mut Batch,
        rays: &[Ray],
        next: &[Ray],
        any: bool,
        out: &mut [GhostOutcome],
    ) -> bool {
        vectorize!(self.level, |simd| self.trace_group_simd(
            simd,
            batch,
            [rays, next],
            any,
            out
        ))
        .is_some()
    }

    #[inline(always)]
    fn trace_group_simd<S: Simd>(
        &self,
        simd: S,
        batch: &mut Batch,
        [rays, next]: [&[Ray]; 2],
        any: bool,
        out: &mut [GhostOutcome],
    ) {
        let mut next = next.chunks(LANES);
        let Batch { group, walk } = batch;
        walk.clear();
        let mut out = out.chunks_mut(LANES);
        for (block, rays) in rays.chunks(LANES).enumerate() {
            if let Some(out) = out.next() {
                out.fill(GhostOutcome::Environment);
            }
            for ray in next.next().unwrap_or_default() {
                prefetch(simd, ray);
            }
            group.clip(simd, &self.frustum, rays, block);
            if group.inside[block] != 0 {
                walk.enqueue(simd, self, group, block, any);
            }
        }
        self.walk_group(simd, walk, group, any);
        walk.settle();
        for &id in walk.uncertain.all() {
            let id = id as usize;
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

    /// [`Self::outcome`] of a group, sixteen at a time, into entries that hold [`GhostOutcome::Environment`].
    #[inline(always)]
    fn outcomes_simd<S: Simd>(&self, simd: S, batch: &Batch, out: &mut [GhostOutcome]) {
        let Batch { group, walk } = batch;
        let found = &walk.found;
        for (block, out) in out.chunks_mut(LANES).enumerate() {
            let (inside, hit) = (group.inside[block], found.hit[block]);
            let missed = inside & !hit;
            let mut unknown = group.invalid[block] | (missed & found.behind[block]);
            for lane in LaneMask(missed & !unknown & group.ends_inside[block]) {
                let k = block * LANES + lane;
                let covered = self.covered(group.u[k] + group.du[k], group.v[k] + group.dv[k]);
                unknown |= u16::from(!covered) << lane;
            }
            for lane in LaneMask(unknown) {
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
            for lane in LaneMask(hit) {
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
