//! Depth in all supported file formats.

use super::*;
use crate::codec::DepthSamples::{Metres, Millimetres, Units, WideUnits};
use ::image::{ExtendedColorType, ImageEncoder};

/// Values of a 3 by 2 image; all rows and columns are different.
const VALUES: [f64; 6] = [1.0, 2.0, 3.0, 4.5, 5.0, 6.0];

fn samples(bytes: &[u8]) -> DepthSamples {
    let map = decode_depth_map(bytes, "d").unwrap();
    assert_eq!((map.width, map.height), (3, 2));
    map.samples
}

fn error(bytes: &[u8]) -> String {
    decode_depth_map(bytes, "d").unwrap_err().to_string()
}

fn npy(descr: &str, fortran: bool, shape: &str, data: &[u8]) -> Vec<u8> {
    let fortran = if fortran { "True" } else { "False" };
    let mut header =
        format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}");
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let length = (header.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), data].concat()
}

fn bytes_of<const N: usize>(values: &[f64], write: impl Fn(f64) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&v| write(v)).collect()
}

fn metres() -> DepthSamples {
    Metres(VALUES.map(|v| v as f32).to_vec())
}

#[test]
fn numpy_floats_are_metres_in_both_orders() {
    let columns = [1.0, 4.5, 2.0, 5.0, 3.0, 6.0];
    let little = |v: &[f64]| bytes_of(v, |v| (v as f32).to_le_bytes());
    for bytes in [
        npy("<f4", false, "(2, 3)", &little(&VALUES)),
        npy("<f4", true, "(2, 3)", &little(&columns)),
        npy("<f4", false, "(2, 3, 1)", &little(&VALUES)),
        npy("<f4", true, "(1, 2, 3)", &little(&columns)),
        npy(
            ">f4",
            false,
            "(2L, 3L)",
            &bytes_of(&VALUES, |v| (v as f32).to_be_bytes()),
        ),
        npy("<f8", false, "(2, 3)", &bytes_of(&VALUES, f64::to_le_bytes)),
        npy(">f8", true, "(2, 3)", &bytes_of(&columns, f64::to_be_bytes)),
        // binary16 of 1, 2, 3, 4.5, 5, 6.
        npy(
            "<f2",
            false,
            "(2, 3)",
            &[0, 0x3C, 0, 0x40, 0, 0x42, 0x80, 0x44, 0, 0x45, 0, 0x46],
        ),
    ] {
        assert_eq!(samples(&bytes), metres());
    }
}

#[test]
fn numpy_integers_are_units() {
    let units = [1000u16, 0, 65535, 40_000, 2, 3];
    let little = |v: u16| v.to_le_bytes();
    let data: Vec<u8> = units.into_iter().flat_map(little).collect();
    assert_eq!(
        samples(&npy("<u2", false, "(2, 3)", &data)),
        Units(units.to_vec())
    );
    let data: Vec<u8> = units.into_iter().flat_map(u16::to_be_bytes).collect();
    assert_eq!(
        samples(&npy(">u2", false, "(2, 3)", &data)),
        Units(units.to_vec())
    );
    let signed = [-1i32, 7, 1000, 65535, 0, 9];
    let data: Vec<u8> = signed.into_iter().flat_map(i32::to_le_bytes).collect();
    let expected = vec![0, 7, 1000, 65535, 0, 9];
    assert_eq!(
        samples(&npy("<i4", false, "(2, 3)", &data)),
        Units(expected)
    );
    let wide = [-5i64, 70_000, 1, 2, 3, 4];
    let data: Vec<u8> = wide.into_iter().flat_map(i64::to_be_bytes).collect();
    let expected = vec![0.0, 70_000.0, 1.0, 2.0, 3.0, 4.0];
    assert_eq!(
        samples(&npy(">i8", false, "(2, 3)", &data)),
        WideUnits(expected)
    );
}

