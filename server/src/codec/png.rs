//! PNG encoding. Live and replay output want speed; a recording that is shipped wants size.

use std::path::Path;

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use super::{CodecError, malformed, write_file};

/// Speed against size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Effort {
    /// About a millisecond for 640x480.
    #[default]
    Fast,
    /// Some twenty times slower and a third smaller; for files that are kept.
    Small,
}

/// RGBA, 8 bits a channel, `width * height * 4` bytes.
pub fn encode_rgba(
    width: u32,
    height: u32,
    rgba: &[u8],
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    encode(width, height, rgba, ExtendedColorType::Rgba8, effort)
}

/// RGB, 8 bits a channel, `width * height * 3` bytes.
pub fn encode_rgb8(
    width: u32,
    height: u32,
    rgb: &[u8],
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    encode(width, height, rgb, ExtendedColorType::Rgb8, effort)
}

/// One 8-bit channel, `width * height` bytes.
pub fn encode_gray8(
    width: u32,
    height: u32,
    gray: &[u8],
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    encode(width, height, gray, ExtendedColorType::L8, effort)
}

/// One 16-bit channel, `width * height` values.
pub fn encode_gray16(
    width: u32,
    height: u32,
    gray: &[u16],
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    let bytes = bytemuck::cast_slice(gray);
    encode(width, height, bytes, ExtendedColorType::L16, effort)
}

/// [`encode_rgba`], fast, into a file.
pub fn write_rgba(path: &Path, width: u32, height: u32, rgba: &[u8]) -> Result<(), CodecError> {
    write_file(path, &encode_rgba(width, height, rgba, Effort::Fast)?)
}

/// [`encode_rgb8`], fast, into a file.
pub fn write_rgb8(path: &Path, width: u32, height: u32, rgb: &[u8]) -> Result<(), CodecError> {
    write_file(path, &encode_rgb8(width, height, rgb, Effort::Fast)?)
}

/// [`encode_gray8`], fast, into a file.
pub fn write_gray8(path: &Path, width: u32, height: u32, gray: &[u8]) -> Result<(), CodecError> {
    write_file(path, &encode_gray8(width, height, gray, Effort::Fast)?)
}

/// [`encode_gray16`], fast, into a file.
pub fn write_gray16(path: &Path, width: u32, height: u32, gray: &[u16]) -> Result<(), CodecError> {
    write_file(path, &encode_gray16(width, height, gray, Effort::Fast)?)
}

fn encode(
    width: u32,
    height: u32,
    data: &[u8],
    kind: ExtendedColorType,
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    const EXPECTED: &str = "pixels of a PNG to write";
    let n_bytes = u64::from(width) * u64::from(height) * u64::from(kind.bits_per_pixel() / 8);
    // The encoder panics on a wrong length and writes an unreadable file for no pixels.
    if n_bytes != data.len() as u64 || n_bytes == 0 {
        let got = format!("{} bytes for {width}x{height} {kind:?}", data.len());
        return Err(malformed("PNG encoder", EXPECTED, got));
    }
    // Up is the one filter as fast as none; adaptive earns its time only with real compression.
    let (compression, filter) = match effort {
        Effort::Fast => (CompressionType::Fast, FilterType::Up),
        Effort::Small => (CompressionType::Default, FilterType::Adaptive),
    };
    let mut out = Vec::with_capacity(data.len() / 2 + 1024);
    PngEncoder::new_with_quality(&mut out, compression, filter)
        .write_image(data, width, height, kind)
        .map_err(|e| malformed("PNG encoder", EXPECTED, e.to_string()))?;
    Ok(out)
}
