use super::*;
use crate::codec::png::Effort;
use proptest::prelude::*;

mod depth;
mod jpeg_end;

fn gradient(width: u32, height: u32) -> ColorImage {
    let pixel = |i: u32| [(i % width * 3) as u8, (i / width * 5) as u8, 90, 255];
    ColorImage {
        width,
        height,
        rgba: (0..width * height).map(pixel).collect(),
    }
}

#[test]
fn lossless_formats_return_every_bit() {
    for (width, height) in [(1, 1), (7, 3), (64, 48)] {
        let color = gradient(width, height);
        let n = width * height;
        let gray16: Vec<u16> = (0..n).map(|i| (i * 997) as u16).collect();
        let gray8: Vec<u8> = (0..n).map(|i| (i * 7) as u8).collect();
        for effort in [Effort::Fast, Effort::Small] {
            let bytes = png::encode_rgba(width, height, color.bytes(), effort).unwrap();
            assert_eq!(decode_color(&bytes, "c").unwrap(), color);
            let bytes = png::encode_gray16(width, height, &gray16, effort).unwrap();
            assert_eq!(decode_depth(&bytes, "d").unwrap().units, gray16);
            let bytes = png::encode_gray8(width, height, &gray8, effort).unwrap();
            assert_eq!(decode_gray8(&bytes, "g").unwrap().values, gray8);
        }
    }
}

#[test]
fn jpeg_at_high_quality_stays_close() {
    let color = gradient(64, 48);
    let decoded = decode_color(&jpeg::encode(&color, 95).unwrap(), "c").unwrap();
    let errors = color.bytes().iter().zip(decoded.bytes());
    let mean =
        errors.map(|(a, b)| f64::from(a.abs_diff(*b))).sum::<f64>() / color.bytes().len() as f64;
    assert!(mean < 2.0, "mean error {mean} codes");
    assert_eq!((decoded.width, decoded.height), (64, 48));
}

#[test]
fn depth_of_the_wrong_kind_names_file_expected_and_got() {
    let color = gradient(4, 4);
    let rgba = png::encode_rgba(4, 4, color.bytes(), Effort::Fast).unwrap();
    let gray8 = png::encode_gray8(4, 4, &[9; 16], Effort::Fast).unwrap();
    let rgb_jpeg = jpeg::encode(&color, 90).unwrap();
    for (bytes, got) in [
        (rgba, "4 channel(s) of 8 bits"),
        (gray8, "1 channel(s) of 8 bits"),
        (rgb_jpeg, "a JPEG image"),
        (Vec::new(), "an empty file"),
        (vec![1, 2, 3], "bytes of neither PNG nor JPEG"),
    ] {
        let error = decode_depth(&bytes, "d.png").unwrap_err().to_string();
        assert_eq!(
            error,
            format!("d.png: expected a 16-bit single-channel PNG depth image, got {got}")
        );
    }
}

#[test]
fn every_truncation_is_an_error() {
    let color = gradient(48, 32);
    let whole_png = png::encode_rgba(48, 32, color.bytes(), Effort::Fast).unwrap();
    let whole_jpeg = jpeg::encode(&color, 90).unwrap();
    // The PNG's last chunk (12 bytes) has no content: decoders may stop before it.
    for cut in 0..whole_png.len() - 12 {
        assert!(
            decode_color(&whole_png[..cut], "p").is_err(),
            "PNG cut at {cut}"
        );
    }
    // Without the end-of-image marker, or with half of it, all blocks are still present.
    for cut in 0..whole_jpeg.len() - 2 {
        assert!(
            decode_color(&whole_jpeg[..cut], "j").is_err(),
            "JPEG cut at {cut}"
        );
    }
}

#[test]
fn a_header_that_promises_too_much_is_refused_before_anything_is_allocated() {
    let mut bytes = png::encode_gray16(4, 4, &[1; 16], Effort::Fast).unwrap();
    // Changes the width in the header chunk, and corrects its checksum.
    bytes[16..20].copy_from_slice(&60_000u32.to_be_bytes());
    let crc = crc32(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&crc.to_be_bytes());
    let error = decode_depth(&bytes, "d.png").unwrap_err().to_string();
    assert_eq!(
        error,
        "d.png: image width: expected at most 8192, got 60000"
    );
}

/// The checksum of PNG chunks (ISO/IEC 15948, annex D).
fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| {
            if c & 1 == 1 {
                0xEDB8_8320 ^ (c >> 1)
            } else {
                c >> 1
            }
        })
    })
}

#[test]
fn pixels_that_do_not_fit_their_size_are_refused() {
    assert!(png::encode_rgba(2, 2, &[0; 15], Effort::Fast).is_err());
    assert!(png::encode_gray16(0, 0, &[], Effort::Fast).is_err());
    let mut image = gradient(2, 2);
    image.width = 3;
    assert!(jpeg::encode(&image, 90).is_err());
}

#[test]
fn a_folder_or_a_large_file_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    assert!(matches!(
        read_file(dir.path(), 10),
        Err(CodecError::NotAFile { .. })
    ));
    let file = dir.path().join("f");
    std::fs::write(&file, [0; 11]).unwrap();
    assert!(matches!(
        read_file(&file, 10),
        Err(CodecError::TooLarge { got: 11, .. })
    ));
    assert_eq!(read_file(&file, 11).unwrap().len(), 11);
}

fn decode_all(bytes: &[u8]) {
    let results = [
        decode_color(bytes, "x").map(|i| (i.rgba.len(), i.width, i.height)),
        decode_depth(bytes, "x").map(|i| (i.units.len(), i.width, i.height)),
        decode_gray8(bytes, "x").map(|i| (i.values.len(), i.width, i.height)),
    ];
    for (n, width, height) in results.into_iter().flatten() {
        assert_eq!(n, width as usize * height as usize);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        prop_assert!(decode_color(&bytes, "x").is_err());
        prop_assert!(decode_depth(&bytes, "x").is_err());
        prop_assert!(decode_gray8(&bytes, "x").is_err());
    }

    #[test]
    fn arbitrary_bytes_behind_a_signature_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
        decode_all(&[b"\x89PNG\r\n\x1a\n".as_slice(), &bytes].concat());
        decode_all(&[b"\xFF\xD8\xFF".as_slice(), &bytes].concat());
    }

    #[test]
    fn damaged_files_never_panic(at in 0..2000usize, value in any::<u8>(), more in any::<[u8; 8]>(), kind in 0..3) {
        let color = gradient(33, 17);
        let mut bytes = match kind {
            0 => jpeg::encode(&color, 80).unwrap(),
            1 => png::encode_rgba(33, 17, color.bytes(), Effort::Fast).unwrap(),
            _ => png::encode_gray16(33, 17, &[7777; 33 * 17], Effort::Small).unwrap(),
        };
        let n = bytes.len();
        bytes[at % n] = value;
        for (i, byte) in more.into_iter().enumerate().take(4) {
            bytes[(at * 31 + i * 97 + usize::from(byte)) % n] = more[i + 4];
        }
        decode_all(&bytes);
    }
}
