//! The cells around a tile, and their weights at its pixels.

use crate::render::cpu::tile::Tile;
use crate::render::prepare::tile_plan::{TILE, TileGrid};

use super::input::{CELL, TILE_CELLS};

/// Cells on each side of a tile whose records its pixels use: a tent reaches over two cells.
const MARGIN: u32 = 2;

/// Side of the square of cells formed by a tile and its margins.
pub(crate) const SPAN: usize = (TILE / CELL + 2 * MARGIN) as usize;

/// Cells along each axis whose records a pixel uses.
const TAPS: u32 = 2 * MARGIN;

/// The cells of a tile and those around it, in rows of [`SPAN`], beginning [`MARGIN`] cells up and left of the
/// tile.
pub(crate) fn around<'c, T>(
    grid: &TileGrid,
    cells: &'c [[T; TILE_CELLS]],
    tile: &Tile,
    none: &'c T,
) -> [&'c T; SPAN * SPAN] {
    let per_tile = i64::from(TILE / CELL);
    let first = |v: u32| i64::from(v / CELL) - i64::from(MARGIN);
    let (first_x, first_y) = (first(tile.x0), first(tile.y0));
    let find = |i: usize| {
        let (x, y) = (first_x + (i % SPAN) as i64, first_y + (i / SPAN) as i64);
        let (column, row) = (x.div_euclid(per_tile), y.div_euclid(per_tile));
        let inside = (0..i64::from(grid.columns)).contains(&column)
            && (0..i64::from(grid.rows)).contains(&row);
        let slot = inside
            .then(|| grid.slot(column as u32, row as u32))
            .flatten()?;
        let place = y.rem_euclid(per_tile) * per_tile + x.rem_euclid(per_tile);
        cells.get(slot).map(|cells| &cells[place as usize])
    };
    std::array::from_fn(|i| find(i).unwrap_or(none))
}

/// The cells of [`around`] whose records a pixel of the tile uses, with their weights: tents that reach two cells
/// to each side. All cells in reach are used, so that a linear change is interpolated exactly.
pub(crate) fn taps(dx: u32, dy: u32) -> impl Iterator<Item = (usize, f32)> {
    // The first cell whose tent reaches the pixel: its centre is less than two cells before the pixel.
    let first = |d: u32| (d + CELL / 2) / CELL + MARGIN - TAPS / 2;
    let weight = |d: u32, cell: u32| {
        let middle = (cell as f32 - MARGIN as f32 + 0.5) * CELL as f32;
        1.0 - (d as f32 + 0.5 - middle).abs() / (MARGIN * CELL) as f32
    };
    let (cx, cy) = (first(dx), first(dy));
    (0..TAPS * TAPS).map(move |k| {
        let (x, y) = (cx + k % TAPS, cy + k / TAPS);
        (
            (y as usize * SPAN + x as usize),
            weight(dx, x) * weight(dy, y),
        )
    })
}
