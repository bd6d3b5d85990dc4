//! PNG encoding: fast for live output, small for recordings that are distributed.

use image::codecs::png::{CompressionType, FilterType, PngEncoder};
use image::{ExtendedColorType, ImageEncoder};

use super::{CodecError, malformed};

/// Trade-off between speed and size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Effort {
    /// About a millisecond for 640x480; for the network.
    #[default]
    Fast,
    /// Fast enough for rendering; for the files of a replay.
    Medium,
    /// About twenty times slower than `Fast` and a third smaller; for files that are kept.
    Small,
    /// The smallest of six attempts, one per row filter: on quantised depth the usual choice of filters is far from
    /// optimal. For files that many people download.
    Smallest,
}

/// Encodes RGBA, 8 bits per channel, `width * height * 4` bytes.
pub fn encode_rgba(
    width: u32,
    height: u32,
    rgba: &[u8],
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    encode(width, height, rgba, ExtendedColorType::Rgba8, effort)
}

/// Encodes RGB, 8 bits per channel, `width * height * 3` bytes.
pub fn encode_rgb8(
    width: u32,
    height: u32,
    rgb: &[u8],
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    encode(width, height, rgb, ExtendedColorType::Rgb8, effort)
}

/// Encodes one 8-bit channel, `width * height` bytes.
pub fn encode_gray8(
    width: u32,
    height: u32,
    gray: &[u8],
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    encode(width, height, gray, ExtendedColorType::L8, effort)
}

/// Encodes one 16-bit channel, `width * height` values.
pub fn encode_gray16(
    width: u32,
    height: u32,
    gray: &[u16],
    effort: Effort,
) -> Result<Vec<u8>, CodecError> {
    let bytes = bytemuck::cast_slice(gray);
    encode(width, height, bytes, ExtendedColorType::L16, effort)
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
    // The encoder would panic on a wrong length, and write an unreadable file for an empty image.
    if n_bytes != data.len() as u64 || n_bytes == 0 {
        let got = format!("{} bytes for {width}x{height} {kind:?}", data.len());
        return Err(malformed("PNG encoder", EXPECTED, got));
    }
    let with = |compression, filter| {
        let mut out = Vec::with_capacity(data.len() / 2 + 1024);
        PngEncoder::new_with_quality(&mut out, compression, filter)
            .write_image(data, width, height, kind)
            .map_err(|e| malformed("PNG encoder", EXPECTED, e.to_string()))?;
        Ok(out)
    };
    // Up is the only filter as fast as none.
    match effort {
        Effort::Fast => with(CompressionType::Fast, FilterType::Up),
        Effort::Medium => with(CompressionType::Fast, FilterType::Adaptive),
        Effort::Small => with(CompressionType::Default, FilterType::Adaptive),
        Effort::Smallest => {
            let mut smallest = with(CompressionType::Best, FilterType::NoFilter)?;
            for filter in [
                FilterType::Sub,
                FilterType::Up,
                FilterType::Avg,
                FilterType::Paeth,
                FilterType::Adaptive,
            ] {
                let bytes = with(CompressionType::Best, filter)?;
                if bytes.len() < smallest.len() {
                    smallest = bytes;
                }
            }
            Ok(smallest)
        }
    }
}
