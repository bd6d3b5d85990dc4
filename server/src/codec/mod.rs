//! Decodes and encodes pictures. Untrusted bytes are handled only here: every decoder bounds its allocations, never
//! panics, and returns one error that names the file, the expected and the actual value.
//!
//! Colour is decoded in the sensor's orientation: EXIF orientation is ignored, because depth has none, and alpha is
//! dropped, because a camera's picture is opaque.

mod depth;
mod depth_map;
mod exr;
pub mod jpeg;
mod jpeg_scan;
mod netpbm;
mod npy;
pub mod png;
mod tiff;

pub use depth::decode_depth_map;
pub use depth_map::{DepthMap, DepthSamples};

use std::fs::File;
use std::io::{Cursor, Read};
use std::path::Path;

use image::{DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits};

use crate::camera::Intrinsics;
use crate::frame::ColorImage;

/// Largest image file, bytes: an uncompressed 16-bit RGB image of a phone's 48 megapixels fits.
pub const MAX_IMAGE_FILE_BYTES: u64 = 320 << 20;

/// Most memory of a decoder, bytes: an RGBA image of [`Intrinsics::MAX_SIDE`] squared, twice (for the decoder's own
/// buffers).
pub const MAX_DECODE_BYTES: u64 =
    2 * 4 * (Intrinsics::MAX_SIDE as u64) * (Intrinsics::MAX_SIDE as u64);

/// Why a picture could not be decoded or encoded.
#[derive(Debug, thiserror::Error)]
pub enum CodecError {
    /// The file could not be read or written.
    #[error("{file}: {source}")]
    Io {
        /// The file.
        file: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// Not a regular file: a folder, a pipe, a device.
    #[error("{file}: expected a regular file")]
    NotAFile {
        /// The file.
        file: String,
    },
    /// Larger than the limit for its kind.
    #[error("{file}: {field}: expected at most {limit}, got {got}")]
    TooLarge {
        /// The file.
        file: String,
        /// The quantity that is too large.
        field: &'static str,
        /// The limit.
        limit: u64,
        /// The actual value.
        got: u64,
    },
    /// Bytes that are invalid in their format.
    #[error("{file}: expected {expected}, got {got}")]
    Malformed {
        /// The file.
        file: String,
        /// The expected content.
        expected: &'static str,
        /// The actual content.
        got: String,
    },
}

/// Depth as stored: sensor units per pixel, rows from the top.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DepthUnits {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` sensor units.
    pub units: Vec<u16>,
}

/// An 8-bit single-channel image, rows from the top (confidence maps, masks).
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GrayImage {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `width * height` values.
    pub values: Vec<u8>,
}

