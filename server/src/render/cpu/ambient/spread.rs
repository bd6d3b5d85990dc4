//! From records of cells to pixels.

use glam::Vec3A;

use crate::frame::depth_sigma_m;

use super::super::FrameContext;
use super::super::shadow_rays::NormalMemo;
use super::super::tile::{TILE, TILE_PIXELS, Tile};
use super::cell::Cell;
use super::gather::{GatherScratch, Place, gather};
use super::{AmbientChange, AmbientTile, CELL, Own, TILE_CELLS};

/// Least sum of weights by which records are believed.
const LEAST_WEIGHT: f32 = 0.1;

/// Where records change no more than this share of light, the nearest serves though none fits: half
/// an 8-bit step of a mid-grey.
const FAINT: f32 = 1.0 / 128.0;

/// Reach of the filter over pixels that gathered for themselves: two pixels to each side, the outer
/// ones with half weight, are one whole 4 x 4 pattern.
const FILTER_WEIGHTS: [f32; 5] = [0.5, 1.0, 1.0, 1.0, 0.5];

/// Finds the changes at the pixels of a tile, from the cells of all tiles or by rays of its own.
pub(super) fn spread_tile(
    ctx: &FrameContext<'_>,
    cells: &[[Cell; TILE_CELLS]],
    tile: &Tile,
    out: &mut AmbientTile,
    scratch: &mut GatherScratch,
) {
    (out.any, out.own) = (false, false);
    if !tile.has_ambient || !ctx.go_on() {
        return;
    }
    let around = Around::new(ctx, cells, tile);
    if around.all.iter().all(|cell| cell.delta == Vec3A::ZERO) {
        return;
    }
    out.any = true;
    out.raw.fill(AmbientChange::default());
    scratch.places.clear();
    for (bx, by) in tile.blocks() {
        if spread_block(ctx, &around, tile, bx, by, &mut out.raw) {
            continue;
        }
        let mut memo = NormalMemo::default();
        for (dx, dy) in (0..16).map(|i| (bx + i % 4, by + i / 4)) {
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            let Some(point) = point_at(ctx, tile, dx, dy) else {
                continue;
            };
            match around.at(dx, dy, point) {
                Some(change) => out.raw[Tile::index(dx, dy)] = change,
                None => {
                    let normal = ctx.ghost_normal(x, y, &mut memo);
                    out.raw[Tile::index(dx, dy)] = AmbientChange {
                        normal,
                        own: Own::Missing,
                        ..AmbientChange::default()
                    };
                    // Every second pixel, as on a chessboard: the filter is wider than that.
                    if (x + y).is_multiple_of(2) {
                        scratch.places.push(Place {
                            point,
                            normal,
                            x,
                            y,
                            lattice: (x, y),
                        });
                    }
                    out.own = true;
                }
            }
        }
    }
    gather(ctx, 1, scratch);
    for (place, gathered) in scratch.places.iter().zip(&scratch.gathered) {
        out.raw[Tile::index(place.x - tile.x0, place.y - tile.y0)] = AmbientChange {
            delta: gathered.delta,
            real: gathered.real,
            normal: place.normal,
            own: Own::Gathered,
        };
    }
}

/// The ghost surface at a place of a tile; `None` in a hole and outside of the picture.
fn point_at(ctx: &FrameContext<'_>, tile: &Tile, dx: u32, dy: u32) -> Option<Vec3A> {
    if dx >= tile.width || dy >= tile.height {
        return None;
    }
    let (x, y) = (tile.x0 + dx, tile.y0 + dy);
    let z = ctx.real_depth(x, y);
    (!z.is_nan()).then(|| ctx.ray_direction(x as f32, y as f32) * z)
}

/// Heuristic: pixels further off a pixel's plane than this share of their distance, or whose normal
/// has a smaller cosine to its own than that, are on another surface.
const SAME_SLOPE: f32 = 0.25;
const SAME_NORMAL: f32 = 0.7;

