//! Inputs of the shade stage.

use crate::render::cpu::light_field::LightField;
use crate::render::cpu::lighting::Lighting;
use crate::render::cpu::tile::{PrimaryPixels, PrimaryTile, Tile};
use crate::render::prepare::frame::PreparedFrame;

/// Number of lights above which shading a single surface takes tens of microseconds.
const MANY_LIGHTS: usize = 64;

/// The frame, and the results of earlier stages.
#[derive(Clone, Copy)]
pub(crate) struct ShadeInput<'a> {
    pub(crate) frame: &'a PreparedFrame<'a>,
    pub(crate) lighting: Lighting<'a>,
    pub(crate) primary: PrimaryPixels<'a>,
    pub(crate) light: LightField<'a>,
}

/// An active tile.
#[derive(Clone, Copy)]
pub(crate) struct ShadeTile<'a> {
    /// Its index in the lists of active tiles.
    pub(crate) slot: usize,
    pub(crate) tile: &'a Tile,
    pub(crate) primary: &'a PrimaryTile,
}

impl ShadeInput<'_> {
    /// Calls the checkpoint before surface `i` of a loop, but not for every surface if each takes less than a
    /// microsecond.
    #[inline]
    pub(crate) fn go_on_at(&self, i: usize) -> bool {
        let slow = self.lighting.photons.is_some() || self.frame.lights.len() > MANY_LIGHTS;
        if slow || i.is_multiple_of(16) {
            self.frame.go_on()
        } else {
            !self.frame.pulse.is_stopped()
        }
    }
}
