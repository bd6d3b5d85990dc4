//! What clients send (README, section 2).

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{Stands, body_as, envelope};
use crate::{Code, Codec, Plane, WireError};

/// What a client is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Role {
    /// Sends frames of its own.
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
    /// Its viewers as well.
    Anyone,
}

/// Which planes of a composite a client wants, and how coded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct CompositeRequest {
    /// The picture.
    pub image: Codec,
    /// JPEG quality of image and camera, 1..=100.
    pub quality: u8,
    /// The camera's own picture.
    pub camera: Codec,
    /// Share of each pixel that is virtual.
    pub mask: Codec,
    /// Depth of the composite.
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
    /// Each codec must be allowed for its plane, and the quality be one.
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
    /// What the client is.
    pub role: Role,
    /// The server's token, if it wants one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub token: Option<String>,
    /// For people.
    #[serde(default)]
    pub name: String,
    /// Viewer: session to watch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub session: Option<String>,
    /// Viewer without session: recording to have played.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<String>,
    /// One of the server's scenes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
    /// Producer: who may change the session.
    #[serde(default)]
    pub control: Control,
    /// Composites that may be under way.
    #[serde(default = "default_credits")]
    pub credits: u32,
    /// What composites hold; `None`: send none.
    #[serde(default = "default_composite")]
    pub composite: Option<CompositeRequest>,
}

impl Hello {
    /// Longest `name`, characters.
    pub const MAX_NAME: usize = 64;

    /// A hello with everything at its default.
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

// The signature is serde's: an Option because `null` is a value of its own here.
#[allow(
    clippy::unnecessary_wraps,
    reason = "serde's default for an Option field whose absence differs from null"
)]
fn default_composite() -> Option<CompositeRequest> {
    Some(CompositeRequest::default())
}

/// A change of which planes this client is sent; what is left out stays as it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Planes {
    /// The picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub image: Option<Codec>,
    /// JPEG quality of image and camera, 1..=100.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quality: Option<u8>,
    /// The camera's own picture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub camera: Option<Codec>,
    /// Share of each pixel that is virtual.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mask: Option<Codec>,
    /// Depth of the composite.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub depth: Option<Codec>,
}

impl Planes {
    /// What was asked for before, changed.
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

/// A scene: its document, or the name of one the server has.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum SceneChoice {
    /// By name.
    Name(String),
    /// The document.
    Document(Map<String, Value>),
}

/// A change of the session's scene.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SetScene {
    /// The new scene.
    pub scene: SceneChoice,
}

/// A change of the session's render settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SetSettings {
    /// Render settings; what is left out takes its default.
    pub settings: Map<String, Value>,
}

/// Announces an upload.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Asset {
    /// The client's number for it.
    pub upload: u32,
    /// As scenes will refer to it.
    pub name: String,
    /// Its size.
    pub bytes: u64,
}

/// Another recording or scene of the server's.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Play {
    /// Recording.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<String>,
    /// Scene.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scene: Option<String>,
}

/// Moves an object: exactly one of `pixel` and `stands` is given.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Place {
    /// The object's name.
    pub object: String,
    /// Onto the real surface seen at u, v of the newest frame.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pixel: Option<[f64; 2]>,
    /// Where an earlier `state` had it.
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

/// Turns an object about the axis it stands on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Turn {
    /// The object's name.
    pub object: String,
    /// Radians, counter-clockwise seen from above.
    pub angle: f64,
}

/// Composites drawn.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Credit {
    /// How many.
    #[serde(default = "one")]
    pub n: u32,
    /// From received by the server to drawn, by the client's estimate of the server's clock,
    /// microseconds; of the newest one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub latency_us: Option<u32>,
    /// From arrived to drawn, microseconds; of the newest one.
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
    /// Comes back as it is.
    pub t: f64,
}

/// The end, with a reason.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Bye {
    /// For people.
    #[serde(default)]
    pub reason: String,
}

/// What clients send.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum Request {
    /// First message.
    Hello(Hello),
    /// New scene.
    Scene(SetScene),
    /// New settings.
    Settings(SetSettings),
    /// Upload announced.
    Asset(Asset),
    /// Other recording or scene.
    Play(Play),
    /// Other planes.
    Planes(Planes),
    /// Object moved.
    Place(Place),
    /// Object turned.
    Turn(Turn),
    /// Composites drawn.
    Credit(Credit),
    /// Clock.
    Ping(Ping),
    /// End.
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

    /// Reads a text message. The id comes back even if the rest is wrong, so that the error
    /// can carry it.
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

    /// The text message, without or with an id.
    pub fn to_text(&self, id: Option<u64>) -> String {
        let mut value = serde_json::to_value(self).unwrap_or_default();
        if let (Some(id), Some(object)) = (id, value.as_object_mut()) {
            object.insert("id".to_owned(), id.into());
        }
        value.to_string()
    }
}
