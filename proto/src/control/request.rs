//! Messages of clients (README, section 2).

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{Stands, body_as, envelope};
use crate::{Code, Codec, Plane, WireError};

/// Role of a client.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Sends its own frames.
    Producer,
    /// Watches a session or a recording.
    Viewer,
}

/// Who may change a producer's session.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Control {
    /// Only the producer.
    #[default]
    Owner,
    /// The producer and its viewers.
    Anyone,
}

/// The planes of a composite that a client requests, with their codecs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct CompositeRequest {
    /// Codec of the image.
    pub image: Codec,
    /// JPEG quality of image and camera, 1..=100.
    pub quality: u8,
    /// Codec of the camera's picture.
    pub camera: Codec,
    /// Codec of the mask: share of each pixel that is virtual.
    pub mask: Codec,
    /// Codec of the depth.
    pub depth: Codec,
}

impl Default for CompositeRequest {
    fn default() -> Self {
        Self {
            image: Codec::Jpeg,
            quality: 85,
            camera: Codec::None,
            mask: Codec::None,
            depth: Codec::None,
        }
    }
}

impl CompositeRequest {
    /// Checks that each codec is allowed for its plane, and the range of the quality.
    fn check(&self, what: &str) -> Result<(), WireError> {
        self.image.check(Plane::Image)?;
        self.camera.check(Plane::Camera)?;
        self.mask.check(Plane::Mask)?;
        self.depth.check(Plane::CompositeDepth)?;
        if (1..=100).contains(&self.quality) {
            return Ok(());
        }
        Err(WireError::new(
            Code::Malformed,
            format_args!("{what}quality"),
            "1 to 100",
            self.quality,
        ))
    }
}

/// The first message of every client.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Hello {
    /// Version of the format.
    pub version: u64,
    /// Role of the client.
    pub role: Role,
    /// The server's token, if required.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
    /// Name, for people.
    #[serde(default)]
    pub name: String,
    /// Viewer: name of the session to watch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Viewer without a session: name of the recording to play.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<String>,
    /// Name of one of the server's scenes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Producer: who may change the session.
    #[serde(default)]
    pub control: Control,
    /// Largest number of composites in flight.
    #[serde(default = "default_credits")]
    pub credits: u32,
    /// Requested planes; `None`: no composites.
    #[serde(default = "default_composite")]
    pub composite: Option<CompositeRequest>,
}

impl Hello {
    /// Longest `name`, characters.
    pub const MAX_NAME: usize = 64;

    /// A hello with default values.
    pub fn new(role: Role) -> Self {
        Self {
            version: u64::from(crate::VERSION),
            role,
            token: None,
            name: String::new(),
            session: None,
            recording: None,
            scene: None,
            control: Control::default(),
            credits: default_credits(),
            composite: default_composite(),
        }
    }

    fn check(&self) -> Result<(), WireError> {
        if self.version != u64::from(crate::VERSION) {
            return Err(WireError::new(
                Code::Version,
                "hello, version",
                crate::VERSION,
                self.version,
            ));
        }
        if self.name.chars().count() > Self::MAX_NAME {
            return Err(WireError::new(
                Code::Malformed,
                "hello, name",
                format_args!("at most {} characters", Self::MAX_NAME),
                self.name.chars().count(),
            ));
        }
        if self.credits == 0 {
            return Err(WireError::new(
                Code::Malformed,
                "hello, credits",
                "at least 1",
                0,
            ));
        }
        self.composite
            .map_or(Ok(()), |c| c.check("hello, composite."))
    }
}

fn default_credits() -> u32 {
    2
}

// serde requires this signature: the result is an Option because `null` is a value of its own.
#[allow(
    clippy::unnecessary_wraps,
    reason = "serde's default for an Option field whose absence differs from null"
)]
fn default_composite() -> Option<CompositeRequest> {
    Some(CompositeRequest::default())
}

/// Changes the planes sent to this client; missing fields are unchanged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Planes {
    /// Codec of the image.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image: Option<Codec>,
    /// JPEG quality of image and camera, 1..=100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<u8>,
    /// Codec of the camera's picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Codec>,
    /// Codec of the mask: share of each pixel that is virtual.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<Codec>,
    /// Codec of the depth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<Codec>,
}

impl Planes {
    /// The planes of `before` with these changes.
    pub fn applied_to(self, before: CompositeRequest) -> CompositeRequest {
        CompositeRequest {
            image: self.image.unwrap_or(before.image),
            quality: self.quality.unwrap_or(before.quality),
            camera: self.camera.unwrap_or(before.camera),
            mask: self.mask.unwrap_or(before.mask),
            depth: self.depth.unwrap_or(before.depth),
        }
    }
}

/// A scene: its document, or the name of one of the server's scenes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum SceneChoice {
    /// By name.
    Name(String),
    /// The document.
    Document(Map<String, Value>),
}

/// Changes the session's scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SetScene {
    /// The new scene.
    pub scene: SceneChoice,
}

/// Changes the session's render settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SetSettings {
    /// Render settings; missing fields have their defaults.
    pub settings: Map<String, Value>,
}

