//! Encodes the planes of a rendered frame as clients request them. Each encoding is made once, by the first
//! client that wants it, and shared with the others.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use ghostlight_proto::control::CompositeRequest;
use ghostlight_proto::{
    Code, Codec, Composite, CompositeHeader, Payloads, Plane, Stamps, WireError, depth,
};

use super::camera::{intrinsics_to_wire, pose_to_wire};
use crate::clock;
use crate::codec::png::{self, Effort};
use crate::codec::{CodecError, jpeg};
use crate::frame::{ColorImage, RgbdFrame};
use crate::render::{Aov, AovImage, FrameStats, Rendered};

/// One encoding of one plane: plane, codec and quality (0 for codecs without one).
type Form = (Plane, Codec, u8);
type Bytes = Result<Vec<u8>, WireError>;

/// A finished composite, not yet encoded.
pub(super) struct Output {
    /// Counts the composites of the session, from 1.
    pub(super) serial: u64,
    /// The frame that it was drawn over.
    pub(super) frame: Arc<RgbdFrame>,
    /// That frame's colour payload, if it was received as JPEG.
    pub(super) camera_jpeg: Option<axum::body::Bytes>,
    /// The composite.
    pub(super) rendered: Rendered,
    /// Time stamps up to the end of rendering.
    pub(super) stamps: Stamps,
    /// Frames of the session dropped so far.
    pub(super) dropped_frames: u64,
    encoded: Mutex<Vec<(Form, Arc<OnceLock<Bytes>>)>>,
}

impl Output {
    /// An output of which nothing is encoded yet.
    pub(super) fn new(
        serial: u64,
        frame: Arc<RgbdFrame>,
        camera_jpeg: Option<axum::body::Bytes>,
        rendered: Rendered,
        stamps: Stamps,
        dropped_frames: u64,
    ) -> Self {
        Self {
            serial,
            frame,
            camera_jpeg,
            rendered,
            stamps,
            dropped_frames,
            encoded: Mutex::new(Vec::new()),
        }
    }

    /// The message for one client, except its time of sending. Takes milliseconds: do not call it on a thread
    /// that serves sockets.
    pub(super) fn message(
        &self,
        request: &CompositeRequest,
        dropped_composites: u64,
    ) -> Result<(Vec<u8>, Stamps), WireError> {
        let mut stamps = self.stamps;
        stamps.encode_start_ns = clock::now_ns();
        let forms = [
            (Plane::Image, request.image),
            (Plane::Camera, request.camera),
            (Plane::Mask, request.mask),
            (Plane::CompositeDepth, request.depth),
        ]
        // Planes that were requested after this frame was rendered come with the next frame.
        .map(|(plane, codec)| match self.has(plane) {
            true => (plane, codec, quality(codec, request.quality)),
            false => (plane, Codec::None, 0),
        });
        let cells = forms.map(|form| self.cell(form));
        let mut payloads: [&[u8]; 4] = [&[]; 4];
        for ((payload, cell), form) in payloads.iter_mut().zip(&cells).zip(forms) {
            if form.1 != Codec::None {
                *payload = cell
                    .get_or_init(|| self.encode(form))
                    .as_deref()
                    .map_err(Clone::clone)?;
            }
        }
        stamps.encoded_ns = clock::now_ns();
        stamps.sent_ns = stamps.encoded_ns;
        let [image, camera, mask, depth] = payloads;
        let FrameStats {
            virtual_pixels,
            traced_pixels,
            secondary_rays,
            secondary_unknown,
            ..
        } = self.rendered.stats;
        let header = CompositeHeader {
            sequence: self.frame.index,
            capture_ns: self.frame.time_ns,
            pose: pose_to_wire(&self.frame.pose),
            camera: intrinsics_to_wire(&self.frame.intrinsics),
            stamps,
            dropped_frames: self.dropped_frames,
            dropped_composites,
            image_codec: forms[0].1,
            camera_codec: forms[1].1,
            mask_codec: forms[2].1,
            depth_codec: forms[3].1,
            virtual_pixels: saturate(virtual_pixels),
            traced_pixels: saturate(traced_pixels),
            secondary_rays: saturate(secondary_rays),
            unknown_rays: saturate(secondary_unknown),
            stage_us: self
                .rendered
                .stage_ns
                .iter()
                .map(|&ns| saturate(ns / 1000))
                .collect(),
        };
        let message = Composite {
            header,
            planes: Payloads {
                image,
                camera,
                mask,
                depth,
            },
        }
        .encode()?;
        Ok((message, stamps))
    }

    fn aov(&self, aov: Aov) -> Option<&AovImage> {
        self.rendered
            .aovs
            .iter()
            .find_map(|(a, image)| (*a == aov).then_some(image))
    }

