//! Encodes pictures as PNG.

use crate::codec::CodecError;
use crate::codec::png::{self, Effort};
use crate::frame::ColorImage;
use crate::render::AovImage;

/// The composite as an 8-bit RGBA PNG.
pub fn png_of(color: &ColorImage) -> Result<Vec<u8>, CodecError> {
    png::encode_rgba(color.width, color.height, color.bytes(), Effort::Medium)
}

/// An AOV as a PNG with the AOV's bit depth.
pub(super) fn png_of_aov(image: &AovImage, width: u32, height: u32) -> Result<Vec<u8>, CodecError> {
    match image {
        AovImage::Gray8(px) => png::encode_gray8(width, height, px, Effort::Medium),
        AovImage::Gray16(px) => png::encode_gray16(width, height, px, Effort::Medium),
        AovImage::Rgb8(px) => png::encode_rgb8(width, height, px.as_flattened(), Effort::Medium),
    }
}
