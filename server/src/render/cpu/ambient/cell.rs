//! Records of the change of ambient light, one for every cell of pixels.

use glam::Vec3A;

use crate::frame::depth_sigma_m;

use crate::render::cpu::tile::Tile;
use crate::render::prepare::occluder::LEAST_SHARE;
use crate::render::prepare::tile_plan::TILE;

use super::gather::{GatherScratch, Gathered, gather};
use super::input::{AmbientInput, CELL, Place, TILE_CELLS, TILES_AT_ONCE};

/// The change that virtual objects cause in the ambient light at one point of the ghost surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cell {
    /// Camera space; NaN if nothing was measured in the cell.
    pub(crate) point: Vec3A,
    pub(crate) normal: Vec3A,
    /// Irradiance that virtual objects add, and irradiance with real objects only.
    pub(crate) delta: Vec3A,
    pub(crate) real: Vec3A,
    /// Distance to the nearest virtual object, metres: the record is valid within a share of it.
    pub(crate) nearest_m: f32,
}

impl Cell {
    pub(crate) const NONE: Self = Self {
        point: Vec3A::NAN,
        normal: Vec3A::ZERO,
        delta: Vec3A::ZERO,
        real: Vec3A::ZERO,
        nearest_m: f32::INFINITY,
    };

    pub(crate) fn is_none(&self) -> bool {
        self.point.is_nan()
    }

    /// Change as a share of the real light; negative if light is removed.
    fn change(&self) -> Vec3A {
        if self.delta == Vec3A::ZERO {
            return Vec3A::ZERO;
        }
        self.delta / self.real.max(Vec3A::splat(f32::MIN_POSITIVE))
    }

    /// Largest share of the real light that is added or removed.
    pub(crate) fn strength(&self) -> f32 {
        self.change().abs().max_element()
    }

    /// The record of a point and its gathered light.
    fn new(place: &Place, gathered: &Gathered) -> Self {
        let mut cell = Self {
            point: place.point,
            normal: place.normal,
            delta: gathered.delta,
            real: gathered.real,
            nearest_m: gathered.nearest_m,
        };
        if cell.strength() < 0.5 * LEAST_SHARE {
            cell.delta = Vec3A::ZERO;
        }
        cell
    }

    /// Whether a point is so far from the record's plane that it is on another surface.
    fn is_beside(&self, point: Vec3A, noise: f32) -> bool {
        let away = point - self.point;
        away.dot(self.normal).abs() - noise > SLOPE * away.length()
    }

    /// Weight of the record, 0 to 1, at a point whose normal is not known and whose depth has an error of
    /// `noise`. Decreases with the distance relative to that of the nearest occluder, and with the distance from
    /// the record's plane.
    pub(crate) fn holds_at(&self, point: Vec3A, noise: f32) -> f32 {
        let away = point - self.point;
        let squared = away.length_squared();
        let reach = (REACH * self.nearest_m).max(f32::MIN_POSITIVE);
        if squared.is_nan() || squared >= reach * reach {
            return 0.0;
        }
        let distance = squared.sqrt();
        let across = (away.dot(self.normal).abs() - noise).max(0.0);
        let far = distance / reach;
        let slope = across / (SLOPE * distance).max(f32::MIN_POSITIVE);
        (1.0 - far) * (1.0 - slope * slope).max(0.0)
    }
}

/// Largest distance from its plane at which a measured point still counts as on it, metres: three sigma of the
/// sensor.
pub(crate) fn noise_at(point: Vec3A) -> f32 {
    3.0 * depth_sigma_m(point.z.max(0.0))
}

/// Weighted mean of changes.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Mean {
    delta: Vec3A,
    real: Vec3A,
    pub(crate) weight: f32,
    /// Weight of the records with known real light.
    real_weight: f32,
}

impl Mean {
    pub(crate) fn add(&mut self, delta: Vec3A, real: Vec3A, weight: f32) {
        self.delta += delta * weight;
        self.weight += weight;
        // Real light is not computed where nothing changes.
        if real != Vec3A::ZERO {
            self.real += real * weight;
            self.real_weight += weight;
        }
    }

