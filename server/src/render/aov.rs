//! Arbitrary output variables (AOVs): images beside the composite.

/// Images beside the composite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Aov {
    /// Share of the pixel that is virtual, M; 8-bit.
    Mask,
    /// Depth of the composite, 16-bit millimetres, 0 where unknown. With a lens it is still the depth at the
    /// pixel's centre, as a pinhole sees it.
    Depth,
    /// Camera-space normal of the visible surface, RGB = (n + 1) / 2; black where unknown.
    Normal,
    /// Im / Ir in luminance, 8-bit: 255 where virtual objects do not change the light, or add to it.
    Shadow,
    /// The same without shadows of lamps: the effect of ambient light alone. 8-bit, 255 where light is unchanged
    /// or added.
    Ambient,
    /// Radiance with only real objects, Ir; sRGB.
    Real,
    /// Radiance with all objects, Im; sRGB.
    Mixed,
}

impl Aov {
    /// All AOVs.
    pub const ALL: [Self; 7] = [
        Self::Mask,
        Self::Depth,
        Self::Normal,
        Self::Shadow,
        Self::Ambient,
        Self::Real,
        Self::Mixed,
    ];

    /// Name on the command line and in paths.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mask => "mask",
            Self::Depth => "depth",
            Self::Normal => "normal",
            Self::Shadow => "shadow",
            Self::Ambient => "ambient",
            Self::Real => "real",
            Self::Mixed => "mixed",
        }
    }
}

/// Pixels of an [`Aov`], the frame's size, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub enum AovImage {
    /// Mask, shadow, ambient.
    Gray8(Vec<u8>),
    /// Depth.
    Gray16(Vec<u16>),
    /// Normal, real, mixed.
    Rgb8(Vec<[u8; 3]>),
}
