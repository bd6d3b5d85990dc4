//! Configuration of a sender: what to send, and to which server.

use std::path::PathBuf;
use std::time::Duration;

use ghostlight_proto::control::Control;

use crate::recording::OpenOptions;
use crate::render::RenderSettings;

/// How fast frames are sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum)]
pub enum Rate {
    /// At the recording's rate, whether or not the server keeps up.
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
    /// How the recording is read.
    pub open: OpenOptions,
    /// `ws://host:port/ws`, or `wss://`.
    pub url: String,
    /// Certificate authority of a `wss://` server; the system's if not given.
    pub ca: Option<PathBuf>,
    /// How fast frames are sent.
    pub rate: Rate,
    /// The server's token.
    pub token: Option<String>,
    /// Who may change what is shown.
    pub control: ControlFlag,
    /// Scene document to upload with its meshes, or a mesh.
    pub scene: Option<PathBuf>,
    /// Name of one of the server's scenes.
    pub server_scene: Option<String>,
    /// Render settings; the server's own if not given.
    pub settings: Option<RenderSettings>,
    /// Stop after this time, repeating the recording as needed. If not given, the recording is sent once.
    pub duration: Option<Duration>,
    /// JPEG quality of the colour sent, 1..=100.
    pub quality: u8,
    /// Reconnection attempts after a lost connection; a composite resets the count.
    pub retries: u32,
}

impl SendConfig {
    /// Default number of reconnection attempts, eight seconds in total.
    pub const RETRIES: u32 = 5;

    /// Sends a recording once, at its own rate, without a scene.
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