/// Announces an upload.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Asset {
    /// Number of the upload, chosen by the client.
    pub upload: u32,
    /// Name that scenes use for it.
    pub name: String,
    /// Size, bytes.
    pub bytes: u64,
}

/// Selects another recording or scene of the server.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Play {
    /// Name of the recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<String>,
    /// Name of the scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
}

/// Moves an object: exactly one of `pixel` and `stands` is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// The object's name.
    pub object: String,
    /// Position on the real surface: the pixel (u, v) of the newest frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel: Option<[f64; 2]>,
    /// A pose from an earlier `state`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stands: Option<Stands>,
}

impl Place {
    fn check(&self) -> Result<(), WireError> {
        if self.pixel.is_some() == self.stands.is_some() {
            let got = if self.pixel.is_some() { "both" } else { "none" };
            return Err(WireError::new(
                Code::Malformed,
                "place",
                "one of pixel and stands",
                got,
            ));
        }
        self.stands
            .map_or(Ok(()), |s| s.pose.check("place, stands"))
    }
}

/// Turns an object about its upright axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Turn {
    /// The object's name.
    pub object: String,
    /// Radians, counter-clockwise seen from above.
    pub angle: f64,
}

/// Returns credits for drawn composites.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Credit {
    /// Number of composites.
    #[serde(default = "one")]
    pub n: u32,
    /// Time from reception by the server to drawing, by the client's estimate of the server's clock, microseconds;
    /// for the newest composite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latency_us: Option<u32>,
    /// Time from arrival to drawing, microseconds; for the newest composite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub draw_us: Option<u32>,
}

impl Default for Credit {
    fn default() -> Self {
        Self {
            n: one(),
            latency_us: None,
            draw_us: None,
        }
    }
}

fn one() -> u32 {
    1
}

/// Asks for the server's clock.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Ping {
    /// Returned unchanged.
    pub t: f64,
}

/// Announces the end, with a reason.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Bye {
    /// Reason, for people.
    #[serde(default)]
    pub reason: String,
}

/// A message of a client.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Request {
    /// The first message.
    Hello(Hello),
    /// Changes the scene.
    Scene(SetScene),
    /// Changes the settings.
    Settings(SetSettings),
    /// Announces an upload.
    Asset(Asset),
    /// Selects another recording or scene.
    Play(Play),
    /// Changes the planes.
    Planes(Planes),
    /// Moves an object.
    Place(Place),
    /// Turns an object.
    Turn(Turn),
    /// Composites were drawn.
    Credit(Credit),
    /// Asks for the server's clock.
    Ping(Ping),
    /// Announces the end.
    Bye(Bye),
}

impl Request {
    /// The message's `type`.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Hello(_) => "hello",
            Self::Scene(_) => "scene",
            Self::Settings(_) => "settings",
            Self::Asset(_) => "asset",
            Self::Play(_) => "play",
            Self::Planes(_) => "planes",
            Self::Place(_) => "place",
            Self::Turn(_) => "turn",
            Self::Credit(_) => "credit",
            Self::Ping(_) => "ping",
            Self::Bye(_) => "bye",
        }
    }

    /// Parses a text message. The id is returned even if the rest is invalid, so that the error can contain it.
    pub fn parse(text: &str) -> (Option<u64>, Result<Self, WireError>) {
        let (id, kind, body) = match envelope(text) {
            Ok(parts) => parts,
            Err(e) => return (None, Err(e)),
        };
        let request = match kind.as_str() {
            "hello" => {
                body_as(body, "hello").and_then(|h: Hello| h.check().map(|()| Self::Hello(h)))
            }
            "scene" => body_as(body, "scene").map(Self::Scene),
            "settings" => body_as(body, "settings").map(Self::Settings),
            "asset" => body_as(body, "asset").map(Self::Asset),
            "play" => body_as(body, "play").map(Self::Play),
            "planes" => body_as(body, "planes").and_then(|p: Planes| {
                p.applied_to(CompositeRequest::default())
                    .check("planes, ")
                    .map(|()| Self::Planes(p))
            }),
            "place" => {
                body_as(body, "place").and_then(|p: Place| p.check().map(|()| Self::Place(p)))
            }
            "turn" => body_as(body, "turn").map(Self::Turn),
            "credit" => body_as(body, "credit").map(Self::Credit),
            "ping" => body_as(body, "ping").map(Self::Ping),
            "bye" => body_as(body, "bye").map(Self::Bye),
            other => Err(WireError::new(
                Code::UnknownType,
                "control message, type",
                "hello, scene, settings, asset, play, planes, place, turn, credit, ping or bye",
                format_args!("{other:?}"),
            )),
        };
        (id, request)
    }

    /// Formats the text message, with an optional id.
    pub fn to_text(&self, id: Option<u64>) -> String {
        let mut value = serde_json::to_value(self).unwrap_or_default();
        if let (Some(id), Some(object)) = (id, value.as_object_mut()) {
            object.insert("id".to_owned(), id.into());
        }
        value.to_string()
    }
}
