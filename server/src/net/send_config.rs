//! What a sender is asked to send, and where.

use std::path::PathBuf;
use std::time::Duration;

use ghostlight_proto::control::Control;

use crate::recording::OpenOptions;
use crate::render::RenderSettings;

/// How fast frames are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Rate {
    /// At the recording's rate, whether the server keeps up or not.
    #[default]
    Realtime,
    /// As soon as the server has answered an earlier frame.
    Max,
}

/// Who may change what is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum ControlFlag {
    /// The sender alone.
    #[default]
    Owner,
    /// Its viewers too.
    Anyone,
}

impl From<ControlFlag> for Control {
    fn from(flag: ControlFlag) -> Self {
        match flag {
            ControlFlag::Owner => Self::Owner,
            ControlFlag::Anyone => Self::Anyone,
        }
    }
}

/// What to send, and where.
#[derive(Debug, Clone)]
pub struct SendConfig {
    /// Recording, of any layout that can be read.
    pub recording: PathBuf,
    /// How to read it.
    pub open: OpenOptions,
    /// `ws://host:port/ws`, or `wss://`.
    pub url: String,
    /// Certificate that signs a `wss://` server's; the system's if not given.
    pub ca: Option<PathBuf>,
    /// How fast.
    pub rate: Rate,
    /// The server's token.
    pub token: Option<String>,
    /// Who may change what is shown.
    pub control: ControlFlag,
    /// Scene document to upload with its meshes, or a mesh.
    pub scene: Option<PathBuf>,
    /// Name of a scene of the server's.
    pub server_scene: Option<String>,
    /// Render settings; the server's own if not given.
    pub settings: Option<RenderSettings>,
    /// Stop after this time; until then the recording is repeated. Once over if not given.
    pub duration: Option<Duration>,
    /// JPEG quality of the colour sent, 1..=100.
    pub quality: u8,
    /// Tries to connect again after a connection was lost; composites in between start the
    /// count anew.
    pub retries: u32,
}

impl SendConfig {
    /// Tries to connect again unless told otherwise: eight seconds of them.
    pub const RETRIES: u32 = 5;

    /// A recording once, at its own rate, without a scene.
    pub fn new(recording: PathBuf, url: String) -> Self {
        Self {
            recording,
            open: OpenOptions::default(),
            url,
            ca: None,
            rate: Rate::Realtime,
            token: None,
            control: ControlFlag::Owner,
            scene: None,
            server_scene: None,
            settings: None,
            duration: None,
            quality: 90,
            retries: Self::RETRIES,
        }
    }
}
