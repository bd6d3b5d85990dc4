//! Masks of the acceleration structure: which rays meet which objects.

use crate::accel::{MASK_GHOST, MASK_VIRTUAL};

/// Virtual objects that refract light: with caustics, what they let through arrives as photons.
pub(crate) const MASK_GLASS: u8 = 4;
/// Virtual objects that let light through without bending it: thin sheets and blended surfaces.
pub(crate) const MASK_SHEET: u8 = 16;
/// Virtual objects that let light through: they tint shadow rays instead of stopping them.
pub(crate) const MASK_TRANSMISSIVE: u8 = MASK_GLASS | MASK_SHEET;
/// Virtual objects that stop light.
pub(crate) const MASK_OPAQUE: u8 = MASK_VIRTUAL;
/// Virtual objects that stop light, as casters of shadows on real surfaces: a coarser level of detail
/// may stand for them.
pub(crate) const MASK_SHADOW: u8 = 8;
/// Everything virtual that casts shadows on real surfaces.
pub(crate) const MASK_SHADOW_ANY: u8 = MASK_SHADOW | MASK_TRANSMISSIVE;
/// Everything virtual.
pub(crate) const MASK_VIRTUAL_ANY: u8 = MASK_OPAQUE | MASK_TRANSMISSIVE;
/// Everything that a ray of the mixed scene meets.
pub(crate) const MASK_ALL: u8 = MASK_VIRTUAL_ANY | MASK_GHOST;
