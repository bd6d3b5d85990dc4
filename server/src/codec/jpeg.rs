//! JPEG encoding, and a completeness check that decoders do not do.

use std::borrow::Cow;

use image::codecs::jpeg::JpegEncoder;
use image::{ExtendedColorType, ImageEncoder};

use super::{CodecError, jpeg_scan, malformed};
use crate::frame::ColorImage;

const END_OF_IMAGE: [u8; 2] = [0xFF, 0xD9];

const EXPECTED_PIXELS: &str = "pixels of a JPEG to write";

/// Encodes a picture for a file (alpha is dropped), with colour at full resolution; `quality` is 1..=100, other
/// values are clamped.
pub fn encode(image: &ColorImage, quality: u8) -> Result<Vec<u8>, CodecError> {
    let pixels = image.rgba.iter();
    let rgb: Vec<u8> = pixels.flat_map(|&[r, g, b, _]| [r, g, b]).collect();
    encode_rgb8(image.width, image.height, &rgb, quality)
}

/// As [`encode`], from RGB, 8 bits per channel, `width * height * 3` bytes.
pub fn encode_rgb8(
    width: u32,
    height: u32,
    rgb: &[u8],
    quality: u8,
) -> Result<Vec<u8>, CodecError> {
    // The encoder would panic on a wrong length.
    let n_pixels = if rgb.len().is_multiple_of(3) {
        rgb.len() / 3
    } else {
        0
    };
    check_pixels(width, height, n_pixels)?;
    let mut out = Vec::with_capacity(rgb.len() / 6);
    JpegEncoder::new_with_quality(&mut out, quality.clamp(1, 100))
        .write_image(rgb, width, height, ExtendedColorType::Rgb8)
        .map_err(|e| malformed("JPEG encoder", EXPECTED_PIXELS, e.to_string()))?;
    Ok(out)
}

/// Encodes a picture for the network: vectorised, and with colour at half resolution if `quality` is under 90.
/// `quality` is 1..=100, other values are clamped.
pub fn encode_fast(image: &ColorImage, quality: u8) -> Result<Vec<u8>, CodecError> {
    check_pixels(image.width, image.height, image.rgba.len())?;
    let error = |e: String| malformed("JPEG encoder", EXPECTED_PIXELS, e);
    let side = |n: u32| u16::try_from(n).map_err(|e| error(e.to_string()));
    let mut out = Vec::with_capacity(image.rgba.len() / 4);
    jpeg_encoder::Encoder::new(&mut out, quality.clamp(1, 100))
        .encode(
            image.bytes(),
            side(image.width)?,
            side(image.height)?,
            jpeg_encoder::ColorType::Rgba,
        )
        .map_err(|e| error(e.to_string()))?;
    Ok(out)
}

fn check_pixels(width: u32, height: u32, n_pixels: usize) -> Result<(), CodecError> {
    if n_pixels > 0 && width as usize * height as usize == n_pixels {
        return Ok(());
    }
    let got = format!("{n_pixels} pixels for {width}x{height}");
    Err(malformed("JPEG encoder", EXPECTED_PIXELS, got))
}

/// A JPEG with its end-of-image marker: unchanged, or with the marker added after the last block if only the marker
/// is missing. The decoder fills missing blocks with grey and reports success; a half-copied frame must be an error
/// instead.
pub(super) fn complete<'a>(bytes: &'a [u8], file: &str) -> Result<Cow<'a, [u8]>, CodecError> {
    let Err(error) = check_complete(bytes, file) else {
        return Ok(bytes.into());
    };
    let end = jpeg_scan::end_of_blocks(bytes).ok_or(error)?;
    Ok([&bytes[..end], &END_OF_IMAGE].concat().into())
}

/// Rejects a JPEG without its end-of-image marker.
fn check_complete(bytes: &[u8], file: &str) -> Result<(), CodecError> {
    const EXPECTED: &str = "a complete JPEG image";
    const START_OF_SCAN: u8 = 0xDA;
    // Segments before the first scan are skipped by their length, because an embedded preview has its own
    // end-of-image marker.
    let mut at = 2;
    loop {
        match bytes.get(at..at + 4) {
            // Fill bytes may precede a marker (ITU-T T.81, B.1.1.2).
            Some([0xFF, 0xFF, ..]) => at += 1,
            Some(&[0xFF, START_OF_SCAN, ..]) => break,
            // Markers without a length: restarts and TEM.
            Some([0xFF, 0x01 | 0xD0..=0xD7, ..]) => at += 2,
            Some(&[0xFF, _, high, low]) => {
                at += 2 + usize::from(u16::from_be_bytes([high, low]));
            }
            Some(_) => return Err(malformed(file, EXPECTED, "no marker between segments")),
            None => return Err(malformed(file, EXPECTED, "an end before the first scan")),
        }
    }
    // Within a scan 0xFF is followed by 0 or a restart, so the pair cannot be data.
    if bytes[at..].windows(2).any(|pair| pair == END_OF_IMAGE) {
        Ok(())
    } else {
        Err(malformed(
            file,
            EXPECTED,
            "a file cut short (no end-of-image marker)",
        ))
    }
}
