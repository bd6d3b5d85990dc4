//! Tiles: the unit of work, and the per-pixel records that stages hand on.
//!
//! Records are stored tile by tile, so that threads write disjoint chunks; tiles that nothing
//! virtual can reach have no records and are copied.

use glam::Vec3A;

use crate::accel::Hit;
use crate::render::FrameStats;

use super::lens_plan::LensPlan;
use super::plan::LightSet;
use super::scatter::LightShare;

/// Side of a tile, pixels.
pub(super) const TILE: u32 = 16;
/// Pixels of a whole tile.
pub(super) const TILE_PIXELS: usize = (TILE * TILE) as usize;

/// What the primary ray through a pixel's centre shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) enum Seen {
    /// The camera's pixel: the ghost surface, or nothing.
    #[default]
    Camera,
    /// A virtual object.
    Object,
    /// The camera's pixel, on a modelled ghost object.
    GhostObject,
}

/// A pixel after the primary stage.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pixel {
    pub(super) seen: Seen,
    /// Meaningful unless `seen` is [`Seen::Camera`].
    pub(super) hit: Hit,
}

impl Default for Pixel {
    fn default() -> Self {
        Self {
            seen: Seen::Camera,
            hit: NO_HIT,
        }
    }
}

/// Stands where nothing was hit.
pub(super) const NO_HIT: Hit = Hit {
    t: f32::INFINITY,
    instance: u32::MAX,
    triangle: 0,
    u: 0.0,
    v: 0.0,
};

/// Light that reaches a pixel's surfaces, as shares of what would without occlusion.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelLight {
    /// Em / Er of the real surface at this pixel, whether or not something virtual covers it.
    pub(super) ghost: Vec3A,
    /// Direct light on the virtual surface seen here, 0..=1 per channel.
    pub(super) object: LightShare,
    pub(super) ghost_penumbra: bool,
    pub(super) object_penumbra: bool,
}

impl Default for PixelLight {
    fn default() -> Self {
        Self {
            ghost: Vec3A::ONE,
            object: LightShare::ALL,
            ghost_penumbra: false,
            object_penumbra: false,
        }
    }
}

/// A tile that something virtual may reach.
#[derive(Debug, Clone)]
pub(super) struct Tile {
    pub(super) x0: u32,
    pub(super) y0: u32,
    pub(super) width: u32,
    pub(super) height: u32,
    /// A mesh's screen bounds overlap it.
    pub(super) sees_objects: bool,
    /// Lights that something virtual may keep from its part of the ghost surface.
    pub(super) lights: LightSet,
    /// Those of them that something transmissive may be before.
    pub(super) glass: LightSet,
    /// Photons may light its part of the ghost surface.
    pub(super) has_photons: bool,
    /// Virtual objects may change the ambient light of its part of the ghost surface.
    pub(super) has_ambient: bool,
    /// What a lens with an extent does here.
    pub(super) lens: LensPlan,
    /// Some of `pixels` may show something else than the camera's.
    pub(super) shows_objects: bool,
    pub(super) pixels: Box<[Pixel; TILE_PIXELS]>,
    /// Of its real surfaces only ambient light may change: `light` is not meaningful.
    pub(super) only_ambient: bool,
    pub(super) light: Box<[PixelLight; TILE_PIXELS]>,
    /// Some pixel is in penumbra.
    pub(super) has_penumbra: bool,
    /// Something virtual changes the light of some real surface in it.
    pub(super) is_relit: bool,
    /// Counts of the shadow stage.
    pub(super) shadow_stats: FrameStats,
}

impl Tile {
    pub(super) fn new() -> Self {
        Self {
            x0: 0,
            y0: 0,
            width: 0,
            height: 0,
            sees_objects: false,
            lights: LightSet::default(),
            glass: LightSet::default(),
            has_photons: false,
            has_ambient: false,
            lens: LensPlan::default(),
            only_ambient: false,
            shows_objects: false,
            pixels: Box::new([Pixel::default(); TILE_PIXELS]),
            light: Box::new([PixelLight::default(); TILE_PIXELS]),
            has_penumbra: false,
            is_relit: false,
            shadow_stats: FrameStats::default(),
        }
    }

    /// Record of the pixel at (dx, dy) within the tile.
    #[inline]
    pub(super) fn index(dx: u32, dy: u32) -> usize {
        (dy * TILE + dx) as usize
    }

    /// The tile's pixels as 4x4 blocks of (dx, dy): rays of a block are close together.
    pub(super) fn blocks(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let (width, height) = (self.width, self.height);
        (0..height.div_ceil(4))
            .flat_map(move |by| (0..width.div_ceil(4)).map(move |bx| (bx * 4, by * 4)))
    }
}

/// Which tile holds a pixel's records.
#[derive(Debug, Clone, Default)]
pub(super) struct TileGrid {
    pub(super) columns: u32,
    pub(super) rows: u32,
    /// Position in the list of active tiles, or `u32::MAX`.
    slots: Vec<u32>,
}

impl TileGrid {
    pub(super) fn reset(&mut self, width: u32, height: u32) {
        self.columns = width.div_ceil(TILE);
        self.rows = height.div_ceil(TILE);
        self.slots.clear();
        self.slots
            .resize((self.columns * self.rows) as usize, u32::MAX);
    }

    pub(super) fn set(&mut self, column: u32, row: u32, slot: usize) {
        self.slots[(row * self.columns + column) as usize] = slot as u32;
    }

    /// Position of a tile in the list of active ones.
    #[inline]
    pub(super) fn slot(&self, column: u32, row: u32) -> Option<usize> {
        let slot = self.slots[(row * self.columns + column) as usize];
        (slot != u32::MAX).then_some(slot as usize)
    }

    /// Active tile and record index of a pixel.
    #[inline]
    pub(super) fn locate(&self, x: u32, y: u32) -> Option<(usize, usize)> {
        self.slot(x / TILE, y / TILE)
            .map(|slot| (slot, Tile::index(x % TILE, y % TILE)))
    }
}
