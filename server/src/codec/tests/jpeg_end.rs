//! JPEGs without their end-of-image marker.

use super::*;
use ::image::codecs::jpeg::JpegEncoder;
use ::image::{ExtendedColorType, ImageEncoder};

/// 41x27, encoded by libjpeg: ten scans, with the last bits of each coefficient in separate scans.
const PROGRESSIVE: &[u8] = include_bytes!("progressive.jpg");

/// Complete JPEGs of several kinds: colour with and without subsampled chroma, odd sizes, grey, with restart
/// intervals, progressive.
fn kinds() -> Vec<Vec<u8>> {
    let mut kinds = vec![PROGRESSIVE.to_vec()];
    for (width, height) in [(48, 32), (33, 17), (1, 1), (8, 40)] {
        let color = gradient(width, height);
        kinds.push(jpeg::encode(&color, 80).unwrap());
        let mut grey = Vec::new();
        let values: Vec<u8> = color.rgba.iter().map(|p| p[0]).collect();
        JpegEncoder::new_with_quality(&mut grey, 70)
            .write_image(&values, width, height, ExtendedColorType::L8)
            .unwrap();
        kinds.push(grey);
        for (sampling, progressive) in [
            (jpeg_encoder::SamplingFactor::F_2_2, false),
            (jpeg_encoder::SamplingFactor::F_2_1, false),
            (jpeg_encoder::SamplingFactor::F_2_2, true),
        ] {
            let mut bytes = Vec::new();
            let mut encoder = jpeg_encoder::Encoder::new(&mut bytes, 85);
            encoder.set_sampling_factor(sampling);
            encoder.set_restart_interval(2);
            encoder.set_progressive(progressive);
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
        // Without the marker, with half of it, and with zeros instead of it.
        for (cut, tail) in [(n - 2, &[][..]), (n - 1, &[]), (n - 2, &[0; 64])] {
            let short = [&bytes[..cut], tail].concat();
            assert_eq!(decode_color(&short, "j").unwrap(), whole);
        }
    }
}

/// The rest is a valid picture, but less sharp than the original.
#[test]
fn a_missing_scan_of_a_progressive_picture_is_an_error() {
    let scans = PROGRESSIVE.windows(2).enumerate();
    let scans = scans
        .filter(|(_, pair)| *pair == [0xFF, 0xDA])
        .map(|(at, _)| at);
    let scans: Vec<usize> = scans.collect();
    assert_eq!(scans.len(), 10);
    for &start in &scans[1..] {
        assert!(decode_color(&PROGRESSIVE[..start], "j").is_err(), "{start}");
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
