//! JPEGs without their end-of-image marker.

use super::*;
use ::image::codecs::jpeg::JpegEncoder;
use ::image::{ExtendedColorType, ImageEncoder};

/// JPEGs of several kinds, whole: colour with and without subsampled chroma, odd sizes, grey, with
/// restart intervals.
fn kinds() -> Vec<Vec<u8>> {
    let mut kinds = Vec::new();
    for (width, height) in [(48, 32), (33, 17), (1, 1), (8, 40)] {
        let color = gradient(width, height);
        kinds.push(jpeg::encode(&color, 80).unwrap());
        let mut grey = Vec::new();
        let values: Vec<u8> = color.rgba.iter().map(|p| p[0]).collect();
        JpegEncoder::new_with_quality(&mut grey, 70)
            .write_image(&values, width, height, ExtendedColorType::L8)
            .unwrap();
        kinds.push(grey);
        for sampling in [
            jpeg_encoder::SamplingFactor::F_2_2,
            jpeg_encoder::SamplingFactor::F_2_1,
        ] {
            let mut bytes = Vec::new();
            let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 85);
            encoder.set_sampling_factor(sampling);
            encoder.set_restart_interval(2);
            encoder
                .encode(
                    color.bytes(),
                    width as u16,
                    height as u16,
                    jpeg_encoder::ColorType::Rgba,
                )
                .unwrap();
            kinds.push(bytes);
        }
    }
    kinds
}

#[test]
fn without_the_end_marker_the_picture_is_the_same() {
    for bytes in kinds() {
        let whole = decode_color(&bytes, "j").unwrap();
        let n = bytes.len();
        assert_eq!(bytes[n - 2..], [0xFF, 0xD9]);
        // The marker missing, half of it, zeros in its place.
        for (cut, tail) in [(n - 2, &[][..]), (n - 1, &[]), (n - 2, &[0; 64])] {
            let short = [&bytes[..cut], tail].concat();
            assert_eq!(decode_color(&short, "j").unwrap(), whole);
        }
    }
}

#[test]
fn a_missing_block_is_an_error() {
    for bytes in kinds() {
        let blocks = bytes.len() - 2;
        for cut in (blocks.saturating_sub(40)..blocks).chain([blocks / 2]) {
            let error = decode_color(&bytes[..cut], "j").unwrap_err().to_string();
            assert!(error.starts_with("j: expected a complete JPEG"), "{error}");
        }
    }
}
