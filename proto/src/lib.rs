//! Ghostlight's wire format: encodes and decodes messages, without any I/O.
//!
//! `README.md` beside this crate is normative; this is an implementation of it. Input is not trusted: every decoder
//! returns a message or a [`WireError`], allocates no more than the caller's sizes allow, and never panics. Images
//! stay encoded; the depth codecs defined by the format itself (RVL, delta + zstd) are in [`depth`].

pub mod control;
pub mod depth;

mod asset;
mod bytes;
mod codec;
mod composite;
mod error;
mod frame;
mod geometry;

pub use asset::{ASSET_HEADER_BYTES, AssetChunk};
pub use codec::{Codec, Plane};
pub use composite::{
    COMPOSITE_HEADER_BYTES, Composite, CompositeHeader, MAX_STAGES, Payloads, Stamps,
};
pub use error::{Code, WireError};
pub use frame::{FRAME_HEADER_BYTES, Frame, FrameHeader};
pub use geometry::{Intrinsics, Pose};

/// WebSocket subprotocol that both peers must name.
pub const SUBPROTOCOL: &str = "ghostlight.v1";

/// Version in every header and in `hello`.
pub const VERSION: u8 = 1;

/// Number of backwards-compatible additions to this version, counted from 1 (README, section 9).
pub const REVISION: u32 = 3;

/// First two bytes of every binary message.
pub const MAGIC: [u8; 2] = *b"GL";

/// Largest image side of the format, pixels; a server may allow less.
pub const MAX_SIDE: u32 = 8192;

/// Kind of a binary message, its fourth byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// RGB-D frame, client to server.
    Frame,
    /// Composite, server to client.
    Composite,
    /// Part of an uploaded file, client to server.
    AssetChunk,
}

impl Kind {
    /// Code on the wire.
    pub fn code(self) -> u8 {
        match self {
            Self::Frame => 1,
            Self::Composite => 2,
            Self::AssetChunk => 3,
        }
    }

    /// The kind of a binary message; checks magic and version.
    pub fn of(message: &[u8]) -> Result<Self, WireError> {
        let &[m0, m1, version, kind, ..] = message else {
            return Err(WireError::new(
                Code::Malformed,
                "binary message",
                "a header of at least 8 bytes",
                format!("{} bytes", message.len()),
            ));
        };
        if [m0, m1] != MAGIC {
            return Err(WireError::new(
                Code::Malformed,
                "binary message, offset 0",
                "47 4C",
                format!("{m0:02X} {m1:02X}"),
            ));
        }
        if version != VERSION {
            return Err(WireError::new(
                Code::Version,
                "binary message, version",
                VERSION,
                version,
            ));
        }
        match kind {
            1 => Ok(Self::Frame),
            2 => Ok(Self::Composite),
            3 => Ok(Self::AssetChunk),
            _ => Err(WireError::new(
                Code::UnknownType,
                "binary message, kind",
                "1 (frame), 2 (composite) or 3 (asset chunk)",
                kind,
            )),
        }
    }
}
