//! What virtual objects do to the ambient light of real surfaces: they keep some of it away, and send
//! back what they reflect themselves. RT2AR names this as future work; without it objects float.
//!
//! The change of irradiance at a point is an integral over the directions that virtual objects fill,
//! of what they send there less what came from there before (differential rendering, Debevec 1998).
//! Only those directions are sampled, so where no object is near nothing is cast and nothing changes.
//!
//! Ambient light changes slowly except where things touch. It is gathered at one point of every tile,
//! where that is not enough at one of every [`CELL`] x [`CELL`] pixels, and interpolated by irradiance
//! caching's rule (Ward, Rubinstein and Clear 1988): a record holds within a share of the distance to
//! the nearest thing that its rays met. Pixels that no record holds for gather for themselves, each
//! with another part of one pattern, and are filtered over a whole pattern (interleaved sampling,
//! Keller and Heidrich 2001).

mod cast;
mod cell;
mod gather;
mod object;
mod occluder;
mod pattern;
mod spread;

pub(super) use occluder::Occluders;
pub(super) use pattern::AmbientPattern;

use std::sync::atomic::{AtomicU64, Ordering};

use glam::Vec3A;
use rayon::prelude::*;

use super::FrameContext;
use super::lending::Lending;
use super::tile::{TILE, TILE_PIXELS, Tile};
use cell::{Cell, cells_of_tile, records_of_tiles};
use gather::GatherScratch;
use object::{ObjectCell, ObjectScratch, object_cells, spread_objects};
use spread::{NODES, Node, filter_tile, spread_tile};

/// Side of a cell, pixels.
pub(super) const CELL: u32 = 8;

/// Cells of a tile.
pub(super) const TILE_CELLS: usize = ((TILE / CELL) * (TILE / CELL)) as usize;

/// Objects that fill less than this share of a point's half sphere, weighted by the cosine, are left
/// out, and so is a change of less than half of it. Half of an 8-bit step is at least 1/230 of a
/// pixel's light: `0.5 / 255` of the coded value, times the transfer curve's exponent of 2.2. What an
/// object fills is at most twice what it takes where it reflects half of what it gets, or where half
/// of the light is a lamp's.
const LEAST_SHARE: f32 = 1.0 / 115.0;

/// What virtual objects change of the ambient light at a pixel of the ghost surface.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct AmbientChange {
    /// Irradiance that they add; negative where they take more away.
    pub(super) delta: Vec3A,
    /// Irradiance with real things only: ambient light and lamps.
    pub(super) real: Vec3A,
    /// Unit normal of the surface as the estimate took it; zero where there is none.
    pub(super) normal: Vec3A,
    /// No record served: gathered at this pixel alone, or left to those beside it.
    pub(super) own: Own,
}

/// The share of light that is left after a change, as a share of it; one where nobody would see it.
fn share_of(change: Vec3A) -> Vec3A {
    if change.abs().max_element() < 0.5 * LEAST_SHARE {
        return Vec3A::ONE;
    }
    (Vec3A::ONE + change).max(Vec3A::ZERO)
}

/// How a pixel that no record serves came by its change.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Own {
    /// A record serves.
    #[default]
    No,
    /// By its own rays: grainy until it is filtered.
    Gathered,
    /// Not yet: the filter fills it in from those beside it that were.
    Missing,
}

impl AmbientChange {
    /// Em / Er where lamps are as they were.
    pub(super) fn share(&self) -> Vec3A {
        if self.delta == Vec3A::ZERO {
            return Vec3A::ONE;
        }
        share_of(self.delta / self.real.max(Vec3A::splat(f32::MIN_POSITIVE)))
    }
}

/// How the changes of a tile are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kept {
    /// There are none; what lies in the buffers is of an earlier frame.
    Nowhere,
    /// At a few nodes, for the tile is a part of one surface.
    AtNodes,
    /// At each pixel.
    AtPixels,
    /// At each pixel, and some gathered for themselves: those are filtered.
    Filtered,
}

/// The changes at the pixels of a tile.
#[derive(Debug, Clone)]
pub(super) struct AmbientTile {
    kept: Kept,
    nodes: [Node; NODES * NODES],
    /// By pixel; empty until a tile needs that, as most never do.
    raw: Vec<AmbientChange>,
    filtered: Vec<AmbientChange>,
}

impl AmbientTile {
    pub(super) fn new() -> Self {
        Self {
            kept: Kept::Nowhere,
            nodes: [Node::default(); NODES * NODES],
            raw: Vec::new(),
            filtered: Vec::new(),
        }
    }

    /// Whether there are any changes.
    pub(super) fn any(&self) -> bool {
        self.kept != Kept::Nowhere
    }

    /// The change at a place of the tile.
    pub(super) fn at(&self, place: usize) -> AmbientChange {
        match self.kept {
            Kept::Nowhere => AmbientChange::default(),
            Kept::AtNodes => Node::change_at(&self.nodes, place),
            Kept::AtPixels => self.raw[place],
            Kept::Filtered => self.filtered[place],
        }
    }

    /// Em / Er at a place of the tile where lamps are as they were.
    pub(super) fn share_at(&self, place: usize) -> Vec3A {
        match self.kept {
            Kept::AtNodes => Node::share_at(&self.nodes, place),
            _ => self.at(place).share(),
        }
    }