    fn has(&self, plane: Plane) -> bool {
        match plane {
            Plane::Mask => self.aov(Aov::Mask).is_some(),
            Plane::CompositeDepth => self.aov(Aov::Depth).is_some(),
            Plane::Image | Plane::Camera | Plane::Color | Plane::Depth => true,
        }
    }

    /// The slot of an encoded plane; the first caller fills it, the others wait for it.
    fn cell(&self, form: Form) -> Arc<OnceLock<Bytes>> {
        let mut encoded = self.encoded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, cell)) = encoded.iter().find(|(f, _)| *f == form) {
            return Arc::clone(cell);
        }
        let cell = Arc::new(OnceLock::new());
        encoded.push((form, Arc::clone(&cell)));
        cell
    }

    fn encode(&self, (plane, codec, quality): Form) -> Bytes {
        match (plane, &self.camera_jpeg) {
            // The camera's own JPEG bytes: no work, and no second compression loss.
            (Plane::Camera, Some(jpeg)) if codec == Codec::Jpeg => Ok(jpeg.to_vec()),
            (Plane::Camera, _) => encode_color(&self.frame.color, codec, quality),
            (Plane::Mask, _) => match self.aov(Aov::Mask) {
                Some(AovImage::Gray8(mask)) => encode_gray8(self.size(), mask, codec),
                _ => Err(missing(plane)),
            },
            (Plane::CompositeDepth, _) => match self.aov(Aov::Depth) {
                Some(AovImage::Gray16(mm)) => encode_depth(self.size(), mm, codec),
                _ => Err(missing(plane)),
            },
            _ => encode_color(&self.rendered.color, codec, quality),
        }
    }

    fn size(&self) -> (u32, u32) {
        (self.frame.color.width, self.frame.color.height)
    }
}

fn quality(codec: Codec, quality: u8) -> u8 {
    match codec {
        Codec::Jpeg => quality,
        _ => 0,
    }
}

fn saturate(n: u64) -> u32 {
    u32::try_from(n).unwrap_or(u32::MAX)
}

fn missing(plane: Plane) -> WireError {
    WireError::new(
        Code::Internal,
        format_args!("{} plane", plane.name()),
        "the renderer to deliver it",
        "another kind of image",
    )
}

fn failed(codec: Codec, error: impl std::fmt::Display) -> WireError {
    WireError::new(
        Code::Internal,
        format_args!("{} encoder", codec.name()),
        "to encode",
        error,
    )
}

/// A colour image in one of the colour codecs.
pub(super) fn encode_color(image: &ColorImage, codec: Codec, quality: u8) -> Bytes {
    let rgb = || -> Vec<u8> {
        let mut rgb = Vec::with_capacity(3 * image.rgba.len());
        for &[r, g, b, _] in &image.rgba {
            rgb.extend_from_slice(&[r, g, b]);
        }
        rgb
    };
    match codec {
        Codec::Jpeg => jpeg::encode_fast(image, quality).map_err(|e| failed(codec, e)),
        Codec::Png => png_bytes(png::encode_rgb8(
            image.width,
            image.height,
            &rgb(),
            Effort::Fast,
        )),
        Codec::Rgb8 => Ok(rgb()),
        Codec::Rgba8 => Ok(image
            .rgba
            .iter()
            .flat_map(|&[r, g, b, _]| [r, g, b, 255])
            .collect()),
        Codec::None | Codec::Gray8 | Codec::U16 | Codec::Rvl | Codec::DeltaZstd => {
            Err(failed(codec, "not a codec for colour"))
        }
    }
}

fn encode_gray8(size: (u32, u32), mask: &[u8], codec: Codec) -> Bytes {
    match codec {
        Codec::Png => png_bytes(png::encode_gray8(size.0, size.1, mask, Effort::Fast)),
        Codec::Gray8 => Ok(mask.to_vec()),
        _ => Err(failed(codec, "not a codec for a mask")),
    }
}

/// Depth samples in one of the depth codecs.
pub(super) fn encode_depth(size: (u32, u32), units: &[u16], codec: Codec) -> Bytes {
    let bytes = || units.iter().flat_map(|u| u.to_le_bytes()).collect();
    match codec {
        Codec::U16 => Ok(bytes()),
        Codec::Rvl => Ok(depth::encode_rvl(units)),
        Codec::DeltaZstd => depth::encode_delta_zstd(units),
        Codec::Png => png_bytes(png::encode_gray16(size.0, size.1, units, Effort::Fast)),
        _ => Err(failed(codec, "not a codec for depth")),
    }
}

fn png_bytes(encoded: Result<Vec<u8>, CodecError>) -> Bytes {
    encoded.map_err(|e| failed(Codec::Png, e))
}
