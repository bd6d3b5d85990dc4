//! The ambient stage: virtual objects occlude ambient light of real surfaces, and reflect light onto them. RT2AR
//! names this as future work; without it objects seem to float.
//!
//! The change of irradiance at a point is an integral over the directions in which there are virtual objects:
//! their radiance minus the radiance that came from there before (differential rendering, Debevec 1998). Only
//! these directions are sampled, so without an object nearby no ray is cast and nothing changes.
//!
//! Ambient light changes slowly except where objects touch. It is gathered at one point of every tile and, where
//! that is not enough, at one point of every [`input::CELL`] x [`input::CELL`] pixels. It is interpolated by the
//! rule of irradiance caching (Ward, Rubinstein and Clear 1988): a record is valid within a share of the distance
//! to the nearest hit of its rays. Pixels without a valid record are gathered individually, each with a different
//! part of one sample pattern, and are filtered over a whole pattern (interleaved sampling, Keller and Heidrich
//! 2001).

mod around;
mod cast;
mod cell;
pub(crate) mod change;
mod gather;
pub(crate) mod input;
mod object;
mod spread;

use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3A;

use crate::render::prepare::tile_plan::TILE_PIXELS;
use crate::render::threads::Workers;

use super::light_field::SurfaceLight;
use super::scratch::ScratchPool;
use super::tile::{PrimaryTile, Tile};
use cell::{Cell, cells_of_tile, records_of_tiles};
use change::{AmbientChange, AmbientChanges, AmbientTile};
use gather::GatherScratch;
use input::{AmbientInput, TILE_CELLS, TILES_AT_ONCE};
use object::{ObjectCell, ObjectScratch, object_cells, spread_objects};
use spread::{filter_tile, spread_tile};

/// The stage for real surfaces: its buffers, and the changes of the current frame.
pub(crate) struct RealAmbient {
    /// One record for every tile.
    records: Vec<Cell>,
    cells: Vec<[Cell; TILE_CELLS]>,
    tiles: Vec<AmbientTile>,
    filtered: Vec<Vec<AmbientChange>>,
    scratch: ScratchPool<GatherScratch>,
}

impl RealAmbient {
    /// For `threads` threads.
    pub(crate) fn new(threads: usize) -> Self {
        Self {
            records: Vec::new(),
            cells: Vec::new(),
            tiles: Vec::new(),
            filtered: Vec::new(),
            scratch: ScratchPool::new(threads),
        }
    }

    /// Computes records of tiles, then of cells, then the changes of pixels, then the filter, for all active
    /// tiles in parallel. Returns the changes by tile, empty if there are no such tiles, and the number of rays
    /// cast.
    pub(crate) fn run(
        &mut self,
        input: AmbientInput<'_>,
        tiles: &[Tile],
        workers: Workers<'_>,
    ) -> (AmbientChanges<'_>, u64) {
        if !tiles.iter().any(|tile| tile.has_ambient) {
            return (AmbientChanges(&[]), 0);
        }
        let n = tiles.len();
        grow(&mut self.records, n, || Cell::NONE);
        grow(&mut self.cells, n, || [Cell::NONE; TILE_CELLS]);
        grow(&mut self.tiles, n, AmbientTile::new);
        grow(&mut self.filtered, n, Vec::new);
        let n_rays = AtomicU64::new(0);
        let with = |work: &mut dyn FnMut(&mut GatherScratch)| {
            self.scratch.with(|scratch| {
                work(scratch);
                n_rays.fetch_add(
                    std::mem::take(&mut scratch.caster.n_rays),
                    Ordering::Relaxed,
                );
            });
        };
        let records = &mut self.records[..n];
        let groups = records.chunks_mut(TILES_AT_ONCE);
        let groups = groups.zip(tiles.chunks(TILES_AT_ONCE));
        workers.for_each(groups, |(records, tiles)| {
            with(&mut |scratch| records_of_tiles(input, tiles, records, scratch));
        });
        let (records, cells) = (&*records, &mut self.cells[..n]);
        workers.for_each(cells.iter_mut().zip(tiles), |(cells, tile)| {
            if tile.has_ambient && input.frame.go_on() {
                with(&mut |scratch| cells_of_tile(input, records, tile, cells, scratch));
            } else {
                cells.fill(Cell::NONE);
            }
        });
        let (cells, out) = (&*cells, &mut self.tiles[..n]);
        workers.for_each(out.iter_mut().zip(tiles), |(out, tile)| {
            with(&mut |scratch| spread_tile(input, cells, tile, out, scratch));
        });
        // The filter of each tile reads its neighbours, so results are stored afterwards.
        let raw = &*out;
        let filtered = &mut self.filtered[..n];
        let numbered = tiles.iter().enumerate();
        workers.for_each(filtered.iter_mut().zip(numbered), |(out, (slot, tile))| {
            filter_tile(input, raw, tile, slot, out);
        });
        for (out, filtered) in out.iter_mut().zip(filtered) {
            std::mem::swap(&mut out.filtered, filtered);
        }
        (AmbientChanges(&self.tiles[..n]), n_rays.into_inner())
    }
}

/// The stage for virtual surfaces.
pub(crate) struct ObjectAmbient {
    cells: Vec<[ObjectCell; TILE_CELLS]>,
    /// Empty for tiles that show no virtual surface.
    tiles: Vec<Vec<Vec3A>>,
    scratch: ScratchPool<ObjectScratch>,
}

impl ObjectAmbient {
    /// For `threads` threads.
    pub(crate) fn new(threads: usize) -> Self {
        Self {
            cells: Vec::new(),
            tiles: Vec::new(),
            scratch: ScratchPool::new(threads),
        }
    }

    /// Difference between the ambient irradiance and that of the surroundings, for each pixel of tiles that show
    /// virtual surfaces. Runs after the shadow stage, because the surfaces around are lit by the light that it
    /// computes.
    pub(crate) fn run(
        &mut self,
        input: AmbientInput<'_>,
        light: SurfaceLight<'_>,
        (tiles, primary): (&[Tile], &[PrimaryTile]),
        workers: Workers<'_>,
    ) -> &[Vec<Vec3A>] {
        let n = tiles.len();
        grow(&mut self.cells, n, || [ObjectCell::NONE; TILE_CELLS]);
        grow(&mut self.tiles, n, Vec::new);
        let asks = |tile: &Tile| tile.sees_objects && !tile.lens.rays && input.frame.go_on();
        let cells = &mut self.cells[..n];
        let tiles = tiles.iter().zip(primary);
        let each = cells.iter_mut().zip(tiles.clone());
        workers.for_each(each, |(cells, (tile, primary))| {
            if asks(tile) {
                let gather =
                    |scratch: &mut _| object_cells(input, light, (tile, primary), cells, scratch);
                self.scratch.with(gather);
            } else {
                cells.fill(ObjectCell::NONE);
            }
        });
        let (cells, out) = (&*cells, &mut self.tiles[..n]);
        let each = out.iter_mut().zip(tiles);
        workers.for_each(each, |(out, (tile, primary))| {
            out.clear();
            if asks(tile) {
                out.resize(TILE_PIXELS, Vec3A::ZERO);
                spread_objects(input, cells, (tile, primary), out);
            }
        });
        &self.tiles[..n]
    }
}

/// Grows a buffer to at least `n` elements.
fn grow<T>(buffer: &mut Vec<T>, n: usize, new: impl FnMut() -> T) {
    buffer.resize_with(n.max(buffer.len()), new);
}
