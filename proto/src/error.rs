//! The one form in which a message is refused.

use std::fmt::Display;

use serde::{Deserialize, Serialize};

/// Error codes, as written on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Code {
    /// The first message is not a hello.
    Hello,
    /// A version this end does not speak.
    Version,
    /// No or wrong token.
    Unauthorized,
    /// This client may not do that.
    Forbidden,
    /// Not JSON, truncated, or a field of the wrong kind.
    Malformed,
    /// A message type or kind that does not exist.
    UnknownType,
    /// Payload sizes do not add up to the message.
    Length,
    /// Larger than the limits given in the welcome.
    TooLarge,
    /// Not a rigid pose.
    Pose,
    /// No camera has these.
    Intrinsics,
    /// Image size, or payload size for that image size.
    Size,
    /// Unknown codec, or one that is not allowed in that place.
    Codec,
    /// Corrupt payload.
    Decode,
    /// Scene document.
    Scene,
    /// Render settings.
    Settings,
    /// Upload.
    Asset,
    /// No such object, or it cannot be put there.
    Object,
    /// No such session, recording or scene.
    NotFound,
    /// Too many sessions, viewers ...
    Limit,
    /// A frame took longer to render than the server allows.
    TooSlow,
    /// The server's own fault.
    Internal,
    /// A code of a newer server.
    #[serde(other)]
    Unknown,
}

impl Code {
    /// As written on the wire.
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

/// Why a message cannot be used: what was wrong, what it should have been, what it was.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what}: expected {expected}, got {got}")]
pub struct WireError {
    /// For programs.
    pub code: Code,
    /// Message and field.
    pub what: String,
    /// What it must be.
    pub expected: String,
    /// What it is.
    pub got: String,
}

impl WireError {
    /// Longest text kept per part, bytes: an error must not echo a hostile message whole.
    const MAX_TEXT: usize = 300;

    /// Parts longer than a few lines are cut.
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
