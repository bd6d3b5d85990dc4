//! TIFF: depth of one channel, and 8-bit colour.

use std::io::Cursor;

use tiff::ColorType;
use tiff::decoder::{Decoder, DecodingResult, Limits};

use super::depth_map::{DepthMap, DepthSamples, EXPECTED, check_depth_size};
use super::{CodecError, MAX_DECODE_BYTES, malformed};
use crate::frame::ColorImage;

/// Pixels of the first image of a file.
struct Pixels {
    width: u32,
    height: u32,
    kind: ColorType,
    samples: DecodingResult,
}

fn read(bytes: &[u8], file: &str, expected: &'static str) -> Result<Pixels, CodecError> {
    let error = |e: tiff::TiffError| malformed(file, expected, format!("TIFF error: {e}"));
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_DECODE_BYTES as usize;
    limits.intermediate_buffer_size = MAX_DECODE_BYTES as usize;
    let mut decoder = Decoder::new(Cursor::new(bytes))
        .map_err(error)?
        .with_limits(limits);
    let (width, height) = decoder.dimensions().map_err(error)?;
    let (width, height) = check_depth_size(width.into(), height.into(), file)?;
    let kind = decoder.colortype().map_err(error)?;
    let samples = decoder.read_image().map_err(error)?;
    Ok(Pixels {
        width,
        height,
        kind,
        samples,
    })
}

pub(super) fn depth(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    let pixels = read(bytes, file, EXPECTED)?;
    let (width, height) = (pixels.width, pixels.height);
    if !matches!(pixels.kind, ColorType::Gray(_)) {
        let got = format!("a TIFF image of {:?}", pixels.kind);
        return Err(malformed(file, EXPECTED, got));
    }
    let map = match pixels.samples {
        DecodingResult::U16(units) => DepthMap {
            width,
            height,
            samples: DepthSamples::Units(units),
        },
        DecodingResult::F32(values) => DepthMap::from_floats(width, height, values),
        DecodingResult::F64(values) => {
            DepthMap::from_floats(width, height, values.iter().map(|&v| v as f32).collect())
        }
        DecodingResult::F16(values) => {
            DepthMap::from_floats(width, height, values.iter().map(|v| v.to_f32()).collect())
        }
        DecodingResult::U8(v) => integers(width, height, &v),
        DecodingResult::U32(v) => integers(width, height, &v),
        DecodingResult::I8(v) => integers(width, height, &v),
        DecodingResult::I16(v) => integers(width, height, &v),
        DecodingResult::I32(v) => integers(width, height, &v),
        DecodingResult::I64(v) => integers(width, height, &v),
        DecodingResult::U64(v) => {
            let values = v.iter().map(|&v| i64::try_from(v).unwrap_or(i64::MAX));
            DepthMap::from_integers(width, height, values)
        }
    };
    let n = match &map.samples {
        DepthSamples::Units(units) => units.len(),
        DepthSamples::WideUnits(v) | DepthSamples::Metres(v) | DepthSamples::Millimetres(v) => {
            v.len()
        }
    };
    if n != width as usize * height as usize {
        let got = format!("{n} samples for {width}x{height}");
        return Err(malformed(file, EXPECTED, got));
    }
    Ok(map)
}

fn integers<T: Copy + Into<i64>>(width: u32, height: u32, values: &[T]) -> DepthMap {
    DepthMap::from_integers(width, height, values.iter().map(|&v| v.into()))
}

/// Decodes 8 bits per channel: grey, RGB or RGBA.
pub(super) fn color(
    bytes: &[u8],
    file: &str,
    expected: &'static str,
) -> Result<ColorImage, CodecError> {
    let pixels = read(bytes, file, expected)?;
    let channels = match pixels.kind {
        ColorType::Gray(8) => 1,
        ColorType::RGB(8) => 3,
        ColorType::RGBA(8) => 4,
        other => {
            return Err(malformed(
                file,
                expected,
                format!("a TIFF image of {other:?}"),
            ));
        }
    };
    let n = pixels.width as usize * pixels.height as usize;
    match pixels.samples {
        DecodingResult::U8(values) if values.len() == n * channels => Ok(ColorImage {
            width: pixels.width,
            height: pixels.height,
            rgba: values
                .chunks_exact(channels)
                .map(|p| match *p {
                    [r, g, b, ..] => [r, g, b, 255],
                    _ => [p[0], p[0], p[0], 255],
                })
                .collect(),
        }),
        _ => Err(malformed(
            file,
            expected,
            "a TIFF image with another size than its header says",
        )),
    }
}
