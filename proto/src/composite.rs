//! A composite, as sent to clients (README, section 7).

use crate::bytes::{Header, Writer, size};
use crate::{Code, Codec, Intrinsics, Kind, MAX_SIDE, Plane, Pose, WireError};

/// Bytes of the composite header before its stage table.
pub const COMPOSITE_HEADER_BYTES: usize = 240;

/// Most render stages in the stage table.
pub const MAX_STAGES: usize = 64;

/// Times of a frame's steps, nanoseconds on the server's clock.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Stamps {
    /// The frame was received completely.
    pub received_ns: i64,
    /// The frame was taken from its slot.
    pub decode_start_ns: i64,
    /// The frame's pixels were decoded.
    pub decoded_ns: i64,
    /// Rendering began.
    pub render_start_ns: i64,
    /// The composite was finished.
    pub render_end_ns: i64,
    /// A credit was available, and this was the newest composite.
    pub encode_start_ns: i64,
    /// The image was encoded.
    pub encoded_ns: i64,
    /// The composite was passed to the socket.
    pub sent_ns: i64,
}

impl Stamps {
    /// The stamps in header order.
    pub fn to_array(self) -> [i64; 8] {
        [
            self.received_ns,
            self.decode_start_ns,
            self.decoded_ns,
            self.render_start_ns,
            self.render_end_ns,
            self.encode_start_ns,
            self.encoded_ns,
            self.sent_ns,
        ]
    }
}

/// All data of a composite except its pixels.
#[derive(Debug, Clone, PartialEq)]
pub struct CompositeHeader {
    /// Sequence number of the rendered frame.
    pub sequence: u64,
    /// Capture time of that frame, as received.
    pub capture_ns: i64,
    /// Pose of that frame.
    pub pose: Pose,
    /// Colour camera of that frame; all planes have its size.
    pub camera: Intrinsics,
    /// Times of the steps.
    pub stamps: Stamps,
    /// Frames of the session that were never rendered.
    pub dropped_frames: u64,
    /// Composites of the session that were not sent to this client.
    pub dropped_composites: u64,
    /// Codec of the image.
    pub image_codec: Codec,
    /// Codec of the camera's picture.
    pub camera_codec: Codec,
    /// Codec of the mask.
    pub mask_codec: Codec,
    /// Codec of the depth.
    pub depth_codec: Codec,
    /// Number of pixels that show virtual objects.
    pub virtual_pixels: u32,
    /// Number of pixels that were ray traced.
    pub traced_pixels: u32,
    /// Number of reflection and refraction rays.
    pub secondary_rays: u32,
    /// Number of these rays that ended in unknown space.
    pub unknown_rays: u32,
    /// Time of each render stage, microseconds; at most [`MAX_STAGES`].
    pub stage_us: Vec<u32>,
}

/// The encoded planes; empty if not sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Payloads<'a> {
    /// Image of the composite.
    pub image: &'a [u8],
    /// The camera's picture.
    pub camera: &'a [u8],
    /// Share of each pixel that is virtual.
    pub mask: &'a [u8],
    /// Depth of the composite, millimetres.
    pub depth: &'a [u8],
}

/// A composite, its planes borrowed from the message.
#[derive(Debug, Clone, PartialEq)]
pub struct Composite<'a> {
    /// The header.
    pub header: CompositeHeader,
    /// The planes.
    pub planes: Payloads<'a>,
}

impl<'a> Composite<'a> {
    /// Offset of `sent_ns`, so that it can be written last.
    const SENT_OFFSET: usize = 176;

