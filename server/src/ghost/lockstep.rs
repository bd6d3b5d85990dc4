//! Sixteen segments walk the pyramid together, one lane each; a lane whose segment is done
//! takes the next one.
//!
//! Each lane goes from tile to tile in the order of its segment: down into a tile whose
//! interval of w it overlaps, past one it does not, and then up a level, since what is left of
//! the tile above may now be passed as a whole. It keeps no stack: the cell it is in, and the
//! parameter at which it came in, say everything.
//!
//! **Why no tile is lost.** Arithmetic is f32. With u = 2^-24 and an image of side N pixels, the
//! parameter of a grid line, `(line - u) / du`, is off by at most
//! - 1 u N / |du| from rounding the segment's start to f32,
//! - 1 u N / |du| from the difference (the line itself is a whole number, exact),
//! - 2 u N / |du| from the rounded 1/du and the product,
//!
//! that is 4 u N pixels of line, here [`PAD_PX`] = 5 to leave room for terms of second order and
//! for the f64 segment's own rounding (2^-53 N). So a line is crossed between its `near` and its
//! `far` parameter. A step is taken only if it is *certain*: the far parameter of one axis lies
//! before the near one of the other, and the position on the other axis, off by another 4 u N
//! from its product, sum and roundings to f32 on top of `pad |dv/du|`, is clear of every grid line.
//! Then the segment can touch no cell but those of the tiles walked through: at a crossing it is
//! farther from the next grid line than the exact test's own rounding, and between crossings it
//! is inside its tile. Where a step is not certain (rays through corners, along edges; about one
//! in a hundred) the lane gives the segment up, and it is traced by the walk that keeps all
//! children within its pads ([`super::pyramid`]).

use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, i32x16, mask32x16, u8x64, u32x16};

use super::cell::CellHit;
use super::group::{GROUP, Group, LANES};
use super::pyramid::{INV_LARGEST, Node};
use super::{Contact, GhostSurface};
use crate::accel::Ray;
use crate::numerics::UNIT_ROUNDOFF;

/// How far a grid line is moved outward, in unit roundoffs of the image's side; see above.
const PAD_PX: f32 = 5.0 * UNIT_ROUNDOFF;

/// The same of w, in unit roundoffs of the segment's largest; see [`super::pyramid`].
const PAD_W: f32 = 16.0 * UNIT_ROUNDOFF;

/// Tile sizes that the walk uses: 1, 4, 16, 64 cells.
const WALK_LEVELS: usize = 4;

/// Places for segments: a group and what the last store of sixteen writes beyond it.
const PLACES: usize = GROUP + LANES;

/// Segments in f32 that wait for a lane, by field.
#[derive(Debug)]
pub(super) struct Waiting {
    u: [f32; PLACES],
    v: [f32; PLACES],
    du: [f32; PLACES],
    dv: [f32; PLACES],
    inv_du: [f32; PLACES],
    inv_dv: [f32; PLACES],
    dw: [f32; PLACES],
    w: [f32; PLACES],
    pad_w: [f32; PLACES],
    /// Number in the group.
    id: [u32; PLACES],
    n: usize,
}

/// Numbers of segments whose steps were not certain.
#[derive(Debug)]
pub(super) struct Uncertain {
    pub(super) ids: [u16; GROUP],
    pub(super) n: usize,
}

impl Uncertain {
    #[inline(always)]
    fn push(&mut self, id: u32) {
        // Never full: each segment is given up once.
        self.ids[self.n % GROUP] = id as u16;
        self.n += 1;
    }
}

/// The state of a group under way.
#[derive(Debug)]
pub(super) struct Walk {
    pub(super) waiting: Waiting,
    pub(super) uncertain: Uncertain,
    /// What each segment met.
    pub(super) contacts: [Contact; GROUP],
}

impl Walk {
    pub(super) const EMPTY: Self = Self {
        waiting: Waiting {
            u: [0.0; PLACES],
            v: [0.0; PLACES],
            du: [0.0; PLACES],
            dv: [0.0; PLACES],
            inv_du: [0.0; PLACES],
            inv_dv: [0.0; PLACES],
            dw: [0.0; PLACES],
            w: [0.0; PLACES],
            pad_w: [0.0; PLACES],
            id: [0; PLACES],
            n: 0,
        },
        uncertain: Uncertain {
            ids: [0; GROUP],
            n: 0,
        },
        contacts: [Contact::NONE; GROUP],
    };

    #[inline(always)]
    pub(super) fn clear(&mut self) {
        self.waiting.n = 0;
        self.uncertain.n = 0;
        self.contacts = [Contact::NONE; GROUP];
    }

