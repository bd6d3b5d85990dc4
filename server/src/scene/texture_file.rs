//! PNG, JPEG and WebP textures from untrusted bytes.

use std::io::Cursor;

use image::{ColorType, ImageDecoder, ImageFormat, ImageReader, Limits};

use super::{Reading, Texture};

/// Largest texture file, bytes.
pub(super) const MAX_BYTES: u64 = 256 << 20;

/// Largest side, texels.
const MAX_SIDE: u32 = 16_384;

/// Most texels of all textures of one mesh file: 512 MiB.
pub(super) const MAX_TEXELS_IN_ALL: u64 = 128 << 20;

/// Most texels of one texture: 256 MiB decoded.
const MAX_TEXELS: u64 = 64 << 20;

/// Decodes a PNG, JPEG or WebP. `reading` is the reading mode of the texture.
///
/// `reserve` is called with the peak memory before anything is allocated.
pub(super) fn decode_within(
    bytes: &[u8],
    reading: Reading,
    reserve: impl FnOnce(u64) -> Result<(), String>,
) -> Result<Texture, String> {
    let format = match image::guess_format(bytes) {
        Ok(format @ (ImageFormat::Png | ImageFormat::Jpeg | ImageFormat::WebP)) => format,
        _ => {
            return Err(format!(
                "expected a PNG, JPEG or WebP image, got {}",
                other_format(bytes)
            ));
        }
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
    let rgba = bytemuck::allocation::try_cast_vec(image.into_raw())
        .unwrap_or_else(|(_, raw)| bytemuck::cast_slice(&raw).to_vec());
    Ok(Texture::read_as(width, height, rgba, reading))
}

/// The format of an unsupported image, by its first bytes.
fn other_format(bytes: &[u8]) -> &'static str {
    let is_avif = bytes.get(4..8) == Some(b"ftyp")
        && matches!(bytes.get(8..12), Some(b"avif" | b"avis" | b"mif1"));
    match bytes {
        [0xAB, b'K', b'T', b'X', b' ', b'2', b'0', ..] => "KTX2 (Basis Universal)",
        [0xAB, b'K', b'T', b'X', ..] => "KTX",
        [b'D', b'D', b'S', b' ', ..] => "DDS",
        [b's', b'B', ..] => "Basis Universal",
        [b'G', b'I', b'F', b'8', ..] => "GIF",
        [b'B', b'M', ..] => "BMP",
        [b'I', b'I', b'*', 0, ..] | [b'M', b'M', 0, b'*', ..] => "TIFF",
        [] => "an empty file",
        _ if is_avif => "AVIF",
        _ => "something else",
    }
}

/// Peak memory while decoding, bytes: the file's texels and the kept texels.
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
    // A progressive JPEG decoder holds all coefficients at once, 16 bits each.
    let inner = match format {
        ImageFormat::Jpeg => 6 * texels,
        // Lossless WebP is predicted from whole pictures of transforms.
        ImageFormat::WebP => 8 * texels,
        _ => 0,
    };
    let decoding = decoder.total_bytes().saturating_add(kept + inner);
    Ok(decoding.max(Texture::bytes_of(texels)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn decode(bytes: &[u8], srgb: bool) -> Result<Texture, String> {
        let reading = Reading {
            srgb,
            ..Reading::default()
        };
        decode_within(bytes, reading, |_| Ok(()))
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
        fn arbitrary_bytes_never_panic(tail in prop::collection::vec(any::<u8>(), 0..200), kind in 0usize..4) {
            let magics: [&[u8]; 4] = [b"\xFF\xD8\xFF", b"\x89PNG\r\n\x1a\n", b"RIFF\xC0\0\0\0WEBPVP8L", b"RIFF\xC0\0\0\0WEBPVP8 "];
            let mut bytes = magics[kind].to_vec();
            bytes.extend(tail);
            let _ = decode(&bytes, true);
        }
    }
}