    /// Decodes and checks a message; the planes stay encoded.
    pub fn decode(message: &'a [u8]) -> Result<Self, WireError> {
        let h = Header::new(message, Kind::Composite, COMPOSITE_HEADER_BYTES)?;
        let n_stages = usize::from(h.u8(236));
        if COMPOSITE_HEADER_BYTES + 4 * n_stages > h.header_bytes {
            return Err(WireError::new(
                Code::Malformed,
                "composite, header bytes",
                format_args!(
                    "at least {} for {n_stages} stages",
                    COMPOSITE_HEADER_BYTES + 4 * n_stages
                ),
                h.header_bytes,
            ));
        }
        let stamp = |i: usize| h.i64(120 + 8 * i);
        let header = CompositeHeader {
            sequence: h.u64(8),
            capture_ns: h.i64(16),
            pose: Pose::read(&h, 24),
            camera: Intrinsics::read(&h, 80),
            stamps: Stamps {
                received_ns: stamp(0),
                decode_start_ns: stamp(1),
                decoded_ns: stamp(2),
                render_start_ns: stamp(3),
                render_end_ns: stamp(4),
                encode_start_ns: stamp(5),
                encoded_ns: stamp(6),
                sent_ns: stamp(7),
            },
            dropped_frames: h.u64(184),
            dropped_composites: h.u64(192),
            image_codec: Codec::from_code(h.u8(200), Plane::Image)?,
            camera_codec: Codec::from_code(h.u8(201), Plane::Camera)?,
            mask_codec: Codec::from_code(h.u8(202), Plane::Mask)?,
            depth_codec: Codec::from_code(h.u8(203), Plane::CompositeDepth)?,
            virtual_pixels: h.u32(220),
            traced_pixels: h.u32(224),
            secondary_rays: h.u32(228),
            unknown_rays: h.u32(232),
            stage_us: (0..n_stages)
                .map(|i| h.u32(COMPOSITE_HEADER_BYTES + 4 * i))
                .collect(),
        };
        let sizes = [h.u32(204), h.u32(208), h.u32(212), h.u32(216)];
        let [image, camera, mask, depth] =
            h.payloads(Kind::Composite, ["image", "camera", "mask", "depth"], sizes)?;
        let composite = Self {
            header,
            planes: Payloads {
                image,
                camera,
                mask,
                depth,
            },
        };
        composite.check()?;
        Ok(composite)
    }

    /// Encodes the message; fails if [`Composite::decode`] would.
    pub fn encode(&self) -> Result<Vec<u8>, WireError> {
        self.check()?;
        let (h, planes) = (&self.header, &self.planes);
        let parts = [
            ("image", planes.image),
            ("camera", planes.camera),
            ("mask", planes.mask),
            ("depth", planes.depth),
        ];
        let header_bytes = (COMPOSITE_HEADER_BYTES + 4 * h.stage_us.len()).next_multiple_of(8);
        let mut out = Writer::new(
            Kind::Composite,
            header_bytes,
            parts.iter().map(|(_, p)| p.len()).sum(),
        );
        out.u64(h.sequence);
        out.i64(h.capture_ns);
        h.pose.write(&mut out);
        h.camera.write(&mut out);
        for stamp in h.stamps.to_array() {
            out.i64(stamp);
        }
        out.u64(h.dropped_frames);
        out.u64(h.dropped_composites);
        for codec in [h.image_codec, h.camera_codec, h.mask_codec, h.depth_codec] {
            out.u8(codec.code());
        }
        for (what, payload) in parts {
            out.u32(size(Kind::Composite, what, payload)?);
        }
        for count in [
            h.virtual_pixels,
            h.traced_pixels,
            h.secondary_rays,
            h.unknown_rays,
        ] {
            out.u32(count);
        }
        // At most MAX_STAGES, so the cast is exact.
        out.u8(h.stage_us.len() as u8);
        out.zeros_to(COMPOSITE_HEADER_BYTES);
        for &us in &h.stage_us {
            out.u32(us);
        }
        out.zeros_to(header_bytes);
        for (_, payload) in parts {
            out.bytes(payload);
        }
        Ok(out.0)
    }

    /// Writes the sending time into an encoded composite.
    pub fn stamp_sent(message: &mut [u8], sent_ns: i64) {
        if let Some(field) = message.get_mut(Self::SENT_OFFSET..Self::SENT_OFFSET + 8) {
            field.copy_from_slice(&sent_ns.to_le_bytes());
        }
    }

    fn check(&self) -> Result<(), WireError> {
        let (h, planes) = (&self.header, &self.planes);
        h.pose.check("composite pose")?;
        h.camera.check("composite", MAX_SIDE)?;
        if h.stage_us.len() > MAX_STAGES {
            return Err(WireError::new(
                Code::Malformed,
                "composite, number of stages",
                format_args!("at most {MAX_STAGES}"),
                h.stage_us.len(),
            ));
        }
        for (plane, codec, payload) in [
            (Plane::Image, h.image_codec, planes.image),
            (Plane::Camera, h.camera_codec, planes.camera),
            (Plane::Mask, h.mask_codec, planes.mask),
            (Plane::CompositeDepth, h.depth_codec, planes.depth),
        ] {
            codec.check(plane)?;
            codec.check_size(plane, h.camera.n_pixels(), payload.len())?;
        }
        Ok(())
    }
}