    /// Lines up the segments of a block that the root's tiles do not rule out.
    #[inline(always)]
    pub(super) fn enqueue<S: Simd>(
        &mut self,
        simd: S,
        surface: &GhostSurface,
        group: &Group,
        block: usize,
        any: bool,
    ) {
        let splat = |x: f32| f32x16::splat(simd, x);
        let at = block * LANES;
        let load = |field: &[f64; GROUP]| {
            let low = f64x8_at(simd, field, at);
            low.narrow(f64x8_at(simd, field, at + 8))
        };
        let (u, v, w) = (load(&group.u), load(&group.v), load(&group.w));
        let (du, dv, dw) = (load(&group.du), load(&group.dv), load(&group.dw));
        let largest = splat(INV_LARGEST);
        let inverse = |field| load(field).min(largest).max(-largest);
        let (inv_du, inv_dv) = (inverse(&group.inv_du), inverse(&group.inv_dv));
        let pad_w = load(&group.w_max) * PAD_W;
        let pad_px = PAD_PX * surface.side;
        let inside = mask32x16::from_bitmask(simd, u64::from(group.inside[block]));
        let touched = inside
            & root_touched(
                simd,
                surface,
                any,
                &[u, v, inv_du, inv_dv, w, dw, pad_w, splat(pad_px)],
            );
        // A start on a grid line inside the image belongs to both its sides.
        let on_line = |x: f32x16<S>, n: usize| {
            let line = x.round_ties_even();
            (x - line).abs().simd_le(splat(pad_px))
                & line.simd_gt(splat(0.0))
                & line.simd_lt(splat(n as f32))
        };
        let uncertain = touched & (on_line(u, surface.cells_x) | on_line(v, surface.cells_y));
        let mut bits = uncertain.to_bitmask();
        while bits != 0 {
            self.uncertain.push(at as u32 + bits.trailing_zeros());
            bits &= bits - 1;
        }
        let ready = touched & !uncertain;
        let waiting = &mut self.waiting;
        let n = waiting.n;
        let fields = [
            (&mut waiting.u, u),
            (&mut waiting.v, v),
            (&mut waiting.du, du),
            (&mut waiting.dv, dv),
            (&mut waiting.inv_du, inv_du),
            (&mut waiting.inv_dv, inv_dv),
            (&mut waiting.dw, dw),
            (&mut waiting.w, w),
            (&mut waiting.pad_w, pad_w),
        ];
        for (field, values) in fields {
            values.compress(ready).store_slice(&mut field[n..n + LANES]);
        }
        let ids = u32x16::load_array(simd, IOTA) + at as u32;
        ids.compress(ready)
            .store_slice(&mut waiting.id[n..n + LANES]);
        waiting.n += ready.to_bitmask().count_ones() as usize;
    }
}

const IOTA: [u32; LANES] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15];

#[inline(always)]
fn f64x8_at<S: Simd>(simd: S, field: &[f64; GROUP], at: usize) -> fearless_simd::f64x8<S> {
    fearless_simd::f64x8::from_slice(simd, &field[at..at + 8])
}

/// Which of sixteen segments some tile of the root does not rule out.
#[inline(always)]
fn root_touched<S: Simd>(
    simd: S,
    surface: &GhostSurface,
    any: bool,
    [u, v, inv_du, inv_dv, w, dw, pad_w, pad_px]: &[f32x16<S>; 8],
) -> mask32x16<S> {
    let splat = |x: f32| f32x16::splat(simd, x);
    let mut touched = mask32x16::splat(simd, false);
    let Some(top) = surface.levels.last() else {
        return touched;
    };
    let root = &surface.nodes[top.offset];
    let size = (1u32 << (2 * (surface.levels.len() - 1))) as f32;
    let (zero, one) = (splat(0.0), splat(1.0));
    let (pad_u, pad_v) = (*pad_px * inv_du.abs(), *pad_px * inv_dv.abs());
    // Where each line of a column or row is crossed.
    let columns = [0.0f32, 1.0, 2.0, 3.0, 4.0].map(|k| (splat(k * size) - *u) * *inv_du);
    let rows = [0.0f32, 1.0, 2.0, 3.0, 4.0].map(|k| (splat(k * size) - *v) * *inv_dv);
    let bounds = Node::bounds(u32x16::load_array_ref(simd, &root.0));
    let (lows, highs) = (bounds.0.to_array(), bounds.1.to_array());
    let w_low = *w - *pad_w;
    let w_high = *w + *pad_w;
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
    }
    touched
}

