//! Little-endian fields at fixed offsets.

use crate::{Code, Kind, MAGIC, VERSION, WireError};

/// A message whose fixed header is known to be complete: reads at constant offsets inside it cannot fail.
pub(crate) struct Header<'a> {
    bytes: &'a [u8],
    /// Length of the header, where the payloads start.
    pub(crate) header_bytes: usize,
}

impl<'a> Header<'a> {
    /// Checks the kind, and that the message contains `fixed` header bytes and the announced header.
    pub(crate) fn new(message: &'a [u8], kind: Kind, fixed: usize) -> Result<Self, WireError> {
        let what = name(kind);
        let got = Kind::of(message)?;
        if got != kind {
            return Err(WireError::new(
                Code::UnknownType,
                format_args!("{what}, kind"),
                kind.code(),
                got.code(),
            ));
        }
        if message.len() < fixed {
            return Err(WireError::new(
                Code::Malformed,
                format_args!("{what} header"),
                format_args!("at least {fixed} bytes"),
                format_args!("{} bytes", message.len()),
            ));
        }
        let mut header = Self {
            bytes: message,
            header_bytes: 0,
        };
        header.header_bytes = header.u32(4) as usize;
        if header.header_bytes < fixed || header.header_bytes > message.len() {
            return Err(WireError::new(
                Code::Malformed,
                format_args!("{what}, header bytes"),
                format_args!("{fixed} to {} (the message)", message.len()),
                header.header_bytes,
            ));
        }
        Ok(header)
    }

    /// Splits the bytes after the header into payloads of the announced sizes, which must use all of them.
    pub(crate) fn payloads<const N: usize>(
        &self,
        kind: Kind,
        names: [&str; N],
        sizes: [u32; N],
    ) -> Result<[&'a [u8]; N], WireError> {
        let mut rest = &self.bytes[self.header_bytes..];
        let announced: u64 = sizes.iter().map(|&n| u64::from(n)).sum();
        if announced != rest.len() as u64 {
            return Err(WireError::new(
                Code::Length,
                format_args!("{}, {} bytes", name(kind), names.join(" + ")),
                format_args!("{} (what follows the header)", rest.len()),
                announced,
            ));
        }
        Ok(sizes.map(|n| {
            // The sum is exact, so no part is too short.
            let (part, after) = rest.split_at((n as usize).min(rest.len()));
            rest = after;
            part
        }))
    }

    fn array<const N: usize>(&self, offset: usize) -> [u8; N] {
        let mut out = [0; N];
        out.copy_from_slice(&self.bytes[offset..offset + N]);
        out
    }

    pub(crate) fn u8(&self, offset: usize) -> u8 {
        self.bytes[offset]
    }
    pub(crate) fn u32(&self, offset: usize) -> u32 {
        u32::from_le_bytes(self.array(offset))
    }
    pub(crate) fn u64(&self, offset: usize) -> u64 {
        u64::from_le_bytes(self.array(offset))
    }
    pub(crate) fn i64(&self, offset: usize) -> i64 {
        i64::from_le_bytes(self.array(offset))
    }
    pub(crate) fn f32(&self, offset: usize) -> f32 {
        f32::from_le_bytes(self.array(offset))
    }
    pub(crate) fn f64(&self, offset: usize) -> f64 {
        f64::from_le_bytes(self.array(offset))
    }
    pub(crate) fn f64s<const N: usize>(&self, offset: usize) -> [f64; N] {
        std::array::from_fn(|i| self.f64(offset + 8 * i))
    }
}

/// Name of a kind, for error messages.
pub(crate) fn name(kind: Kind) -> &'static str {
    match kind {
        Kind::Frame => "frame",
        Kind::Composite => "composite",
        Kind::AssetChunk => "asset chunk",
    }
}

/// Appends fields in the order of their offsets.
pub(crate) struct Writer(pub(crate) Vec<u8>);

impl Writer {
    /// A writer with capacity for the whole message and the first 8 bytes written.
    pub(crate) fn new(kind: Kind, header_bytes: usize, payload_bytes: usize) -> Self {
        let mut bytes = Vec::with_capacity(header_bytes + payload_bytes);
        bytes.extend_from_slice(&MAGIC);
        bytes.extend_from_slice(&[VERSION, kind.code()]);
        bytes.extend_from_slice(&(header_bytes as u32).to_le_bytes());
        Self(bytes)
    }
    pub(crate) fn u8(&mut self, v: u8) {
        self.0.push(v);
    }
    pub(crate) fn u32(&mut self, v: u32) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    pub(crate) fn u64(&mut self, v: u64) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    pub(crate) fn i64(&mut self, v: i64) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    pub(crate) fn f32(&mut self, v: f32) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    pub(crate) fn f64s(&mut self, v: &[f64]) {
        for x in v {
            self.0.extend_from_slice(&x.to_le_bytes());
        }
    }
    pub(crate) fn zeros_to(&mut self, offset: usize) {
        self.0.resize(offset, 0);
    }
    pub(crate) fn bytes(&mut self, v: &[u8]) {
        self.0.extend_from_slice(v);
    }
}

/// The size of a payload as a header field.
pub(crate) fn size(kind: Kind, what: &str, payload: &[u8]) -> Result<u32, WireError> {
    u32::try_from(payload.len()).map_err(|_| {
        WireError::new(
            Code::TooLarge,
            format_args!("{}, {what} payload", name(kind)),
            "at most 4 GiB",
            payload.len(),
        )
    })
}