/// Reads a whole regular file of at most `max_bytes`.
pub fn read_file(path: &Path, max_bytes: u64) -> Result<Vec<u8>, CodecError> {
    let name = || path.display().to_string();
    let io = |source| CodecError::Io {
        file: name(),
        source,
    };
    // Checked before opening, because opening a pipe would wait for its writer.
    if !std::fs::metadata(path).map_err(io)?.is_file() {
        return Err(CodecError::NotAFile { file: name() });
    }
    let file = File::open(path).map_err(io)?;
    let size = file.metadata().map_err(io)?.len();
    let too_large = |got| CodecError::TooLarge {
        file: name(),
        field: "file size in bytes",
        limit: max_bytes,
        got,
    };
    if size > max_bytes {
        return Err(too_large(size));
    }
    let mut bytes = Vec::with_capacity(size as usize);
    // One byte past the limit reveals a file that grew in the meantime.
    file.take(max_bytes + 1)
        .read_to_end(&mut bytes)
        .map_err(io)?;
    if bytes.len() as u64 > max_bytes {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}

/// Decodes a colour image: JPEG, PNG, WebP, BMP, PPM (PGM) or 8-bit TIFF, recognised by its first bytes; `file` names
/// it in errors. A JPEG without its end-of-image marker is accepted if all its blocks are present.
pub fn decode_color(bytes: &[u8], file: &str) -> Result<ColorImage, CodecError> {
    const EXPECTED: &str = "a JPEG, PNG, WebP, BMP, PPM or TIFF colour image";
    let format = match bytes {
        [b'I', b'I', 42, 0, ..] | [b'M', b'M', 0, 42, ..] => {
            return tiff::color(bytes, file, EXPECTED);
        }
        [
            b'R',
            b'I',
            b'F',
            b'F',
            _,
            _,
            _,
            _,
            b'W',
            b'E',
            b'B',
            b'P',
            ..,
        ] => ImageFormat::WebP,
        [b'B', b'M', ..] => ImageFormat::Bmp,
        [
            b'P',
            b'2' | b'3' | b'5' | b'6',
            b'\n' | b'\r' | b' ' | b'\t',
            ..,
        ] => ImageFormat::Pnm,
        [0x89, b'P', b'N', b'G', ..] | [0xFF, 0xD8, ..] | [] => {
            image_format(bytes, file, EXPECTED)?
        }
        _ => return Err(malformed(file, EXPECTED, "bytes of none of these")),
    };
    let bytes = match format {
        ImageFormat::Jpeg => jpeg::complete(bytes, file)?,
        _ => bytes.into(),
    };
    let image = decode(&bytes, format, file, EXPECTED)?;
    let (width, height) = (image.width(), image.height());
    let rgb = image.into_rgb8().into_raw();
    let rgba = rgb.as_chunks::<3>().0.iter();
    Ok(ColorImage {
        width,
        height,
        rgba: rgba.map(|&[r, g, b]| [r, g, b, 255]).collect(),
    })
}

/// Decodes a 16-bit single-channel PNG of depth, the format of the protocol; `file` names it in errors. For the other
/// formats of files, see [`decode_depth_map`].
pub fn decode_depth(bytes: &[u8], file: &str) -> Result<DepthUnits, CodecError> {
    const EXPECTED: &str = "a 16-bit single-channel PNG depth image";
    let format = image_format(bytes, file, EXPECTED)?;
    if format != ImageFormat::Png {
        return Err(malformed(file, EXPECTED, "a JPEG image"));
    }
    match decode(bytes, format, file, EXPECTED)? {
        DynamicImage::ImageLuma16(image) => Ok(DepthUnits {
            width: image.width(),
            height: image.height(),
            units: image.into_raw(),
        }),
        other => Err(malformed(file, EXPECTED, kind_of(&other))),
    }
}

/// Decodes an 8-bit single-channel PNG; `file` names it in errors.
pub fn decode_gray8(bytes: &[u8], file: &str) -> Result<GrayImage, CodecError> {
    const EXPECTED: &str = "an 8-bit single-channel PNG image";
    let format = image_format(bytes, file, EXPECTED)?;
    if format != ImageFormat::Png {
        return Err(malformed(file, EXPECTED, "a JPEG image"));
    }
    match decode(bytes, format, file, EXPECTED)? {
        DynamicImage::ImageLuma8(image) => Ok(GrayImage {
            width: image.width(),
            height: image.height(),
            values: image.into_raw(),
        }),
        other => Err(malformed(file, EXPECTED, kind_of(&other))),
    }
}

/// The format, recognised by its first bytes: a file's extension may be wrong.
fn image_format(
    bytes: &[u8],
    file: &str,
    expected: &'static str,
) -> Result<ImageFormat, CodecError> {
    match bytes {
        [0x89, b'P', b'N', b'G', ..] => Ok(ImageFormat::Png),
        [0xFF, 0xD8, ..] => Ok(ImageFormat::Jpeg),
        [] => Err(malformed(file, expected, "an empty file")),
        _ => Err(malformed(file, expected, "bytes of neither PNG nor JPEG")),
    }
}

fn decode(
    bytes: &[u8],
    format: ImageFormat,
    file: &str,
    expected: &'static str,
) -> Result<DynamicImage, CodecError> {
    let mut limits = Limits::default();
    limits.max_alloc = Some(MAX_DECODE_BYTES);
    let error = |e: image::ImageError| malformed(file, expected, format!("{format:?} error: {e}"));
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    // The size is not limited here: it is checked below, where the error can name it.
    reader.limits(limits);
    let decoder = reader.into_decoder().map_err(error)?;
    let (width, height) = decoder.dimensions();
    check_size(width, height, file, expected)?;
    DynamicImage::from_decoder(decoder).map_err(error)
}

/// Checks an image's size before anything is allocated for it.
fn check_size(
    width: u32,
    height: u32,
    file: &str,
    expected: &'static str,
) -> Result<(u32, u32), CodecError> {
    for (field, got) in [("image width", width), ("image height", height)] {
        if got > Intrinsics::MAX_SIDE {
            return Err(CodecError::TooLarge {
                file: file.to_owned(),
                field,
                limit: Intrinsics::MAX_SIDE.into(),
                got: got.into(),
            });
        }
        if got == 0 {
            return Err(malformed(file, expected, format!("{field} 0")));
        }
    }
    Ok((width, height))
}

fn malformed(file: &str, expected: &'static str, got: impl Into<String>) -> CodecError {
    CodecError::Malformed {
        file: file.to_owned(),
        expected,
        got: got.into(),
    }
}

fn kind_of(image: &DynamicImage) -> String {
    let color = image.color();
    format!(
        "{} channel(s) of {} bits",
        color.channel_count(),
        color.bits_per_pixel() / u16::from(color.channel_count())
    )
}

#[cfg(test)]
mod tests;