#[test]
fn numpy_files_that_are_no_depth_say_why() {
    for (bytes, got) in [
        (
            npy("<f4", false, "(2, 3)", &[0; 23]),
            "5 of 6 samples (cut short)",
        ),
        (
            npy("<c8", false, "(2, 3)", &[0; 48]),
            "an NPY array of \"<c8\"",
        ),
        (
            npy("<f4", false, "(2, 3, 3)", &[0; 72]),
            "an NPY array of shape [2, 3, 3]",
        ),
        (
            npy("<f4", false, "(6,)", &[0; 24]),
            "an NPY array of shape [6]",
        ),
        (npy("<f4", false, "(0, 3)", &[]), "image height 0"),
        (
            b"PK\x03\x04".to_vec(),
            "a zip archive (of .npz: save each array by numpy.save)",
        ),
    ] {
        assert!(
            error(&bytes).ends_with(&format!("got {got}")),
            "{}",
            error(&bytes)
        );
    }
    let huge = npy("<f4", false, "(99999999999, 3)", &[]);
    assert!(
        error(&huge).contains("image height: expected at most 8192"),
        "{}",
        error(&huge)
    );
}

#[test]
fn floats_that_no_camera_measures_in_metres_are_millimetres() {
    let write = |v: f64| (v as f32).to_le_bytes();
    let millimetres = VALUES.map(|v| v * 1000.0);
    let file = npy("<f4", false, "(2, 3)", &bytes_of(&millimetres, write));
    let map = decode_depth_map(&file, "d").unwrap();
    assert_eq!(
        map.samples,
        Millimetres(millimetres.map(|v| v as f32).to_vec())
    );
    assert_eq!(map.to_image(map.units_per_metre(5000.0), 10.0).z_m[3], 4.5);
    // A far sky with near objects stays in metres.
    let sky = [1.0, 1e4, 1e4, 1e4, f64::INFINITY, f64::NAN];
    let file = npy("<f4", false, "(2, 3)", &bytes_of(&sky, write));
    let map = decode_depth_map(&file, "d").unwrap();
    let image = map.to_image(map.units_per_metre(5000.0), 10.0);
    assert_eq!(image.z_m[0], 1.0);
    assert_eq!(image.invalid_share(), 5.0 / 6.0);
}

#[test]
fn netpbm() {
    let units = Units(vec![0x1388, 2, 3, 4, 5, 0xFFFF]);
    let wide = b"P5\n# a comment\n3 2\n65535\n\x13\x88\0\x02\0\x03\0\x04\0\x05\xFF\xFF";
    assert_eq!(samples(wide), units);
    assert_eq!(samples(b"P2 3 2 65535 5000 2 3\n4 # x\n5 65535"), units);
    assert_eq!(
        samples(b"P5 3 2 255\n\x01\x02\x03\x04\x05\xFF"),
        Units(vec![1, 2, 3, 4, 5, 255])
    );
    // PFM stores rows from the bottom.
    let rows = [4.5f32, 5.0, 6.0, 1.0, 2.0, 3.0];
    let little: Vec<u8> = rows.into_iter().flat_map(f32::to_le_bytes).collect();
    assert_eq!(
        samples(&[b"Pf\n3 2\n-1.0\n", &little[..]].concat()),
        metres()
    );
    let big: Vec<u8> = rows.into_iter().flat_map(f32::to_be_bytes).collect();
    assert_eq!(samples(&[b"Pf\n3 2\n1\n", &big[..]].concat()), metres());
    for bad in [
        &b"P5\n3 2\n65535\n\x13\x88\0"[..],
        b"P5\n99999 2\n65535\n",
        b"P5\n3 2\n70000\n",
        b"P2 3 2 255 1 2 3 4 5",
        b"P2 3 2 255 1 2 3 4 5 x",
        b"P6\n3 2\n255\n",
        b"P5",
        b"Pf\n8192 8192\n-1\n",
    ] {
        assert!(error(bad).starts_with("d: "), "{}", error(bad));
    }
}

