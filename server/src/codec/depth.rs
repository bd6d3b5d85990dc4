//! Depth images as files: 16-bit grey PNG and other formats.
//!
//! | form | samples |
//! |---|---|
//! | PNG | 16-bit grey, with or without alpha or a transparent value |
//! | PGM (P5, P2) | 8 or 16 bits |
//! | TIFF | u8, u16, u32, i16, i32, f16, f32, f64, one channel |
//! | NPY | the same, both byte orders, C and Fortran order |
//! | PFM, EXR | float |
//!
//! **Units.** Integers are in the recording's depth units (5000 per metre in TUM, 1000 elsewhere). Floats are metres,
//! unless nine of ten of the positive values are over 100, which no depth camera measures in metres: then they are
//! millimetres. A transparent pixel is invalid, unless all pixels are transparent.

use image::{DynamicImage, ImageFormat};

use super::depth_map::{DepthMap, DepthSamples, EXPECTED};
use super::{CodecError, decode, exr, kind_of, malformed, netpbm, npy, tiff};

/// Decodes a depth image in any of the formats above, recognised by its first bytes; `file` names it in errors.
pub fn decode_depth_map(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    let map = match bytes {
        [] => return Err(malformed(file, EXPECTED, "an empty file")),
        [0x89, b'P', b'N', b'G', ..] => png(bytes, file)?,
        [b'P', b'2' | b'5', ..] => netpbm::pgm(bytes, file)?,
        [b'P', b'f', ..] => netpbm::pfm(bytes, file)?,
        [0x93, b'N', b'U', b'M', b'P', b'Y', ..] => npy::decode(bytes, file)?,
        [b'I', b'I', 42 | 43, 0, ..] | [b'M', b'M', 0, 42 | 43, ..] => tiff::depth(bytes, file)?,
        [0x76, 0x2F, 0x31, 0x01, ..] => exr::depth(bytes, file)?,
        [b'P', b'3' | b'6' | b'F', ..] => {
            return Err(malformed(
                file,
                EXPECTED,
                "a Netpbm image of three channels",
            ));
        }
        [0xFF, 0xD8, ..] => {
            let got = "a JPEG image (its compression destroys depth)";
            return Err(malformed(file, EXPECTED, got));
        }
        [b'P', b'K', 3, 4, ..] => {
            let got = "a zip archive (of .npz: save each array by numpy.save)";
            return Err(malformed(file, EXPECTED, got));
        }
        [b'v', b'e', b'r', b's', b'i', b'o', b'n', b' ', ..] => {
            let got = "a Git LFS pointer (the file itself was not fetched: git lfs pull)";
            return Err(malformed(file, EXPECTED, got));
        }
        _ => return Err(malformed(file, EXPECTED, "bytes of none of these")),
    };
    Ok(map)
}

fn png(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    match decode(bytes, ImageFormat::Png, file, EXPECTED)? {
        DynamicImage::ImageLuma16(image) => Ok(DepthMap {
            width: image.width(),
            height: image.height(),
            samples: DepthSamples::Units(image.into_raw()),
        }),
        DynamicImage::ImageLumaA16(image) => {
            let opaque = image.pixels().any(|pixel| pixel.0[1] != 0);
            let unit = |[unit, alpha]: [u16; 2]| if opaque && alpha == 0 { 0 } else { unit };
            Ok(DepthMap {
                width: image.width(),
                height: image.height(),
                samples: DepthSamples::Units(image.pixels().map(|pixel| unit(pixel.0)).collect()),
            })
        }
        other => {
            let kind = kind_of(&other);
            let got = match other.color().channel_count() {
                1 | 2 => format!("{kind} (8 bits are a picture of depth, not depth)"),
                _ => format!("{kind} (packed or coloured depth: write it as 16-bit grey)"),
            };
            Err(malformed(file, EXPECTED, got))
        }
    }
}
