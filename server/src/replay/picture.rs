//! Pictures to PNG.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder, ImageError};

use crate::frame::ColorImage;
use crate::render::AovImage;

/// The composite as an 8-bit RGBA PNG.
pub fn png_of(color: &ColorImage) -> Result<Vec<u8>, ImageError> {
    encode(
        color.bytes(),
        color.width,
        color.height,
        ExtendedColorType::Rgba8,
    )
}

/// An image beside the composite, as a PNG of its own depth.
pub(super) fn png_of_aov(image: &AovImage, width: u32, height: u32) -> Result<Vec<u8>, ImageError> {
    match image {
        AovImage::Gray8(px) => encode(px, width, height, ExtendedColorType::L8),
        AovImage::Gray16(px) => encode(
            bytemuck::cast_slice(px),
            width,
            height,
            ExtendedColorType::L16,
        ),
        AovImage::Rgb8(px) => encode(px.as_flattened(), width, height, ExtendedColorType::Rgb8),
    }
}

fn encode(
    bytes: &[u8],
    width: u32,
    height: u32,
    color: ExtendedColorType,
) -> Result<Vec<u8>, ImageError> {
    let mut png = Vec::with_capacity(bytes.len() / 2);
    // Writing keeps up with rendering only at the fast setting; files are about a fifth larger.
    PngEncoder::new_with_quality(&mut png, CompressionType::Fast, FilterType::Adaptive)
        .write_image(bytes, width, height, color)?;
    Ok(png)
}
