//! Records of ambient change, one for every cell of pixels.

use glam::Vec3A;

use crate::frame::depth_sigma_m;

use super::super::FrameContext;
use super::super::tile::{TILE, Tile};
use super::gather::{GatherScratch, Place, gather};
use super::{CELL, LEAST_SHARE, TILE_CELLS};

/// What virtual objects change of the ambient light at one point of the ghost surface.
#[derive(Debug, Clone, Copy)]
pub(in super::super) struct Cell {
    /// Camera space; NaN where nothing was measured in the cell.
    pub(super) point: Vec3A,
    pub(super) normal: Vec3A,
    /// Irradiance that virtual objects add, and that with real things only.
    pub(super) delta: Vec3A,
    pub(super) real: Vec3A,
    /// Distance to the nearest thing virtual, metres: the record holds within a share of it.
    pub(super) nearest_m: f32,
}

impl Cell {
    pub(in super::super) const NONE: Self = Self {
        point: Vec3A::NAN,
        normal: Vec3A::ZERO,
        delta: Vec3A::ZERO,
        real: Vec3A::ZERO,
        nearest_m: f32::INFINITY,
    };

    pub(super) fn is_none(&self) -> bool {
        self.point.is_nan()
    }

    /// Share of real light that is added or taken, at most.
    pub(super) fn strength(&self) -> f32 {
        let real = self.real.max(Vec3A::splat(f32::MIN_POSITIVE));
        (self.delta.abs() / real).max_element()
    }

    /// How well the record serves at a point whose normal is not known, 0 to 1: less with distance, as a
    /// share of that to the nearest occluder, and not off the record's plane.
    pub(super) fn holds_at(&self, point: Vec3A) -> f32 {
        let away = point - self.point;
        let distance = away.length();
        let noise = 3.0 * depth_sigma_m(point.z.max(0.0));
        let across = (away.dot(self.normal).abs() - noise).max(0.0);
        let far = distance / (REACH * self.nearest_m).max(f32::MIN_POSITIVE);
        let slope = across / (SLOPE * distance).max(f32::MIN_POSITIVE);
        // Zero for a NaN.
        (1.0 - far).max(0.0) * (1.0 - slope * slope).max(0.0)
    }
}

/// Heuristic: a record serves within this share of the distance to what is nearest (Ward's `a`). Less
/// is more exact and gathers at more pixels; more blurs contact.
const REACH: f32 = 0.3;

/// Heuristic: a point further off a record's plane than this share of its distance lies on another
/// surface, or one turned by more than 27 degrees.
const SLOPE: f32 = 0.5;

/// Gathers the records of a tile's cells.
pub(super) fn cells_of_tile(
    ctx: &FrameContext<'_>,
    tile: &Tile,
    cells: &mut [Cell; TILE_CELLS],
    scratch: &mut GatherScratch,
) {
    cells.fill(Cell::NONE);
    scratch.places.clear();
    let places = std::array::from_fn::<_, TILE_CELLS, _>(|i| place_of_cell(ctx, tile, i as u32));
    scratch.places.extend(places.iter().flatten());
    let packets = ctx.settings.ambient.samples.div_ceil(16) as usize;
    gather(ctx, packets, scratch);
    let mut gathered = scratch.gathered.iter();
    for (cell, place) in cells.iter_mut().zip(places) {
        let (Some(place), Some(gathered)) = (place, place.and_then(|_| gathered.next())) else {
            continue;
        };
        *cell = Cell {
            point: place.point,
            normal: place.normal,
            delta: gathered.delta,
            real: gathered.real,
            nearest_m: gathered.nearest_m,
        };
        if cell.strength() < 0.5 * LEAST_SHARE {
            cell.delta = Vec3A::ZERO;
        }
    }
}

/// Where a cell gathers: in its middle, or where something is measured near that.
fn place_of_cell(ctx: &FrameContext<'_>, tile: &Tile, cell: u32) -> Option<Place> {
    let per_row = TILE / CELL;
    let (cx, cy) = (cell % per_row * CELL, cell / per_row * CELL);
    if cx >= tile.width || cy >= tile.height {
        return None;
    }
    let (w, h) = ((tile.width - cx).min(CELL), (tile.height - cy).min(CELL));
    let measured = |&(dx, dy): &(u32, u32)| {
        dx < w
            && dy < h
            && !ctx
                .real_depth(tile.x0 + cx + dx, tile.y0 + cy + dy)
                .is_nan()
    };
    let candidates = [(w / 2, h / 2), (1, 1), (6, 1), (1, 6), (6, 6), (0, 0)];
    let (dx, dy) = candidates.into_iter().find(measured)?;
    let (x, y) = (tile.x0 + cx + dx, tile.y0 + cy + dy);
    Some(Place {
        point: ctx.ray_direction(x as f32, y as f32) * ctx.real_depth(x, y),
        normal: ctx.real_normal(x, y),
        x,
        y,
        lattice: ((tile.x0 + cx) / CELL, (tile.y0 + cy) / CELL),
    })
}
