//! An RGB-D frame, as sent by clients (README, section 4).

use crate::bytes::{Header, Writer, size};
use crate::{Code, Codec, Intrinsics, Kind, MAX_SIDE, Plane, Pose, WireError};

/// Bytes of the frame header of this version.
pub const FRAME_HEADER_BYTES: usize = 240;

/// All data of a frame except its pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameHeader {
    /// Sequence number, chosen by the client.
    pub sequence: u64,
    /// Capture time, nanoseconds on the client's clock.
    pub capture_ns: i64,
    /// World from colour camera.
    pub pose: Pose,
    /// Intrinsics of the colour image.
    pub color: Intrinsics,
    /// Intrinsics of the depth image.
    pub depth: Intrinsics,
    /// Colour camera from depth camera.
    pub color_from_depth: Pose,
    /// Metres per depth unit.
    pub metres_per_unit: f64,
    /// Codec of the colour payload.
    pub color_codec: Codec,
    /// Codec of the depth payload.
    pub depth_codec: Codec,
    /// Larger depth is invalid, metres; 0: no bound.
    pub max_depth_m: f32,
}

/// A frame, its payloads borrowed from the message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame<'a> {
    /// The header.
    pub header: FrameHeader,
    /// Encoded colour.
    pub color: &'a [u8],
    /// Encoded depth.
    pub depth: &'a [u8],
}

impl<'a> Frame<'a> {
    /// Decodes and checks a message; the payloads stay encoded.
    pub fn decode(message: &'a [u8]) -> Result<Self, WireError> {
        let h = Header::new(message, Kind::Frame, FRAME_HEADER_BYTES)?;
        let header = FrameHeader {
            sequence: h.u64(8),
            capture_ns: h.i64(16),
            pose: Pose::read(&h, 24),
            color: Intrinsics::read(&h, 80),
            depth: Intrinsics::read(&h, 120),
            color_from_depth: Pose::read(&h, 160),
            metres_per_unit: h.f64(216),
            color_codec: Codec::from_code(h.u8(224), Plane::Color)?,
            depth_codec: Codec::from_code(h.u8(225), Plane::Depth)?,
            max_depth_m: h.f32(236),
        };
        let [color, depth] =
            h.payloads(Kind::Frame, ["colour", "depth"], [h.u32(228), h.u32(232)])?;
        let frame = Self {
            header,
            color,
            depth,
        };
        frame.check()?;
        Ok(frame)
    }

    /// Encodes the message; fails if [`Frame::decode`] would.
    pub fn encode(&self) -> Result<Vec<u8>, WireError> {
        self.check()?;
        let color_bytes = size(Kind::Frame, "colour", self.color)?;
        let depth_bytes = size(Kind::Frame, "depth", self.depth)?;
        let h = &self.header;
        let mut out = Writer::new(
            Kind::Frame,
            FRAME_HEADER_BYTES,
            self.color.len() + self.depth.len(),
        );
        out.u64(h.sequence);
        out.i64(h.capture_ns);
        h.pose.write(&mut out);
        h.color.write(&mut out);
        h.depth.write(&mut out);
        h.color_from_depth.write(&mut out);
        out.f64s(&[h.metres_per_unit]);
        out.u8(h.color_codec.code());
        out.u8(h.depth_codec.code());
        out.zeros_to(228);
        out.u32(color_bytes);
        out.u32(depth_bytes);
        out.f32(h.max_depth_m);
        out.bytes(self.color);
        out.bytes(self.depth);
        Ok(out.0)
    }

    fn check(&self) -> Result<(), WireError> {
        let h = &self.header;
        h.pose.check("frame pose")?;
        h.color.check("frame colour", MAX_SIDE)?;
        h.depth.check("frame depth", MAX_SIDE)?;
        h.color_from_depth.check("frame color_from_depth")?;
        if !(h.metres_per_unit.is_finite() && h.metres_per_unit > 0.0) {
            return Err(WireError::new(
                Code::Intrinsics,
                "frame metres per unit",
                "a finite number above 0",
                h.metres_per_unit,
            ));
        }
        if !(h.max_depth_m.is_finite() && h.max_depth_m >= 0.0) {
            return Err(WireError::new(
                Code::Intrinsics,
                "frame largest depth",
                "a finite number of metres, 0 for no bound",
                h.max_depth_m,
            ));
        }
        h.color_codec.check(Plane::Color)?;
        h.depth_codec.check(Plane::Depth)?;
        h.color_codec
            .check_size(Plane::Color, h.color.n_pixels(), self.color.len())?;
        h.depth_codec
            .check_size(Plane::Depth, h.depth.n_pixels(), self.depth.len())
    }
}
