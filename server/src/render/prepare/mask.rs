//! Masks of the acceleration structure: which rays can hit which objects.

use crate::accel::{MASK_GHOST, MASK_VIRTUAL};

/// Virtual objects that refract light: with caustics, their transmitted light arrives as photons.
pub(crate) const MASK_GLASS: u8 = 4;
/// Virtual objects that transmit light without bending it: thin surfaces and blended ones.
pub(crate) const MASK_SHEET: u8 = 16;
/// Virtual objects that transmit light: they tint shadow rays instead of blocking them.
pub(crate) const MASK_TRANSMISSIVE: u8 = MASK_GLASS | MASK_SHEET;
/// Virtual objects that block light.
pub(crate) const MASK_OPAQUE: u8 = MASK_VIRTUAL;
/// Virtual objects that block light, as casters of shadows on real surfaces; may be at a coarser level of detail.
pub(crate) const MASK_SHADOW: u8 = 8;
/// All virtual objects that cast shadows on real surfaces.
pub(crate) const MASK_SHADOW_ANY: u8 = MASK_SHADOW | MASK_TRANSMISSIVE;
/// All virtual objects.
pub(crate) const MASK_VIRTUAL_ANY: u8 = MASK_OPAQUE | MASK_TRANSMISSIVE;
/// All objects that a ray of the mixed scene can hit.
pub(crate) const MASK_ALL: u8 = MASK_VIRTUAL_ANY | MASK_GHOST;