/// Sixteen segments under way.
struct Lanes<S: Simd> {
    u: f32x16<S>,
    v: f32x16<S>,
    du: f32x16<S>,
    dv: f32x16<S>,
    inv_du: f32x16<S>,
    inv_dv: f32x16<S>,
    dw: f32x16<S>,
    w_low: f32x16<S>,
    w_known: f32x16<S>,
    /// Infinite while it is not known whether the segment was ever behind the sheet.
    w_high: f32x16<S>,
    pad_u: f32x16<S>,
    pad_v: f32x16<S>,
    /// Half a pixel less the rounding of v where a line of u is crossed, and the reverse.
    clear_v: f32x16<S>,
    clear_u: f32x16<S>,
    id: u32x16<S>,
    x: i32x16<S>,
    y: i32x16<S>,
    s_in: f32x16<S>,
    /// Level of the tile as the bytes of a table's entry: four times the level and 0 to 3.
    level: u32x16<S>,
    /// Under way, not waiting for the exact test.
    active: u32,
    /// At a cell, waiting for it.
    at_cell: u32,
    /// The cell where it is was tested.
    passed: u32,
}

/// What stays the same for all steps.
struct Terrain<'a, S: Simd> {
    simd: S,
    surface: &'a GhostSurface,
    /// Per level: shift to its tiles, offset and stride of its nodes.
    shift: u32x16<S>,
    offset: u32x16<S>,
    stride: u32x16<S>,
    top: u32,
    any: bool,
}

const LEVEL_ZERO: u32 = 0x0302_0100;
const LEVEL_STEP: u32 = 0x0404_0404;

impl<'a, S: Simd> Terrain<'a, S> {
    #[inline(always)]
    fn new(simd: S, surface: &'a GhostSurface, any: bool) -> Self {
        let mut tables = [[0u32; WALK_LEVELS]; 3];
        for (level, shape) in surface.levels.iter().take(WALK_LEVELS).enumerate() {
            tables[0][level] = 2 * level as u32;
            tables[1][level] = shape.offset as u32;
            tables[2][level] = shape.stride as u32;
        }
        let [shift, offset, stride] =
            tables.map(|table| u32x16::from_fn(simd, |lane| table[lane % WALK_LEVELS]));
        let top = surface.levels.len().clamp(1, WALK_LEVELS) as u32 - 1;
        Self {
            simd,
            surface,
            shift,
            offset,
            stride,
            top: LEVEL_ZERO + LEVEL_STEP * top,
            any,
        }
    }
}