    /// The means; requires a weight above zero.
    pub(crate) fn delta_and_real(&self) -> (Vec3A, Vec3A) {
        let real = match self.real_weight {
            0.0 => Vec3A::ZERO,
            weight => self.real / weight,
        };
        (self.delta / self.weight, real)
    }
}

/// Heuristic: a record is used within this share of the distance to the nearest object (Ward's `a`). Lower values
/// are more exact and gather at more pixels; higher values blur contact shadows.
const REACH: f32 = 0.3;

/// Heuristic: a point farther from a record's plane than this share of its distance from the record is on another
/// surface, or on one tilted by more than 27 degrees.
const SLOPE: f32 = 0.5;

/// If no record fits and all records change at most this share of light, the nearest one is used: half an 8-bit
/// step of a mid-grey.
pub(crate) const FAINT: f32 = 1.0 / 128.0;

/// Heuristic: if the shares of light of neighbouring tiles differ by more than this, finer records are gathered
/// between them. Interpolation over a tile has an error of about an eighth of its second difference, which is
/// less.
const SMOOTH: f32 = 1.0 / 16.0;

/// Gathers a record for every tile, at its centre.
pub(crate) fn records_of_tiles(
    input: AmbientInput<'_>,
    tiles: &[Tile],
    records: &mut [Cell],
    scratch: &mut GatherScratch,
) {
    scratch.places.clear();
    records.fill(Cell::NONE);
    let place = |tile: &Tile| {
        if !tile.has_ambient || !input.frame.go_on() {
            return None;
        }
        let middle = (tile.x0 + tile.width / 2, tile.y0 + tile.height / 2);
        let measured = !input.frame.sensed.depth_at(middle.0, middle.1).is_nan();
        let aside = || (0..TILE_CELLS).find_map(|i| pixel_of_cell(input, tile, i as u32));
        let (x, y) = measured.then_some(middle).or_else(aside)?;
        Some(place_at(input, x, y, (tile.x0 / TILE, tile.y0 / TILE)))
    };
    // An index for each point: tiles without a point have no record.
    let mut slots = [0; TILES_AT_ONCE];
    for (slot, tile) in tiles.iter().enumerate() {
        if let Some(place) = place(tile) {
            slots[scratch.places.len()] = slot;
            scratch.places.push(place);
        }
    }
    gather(
        input,
        input.frame.settings.ambient.samples as usize,
        scratch,
    );
    let gathered = scratch.places.iter().zip(&scratch.gathered);
    for (slot, (place, gathered)) in slots.into_iter().zip(gathered) {
        records[slot] = Cell::new(place, gathered);
    }
}

/// The records of a tile's cells: interpolated between those of tiles, or gathered.
pub(crate) fn cells_of_tile(
    input: AmbientInput<'_>,
    records: &[Cell],
    tile: &Tile,
    cells: &mut [Cell; TILE_CELLS],
    scratch: &mut GatherScratch,
) {
    cells.fill(Cell::NONE);
    scratch.places.clear();
    let mut gathering = [0; TILE_CELLS];
    for (i, cell) in cells.iter_mut().enumerate() {
        let Some((x, y)) = pixel_of_cell(input, tile, i as u32) else {
            continue;
        };
        if let Some(between) = between(input, records, x, y) {
            *cell = between;
        } else {
            gathering[scratch.places.len()] = i;
            scratch
                .places
                .push(place_at(input, x, y, (x / CELL, y / CELL)));
        }
    }
    if scratch.places.is_empty() {
        return;
    }
    gather(
        input,
        input.frame.settings.ambient.samples as usize,
        scratch,
    );
    let gathered = scratch.places.iter().zip(&scratch.gathered);
    for (i, (place, gathered)) in gathering.into_iter().zip(gathered) {
        cells[i] = Cell::new(place, gathered);
    }
}

/// Least sum of the valid weights of the four tiles around a cell: two tiles, or the nearest alone.
const LEAST_BETWEEN: f32 = 0.3;

