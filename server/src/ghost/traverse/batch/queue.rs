//! The queue of a group's segments, in f32, without those that miss all tiles of the root; and the results of the
//! traversal.

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, f64x8, mask32x8, mask32x16, mask64x8, u32x8, u32x16};

use super::segments::{CELLS, GROUP, Group, LANES, f32x16_at};
use crate::ghost::node::Node;
use crate::ghost::surface::GhostSurface;
use crate::ghost::traverse::pyramid::INV_LARGEST;
use crate::numerics::UNIT_ROUNDOFF;

/// Distance by which a grid line is moved outward, relative to the image's side; see [`super::lockstep`].
pub(crate) const PAD_PX: f32 = 5.0 * UNIT_ROUNDOFF;

/// The same for w, relative to the segment's largest w; see [`crate::ghost::traverse::pyramid`].
pub(crate) const PAD_W: f32 = 16.0 * UNIT_ROUNDOFF;

/// Capacity for segments: a group, plus the lanes that the last store of sixteen writes beyond it.
pub(crate) const PLACES: usize = GROUP + LANES;

/// Segments in f32 that have no lane yet, as a structure of arrays.
#[derive(Debug)]
pub(crate) struct SegmentQueue {
    pub(crate) u: [f32; PLACES],
    pub(crate) v: [f32; PLACES],
    pub(crate) du: [f32; PLACES],
    pub(crate) dv: [f32; PLACES],
    pub(crate) inv_du: [f32; PLACES],
    pub(crate) inv_dv: [f32; PLACES],
    pub(crate) dw: [f32; PLACES],
    pub(crate) w: [f32; PLACES],
    pub(crate) pad_w: [f32; PLACES],
    /// Largest parameter at which the segment touches a tile of the root.
    pub(crate) s_end: [f32; PLACES],
    /// Index in the group.
    pub(crate) id: [u32; PLACES],
    pub(crate) n: usize,
}

/// Indices of segments, in no particular order.
#[derive(Debug)]
pub(crate) struct Ids {
    ids: [u32; PLACES],
    n: usize,
}

impl Ids {
    const NONE: Self = Self {
        ids: [0; PLACES],
        n: 0,
    };

    pub(crate) fn all(&self) -> &[u32] {
        &self.ids[..self.n]
    }

    /// Appends the ids of the active lanes, branch-free. Cannot overflow: each segment is appended at
    /// most once.
    #[inline(always)]
    pub(crate) fn append<S: Simd>(&mut self, simd: S, ids: u32x16<S>, lanes: u32) {
        let mask = mask32x16::from_bitmask(simd, u64::from(lanes));
        let n = self.n.min(GROUP);
        ids.compress(mask).store_slice(&mut self.ids[n..n + LANES]);
        self.n = n + lanes.count_ones() as usize;
    }
}

/// Contacts, in the order in which they were found.
#[derive(Debug)]
pub(crate) struct Contacts {
    /// Index of the segment, and [`Self::FROM_FRONT`].
    ids: [u32; PLACES],
    s: [f64; PLACES],
    n: usize,
}

impl Contacts {
    const NONE: Self = Self {
        ids: [0; PLACES],
        s: [0.0; PLACES],
        n: 0,
    };
    const FROM_FRONT: u32 = 1 << 31;

    /// Appends the contacts of some of eight segments, like [`Ids::append`].
    #[inline(always)]
    pub(crate) fn append<S: Simd>(
        &mut self,
        simd: S,
        ids: u32x8<S>,
        s: &[f64; CELLS],
        [hit, from_front]: [u32; 2],
    ) {
        let n = self.n.min(GROUP);
        let front = mask32x8::from_bitmask(simd, u64::from(from_front));
        let flag = u32x8::splat(simd, Self::FROM_FRONT);
        let ids = front.select(ids | flag, ids);
        ids.compress(mask32x8::from_bitmask(simd, u64::from(hit)))
            .store_slice(&mut self.ids[n..n + CELLS]);
        f64x8::load_array_ref(simd, s)
            .compress(mask64x8::from_bitmask(simd, u64::from(hit)))
            .store_slice(&mut self.s[n..n + CELLS]);
        self.n = n + hit.count_ones() as usize;
    }
}

/// Hits of a group, as bits for each sixteen segments.
#[derive(Debug)]
pub(crate) struct BatchHits {
    pub(crate) hit: [u16; GROUP / LANES],
    /// Hits from the free side.
    pub(crate) from_front: [u16; GROUP / LANES],
    /// Segments without a hit that were behind the depth surface.
    pub(crate) behind: [u16; GROUP / LANES],
    /// Segment parameter of each hit.
    pub(crate) s: [f64; GROUP],
}

