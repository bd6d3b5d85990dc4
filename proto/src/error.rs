//! The error for every rejected message.

use std::fmt::Display;

use serde::{Deserialize, Serialize};

/// Error codes, as written on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Code {
    /// The first message is not a hello.
    Hello,
    /// An unsupported version.
    Version,
    /// A missing or wrong token.
    Unauthorized,
    /// The client is not allowed to do this.
    Forbidden,
    /// Not JSON, truncated, or a field with a wrong type.
    Malformed,
    /// An unknown message type or kind.
    UnknownType,
    /// Payload sizes do not add up to the message.
    Length,
    /// Larger than the limits in the welcome.
    TooLarge,
    /// Not a rigid pose.
    Pose,
    /// Invalid intrinsics.
    Intrinsics,
    /// Invalid image size, or invalid payload size for the image size.
    Size,
    /// Unknown codec, or one that is not allowed for the plane.
    Codec,
    /// Corrupt payload.
    Decode,
    /// Invalid scene document.
    Scene,
    /// Invalid render settings.
    Settings,
    /// Invalid upload.
    Asset,
    /// Unknown object, or an object that cannot be placed there.
    Object,
    /// Unknown session, recording or scene.
    NotFound,
    /// Too many sessions, viewers ...
    Limit,
    /// A frame took longer to render than the server allows.
    TooSlow,
    /// An error of the server itself.
    Internal,
    /// A code of a newer server.
    #[serde(other)]
    Unknown,
}

impl Code {
    /// Name on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Self::Hello => "hello",
            Self::Version => "version",
            Self::Unauthorized => "unauthorized",
            Self::Forbidden => "forbidden",
            Self::Malformed => "malformed",
            Self::UnknownType => "unknown_type",
            Self::Length => "length",
            Self::TooLarge => "too_large",
            Self::Pose => "pose",
            Self::Intrinsics => "intrinsics",
            Self::Size => "size",
            Self::Codec => "codec",
            Self::Decode => "decode",
            Self::Scene => "scene",
            Self::Settings => "settings",
            Self::Asset => "asset",
            Self::Object => "object",
            Self::NotFound => "not_found",
            Self::Limit => "limit",
            Self::TooSlow => "too_slow",
            Self::Internal => "internal",
            Self::Unknown => "unknown",
        }
    }
}

/// Why a message cannot be used: the field, the expected value and the actual value.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what}: expected {expected}, got {got}")]
pub struct WireError {
    /// Error code, for programs.
    pub code: Code,
    /// Message and field.
    pub what: String,
    /// The expected value.
    pub expected: String,
    /// The actual value.
    pub got: String,
}

impl WireError {
    /// Longest text per part, bytes, so that an error does not echo a whole hostile message.
    const MAX_TEXT: usize = 300;

    /// A new error; long parts are truncated.
    pub fn new(code: Code, what: impl Display, expected: impl Display, got: impl Display) -> Self {
        let cut = |text: String| {
            if text.len() <= Self::MAX_TEXT {
                return text;
            }
            let mut end = Self::MAX_TEXT;
            while !text.is_char_boundary(end) {
                end -= 1;
            }
            format!("{}...", &text[..end])
        };
        Self {
            code,
            what: cut(what.to_string()),
            expected: cut(expected.to_string()),
            got: cut(got.to_string()),
        }
    }
}