/// The record of a cell, interpolated from the four tiles with the nearest centres, without those on other
/// surfaces; `None` if one of them is not valid there, or if they differ too much.
fn between(input: AmbientInput<'_>, records: &[Cell], x: u32, y: u32) -> Option<Cell> {
    // In tiles, from the centre of the first.
    let along = |v: u32| (v as f32 + 0.5) / TILE as f32 - 0.5;
    let (u, v) = (along(x), along(y));
    let point = input.frame.sensed.direction_at(x, y) * input.frame.sensed.depth_at(x, y);
    let noise = noise_at(point);
    let mut sum = Cell {
        point,
        nearest_m: f32::INFINITY,
        ..Cell::NONE
    };
    let (mut least, mut most) = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
    let mut mean = Mean::default();
    let (mut held, mut faint, mut heaviest) = (true, true, (0.0, None));
    for (i, j) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (column, row) = (u.floor() + i, v.floor() + j);
        let weight = (1.0 - (u - column).abs()) * (1.0 - (v - row).abs());
        let inside = column >= 0.0
            && row >= 0.0
            && column < input.grid.columns as f32
            && row < input.grid.rows as f32;
        // A tile that is not active, or has no measurement, has no record.
        let slot = inside
            .then(|| input.grid.slot(column as u32, row as u32))
            .flatten();
        let Some(record) = slot.map(|slot| &records[slot]).filter(|r| !r.is_none()) else {
            continue;
        };
        if weight <= 0.0 {
            continue;
        }
        let change = record.change();
        faint &= change.abs().max_element() <= FAINT;
        if weight > heaviest.0 {
            heaviest = (weight, Some(record));
        }
        if record.is_beside(point, noise) {
            continue;
        }
        held &= record.holds_at(point, noise) > 0.0;
        (least, most) = (least.min(change), most.max(change));
        mean.add(record.delta, record.real, weight);
        sum.normal += record.normal * weight;
        sum.nearest_m = sum.nearest_m.min(record.nearest_m);
    }
    // False for NaN.
    let smooth = (most - least).max_element() <= SMOOTH;
    if mean.weight >= LEAST_BETWEEN && smooth && held {
        (sum.delta, sum.real) = mean.delta_and_real();
    } else if faint
        && held
        && let Some(nearest) = heaviest.1
    {
        // All records are on other surfaces, but whichever is right, the difference would be invisible. Not used
        // if one of them is not valid at this distance: a thin object may touch the surface here.
        return Some(Cell { point, ..*nearest });
    } else {
        return None;
    }
    sum.normal = sum.normal.try_normalize()?;
    Some(sum)
}

/// Where a cell has its record: at its centre, or at the measured pixel nearest to it.
fn pixel_of_cell(input: AmbientInput<'_>, tile: &Tile, cell: u32) -> Option<(u32, u32)> {
    let per_row = TILE / CELL;
    let (cx, cy) = (cell % per_row * CELL, cell / per_row * CELL);
    if cx >= tile.width || cy >= tile.height {
        return None;
    }
    let (w, h) = ((tile.width - cx).min(CELL), (tile.height - cy).min(CELL));
    let (x, y) = (tile.x0 + cx, tile.y0 + cy);
    let measured = |&(dx, dy): &(u32, u32)| {
        dx < w && dy < h && !input.frame.sensed.depth_at(x + dx, y + dy).is_nan()
    };
    let candidates = [(w / 2, h / 2), (1, 1), (6, 1), (1, 6), (6, 6), (0, 0)];
    let (dx, dy) = candidates.into_iter().find(measured)?;
    Some((x + dx, y + dy))
}

/// A point for a pixel with a measurement.
fn place_at(input: AmbientInput<'_>, x: u32, y: u32, lattice: (u32, u32)) -> Place {
    Place {
        point: input.frame.sensed.direction_at(x, y) * input.frame.sensed.depth_at(x, y),
        normal: input.frame.sensed.normal_at(x, y),
        x,
        y,
        lattice,
    }
}
