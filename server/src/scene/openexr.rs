//! OpenEXR environment maps from untrusted bytes: half, float or integer colours, scan lines or tiles, with any
//! compression that the library supports.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use exr::meta::MetaData;
use exr::prelude::{AnyChannel, FlatSamples, ReadChannels, ReadLayers, read};

use super::radiance::Picture;

/// The magic number of OpenEXR files.
pub(super) const MAGIC: [u8; 4] = [0x76, 0x2F, 0x31, 0x01];

/// Most decoded bytes of all channels of one file.
const MAX_DECODED: u64 = 4 << 30;

/// Decodes a map. `reserve` is called with its size and the bytes of its channels before they are allocated.
pub(super) fn decode(
    bytes: &[u8],
    reserve: impl FnOnce(u32, u32, u64) -> Result<(), String>,
) -> Result<Picture, String> {
    // A panic of the library must not stop the server.
    catch_unwind(AssertUnwindSafe(|| decode_unguarded(bytes, reserve)))
        .unwrap_or_else(|_| Err("OpenEXR: its data are damaged".to_owned()))
}

fn decode_unguarded(
    bytes: &[u8],
    reserve: impl FnOnce(u32, u32, u64) -> Result<(), String>,
) -> Result<Picture, String> {
    let broken = |error: exr::error::Error| {
        format!("OpenEXR: {}", error.to_string().replace(['\n', '\r'], " "))
    };
    let metadata = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(broken)?;
    let (mut width, mut height, mut n_bytes) = (0, 0, 0u64);
    for header in &metadata.headers {
        let size = header.layer_size;
        let side = |n: usize| u32::try_from(n).map_err(|_| format!("OpenEXR: {n} texels wide"));
        width = width.max(side(size.width())?);
        height = height.max(side(size.height())?);
        let n_channels = header.channels.list.len() as u64;
        let texels = u64::from(side(size.width())?) * u64::from(side(size.height())?);
        n_bytes = n_bytes.saturating_add(texels.saturating_mul(4 * n_channels));
    }
    if n_bytes > MAX_DECODED {
        return Err(format!(
            "OpenEXR: expected at most {MAX_DECODED} bytes of texels, got {n_bytes}"
        ));
    }
    reserve(width, height, n_bytes)?;
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(broken)?;
    let layer = image.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    let channels = &layer.channel_data.list;
    let mut notes = Vec::new();
    let rgb = colors(channels).ok_or_else(|| {
        let names: Vec<String> = channels
            .iter()
            .take(8)
            .map(|c| c.name.to_string())
            .collect();
        format!(
            "OpenEXR: expected the channels R, G and B, or Y, got {:?}",
            names.join(", ")
        )
    })?;
    if rgb[0].name == rgb[1].name {
        notes.push(format!(
            "its channel {:?} is taken as grey",
            rgb[0].name.to_string()
        ));
    }
    let n_texels = width * height;
    let values = rgb.map(|channel| &channel.sample_data);
    let texels = (0..n_texels)
        .map(|i| values.map(|samples| sample(samples, i)))
        .collect();
    Ok(Picture {
        width: width as u32,
        height: height as u32,
        texels,
        notes,
    })
}

fn sample(samples: &FlatSamples, i: usize) -> f32 {
    let value = match samples {
        FlatSamples::F16(values) => values.get(i).map(|x| x.to_f32()),
        FlatSamples::F32(values) => values.get(i).copied(),
        FlatSamples::U32(values) => values.get(i).map(|&x| x as f32),
    };
    value.unwrap_or(0.0)
}

/// Red, green and blue of a layer: channels with plain names, else of Blender's combined pass, else of the first pass
/// that has all three; else grey.
fn colors(channels: &[AnyChannel<FlatSamples>]) -> Option<[&AnyChannel<FlatSamples>; 3]> {
    let named = |wanted: &str| {
        channels
            .iter()
            .find(|channel| channel.name.to_string().eq_ignore_ascii_case(wanted))
    };
    let triple = |prefix: &str| {
        let get = |channel: &str| named(&format!("{prefix}{channel}"));
        Some([get("R")?, get("G")?, get("B")?])
    };
    let mut prefixes: Vec<String> = channels
        .iter()
        .filter_map(|channel| {
            let name = channel.name.to_string();
            let (pass, last) = name.rsplit_once('.')?;
            last.eq_ignore_ascii_case("R").then(|| format!("{pass}."))
        })
        .collect();
    prefixes.sort_by_key(|prefix| !prefix.to_lowercase().contains("combined"));
    let passes = || prefixes.iter().find_map(|prefix| triple(prefix));
    let grey = || {
        let only = || channels.first().filter(|_| channels.len() == 1);
        let channel = named("Y").or_else(only)?;
        Some([channel; 3])
    };
    triple("").or_else(passes).or_else(grey)
}

#[cfg(test)]
mod tests {
    use super::*;
    use exr::prelude::{
        Encoding, Image, Layer, LayerAttributes, SpecificChannels, WritableImage, f16,
    };
    use proptest::prelude::*;

    fn file(encoding: Encoding) -> Vec<u8> {
        let channels = SpecificChannels::rgb(|at: exr::math::Vec2<usize>| {
            (
                f16::from_f32(at.x() as f32),
                f16::from_f32(at.y() as f32),
                f16::from_f32(0.5),
            )
        });
        let layer = Layer::new((6, 3), LayerAttributes::named("map"), encoding, channels);
        let mut bytes = Cursor::new(Vec::new());
        Image::from_layer(layer)
            .write()
            .non_parallel()
            .to_buffered(&mut bytes)
            .unwrap();
        bytes.into_inner()
    }

    fn read_small(bytes: &[u8]) -> Result<Picture, String> {
        decode(bytes, |width, height, n_bytes| {
            match width.checked_mul(height) {
                Some(1..=4096) if n_bytes < 1 << 20 => Ok(()),
                _ => Err(format!("{width}x{height}: too large")),
            }
        })
    }

    #[test]
    fn scan_lines_and_tiles_are_read() {
        for encoding in [
            Encoding::UNCOMPRESSED,
            Encoding::FAST_LOSSLESS,
            Encoding::SMALL_LOSSLESS,
            Encoding::SMALL_FAST_LOSSLESS,
        ] {
            let picture = read_small(&file(encoding)).unwrap();
            assert_eq!((picture.width, picture.height), (6, 3));
            assert_eq!(picture.texels[6 + 4], [4.0, 1.0, 0.5]);
            assert!(picture.notes.is_empty());
        }
    }

    #[test]
    fn a_cut_file_is_one_error() {
        let bytes = file(Encoding::UNCOMPRESSED);
        for n in 0..bytes.len() {
            let error = read_small(&bytes[..n]).unwrap_err();
            assert!(!error.contains('\n'), "{error}");
        }
    }

    proptest! {
        #[test]
        fn damaged_bytes_never_panic(
            compressed: bool,
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        ) {
            let encoding = if compressed { Encoding::SMALL_LOSSLESS } else { Encoding::UNCOMPRESSED };
            let mut bytes = file(encoding);
            for (at, byte) in changes {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            if let Ok(picture) = read_small(&bytes) {
                prop_assert_eq!(picture.texels.len() as u32, picture.width * picture.height);
            }
        }
    }
}
