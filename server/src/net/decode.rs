//! Decodes a received frame: colour, and depth registered to it.

use std::sync::atomic::{AtomicI64, Ordering};

use ghostlight_proto::{Code, Codec, Frame, FrameHeader, WireError, depth};

use super::camera::{intrinsics_from_wire, pose_from_wire};
use super::catalog::EncodedFrame;
use crate::clock;
use crate::codec;
use crate::frame::{ColorImage, DepthImage, FrameGeometry};
use crate::recording::register_depth;

/// Decodes a frame whose header has been validated; colour and depth may be decoded in parallel.
pub(super) struct FrameDecoder<'a> {
    frame: &'a Frame<'a>,
    /// When the later of colour and depth was decoded, on the process's clock.
    decoded_ns: AtomicI64,
}

impl<'a> FrameDecoder<'a> {
    pub(super) fn new(frame: &'a Frame<'a>) -> Self {
        Self {
            frame,
            decoded_ns: AtomicI64::new(0),
        }
    }

    /// When both colour and depth were decoded, on the process's clock.
    pub(super) fn decoded_ns(&self) -> i64 {
        self.decoded_ns.load(Ordering::Relaxed)
    }

    fn done(&self) {
        self.decoded_ns
            .fetch_max(clock::now_ns(), Ordering::Relaxed);
    }
}

impl EncodedFrame for FrameDecoder<'_> {
    fn geometry(&self) -> Result<FrameGeometry, WireError> {
        let h = &self.frame.header;
        let units = depth_units(h, self.frame.depth)?;
        let max_m = if h.max_depth_m > 0.0 {
            h.max_depth_m
        } else {
            DepthImage::MAX_M
        };
        let units_per_metre = 1.0 / h.metres_per_unit;
        let (width, height) = (h.depth.width, h.depth.height);
        let depth = DepthImage::from_units(width, height, &units, units_per_metre, max_m);
        let intrinsics = intrinsics_from_wire(&h.color)?;
        let depth_camera = intrinsics_from_wire(&h.depth)?;
        let color_from_depth = pose_from_wire(&h.color_from_depth)?;
        let geometry = FrameGeometry {
            index: h.sequence,
            time_ns: h.capture_ns,
            depth: register_depth(depth, &depth_camera, &color_from_depth, &intrinsics),
            intrinsics,
            pose: pose_from_wire(&h.pose)?,
        };
        self.done();
        Ok(geometry)
    }

    fn color(&self) -> Result<ColorImage, WireError> {
        let image = color(&self.frame.header, self.frame.color)?;
        self.done();
        Ok(image)
    }
}

fn color(h: &FrameHeader, payload: &[u8]) -> Result<ColorImage, WireError> {
    let (width, height) = (h.color.width, h.color.height);
    let rgba = match h.color_codec {
        Codec::Rgb8 => payload
            .as_chunks::<3>()
            .0
            .iter()
            .map(|&[r, g, b]| [r, g, b, 255])
            .collect(),
        Codec::Rgba8 => payload
            .as_chunks::<4>()
            .0
            .iter()
            .map(|&[r, g, b, _]| [r, g, b, 255])
            .collect(),
        other => {
            check_announced(payload, other, "colour", width, height)?;
            let what = "colour payload";
            codec::decode_color(payload, what)
                .map_err(|e| refused(what, "an image that decodes", e))?
                .rgba
        }
    };
    Ok(ColorImage {
        width,
        height,
        rgba,
    })
}

fn depth_units(h: &FrameHeader, payload: &[u8]) -> Result<Vec<u16>, WireError> {
    let n_pixels = h.depth.n_pixels();
    match h.depth_codec {
        Codec::U16 => Ok(payload
            .as_chunks::<2>()
            .0
            .iter()
            .map(|&b| u16::from_le_bytes(b))
            .collect()),
        Codec::Rvl => depth::decode_rvl(payload, n_pixels),
        Codec::DeltaZstd => depth::decode_delta_zstd(payload, n_pixels),
        other => {
            check_announced(payload, other, "depth", h.depth.width, h.depth.height)?;
            let what = "depth payload";
            Ok(codec::decode_depth(payload, what)
                .map_err(|e| refused(what, "a 16-bit grey PNG that decodes", e))?
                .units)
        }
    }
}

/// Checks that a payload has the announced container format and size before any pixel is decoded. This bounds
/// what a small payload can make the decoder allocate.
fn check_announced(
    payload: &[u8],
    codec: Codec,
    plane: &str,
    width: u32,
    height: u32,
) -> Result<(), WireError> {
    let what = format!("{plane} payload");
    let format = match codec {
        Codec::Jpeg => image::ImageFormat::Jpeg,
        _ => image::ImageFormat::Png,
    };
    let size = image::ImageReader::with_format(std::io::Cursor::new(payload), format)
        .into_dimensions()
        .map_err(|e| {
            WireError::new(
                Code::Decode,
                &what,
                format_args!("a {} of {width}x{height}", codec.name()),
                e,
            )
        })?;
    if size == (width, height) {
        return Ok(());
    }
    Err(WireError::new(
        Code::Size,
        what,
        format_args!("{width}x{height} (as announced)"),
        format_args!("{}x{}", size.0, size.1),
    ))
}

fn refused(what: &str, expected: &str, error: impl std::fmt::Display) -> WireError {
    WireError::new(Code::Decode, what, expected, error)
}
