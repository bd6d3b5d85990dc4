//! A chunk of an uploaded file (README, section 5).

use crate::bytes::{Header, Writer};
use crate::{Code, Kind, WireError};

/// Bytes of the asset chunk header of this version.
pub const ASSET_HEADER_BYTES: usize = 24;

/// A chunk of an uploaded file, borrowed from the message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AssetChunk<'a> {
    /// Number of the upload, as announced.
    pub upload: u32,
    /// Offset of the bytes in the file.
    pub offset: u64,
    /// At least one byte.
    pub bytes: &'a [u8],
}

impl<'a> AssetChunk<'a> {
    /// Decodes and checks a message.
    pub fn decode(message: &'a [u8]) -> Result<Self, WireError> {
        let h = Header::new(message, Kind::AssetChunk, ASSET_HEADER_BYTES)?;
        let chunk = Self {
            upload: h.u32(8),
            offset: h.u64(16),
            bytes: &message[h.header_bytes..],
        };
        chunk.check()?;
        Ok(chunk)
    }

    /// Encodes the message.
    pub fn encode(&self) -> Result<Vec<u8>, WireError> {
        self.check()?;
        let mut out = Writer::new(Kind::AssetChunk, ASSET_HEADER_BYTES, self.bytes.len());
        out.u32(self.upload);
        out.u32(0);
        out.u64(self.offset);
        out.bytes(self.bytes);
        Ok(out.0)
    }

    fn check(&self) -> Result<(), WireError> {
        if !self.bytes.is_empty() {
            return Ok(());
        }
        Err(WireError::new(
            Code::Length,
            "asset chunk",
            "at least 1 byte",
            "0 bytes",
        ))
    }
}
