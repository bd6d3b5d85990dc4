//! OpenEXR depth: the channel `Z`, or the one that replaces it.

use std::io::Cursor;

use exr::meta::MetaData;
use exr::prelude::{FlatSamples, ReadChannels, ReadLayers, read};

use super::depth_map::{DepthMap, EXPECTED, check_depth_size};
use super::{CodecError, MAX_DECODE_BYTES, malformed};

/// Names of depth channels, the most likely first: Blender writes `Z`, `View Layer.Depth.Z` or `V`, OpenCV writes `Y`
/// or three equal channels.
const CHANNELS: [&str; 6] = ["z", "depth", "d", "v", "y", "r"];

pub(super) fn depth(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    let bad = |e: exr::error::Error| malformed(file, EXPECTED, format!("EXR error: {e}"));
    let metadata = MetaData::read_from_buffered(Cursor::new(bytes), false).map_err(bad)?;
    let mut n_bytes = 0u64;
    for header in &metadata.headers {
        let (width, height) = (header.layer_size.width(), header.layer_size.height());
        check_depth_size(width as u64, height as u64, file)?;
        let channels = header.channels.list.len() as u64;
        n_bytes = n_bytes.saturating_add(4 * width as u64 * height as u64 * channels);
    }
    if n_bytes > MAX_DECODE_BYTES {
        return Err(CodecError::TooLarge {
            file: file.to_owned(),
            field: "decoded EXR image in bytes",
            limit: MAX_DECODE_BYTES,
            got: n_bytes,
        });
    }
    let image = read()
        .no_deep_data()
        .largest_resolution_level()
        .all_channels()
        .first_valid_layer()
        .all_attributes()
        .non_parallel()
        .from_buffered(Cursor::new(bytes))
        .map_err(bad)?;
    let layer = image.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    let (w, h) = check_depth_size(width as u64, height as u64, file)?;
    let list = &layer.channel_data.list;
    let last_part = |name: &str| {
        let name = name.to_ascii_lowercase();
        name.rsplit('.').next().unwrap_or_default().to_owned()
    };
    let named = |wanted: &str| {
        list.iter()
            .find(|c| last_part(&c.name.to_string()) == wanted)
    };
    let only = (list.len() == 1).then(|| list.first()).flatten();
    let Some(channel) = only.or_else(|| CHANNELS.into_iter().find_map(named)) else {
        let names: Vec<String> = list.iter().take(8).map(|c| c.name.to_string()).collect();
        let got = format!("an EXR image with the channels {}", names.join(", "));
        return Err(malformed(file, EXPECTED, got.escape_debug().to_string()));
    };
    let values: Vec<f32> = match &channel.sample_data {
        FlatSamples::F16(v) => v.iter().map(|v| v.to_f32()).collect(),
        FlatSamples::F32(v) => v.clone(),
        FlatSamples::U32(v) => v.iter().map(|&v| v as f32).collect(),
    };
    if values.len() != width * height {
        let got = format!("an EXR channel of {} samples for {w}x{h}", values.len());
        return Err(malformed(file, EXPECTED, got));
    }
    Ok(DepthMap::from_floats(w, h, values))
}
