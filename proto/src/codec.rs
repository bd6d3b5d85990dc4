//! Codecs of payloads, and the planes they are allowed for.

use serde::{Deserialize, Serialize};

use crate::{Code, WireError};

/// Codec of a payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Codec {
    /// No payload.
    None,
    /// JPEG.
    Jpeg,
    /// PNG.
    Png,
    /// 3 bytes per pixel.
    Rgb8,
    /// 4 bytes per pixel.
    Rgba8,
    /// 1 byte per pixel.
    Gray8,
    /// 2 bytes per pixel, little-endian.
    U16,
    /// Run-length and variable-length coded 16-bit samples ([`crate::depth`]).
    Rvl,
    /// Differences in byte planes, compressed with zstd ([`crate::depth`]).
    DeltaZstd,
}

/// Content of a payload.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Plane {
    /// Colour of a frame.
    Color,
    /// Depth of a frame.
    Depth,
    /// Image of a composite.
    Image,
    /// The camera's picture, sent with a composite.
    Camera,
    /// Share of each pixel that is virtual.
    Mask,
    /// Depth of a composite.
    CompositeDepth,
}

impl Plane {
    /// Name in error messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Color => "colour",
            Self::Depth | Self::CompositeDepth => "depth",
            Self::Image => "image",
            Self::Camera => "camera",
            Self::Mask => "mask",
        }
    }
}

impl Codec {
    /// All codecs.
    pub const ALL: [Self; 9] = [
        Self::None,
        Self::Jpeg,
        Self::Png,
        Self::Rgb8,
        Self::Rgba8,
        Self::Gray8,
        Self::U16,
        Self::Rvl,
        Self::DeltaZstd,
    ];

    /// Code on the wire.
    pub fn code(self) -> u8 {
        match self {
            Self::None => 0,
            Self::Jpeg => 1,
            Self::Png => 2,
            Self::Rgb8 => 3,
            Self::Rgba8 => 4,
            Self::Gray8 => 5,
            Self::U16 => 16,
            Self::Rvl => 17,
            Self::DeltaZstd => 18,
        }
    }

    /// Name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Jpeg => "jpeg",
            Self::Png => "png",
            Self::Rgb8 => "rgb8",
            Self::Rgba8 => "rgba8",
            Self::Gray8 => "gray8",
            Self::U16 => "u16",
            Self::Rvl => "rvl",
            Self::DeltaZstd => "delta_zstd",
        }
    }

    /// Whether the codec is allowed for a plane.
    pub fn allowed_for(self, plane: Plane) -> bool {
        match self {
            Self::None => matches!(plane, Plane::Camera | Plane::Mask | Plane::CompositeDepth),
            Self::Jpeg | Self::Rgb8 | Self::Rgba8 => {
                matches!(plane, Plane::Color | Plane::Image | Plane::Camera)
            }
            Self::Png => true,
            Self::Gray8 => plane == Plane::Mask,
            Self::U16 | Self::Rvl | Self::DeltaZstd => {
                matches!(plane, Plane::Depth | Plane::CompositeDepth)
            }
        }
    }

    /// Bytes per pixel, if fixed.
    pub fn bytes_per_pixel(self) -> Option<usize> {
        match self {
            Self::Gray8 => Some(1),
            Self::U16 => Some(2),
            Self::Rgb8 => Some(3),
            Self::Rgba8 => Some(4),
            Self::None | Self::Jpeg | Self::Png | Self::Rvl | Self::DeltaZstd => None,
        }
    }

    /// The codec with a code; an error if it is unknown or not allowed for the plane.
    pub fn from_code(code: u8, plane: Plane) -> Result<Self, WireError> {
        Self::ALL
            .into_iter()
            .find(|codec| codec.code() == code && codec.allowed_for(plane))
            .ok_or_else(|| refused(plane, code))
    }

    /// An error if the codec is not allowed for the plane.
    pub fn check(self, plane: Plane) -> Result<(), WireError> {
        if self.allowed_for(plane) {
            return Ok(());
        }
        Err(refused(plane, self.name()))
    }

    /// Checks that a payload of this size can be an image of this many pixels.
    pub(crate) fn check_size(
        self,
        plane: Plane,
        n_pixels: usize,
        bytes: usize,
    ) -> Result<(), WireError> {
        let (fits, expected) = match self.bytes_per_pixel() {
            Some(n) => (
                bytes == n * n_pixels,
                format!("{} bytes ({n} a pixel)", n * n_pixels),
            ),
            None if self == Self::None => (bytes == 0, "0 bytes".to_owned()),
            None => (bytes > 0, "at least 1 byte".to_owned()),
        };
        if fits {
            return Ok(());
        }
        Err(WireError::new(
            Code::Size,
            format_args!("{} payload ({})", plane.name(), self.name()),
            expected,
            format_args!("{bytes} bytes"),
        ))
    }
}

fn refused(plane: Plane, got: impl std::fmt::Display) -> WireError {
    let allowed: Vec<String> = Codec::ALL
        .into_iter()
        .filter(|codec| codec.allowed_for(plane))
        .map(|codec| format!("{} ({})", codec.code(), codec.name()))
        .collect();
    WireError::new(
        Code::Codec,
        format_args!("{} codec", plane.name()),
        allowed.join(", "),
        got,
    )
}