/// Fills a 4x4 block that is a part of one surface from what records say at its corners; false if it is
/// not, or a corner has to gather for itself.
fn spread_block(
    ctx: &FrameContext<'_>,
    around: &Around,
    tile: &Tile,
    bx: u32,
    by: u32,
    out: &mut [AmbientChange; TILE_PIXELS],
) -> bool {
    if bx + 4 > tile.width || by + 4 > tile.height {
        return false;
    }
    let (mut near, mut far) = (f32::INFINITY, 0.0_f32);
    for (dx, dy) in (0..16).map(|i| (bx + i % 4, by + i / 4)) {
        let z = ctx.real_depth(tile.x0 + dx, tile.y0 + dy);
        if z.is_nan() {
            return false;
        }
        (near, far) = (near.min(z), far.max(z));
    }
    // As shadows ask it of a block: over three steps no more than three neighbours may differ.
    if far - near > 3.0 * ctx.settings.ghost.edge_relative * near {
        return false;
    }
    let corner = |dx, dy| around.at(dx, dy, point_at(ctx, tile, dx, dy)?);
    let (Some(a), Some(b)) = (corner(bx, by), corner(bx + 3, by)) else {
        return false;
    };
    let (Some(c), Some(d)) = (corner(bx, by + 3), corner(bx + 3, by + 3)) else {
        return false;
    };
    for i in 0..16 {
        let (s, t) = ((i % 4) as f32 / 3.0, (i / 4) as f32 / 3.0);
        let mix = |of: fn(&AmbientChange) -> Vec3A| {
            of(&a).lerp(of(&b), s).lerp(of(&c).lerp(of(&d), s), t)
        };
        out[Tile::index(bx + i % 4, by + i / 4)] = AmbientChange {
            delta: mix(|change| change.delta),
            real: mix(|change| change.real),
            normal: mix(|change| change.normal)
                .try_normalize()
                .unwrap_or(a.normal),
            own: Own::No,
        };
    }
    true
}

/// Cells of a tile and those that touch it.
const SPAN: usize = (TILE / CELL) as usize + 2;

/// The cells of a tile and those that touch it, in rows of [`SPAN`] from one cell up and left of it.
pub(super) fn around<T: Copy>(
    ctx: &FrameContext<'_>,
    cells: &[[T; TILE_CELLS]],
    tile: &Tile,
    none: T,
) -> [T; SPAN * SPAN] {
    let per_tile = i64::from(TILE / CELL);
    let (first_x, first_y) = (i64::from(tile.x0 / CELL) - 1, i64::from(tile.y0 / CELL) - 1);
    let find = |i: usize| {
        let (x, y) = (first_x + (i % SPAN) as i64, first_y + (i / SPAN) as i64);
        let (column, row) = (x.div_euclid(per_tile), y.div_euclid(per_tile));
        let inside = (0..i64::from(ctx.grid.columns)).contains(&column)
            && (0..i64::from(ctx.grid.rows)).contains(&row);
        let slot = inside
            .then(|| ctx.grid.slot(column as u32, row as u32))
            .flatten()?;
        let place = y.rem_euclid(per_tile) * per_tile + x.rem_euclid(per_tile);
        cells.get(slot).map(|cells| cells[place as usize])
    };
    std::array::from_fn(|i| find(i).unwrap_or(none))
}

/// Place of a cell among those of [`around`].
pub(super) fn index(column: u32, row: u32) -> usize {
    row as usize * SPAN + column as usize
}

/// Weight along one axis of the `k`-th of the three cells around a place of a tile: a tent of two
/// cells' width to each side.
pub(super) fn tent(d: u32, k: u32) -> f32 {
    let middle = (d / CELL + k) as f32 - 0.5;
    (1.0 - ((d as f32 + 0.5) / CELL as f32 - middle).abs() / 2.0).max(0.0)
}

struct Around {
    all: [Cell; SPAN * SPAN],
}

