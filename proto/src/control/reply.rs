//! Messages of servers (README, section 3).

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Bye, Role, body_as, envelope};
use crate::{Code, Pose, WireError};

/// Limits of a server.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Limits {
    /// Size of a message, bytes.
    pub message_bytes: u64,
    /// Image side, pixels.
    pub side_px: u32,
    /// Number of pixels of an image.
    pub pixels: u64,
    /// Size of a scene document, bytes.
    pub scene_bytes: u64,
    /// Size of an upload, bytes.
    pub asset_bytes: u64,
    /// Size of all uploads of a session, bytes.
    pub assets_bytes: u64,
    /// Most credits of a client.
    pub credits: u32,
}

/// Answer to a hello.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Welcome {
    /// Version of the format.
    pub version: u64,
    /// Revision of this version that the server supports; see [`crate::REVISION`].
    #[serde(default = "first_revision")]
    pub revision: u32,
    /// Name and version of the server.
    pub server: String,
    /// Name of the client's session.
    pub session: String,
    /// The requested role.
    pub role: Role,
    /// Whether this client may change the session.
    pub control: bool,
    /// Initial number of credits.
    pub credits: u32,
    /// The server's clock, microseconds.
    pub clock_us: u64,
    /// Names of the render stages in composites.
    pub stages: Vec<String>,
    /// Limits of the server.
    pub limits: Limits,
}

fn first_revision() -> u32 {
    1
}

/// Source of a session's frames.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", content = "name", rename_all = "snake_case")]
pub enum Source {
    /// A recording of the server.
    Recording(String),
    /// A producer.
    Live(String),
}

/// Pose of an object in world space.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stands {
    /// World from object, without the object's scale.
    #[serde(flatten)]
    pub pose: Pose,
    /// Sum of all `turn` angles, radians; already included in the pose.
    #[serde(default)]
    pub turned: f64,
}

/// An object of the scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ObjectInfo {
    /// Name in the scene document.
    pub name: String,
    /// Its pose; unknown before a scene's first frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stands: Option<Stands>,
}

/// Current state of a session.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// Name of the session.
    pub session: String,
    /// Source of its frames.
    pub source: Source,
    /// Name of its scene, if any.
    pub scene: Option<String>,
    /// Objects that can be placed and turned.
    pub objects: Vec<ObjectInfo>,
    /// Complete render settings.
    pub settings: Value,
}

/// A request was carried out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Done {
    /// Id of the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<u64>,
    /// Type of the request.
    pub request: String,
    /// A difference from the request, for people.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

/// A message was rejected.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct ErrorReport {
    /// Id of the request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub id: Option<u64>,
    /// Sequence number of the frame, if the error is about one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sequence: Option<u64>,
    /// Error code, for programs.
    pub code: Code,
    /// Message and field.
    pub what: String,
    /// The expected value.
    pub expected: String,
    /// The actual value.
    pub got: String,
    /// Whether the connection is closed.
    pub fatal: bool,
}

impl ErrorReport {
    /// From an error and the numbers of its message.
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

/// Counts, sent once a second.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Stats {
    /// Frames of the session that were received.
    pub frames_received: u64,
    /// Received frames that were rendered.
    pub frames_rendered: u64,
    /// Received frames that were replaced by newer ones.
    pub frames_dropped: u64,
    /// Received frames that were answered with an error.
    pub frames_refused: u64,
    /// Composites sent to this client.
    pub composites_sent: u64,
    /// Composites not sent to this client.
    pub composites_dropped: u64,
    /// Number of clients that receive this session.
    pub viewers: u64,
    /// Period of the source's frames, microseconds, if it has a rate.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source_period_us: Option<u64>,
    /// Render settings that were reduced for the last frame to keep a time limit: `edge_samples 4 -> 2`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lowered: Vec<String>,
}

/// Answer to a ping.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Pong {
    /// The value of the ping.
    pub t: f64,
    /// The server's clock, microseconds.
    pub clock_us: u64,
}

/// A message of a server.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Reply {
    /// Answer to a hello.
    Welcome(Welcome),
    /// The current state.
    State(State),
    /// A request was carried out.
    Done(Done),
    /// A message was rejected.
    Error(ErrorReport),
    /// Counts.
    Stats(Stats),
    /// Answer to a ping.
    Pong(Pong),
    /// The connection will be closed.
    Bye(Bye),
}

impl Reply {
    /// Parses a text message.
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

    /// Formats the text message.
    pub fn to_text(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }
}