#[test]
fn tiff_of_integers_and_floats() {
    use ::tiff::encoder::{TiffEncoder, colortype};
    let mut file = Cursor::new(Vec::new());
    let floats = VALUES.map(|v| v as f32);
    TiffEncoder::new(&mut file)
        .unwrap()
        .write_image::<colortype::Gray32Float>(3, 2, &floats)
        .unwrap();
    assert_eq!(samples(file.get_ref()), metres());
    let mut file = Cursor::new(Vec::new());
    TiffEncoder::new(&mut file)
        .unwrap()
        .write_image::<colortype::Gray64Float>(3, 2, &VALUES)
        .unwrap();
    assert_eq!(samples(file.get_ref()), metres());
    let mut file = Cursor::new(Vec::new());
    TiffEncoder::new(&mut file)
        .unwrap()
        .write_image::<colortype::Gray16>(3, 2, &[1, 2, 3, 4, 5, 65535])
        .unwrap();
    assert_eq!(samples(file.get_ref()), Units(vec![1, 2, 3, 4, 5, 65535]));
    let mut file = Cursor::new(Vec::new());
    TiffEncoder::new(&mut file)
        .unwrap()
        .write_image::<colortype::Gray32>(3, 2, &[1, 2, 3, 4, 5, 70_000])
        .unwrap();
    assert_eq!(
        samples(file.get_ref()),
        WideUnits(vec![1.0, 2.0, 3.0, 4.0, 5.0, 70_000.0])
    );
    let mut file = Cursor::new(Vec::new());
    TiffEncoder::new(&mut file)
        .unwrap()
        .write_image::<colortype::RGB8>(2, 1, &[1, 2, 3, 4, 5, 6])
        .unwrap();
    assert!(error(file.get_ref()).ends_with("a TIFF image of RGB(8)"));
    let color = decode_color(file.get_ref(), "c").unwrap();
    assert_eq!(color.rgba, [[1, 2, 3, 255], [4, 5, 6, 255]]);
}

#[test]
fn exr_takes_the_channel_of_depth() {
    use ::exr::prelude::*;
    let floats = VALUES.map(|v| v as f32);
    let channel =
        |name: &str, values: [f32; 6]| AnyChannel::new(name, FlatSamples::F32(values.to_vec()));
    let write = |channels: Vec<AnyChannel<FlatSamples>>| {
        let layer = Layer::new(
            (3, 2),
            LayerAttributes::named("depth"),
            Encoding::FAST_LOSSLESS,
            AnyChannels::sort(channels.into()),
        );
        let mut file = Cursor::new(Vec::new());
        Image::from_layer(layer)
            .write()
            .to_buffered(&mut file)
            .unwrap();
        file.into_inner()
    };
    assert_eq!(samples(&write(vec![channel("anything", floats)])), metres());
    let colour = [0.5; 6];
    let named = vec![channel("R", colour), channel("ViewLayer.Depth.Z", floats)];
    assert_eq!(samples(&write(named)), metres());
    let none = write(vec![channel("A", colour), channel("B", colour)]);
    assert!(
        error(&none).ends_with("an EXR image with the channels A, B"),
        "{}",
        error(&none)
    );
}

#[test]
fn transparent_pixels_are_not_measured_unless_all_are() {
    let write = |alpha: [u16; 6]| {
        let pairs: Vec<u16> = (1..7).zip(alpha).flat_map(|(v, a)| [v, a]).collect();
        let mut png = Vec::new();
        ::image::codecs::png::PngEncoder::new(&mut png)
            .write_image(bytemuck::cast_slice(&pairs), 3, 2, ExtendedColorType::La16)
            .unwrap();
        png
    };
    assert_eq!(samples(&write([65535; 6])), Units(vec![1, 2, 3, 4, 5, 6]));
    assert_eq!(samples(&write([0; 6])), Units(vec![1, 2, 3, 4, 5, 6]));
    let some = write([0, 65535, 65535, 65535, 1, 65535]);
    assert_eq!(samples(&some), Units(vec![0, 2, 3, 4, 5, 6]));
}