impl BatchHits {
    const NOTHING: Self = Self {
        hit: [0; GROUP / LANES],
        from_front: [0; GROUP / LANES],
        behind: [0; GROUP / LANES],
        s: [0.0; GROUP],
    };

    #[inline(always)]
    pub(crate) fn put_hit(&mut self, id: usize, s: f64, from_front: bool) {
        self.s[id % GROUP] = s;
        self.hit[id % GROUP / LANES] |= 1 << (id % LANES);
        self.from_front[id % GROUP / LANES] |= u16::from(from_front) << (id % LANES);
    }

    #[inline(always)]
    pub(crate) fn put_behind(&mut self, id: usize, behind: bool) {
        self.behind[id % GROUP / LANES] |= u16::from(behind) << (id % LANES);
    }
}

/// State of the traversal of a group.
#[derive(Debug)]
pub(crate) struct Walk {
    pub(crate) queue: SegmentQueue,
    /// Segments with an uncertain step, left to the traversal of single segments.
    pub(crate) uncertain: Ids,
    /// Segments that were behind the depth surface.
    pub(crate) behind: Ids,
    pub(crate) contacts: Contacts,
    pub(crate) found: BatchHits,
}

impl Walk {
    pub(crate) const EMPTY: Self = Self {
        queue: SegmentQueue {
            u: [0.0; PLACES],
            v: [0.0; PLACES],
            du: [0.0; PLACES],
            dv: [0.0; PLACES],
            inv_du: [0.0; PLACES],
            inv_dv: [0.0; PLACES],
            dw: [0.0; PLACES],
            w: [0.0; PLACES],
            pad_w: [0.0; PLACES],
            s_end: [0.0; PLACES],
            id: [0; PLACES],
            n: 0,
        },
        uncertain: Ids::NONE,
        behind: Ids::NONE,
        contacts: Contacts::NONE,
        found: BatchHits::NOTHING,
    };

    #[inline(always)]
    pub(crate) fn clear(&mut self) {
        self.queue.n = 0;
        self.uncertain.n = 0;
        self.behind.n = 0;
        self.contacts.n = 0;
        self.found.hit.fill(0);
        self.found.from_front.fill(0);
        self.found.behind.fill(0);
    }

    /// Converts contacts to hits.
    #[inline(always)]
    pub(crate) fn settle(&mut self) {
        let Contacts { ids, s, n } = &self.contacts;
        for (&id, &s) in ids.iter().zip(s).take(*n) {
            let id_only = (id & !Contacts::FROM_FRONT) as usize;
            self.found.put_hit(id_only, s, id != id_only as u32);
        }
        for &id in self.behind.all() {
            self.found.put_behind(id as usize, true);
        }
    }

    /// Queues the segments of a block, except those that miss all tiles of the root.
    #[inline(always)]
    pub(crate) fn enqueue<S: Simd>(
        &mut self,
        simd: S,
        surface: &GhostSurface,
        group: &Group,
        block: usize,
        any: bool,
    ) {
        let splat = |x: f32| f32x16::splat(simd, x);
        let at = block * LANES;
        let (u, v) = (f32x16_at(simd, &group.u, at), f32x16_at(simd, &group.v, at));
        let (du, dv) = (
            f32x16_at(simd, &group.du, at),
            f32x16_at(simd, &group.dv, at),
        );
        let (w, dw) = (
            f32x16_at(simd, &group.w, at),
            f32x16_at(simd, &group.dw, at),
        );
        let inv_du = f32x16_at(simd, &group.inv_du, at);
        let inv_dv = f32x16_at(simd, &group.inv_dv, at);
        let largest = splat(INV_LARGEST);
        let inv_du = inv_du.min(largest).max(-largest);
        let inv_dv = inv_dv.min(largest).max(-largest);
        let pad_w = f32x16_at(simd, &group.w_max, at) * PAD_W;
        let pad_px = PAD_PX * surface.side;
        let inside = mask32x16::from_bitmask(simd, u64::from(group.inside[block]));
        let (touched, s_end) = root_touched(
            simd,
            surface,
            any,
            &[u, v, inv_du, inv_dv, w, dw, pad_w, splat(pad_px)],
        );
        let touched = inside & touched;
        let uncertain = touched
            & (on_line(simd, u, pad_px, surface.cells_x)
                | on_line(simd, v, pad_px, surface.cells_y));
        let ready = touched & !uncertain;
        let queue = &mut self.queue;
        let n = queue.n;
        let fields = [
            (&mut queue.u, u),
            (&mut queue.v, v),
            (&mut queue.du, du),
            (&mut queue.dv, dv),
            (&mut queue.inv_du, inv_du),
            (&mut queue.inv_dv, inv_dv),
            (&mut queue.dw, dw),
            (&mut queue.w, w),
            (&mut queue.pad_w, pad_w),
            (&mut queue.s_end, s_end),
        ];
        for (field, values) in fields {
            values.compress(ready).store_slice(&mut field[n..n + LANES]);
        }
        let ids = u32x16::load_array(simd, IOTA) + at as u32;
        self.uncertain
            .append(simd, ids, uncertain.to_bitmask() as u32);
        ids.compress(ready).store_slice(&mut queue.id[n..n + LANES]);
        queue.n += ready.to_bitmask().count_ones() as usize;
    }
}

