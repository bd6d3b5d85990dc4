//! The result of the shade stage.

use glam::Vec3A;

use crate::render::prepare::tile_plan::TILE_PIXELS;
use crate::render::stats::FrameStats;

/// The result of a tile.
#[derive(Debug, Clone)]
pub(crate) struct Shaded {
    /// Linear composite; meaningful where `touched`.
    pub(crate) color: Box<[Vec3A; TILE_PIXELS]>,
    /// M Im: the virtual part of `color`, which bloom and glare spread.
    pub(crate) virtual_light: Box<[Vec3A; TILE_PIXELS]>,
    /// M.
    pub(crate) mask: Box<[f32; TILE_PIXELS]>,
    /// Share of light that virtual objects leave on real surfaces in each pixel; only if a lens gathers it from
    /// other pixels as well, otherwise empty.
    pub(crate) shares: Vec<Vec3A>,
    /// Pixels that differ from the camera's.
    pub(crate) touched: Box<[bool; TILE_PIXELS]>,
    /// `color` as displayed; meaningful where `touched`. Converted here, while other tiles are still being
    /// traced; only pixels that highlights spread to are converted again.
    pub(crate) bytes: Box<[[u8; 3]; TILE_PIXELS]>,
    /// The change that virtual objects cause on modelled real mirrors, Im - Ir, per pixel; empty without
    /// any.
    pub(crate) delta: Vec<Vec3A>,
    /// Whether rays were traced for it, so that it has to be finished.
    pub(crate) traced: bool,
    /// Whether `virtual_light` and `mask` are zero everywhere.
    pub(crate) blank: bool,
    /// Largest luminance of `virtual_light`.
    pub(crate) peak: f32,
    pub(crate) stats: FrameStats,
}

impl Shaded {
    pub(crate) fn new() -> Self {
        Self {
            color: Box::new([Vec3A::ZERO; TILE_PIXELS]),
            virtual_light: Box::new([Vec3A::ZERO; TILE_PIXELS]),
            mask: Box::new([0.0; TILE_PIXELS]),
            shares: Vec::new(),
            touched: Box::new([false; TILE_PIXELS]),
            bytes: Box::new([[0; 3]; TILE_PIXELS]),
            delta: Vec::new(),
            traced: false,
            blank: true,
            peak: 0.0,
            stats: FrameStats::default(),
        }
    }
}
