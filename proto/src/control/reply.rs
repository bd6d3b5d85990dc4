//! What servers send (README, section 3).

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Bye, Role, body_as, envelope};
use crate::{Code, Pose, WireError};

/// What a server allows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// One message.
    pub message_bytes: u64,
    /// Image side, pixels.
    pub side_px: u32,
    /// Image size, pixels.
    pub pixels: u64,
    /// Scene document.
    pub scene_bytes: u64,
    /// One upload.
    pub asset_bytes: u64,
    /// All uploads of a session.
    pub assets_bytes: u64,
    /// Composites under way to a client.
    pub credits: u32,
}

/// Answer to a hello.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Welcome {
    /// Version of the format.
    pub version: u64,
    /// What the server knows of this version; see [`crate::REVISION`].
    #[serde(default = "first_revision")]
    pub revision: u32,
    /// Name and version of the server.
    pub server: String,
    /// The session this client is in.
    pub session: String,
    /// As asked for.
    pub role: Role,
    /// Whether this client may change the session.
    pub control: bool,
    /// Credits it starts with.
    pub credits: u32,
    /// Server's clock, microseconds.
    pub clock_us: u64,
    /// Names for the stage table of composites.
    pub stages: Vec<String>,
    /// What the server allows.
    pub limits: Limits,
}

fn first_revision() -> u32 {
    1
}

/// Where a session's frames come from.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", content = "name", rename_all = "snake_case")]
pub enum Source {
    /// A recording of the server's.
    Recording(String),
    /// A producer.
    Live(String),
}

/// Where an object is, in world coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stands {
    /// World from object, without its scale.
    #[serde(flatten)]
    pub pose: Pose,
    /// What `turn` has added up to, radians; the pose has it already.
    #[serde(default)]
    pub turned: f64,
}

/// An object of the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObjectInfo {
    /// Its name in the scene document.
    pub name: String,
    /// Where it is; not known before a scene's first frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stands: Option<Stands>,
}

/// What a session shows now.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Which session.
    pub session: String,
    /// Where its frames come from.
    pub source: Source,
    /// Name of its scene, if it has one.
    pub scene: Option<String>,
    /// What can be placed and turned.
    pub objects: Vec<ObjectInfo>,
    /// Complete render settings.
    pub settings: Value,
}

/// A request that was carried out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Done {
    /// The request's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<u64>,
    /// The request's type.
    pub request: String,
    /// What came otherwise than asked, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// A message that could not be used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErrorReport {
    /// The request's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<u64>,
    /// The frame's, if it is about one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequence: Option<u64>,
    /// For programs.
    pub code: Code,
    /// Message and field.
    pub what: String,
    /// What it must be.
    pub expected: String,
    /// What it was.
    pub got: String,
    /// Whether the connection ends.
    pub fatal: bool,
}

impl ErrorReport {
    /// About a message; see the fields.
    pub fn new(error: WireError, id: Option<u64>, sequence: Option<u64>, fatal: bool) -> Self {
        Self {
            id,
            sequence,
            code: error.code,
            what: error.what,
            expected: error.expected,
            got: error.got,
            fatal,
        }
    }
}

/// Counts, once a second.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Stats {
    /// Frames of the session that arrived.
    pub frames_received: u64,
    /// Of these, rendered.
    pub frames_rendered: u64,
    /// Of these, replaced by newer ones.
    pub frames_dropped: u64,
    /// Of these, in error.
    pub frames_refused: u64,
    /// Composites sent to this client.
    pub composites_sent: u64,
    /// Composites it was not sent.
    pub composites_dropped: u64,
    /// Clients that receive this session.
    pub viewers: u64,
    /// Between two frames of the source, microseconds, where it has a rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_period_us: Option<u64>,
    /// Render settings that the last frame was made with less of than asked for, to keep a time
    /// limit: `edge_samples 4 -> 2`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lowered: Vec<String>,
}

/// Answer to a ping.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pong {
    /// As in the ping.
    pub t: f64,
    /// Server's clock, microseconds.
    pub clock_us: u64,
}

/// What servers send.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Reply {
    /// Answer to a hello.
    Welcome(Welcome),
    /// What is shown now.
    State(State),
    /// Request carried out.
    Done(Done),
    /// Message refused.
    Error(ErrorReport),
    /// Counts.
    Stats(Stats),
    /// Answer to a ping.
    Pong(Pong),
    /// A close follows.
    Bye(Bye),
}

impl Reply {
    /// Reads a text message.
    pub fn parse(text: &str) -> Result<Self, WireError> {
        let (_, kind, body) = envelope(text)?;
        match kind.as_str() {
            "welcome" => body_as(body, "welcome").map(Self::Welcome),
            "state" => body_as(body, "state").map(Self::State),
            "done" => body_as(body, "done").map(Self::Done),
            "error" => body_as(body, "error").map(Self::Error),
            "stats" => body_as(body, "stats").map(Self::Stats),
            "pong" => body_as(body, "pong").map(Self::Pong),
            "bye" => body_as(body, "bye").map(Self::Bye),
            other => Err(WireError::new(
                Code::UnknownType,
                "control message, type",
                "welcome, state, done, error, stats, pong or bye",
                format_args!("{other:?}"),
            )),
        }
    }

    /// The text message.
    pub fn to_text(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }
}