impl Around {
    fn new(ctx: &FrameContext<'_>, cells: &[[Cell; TILE_CELLS]], tile: &Tile) -> Self {
        Self {
            all: around(ctx, cells, tile, Cell::NONE),
        }
    }

    /// What the records say of a pixel of the tile; `None` if it has to gather for itself.
    fn at(&self, dx: u32, dy: u32, point: Vec3A) -> Option<AmbientChange> {
        let (cx, cy) = (dx / CELL, dy / CELL);
        let mut sum = AmbientChange::default();
        let (mut weights, mut strongest) = (0.0, 0.0_f32);
        let mut nearest: Option<(f32, &Cell)> = None;
        for (kx, ky) in (0..9).map(|k| (k % 3, k / 3)) {
            let cell = &self.all[index(cx + kx, cy + ky)];
            if cell.is_none() {
                continue;
            }
            strongest = strongest.max(cell.strength());
            let distance = (cell.point - point).length_squared();
            if nearest.is_none_or(|(least, _)| distance < least) {
                nearest = Some((distance, cell));
            }
            let weight = tent(dx, kx) * tent(dy, ky) * cell.holds_at(point);
            sum.delta += cell.delta * weight;
            sum.real += cell.real * weight;
            sum.normal += cell.normal * weight;
            weights += weight;
        }
        let (_, nearest) = nearest?;
        if weights >= LEAST_WEIGHT {
            sum.delta /= weights;
            sum.real /= weights;
            sum.normal = sum.normal.try_normalize().unwrap_or(nearest.normal);
            return Some(sum);
        }
        (strongest <= FAINT).then_some(AmbientChange {
            delta: nearest.delta,
            real: nearest.real,
            normal: nearest.normal,
            own: Own::No,
        })
    }
}

/// Filters the pixels of a tile that gathered for themselves; others are copied.
pub(super) fn filter_tile(
    ctx: &FrameContext<'_>,
    raw: &[AmbientTile],
    tile: &Tile,
    slot: usize,
    out: &mut [AmbientChange; TILE_PIXELS],
) {
    if !raw[slot].own || !ctx.go_on() {
        return;
    }
    *out = *raw[slot].raw;
    let (right, bottom) = (ctx.frame.color.width - 1, ctx.frame.color.height - 1);
    for (place, own) in out
        .iter_mut()
        .enumerate()
        .filter(|(_, change)| change.own != Own::No)
    {
        let (x, y) = (tile.x0 + place as u32 % TILE, tile.y0 + place as u32 / TILE);
        let here = ctx.ray_direction(x as f32, y as f32) * ctx.real_depth(x, y);
        let noise = 3.0 * depth_sigma_m(here.z.max(0.0));
        let (mut delta, mut real, mut weights) = (Vec3A::ZERO, Vec3A::ZERO, 0.0);
        for (j, wy) in (0..).zip(FILTER_WEIGHTS) {
            for (i, wx) in (0..).zip(FILTER_WEIGHTS) {
                let (Some(nx), Some(ny)) = ((x + i).checked_sub(2), (y + j).checked_sub(2)) else {
                    continue;
                };
                if nx > right || ny > bottom {
                    continue;
                }
                let there = match ctx.grid.locate(nx, ny) {
                    Some((slot, place)) if raw[slot].any => &raw[slot].raw[place],
                    _ => continue,
                };
                let z = ctx.real_depth(nx, ny);
                let away = ctx.ray_direction(nx as f32, ny as f32) * z - here;
                let across = away.dot(own.normal).abs() - noise;
                let on_it = across <= SAME_SLOPE * away.length();
                if there.own == Own::Missing {
                    continue;
                }
                // False in a hole.
                if on_it && there.normal.dot(own.normal) >= SAME_NORMAL {
                    delta += there.delta * (wx * wy);
                    real += there.real * (wx * wy);
                    weights += wx * wy;
                }
            }
        }
        if weights > 0.0 {
            own.delta = delta / weights;
            own.real = real / weights;
        }
    }
}
