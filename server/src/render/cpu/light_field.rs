//! The light of every pixel: before the filter, after it, and with the ambient light of virtual surfaces.

use glam::Vec3A;

use crate::render::prepare::sensed::Sensed;
use crate::render::prepare::tile_plan::{TILE_PIXELS, TileGrid};

use super::ambient::change::AmbientChanges;
use super::tile::{LightTile, PixelLight};

/// Light before the filter.
#[derive(Clone, Copy)]
pub(crate) struct RawLight<'a> {
    pub(crate) grid: &'a TileGrid,
    /// By active tile, like `ambient`.
    pub(crate) tiles: &'a [LightTile],
    pub(crate) ambient: AmbientChanges<'a>,
}

impl RawLight<'_> {
    /// Light of a pixel; `None` in a tile that nothing virtual reaches.
    pub(crate) fn at(&self, x: u32, y: u32) -> Option<PixelLight> {
        self.grid
            .locate(x, y)
            .map(|(slot, place)| self.in_tile(slot, place))
    }

    /// Light at a pixel of an active tile.
    fn in_tile(&self, slot: usize, place: usize) -> PixelLight {
        let tile = &self.tiles[slot];
        if tile.only_ambient {
            return PixelLight {
                ghost: self.ambient.share(slot, place),
                ..PixelLight::default()
            };
        }
        tile.light[place]
    }
}

/// Light after the filter.
#[derive(Clone, Copy)]
pub(crate) struct SurfaceLight<'a> {
    pub(crate) raw: RawLight<'a>,
    /// By active tile, meaningful only in penumbra; empty without a filter.
    pub(crate) filtered: &'a [Box<[PixelLight; TILE_PIXELS]>],
}

impl SurfaceLight<'_> {
    /// Light of a pixel.
    pub(crate) fn at(&self, x: u32, y: u32) -> PixelLight {
        let raw = &self.raw;
        raw.grid
            .locate(x, y)
            .map_or_else(PixelLight::default, |(slot, place)| {
                self.in_tile(slot, place)
            })
    }

    fn in_tile(&self, slot: usize, place: usize) -> PixelLight {
        let filtered = self.filtered.get(slot);
        match filtered.filter(|_| self.raw.tiles[slot].has_penumbra) {
            Some(filtered) => filtered[place],
            None => self.raw.in_tile(slot, place),
        }
    }

    /// The camera's picture at any position, relit by the light that virtual objects leave.
    pub(crate) fn relit_camera(&self, sensed: &Sensed<'_>, u: f32, v: f32) -> Vec3A {
        sensed.interpolate(u, v, |x, y| sensed.color_at(x, y) * self.at(x, y).ghost)
    }
}

/// Light after the filter, with the ambient light of virtual surfaces.
#[derive(Clone, Copy)]
pub(crate) struct LightField<'a> {
    pub(crate) surfaces: SurfaceLight<'a>,
    /// Ambient irradiance on virtual surfaces minus that of the surroundings, for each pixel of tiles that show
    /// any (other tiles have none); empty if it is not computed.
    pub(crate) object_ambient: &'a [Vec<Vec3A>],
}

impl LightField<'_> {
    /// Light of a pixel.
    pub(crate) fn at(&self, x: u32, y: u32) -> PixelLight {
        let grid = self.surfaces.raw.grid;
        grid.locate(x, y)
            .map_or_else(PixelLight::default, |(slot, place)| {
                let mut light = self.surfaces.in_tile(slot, place);
                let ambient = self.object_ambient.get(slot);
                if let Some(&ambient) = ambient.and_then(|tile| tile.get(place)) {
                    light.object.ambient = ambient;
                }
                light
            })
    }
}