const IOTA: [u32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

/// Whether a segment's start coordinate is on a grid line inside the image, which belongs to the cells on both
/// sides.
#[inline(always)]
fn on_line<S: Simd>(simd: S, x: f32x16<S>, pad_px: f32, cells: usize) -> mask32x16<S> {
    let line = x.round_ties_even();
    (x - line).abs().simd_le(f32x16::splat(simd, pad_px))
        & line.simd_gt(f32x16::splat(simd, 0.0))
        & line.simd_lt(f32x16::splat(simd, cells as f32))
}

/// Which of sixteen segments may touch a tile of the root, and up to which parameter.
///
/// If w grows along the segment, the segment is in front of a tile from the parameter on at which w, padded down,
/// exceeds the tile's bound. That parameter has an error of eight roundings of numbers up to the segment's
/// largest w, divided by dw; the pad is sixteen.
#[inline(always)]
fn root_touched<S: Simd>(
    simd: S,
    surface: &GhostSurface,
    any: bool,
    [u, v, inv_du, inv_dv, w, dw, pad_w, pad_px]: &[f32x16<S>; 8],
) -> (mask32x16<S>, f32x16<S>) {
    let splat = |x: f32| f32x16::splat(simd, x);
    let mut touched = mask32x16::splat(simd, false);
    let mut s_end = splat(0.0);
    let Some(top) = surface.levels.last() else {
        return (touched, s_end);
    };
    let root = &surface.nodes[top.offset];
    let size = (1u32 << (2 * (surface.levels.len() - 1))) as f32;
    let (zero, one) = (splat(0.0), splat(1.0));
    let (pad_u, pad_v) = (*pad_px * inv_du.abs(), *pad_px * inv_dv.abs());
    // Parameters at which the lines of columns and rows are crossed.
    let (mut columns, mut rows) = ([zero; 5], [zero; 5]);
    for k in 0..5 {
        let line = splat(k as f32 * size);
        columns[k] = (line - *u) * *inv_du;
        rows[k] = (line - *v) * *inv_dv;
    }
    let bounds = Node::bounds(u32x16::load_array_ref(simd, &root.0));
    let (lows, highs) = (bounds.0.to_array(), bounds.1.to_array());
    let w_low = *w - *pad_w;
    let w_high = *w + *pad_w;
    let grows = dw.simd_gt(zero);
    let inv_dw = (one / *dw).min(splat(INV_LARGEST));
    for child in 0..16 {
        if lows[child] > highs[child] {
            continue;
        }
        let (i, j) = (child % 4, child / 4);
        let u_in = columns[i].min(columns[i + 1]) - pad_u;
        let u_out = columns[i].max(columns[i + 1]) + pad_u;
        let v_in = rows[j].min(rows[j + 1]) - pad_v;
        let v_out = rows[j].max(rows[j + 1]) + pad_v;
        let s_in = u_in.max(v_in).max(zero);
        let s_out = u_out.min(v_out).min(one);
        let (w_in, w_out) = (s_in * *dw, s_out * *dw);
        let mut meets =
            s_in.simd_le(s_out) & (w_low + w_in.min(w_out)).simd_le(splat(highs[child]));
        if any {
            meets &= (w_high + w_in.max(w_out)).simd_ge(splat(lows[child]));
        }
        touched |= meets;
        let s_above = grows.select((splat(highs[child]) - w_low) * inv_dw, one);
        s_end = meets.select(s_end.max(s_out.min(s_above)), s_end);
    }
    (touched, s_end)
}