impl<S: Simd> Lanes<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = f32x16::splat(simd, 0.0);
        let none = i32x16::splat(simd, 0);
        Self {
            u: zero,
            v: zero,
            du: zero,
            dv: zero,
            inv_du: zero,
            inv_dv: zero,
            dw: zero,
            w_low: zero,
            w_known: zero,
            w_high: zero,
            pad_u: zero,
            pad_v: zero,
            clear_v: zero,
            clear_u: zero,
            id: u32x16::splat(simd, 0),
            x: none,
            y: none,
            s_in: zero,
            level: u32x16::splat(simd, LEVEL_ZERO),
            active: 0,
            at_cell: 0,
            passed: 0,
        }
    }

    /// Puts waiting segments, from `next` on, into lanes that are free.
    #[inline(always)]
    fn refill(&mut self, terrain: &Terrain<'_, S>, waiting: &Waiting, next: &mut usize) {
        let simd = terrain.simd;
        let surface = terrain.surface;
        let mut free = !(self.active | self.at_cell) & 0xffff;
        let left = waiting.n - *next;
        while free.count_ones() as usize > left {
            free &= free - 1;
        }
        let from = *next;
        *next += free.count_ones() as usize;
        let lanes = mask32x16::from_bitmask(simd, u64::from(free));
        let take = |field: &[f32; PLACES], old: f32x16<S>| {
            f32x16::from_slice(simd, &field[from..from + LANES]).expand_merge(lanes, old)
        };
        self.u = take(&waiting.u, self.u);
        self.v = take(&waiting.v, self.v);
        self.du = take(&waiting.du, self.du);
        self.dv = take(&waiting.dv, self.dv);
        self.inv_du = take(&waiting.inv_du, self.inv_du);
        self.inv_dv = take(&waiting.inv_dv, self.inv_dv);
        self.dw = take(&waiting.dw, self.dw);
        let zero = f32x16::splat(simd, 0.0);
        let w = take(&waiting.w, zero);
        let pad_w = take(&waiting.pad_w, zero);
        self.w_low = lanes.select(w - pad_w, self.w_low);
        self.w_known = lanes.select(w + pad_w, self.w_known);
        let w_high = if terrain.any {
            self.w_known
        } else {
            f32x16::splat(simd, f32::INFINITY)
        };
        self.w_high = lanes.select(w_high, self.w_high);
        let pad_px = PAD_PX * surface.side;
        self.pad_u = self.inv_du.abs() * pad_px;
        self.pad_v = self.inv_dv.abs() * pad_px;
        let half = f32x16::splat(simd, 0.5 - pad_px);
        self.clear_v = half - self.pad_u * self.dv.abs();
        self.clear_u = half - self.pad_v * self.du.abs();
        self.id =
            u32x16::from_slice(simd, &waiting.id[from..from + LANES]).expand_merge(lanes, self.id);
        let cell = |x: f32x16<S>, n: usize| {
            x.to_int::<i32x16<S>>()
                .min(i32x16::splat(simd, n as i32 - 1))
        };
        self.x = lanes.select(cell(self.u, surface.cells_x), self.x);
        self.y = lanes.select(cell(self.v, surface.cells_y), self.y);
        self.s_in = lanes.select(zero, self.s_in);
        self.level = lanes.select(u32x16::splat(simd, terrain.top), self.level);
        self.active |= free;
        self.passed &= !free;
    }

    /// One step of every lane under way.
    #[inline(always)]
    fn step(&mut self, terrain: &Terrain<'_, S>, uncertain: &mut Uncertain) {
        let simd = terrain.simd;
        let surface = terrain.surface;
        let splat = |x: f32| f32x16::splat(simd, x);
        let mask = |bits: u32| mask32x16::from_bitmask(simd, u64::from(bits));
        let bytes: u8x64<S> = self.level.bitcast();
        let lookup = |table: u32x16<S>| table.swizzle_dyn_within_blocks(bytes);
        let shift: i32x16<S> = lookup(terrain.shift).bitcast();
        let (tile_x, tile_y) = (self.x >> shift, self.y >> shift);
        // The tile's line on the far side, and the cell beyond it.
        let falls = |inv: f32x16<S>| inv.bitcast::<i32x16<S>>() >> 31;
        let (fall_x, fall_y) = (falls(self.inv_du), falls(self.inv_dv));
        let line_x = (tile_x + fall_x + 1) << shift;
        let line_y = (tile_y + fall_y + 1) << shift;
        let s_u = (line_x.to_float::<f32x16<S>>() - self.u) * self.inv_du;
        let s_v = (line_y.to_float::<f32x16<S>>() - self.v) * self.inv_dv;
        let (near_u, far_u) = (s_u - self.pad_u, s_u + self.pad_u);
        let (near_v, far_v) = (s_v - self.pad_v, s_v + self.pad_v);
        let s_out = far_u.min(far_v).min(splat(1.0));
        let tile = {
            let (x, y): (u32x16<S>, u32x16<S>) = (tile_x.bitcast(), tile_y.bitcast());
            let node = lookup(terrain.offset) + (y >> 2) * lookup(terrain.stride) + (x >> 2);
            let at = (node << 4) | ((y & 3) << 2) | (x & 3);
            let at = at.to_array();
            u32x16::load_array(
                simd,
                at.map(|at| surface.nodes[at as usize / 16].0[at as usize % 16]),
            )
        };
        let (tile_low, tile_high) = Node::bounds(tile);
        let (w_in, w_out) = (self.s_in * self.dw, s_out * self.dw);
        let low = self.w_low + w_in.min(w_out);
        let high = self.w_high + w_in.max(w_out);
        let active = mask(self.active);
        let overlaps = active
            & mask(!self.passed)
            & low.simd_le(tile_high)
            & high.simd_ge(tile_low)
            & tile_low.simd_le(tile_high);
        let is_cell = self.level.simd_eq(u32x16::splat(simd, LEVEL_ZERO));
        // Past the tile.
        let cross_u = far_u.simd_lt(near_v);
        let cross_v = far_v.simd_lt(near_u);
        let near = near_u.min(near_v);
        let ends = near.simd_gt(splat(1.0));
        let along = cross_u.select(s_u, s_v);
        let position = cross_u.select(self.v, self.u) + along * cross_u.select(self.dv, self.du);
        let floor = position.floor();
        let clear = (position - floor - splat(0.5))
            .abs()
            .simd_lt(cross_u.select(self.clear_v, self.clear_u));
        let side = floor.to_int::<i32x16<S>>();
        let beyond_x = line_x + fall_x;
        let beyond_y = line_y + fall_y;
        let outside = {
            let n = |cells: usize| u32x16::splat(simd, cells as u32);
            let out_x = beyond_x.bitcast::<u32x16<S>>().simd_ge(n(surface.cells_x));
            let out_y = beyond_y.bitcast::<u32x16<S>>().simd_ge(n(surface.cells_y));
            (cross_u & out_x) | (cross_v & out_y)
        };
        let passes = active & !overlaps;
        let ends = passes & (ends | outside);
        let goes_on = passes & !ends;
        let certain = (cross_u | cross_v) & clear;
        let moves = goes_on & certain;
        let last = |cells: usize| i32x16::splat(simd, cells as i32 - 1);
        let none = i32x16::splat(simd, 0);
        let side_x = side.max(none).min(last(surface.cells_x));
        let side_y = side.max(none).min(last(surface.cells_y));
        self.x = moves.select(cross_u.select(beyond_x, side_x), self.x);
        self.y = moves.select(cross_u.select(side_y, beyond_y), self.y);
        self.s_in = moves.select(near.max(splat(0.0)), self.s_in);
        let top = u32x16::splat(simd, terrain.top);
        let up = (self.level + LEVEL_STEP).min(top);
        let descends = overlaps & !is_cell;
        self.level = moves.select(up, self.level);
        self.level = descends.select(self.level - LEVEL_STEP, self.level);
        let reaches = (overlaps & is_cell).to_bitmask() as u32;
        let lost = (goes_on & !certain).to_bitmask() as u32;
        self.passed &= !(moves.to_bitmask() as u32);
        self.at_cell |= reaches;
        self.active &= !(reaches | lost | ends.to_bitmask() as u32);
        if lost != 0 {
            let ids = self.id.to_array();
            let mut bits = lost;
            while bits != 0 {
                uncertain.push(ids[bits.trailing_zeros() as usize % LANES]);
                bits &= bits - 1;
            }
        }
    }

    /// The exact tests that lanes wait for.
    #[inline(always)]
    fn test_cells(
        &mut self,
        terrain: &Terrain<'_, S>,
        group: &Group,
        rays: &[Ray],
        contacts: &mut [Contact; GROUP],
        uncertain: &mut Uncertain,
    ) {
        let surface = terrain.surface;
        let (ids, xs, ys) = (self.id.to_array(), self.x.to_array(), self.y.to_array());
        let (mut goes_on, mut behind) = (0, 0);
        let mut bits = self.at_cell;
        while bits != 0 {
            let lane = bits.trailing_zeros() as usize % LANES;
            bits &= bits - 1;
            let id = ids[lane] as usize % GROUP;
            let (x, y) = (xs[lane] as usize, ys[lane] as usize);
            let segment = group.segment(id, &rays[id]);
            let contact = &mut contacts[id];
            match surface.cell_contact(&segment, x, y, &mut contact.behind) {
                Some(hit) if terrain.any || hit.interior => {
                    contact.offer(hit, y * surface.cells_x + x);
                }
                // A neighbour may hold an equal contact.
                Some(CellHit { .. }) => uncertain.push(id as u32),
                None => {
                    goes_on |= 1 << lane;
                    behind |= u32::from(contact.behind) << lane;
                }
            }
        }
        self.at_cell = 0;
        self.active |= goes_on;
        self.passed |= goes_on;
        let behind = mask32x16::from_bitmask(terrain.simd, u64::from(behind));
        self.w_high = behind.select(self.w_known, self.w_high);
    }
}

/// Lanes that may idle or wait before the others are interrupted for them.
const PATIENCE: u32 = 5;

impl GhostSurface {
    /// Walks all segments of a group that wait.
    #[inline(always)]
    pub(super) fn walk_group<S: Simd>(
        &self,
        simd: S,
        walk: &mut Walk,
        group: &Group,
        rays: &[Ray],
        any: bool,
    ) {
        let terrain = Terrain::new(simd, self, any);
        let Walk {
            waiting,
            uncertain,
            contacts,
        } = walk;
        let mut sets = [Lanes::new(simd), Lanes::new(simd)];
        let mut next = 0;
        loop {
            let mut busy = 0;
            for lanes in &mut sets {
                let idle = 16 - lanes.active.count_ones();
                if idle >= PATIENCE || lanes.active == 0 {
                    if lanes.at_cell != 0 {
                        lanes.test_cells(&terrain, group, rays, contacts, uncertain);
                    }
                    if next < waiting.n && lanes.active != 0xffff {
                        lanes.refill(&terrain, waiting, &mut next);
                    }
                }
                busy |= lanes.active;
            }
            if busy == 0 {
                break;
            }
            for lanes in &mut sets {
                lanes.step(&terrain, uncertain);
            }
        }
    }
}
