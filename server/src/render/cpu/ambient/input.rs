//! Inputs of the ambient stage, and the sizes that its steps share.

use glam::Vec3A;

use crate::render::prepare::environment::Surroundings;
use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::tile_plan::{TILE, TileGrid};

/// Side of a cell, pixels.
pub(crate) const CELL: u32 = 8;

/// Cells of a tile.
pub(crate) const TILE_CELLS: usize = ((TILE / CELL) * (TILE / CELL)) as usize;

/// Tiles whose records are gathered together.
pub(crate) const TILES_AT_ONCE: usize = 16;

/// The frame, its environment and its tile grid.
#[derive(Clone, Copy)]
pub(crate) struct AmbientInput<'a> {
    pub(crate) frame: &'a PreparedFrame<'a>,
    pub(crate) surroundings: &'a Surroundings<'a>,
    pub(crate) grid: &'a TileGrid,
}

/// A point of the ghost surface at which light is gathered.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    /// Camera space.
    pub(crate) point: Vec3A,
    /// Unit.
    pub(crate) normal: Vec3A,
    /// Pixel coordinates.
    pub(crate) x: u32,
    pub(crate) y: u32,
    /// Position in the 4x4 sample pattern: neighbours have neighbouring positions.
    pub(crate) lattice: (u32, u32),
}