    /// The change before the filter.
    fn raw_at(&self, place: usize) -> Option<AmbientChange> {
        match self.kept {
            Kept::Nowhere => None,
            Kept::AtNodes => Some(Node::change_at(&self.nodes, place)),
            Kept::AtPixels | Kept::Filtered => Some(self.raw[place]),
        }
    }
}

/// Tiles whose records are gathered together.
const TILES_AT_ONCE: usize = 16;

/// The stage for real surfaces: its buffers, and what it found in the present frame.
pub(super) struct RealAmbient {
    /// One for every tile.
    records: Vec<Cell>,
    cells: Vec<[Cell; TILE_CELLS]>,
    tiles: Vec<AmbientTile>,
    filtered: Vec<Vec<AmbientChange>>,
    scratch: Lending<GatherScratch>,
}

impl RealAmbient {
    /// For so many threads.
    pub(super) fn new(threads: usize) -> Self {
        Self {
            records: Vec::new(),
            cells: Vec::new(),
            tiles: Vec::new(),
            filtered: Vec::new(),
            scratch: Lending::new(threads),
        }
    }

    /// Records of tiles, then cells, then pixels, then the filter, of every active tile in parallel on
    /// the current pool. Returns the changes by tile, none if there are no such tiles, and the rays
    /// cast.
    pub(super) fn run(&mut self, ctx: &FrameContext<'_>, tiles: &[Tile]) -> (&[AmbientTile], u64) {
        if !tiles.iter().any(|tile| tile.has_ambient) {
            return (&[], 0);
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
        records
            .par_chunks_mut(TILES_AT_ONCE)
            .zip(tiles.par_chunks(TILES_AT_ONCE))
            .for_each(|(records, tiles)| {
                with(&mut |scratch| records_of_tiles(ctx, tiles, records, scratch));
            });
        let (records, cells) = (&*records, &mut self.cells[..n]);
        cells.par_iter_mut().zip(tiles).for_each(|(cells, tile)| {
            if tile.has_ambient && ctx.go_on() {
                with(&mut |scratch| cells_of_tile(ctx, records, tile, cells, scratch));
            } else {
                cells.fill(Cell::NONE);
            }
        });
        let (cells, out) = (&*cells, &mut self.tiles[..n]);
        out.par_iter_mut().zip(tiles).for_each(|(out, tile)| {
            with(&mut |scratch| spread_tile(ctx, cells, tile, out, scratch));
        });
        // Each tile's filter reads its neighbours', so results are put in place afterwards.
        let raw = &*out;
        let filtered = &mut self.filtered[..n];
        let numbered = tiles.par_iter().enumerate();
        filtered
            .par_iter_mut()
            .zip(numbered)
            .for_each(|(out, (slot, tile))| filter_tile(ctx, raw, tile, slot, out));
        for (out, filtered) in out.iter_mut().zip(filtered) {
            std::mem::swap(&mut out.filtered, filtered);
        }
        (&self.tiles[..n], n_rays.into_inner())
    }
}

/// The stage for virtual surfaces.
pub(super) struct ObjectAmbient {
    cells: Vec<[ObjectCell; TILE_CELLS]>,
    /// Empty for tiles that see no virtual surface.
    tiles: Vec<Vec<Vec3A>>,
    scratch: Lending<ObjectScratch>,
}

impl ObjectAmbient {
    /// For so many threads.
    pub(super) fn new(threads: usize) -> Self {
        Self {
            cells: Vec::new(),
            tiles: Vec::new(),
            scratch: Lending::new(threads),
        }
    }

    /// How ambient irradiance differs from that of the surroundings, per pixel of tiles that see virtual
    /// surfaces. Runs when shadows are known, for what they see is lit by what those leave.
    pub(super) fn run(&mut self, ctx: &FrameContext<'_>, tiles: &[Tile]) -> &[Vec<Vec3A>] {
        let n = tiles.len();
        grow(&mut self.cells, n, || [ObjectCell::NONE; TILE_CELLS]);
        grow(&mut self.tiles, n, Vec::new);
        let asks = |tile: &Tile| tile.sees_objects && !tile.lens.rays && ctx.go_on();
        let cells = &mut self.cells[..n];
        cells.par_iter_mut().zip(tiles).for_each(|(cells, tile)| {
            if asks(tile) {
                let gather = |scratch: &mut _| object_cells(ctx, tile, cells, scratch);
                self.scratch.with(gather);
            } else {
                cells.fill(ObjectCell::NONE);
            }
        });
        let (cells, out) = (&*cells, &mut self.tiles[..n]);
        out.par_iter_mut().zip(tiles).for_each(|(out, tile)| {
            out.clear();
            if asks(tile) {
                out.resize(TILE_PIXELS, Vec3A::ZERO);
                spread_objects(ctx, cells, tile, out);
            }
        });
        &self.tiles[..n]
    }
}

/// Makes room for `n`, once.
fn grow<T>(buffer: &mut Vec<T>, n: usize, new: impl FnMut() -> T) {
    buffer.resize_with(n.max(buffer.len()), new);
}