#[test]
fn what_is_no_depth_is_told_apart() {
    let color = gradient(3, 2);
    let rgba = png::encode_rgba(3, 2, color.bytes(), Effort::Fast).unwrap();
    assert!(error(&rgba).contains("packed or coloured depth"));
    let gray8 = png::encode_gray8(3, 2, &[9; 6], Effort::Fast).unwrap();
    assert!(error(&gray8).contains("8 bits are a picture of depth"));
    assert!(error(&jpeg::encode(&color, 90).unwrap()).contains("compression destroys depth"));
    assert!(error(b"version https://git-lfs.github.com/spec/v1").contains("git lfs pull"));
    assert!(error(b"").ends_with("an empty file"));
}

/// Checks that the decoded depth has the number of samples of its size.
fn check(bytes: &[u8]) {
    if let Ok(map) = decode_depth_map(bytes, "x") {
        let n = map.to_image(1000.0, 10.0).z_m.len();
        assert_eq!(n, map.width as usize * map.height as usize);
    }
}

/// One valid file per format.
fn seeds() -> Vec<Vec<u8>> {
    use ::tiff::encoder::{TiffEncoder, colortype};
    let mut tiff = Cursor::new(Vec::new());
    TiffEncoder::new(&mut tiff)
        .unwrap()
        .write_image::<colortype::Gray32Float>(3, 2, &VALUES.map(|v| v as f32))
        .unwrap();
    let mut exr = Cursor::new(Vec::new());
    {
        use ::exr::prelude::*;
        let z = AnyChannel::new("Z", FlatSamples::F32(vec![1.0; 6]));
        let layer = Layer::new(
            (3, 2),
            LayerAttributes::named("depth"),
            Encoding::SMALL_LOSSLESS,
            AnyChannels::sort(vec![z].into()),
        );
        Image::from_layer(layer)
            .write()
            .to_buffered(&mut exr)
            .unwrap();
    }
    vec![
        tiff.into_inner(),
        exr.into_inner(),
        npy("<f4", true, "(2, 3)", &[7; 24]),
        b"P5\n3 2\n65535\n\x13\x88\0\x02\0\x03\0\x04\0\x05\xFF\xFF".to_vec(),
        b"P2 3 2 65535 5000 2 3\n4 # x\n5 65535".to_vec(),
        [b"Pf\n3 2\n-1.0\n", &[7; 24][..]].concat(),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn damaged_depth_never_panics(
        kind in 0..6usize,
        changes in prop::collection::vec((any::<u16>(), any::<u8>()), 1..8),
        cut in any::<u16>(),
    ) {
        let mut bytes = seeds().swap_remove(kind);
        let n = bytes.len();
        for (at, value) in changes {
            bytes[usize::from(at) % n] = value;
        }
        check(&bytes);
        check(&bytes[..usize::from(cut) % n]);
        let _ = decode_color(&bytes, "x");
    }

    #[test]
    fn arbitrary_bytes_behind_a_depth_signature_never_panic(
        kind in 0..10usize,
        bytes in prop::collection::vec(any::<u8>(), 0..400),
    ) {
        let signature: &[u8] = [
            &b"P5 "[..], b"P2 ", b"Pf ", b"\x93NUMPY\x01\0", b"\x93NUMPY\x03\0",
            b"II*\0", b"MM\0*", b"\x76\x2F\x31\x01\x02\0\0\0", b"RIFF\x40\0\0\0WEBPVP8L", b"BM",
        ][kind];
        let bytes = [signature, &bytes].concat();
        check(&bytes);
        let _ = decode_color(&bytes, "x");
    }
}
