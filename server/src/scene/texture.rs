//! PNG and JPEG textures from untrusted bytes.

use std::io::Cursor;

use image::{ColorType, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::Texture;

/// Largest texture file, bytes.
pub(super) const MAX_BYTES: u64 = 256 << 20;

/// Largest side, texels.
const MAX_SIDE: u32 = 16_384;

/// Most texels of all textures of one mesh file: 512 MiB.
pub(super) const MAX_TEXELS_IN_ALL: u64 = 128 << 20;

/// Most texels of one texture: 256 MiB decoded.
const MAX_TEXELS: u64 = 64 << 20;

/// Decodes a PNG or JPEG. `srgb` says how the texels are to be read later.
///
/// `reserve` is asked for the bytes that this takes at most, before it takes them.
pub(super) fn decode_within(
    bytes: &[u8],
    srgb: bool,
    reserve: impl FnOnce(u64) -> Result<(), String>,
) -> Result<Texture, String> {
    let format = match image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg)) => format,
        _ => return Err("expected a PNG or JPEG image, got something else".to_owned()),
    };
    let size = ImageReader::with_format(Cursor::new(bytes), format)
        .into_dimensions()
        .map_err(|error| format!("image cannot be decoded: {error}"))?;
    if u64::from(size.0) * u64::from(size.1) > MAX_TEXELS || size.0 == 0 || size.1 == 0 {
        return Err(format!(
            "expected an image of 1 to {MAX_TEXELS} texels, got {}x{}",
            size.0, size.1
        ));
    }
    reserve(peak_bytes(bytes, format)?)?;
    let mut reader = ImageReader::with_format(Cursor::new(bytes), format);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(1 << 30);
    reader.limits(limits);
    let image = reader
        .decode()
        .map_err(|error| format!("image cannot be decoded: {error}"))?
        .into_rgba8();
    let (width, height) = image.dimensions();
    Ok(Texture {
        width,
        height,
        rgba: bytemuck::allocation::try_cast_vec(image.into_raw())
            .unwrap_or_else(|(_, raw)| bytemuck::cast_slice(&raw).to_vec()),
        srgb,
    })
}

/// What decoding takes at most: texels as the file has them, and as they are kept.
fn peak_bytes(bytes: &[u8], format: ImageFormat) -> Result<u64, String> {
    let decoder = ImageReader::with_format(Cursor::new(bytes), format)
        .into_decoder()
        .map_err(|error| format!("image cannot be decoded: {error}"))?;
    let (width, height) = decoder.dimensions();
    let texels = u64::from(width) * u64::from(height);
    let kept = match decoder.color_type() {
        // Decoded in place.
        ColorType::Rgba8 => 0,
        _ => 4 * texels,
    };
    // A progressive JPEG's coefficients are all there at once, in 16 bits.
    let inner = match format {
        ImageFormat::Jpeg => 6 * texels,
        _ => 0,
    };
    Ok(decoder.total_bytes().saturating_add(kept + inner))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn decode(bytes: &[u8], srgb: bool) -> Result<Texture, String> {
        decode_within(bytes, srgb, |_| Ok(()))
    }

    #[test]
    fn png_survives_and_damage_is_an_error() {
        let image = image::RgbaImage::from_fn(3, 2, |x, y| image::Rgba([x as u8, y as u8, 7, 255]));
        let mut bytes = Cursor::new(Vec::new());
        image.write_to(&mut bytes, ImageFormat::Png).unwrap();
        let bytes = bytes.into_inner();
        let texture = decode(&bytes, true).unwrap();
        assert_eq!((texture.width, texture.height), (3, 2));
        assert_eq!(texture.rgba[4], [1, 1, 7, 255]);
        for n in 0..bytes.len() - 12 {
            assert!(decode(&bytes[..n], true).is_err());
        }
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(tail in prop::collection::vec(any::<u8>(), 0..200), jpeg: bool) {
            let mut bytes = if jpeg { vec![0xFF, 0xD8, 0xFF] } else { b"\x89PNG\r\n\x1a\n".to_vec() };
            bytes.extend(tail);
            let _ = decode(&bytes, true);
        }
    }
}
