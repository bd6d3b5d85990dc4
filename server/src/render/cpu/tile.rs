//! Tiles: the unit of work, and the per-pixel records that stages pass on.
//!
//! Records are stored tile by tile, so that threads write disjoint chunks. Tiles that no virtual object can
//! affect have no records; their pixels are copied.

use glam::Vec3A;

use crate::accel::Hit;
use crate::render::prepare::tile_plan::{
    LensPlan, LightSet, TILE, TILE_PIXELS, TileGrid, pixel_index,
};
use crate::render::stats::FrameStats;

/// What the primary ray through a pixel's centre hits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum PrimaryHit {
    /// The camera's pixel: the ghost surface, or nothing.
    #[default]
    Camera,
    /// A virtual object.
    Object,
    /// A modelled ghost object; the pixel shows the camera's picture.
    GhostObject,
}

/// A pixel after the primary stage.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pixel {
    pub(crate) seen: PrimaryHit,
    /// Meaningful unless `seen` is [`PrimaryHit::Camera`].
    pub(crate) hit: Hit,
}

impl Default for Pixel {
    fn default() -> Self {
        Self {
            seen: PrimaryHit::Camera,
            hit: NO_HIT,
        }
    }
}

/// The hit of a ray that hit nothing.
pub(crate) const NO_HIT: Hit = Hit {
    t: f32::INFINITY,
    instance: u32::MAX,
    triangle: 0,
    u: 0.0,
    v: 0.0,
};

/// Light on a pixel's surfaces, as shares of the unoccluded light.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelLight {
    /// Em / Er of the real surface at this pixel, whether or not a virtual object covers it.
    pub(crate) ghost: Vec3A,
    /// Direct light on the virtual surface at this pixel, 0..=1 per channel.
    pub(crate) object: LightShare,
    pub(crate) ghost_penumbra: bool,
    pub(crate) object_penumbra: bool,
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

/// Light on a surface: the lit shares of its diffuse and of its specular reflection of lamps, and the difference
/// of its ambient light from that of the surroundings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LightShare {
    pub(crate) diffuse: Vec3A,
    pub(crate) gloss: Vec3A,
    /// Ambient irradiance minus that of the surroundings.
    pub(crate) ambient: Vec3A,
}

impl LightShare {
    pub(crate) const ALL: Self = Self {
        diffuse: Vec3A::ONE,
        gloss: Vec3A::ONE,
        ambient: Vec3A::ZERO,
    };
}

/// The plan of a tile that virtual objects may affect.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Tile {
    /// First column and row.
    pub(crate) x0: u32,
    pub(crate) y0: u32,
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// The screen bounds of a mesh overlap it.
    pub(crate) sees_objects: bool,
    /// Lights that virtual objects may block from its part of the ghost surface.
    pub(crate) lights: LightSet,
    /// Those of `lights` that transmissive objects may be in front of.
    pub(crate) glass: LightSet,
    /// Photons may light its part of the ghost surface.
    pub(crate) has_photons: bool,
    /// Virtual objects may change the ambient light of its part of the ghost surface.
    pub(crate) has_ambient: bool,
    /// The effect of a lens with an aperture on this tile.
    pub(crate) lens: LensPlan,
}

impl Tile {
    /// Record of the pixel at (dx, dy) within the tile.
    #[inline]
    pub(crate) fn index(dx: u32, dy: u32) -> usize {
        pixel_index(dx, dy)
    }

    /// The tile's pixels as 4x4 blocks of (dx, dy): rays of a block are coherent.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = (u32, u32)> + use<> {
        let (width, height) = (self.width, self.height);
        (0..height.div_ceil(4))
            .flat_map(move |by| (0..width.div_ceil(4)).map(move |bx| (bx * 4, by * 4)))
    }
}

/// Results of the primary stage for a tile.
#[derive(Debug, Clone)]
pub(crate) struct PrimaryTile {
    pub(crate) pixels: Box<[Pixel; TILE_PIXELS]>,
    /// Some of `pixels` may not show the camera's picture.
    pub(crate) shows_objects: bool,
}

impl PrimaryTile {
    pub(crate) fn new() -> Self {
        Self {
            pixels: Box::new([Pixel::default(); TILE_PIXELS]),
            shows_objects: false,
        }
    }
}

/// Results of the shadow stage for a tile.
#[derive(Debug, Clone)]
pub(crate) struct LightTile {
    pub(crate) light: Box<[PixelLight; TILE_PIXELS]>,
    /// Only the ambient light of its real surfaces may change: `light` is not meaningful.
    pub(crate) only_ambient: bool,
    /// Some pixel is in penumbra.
    pub(crate) has_penumbra: bool,
    /// Virtual objects change the light of some real surface in it.
    pub(crate) is_relit: bool,
    pub(crate) stats: FrameStats,
}

impl LightTile {
    pub(crate) fn new() -> Self {
        Self {
            light: Box::new([PixelLight::default(); TILE_PIXELS]),
            only_ambient: false,
            has_penumbra: false,
            is_relit: false,
            stats: FrameStats::default(),
        }
    }
}

/// Results of the primary stage for every pixel of the picture.
#[derive(Clone, Copy)]
pub(crate) struct PrimaryPixels<'a> {
    pub(crate) grid: &'a TileGrid,
    /// By active tile.
    pub(crate) tiles: &'a [PrimaryTile],
}

impl PrimaryPixels<'_> {
    /// The record of a pixel; in a tile without records, one that shows the camera's picture.
    pub(crate) fn at(&self, x: u32, y: u32) -> Pixel {
        self.grid
            .locate(x, y)
            .map_or_else(Pixel::default, |(slot, place)| {
                self.tiles[slot].pixels[place]
            })
    }
}

/// The pixels of a tile, a bit for each, row by row.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct PixelSet([u16; TILE as usize]);

impl PixelSet {
    /// Adds a pixel, given in coordinates of the picture.
    pub(crate) fn insert(&mut self, x: u32, y: u32) {
        self.0[(y % TILE) as usize] |= 1 << (x % TILE);
    }

    pub(crate) fn contains(&self, x: u32, y: u32) -> bool {
        self.0[(y % TILE) as usize] >> (x % TILE) & 1 != 0
    }

    /// The pixels, and those to their left, right, above and below within the tile.
    pub(crate) fn widened(&self) -> Self {
        let row = |y: usize| self.0.get(y).copied().unwrap_or(0);
        Self(std::array::from_fn(|y| {
            row(y) | row(y) << 1 | row(y) >> 1 | row(y.wrapping_sub(1)) | row(y + 1)
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn widening_adds_the_four_neighbours_within_the_tile() {
        const { assert!(TILE == u16::BITS) };
        for (x, y) in (0..TILE).flat_map(|y| (0..TILE).map(move |x| (x, y))) {
            let mut one = PixelSet::default();
            one.insert(x + 3 * TILE, y + TILE);
            let wide = one.widened();
            for (i, j) in (0..TILE).flat_map(|j| (0..TILE).map(move |i| (i, j))) {
                let near = x.abs_diff(i) + y.abs_diff(j) <= 1;
                assert_eq!(wide.contains(i, j), near, "{x} {y}: {i} {j}");
            }
        }
    }
}
