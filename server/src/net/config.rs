//! Validated server configuration.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, bail};
use ghostlight_proto::control::Limits;

use super::listen::Listen;
use super::tls::TlsFiles;
use crate::memory;
use crate::recording::OpenOptions;
use crate::render::{Backend, RenderSettings};
use crate::scene::SceneDocument;

/// Limits on clients. Each limits memory or time.
#[derive(Debug, Clone)]
pub struct Bounds {
    /// Most clients, counted after a valid hello.
    pub connections: usize,
    /// Most connections that have not sent a valid hello: in the TLS handshake, in HTTP, or silent. At the limit,
    /// a new connection replaces the oldest.
    pub waiting: usize,
    /// Most such connections from one address (one /64 of IPv6).
    pub waiting_per_address: usize,
    /// Most sessions; each has a render thread and a scene.
    pub sessions: usize,
    /// Most clients that receive the composites of one session.
    pub viewers: usize,
    /// Largest message, bytes. A message of up to twice this size is refused with an error; a larger one ends the
    /// connection.
    pub message_bytes: usize,
    /// Largest side of an image, pixels.
    pub side_px: u32,
    /// Largest image, pixels.
    pub pixels: usize,
    /// Largest text message, scene documents included, bytes.
    pub scene_bytes: usize,
    /// Largest upload, bytes.
    pub asset_bytes: u64,
    /// All uploads of a session together, bytes.
    pub assets_bytes: u64,
    /// Most uploads of a session.
    pub assets: usize,
    /// Memory of a session's scenes and uploads, bytes: textures, triangles, BVHs, maps.
    pub session_bytes: u64,
    /// Memory of all sessions' scenes and uploads, bytes.
    pub scenes_bytes: u64,
    /// Time limit for loading a scene.
    pub load: Duration,
    /// Most triangles stored for a session's scene; bounds the memory of its acceleration structure.
    pub triangles: usize,
    /// Most composites sent to one client and not yet acknowledged.
    pub credits: u32,
    /// Timeout for a client that is silent or does not read.
    pub idle: Duration,
    /// Timeout for the TLS handshake, and for the head of a request.
    pub handshake: Duration,
    /// Timeout for the first message.
    pub hello: Duration,
    /// Largest first message, bytes.
    pub hello_bytes: usize,
    /// Longest life of a connection that is not a WebSocket, such as a download of the page's files.
    pub request: Duration,
    /// Timeout for a message from its first byte to its last.
    pub message: Duration,
    /// Bytes buffered of incomplete messages of all clients together. Half of it is divided evenly among the
    /// clients, so that each has a guaranteed part; larger messages take from the shared other half.
    pub unfinished_bytes: u64,
    /// Time limit for one frame, from decoding to composite. A frame that takes longer is cancelled with an
    /// error, and the last good picture stays.
    pub frame: Duration,
}

impl Default for Bounds {
    fn default() -> Self {
        Self {
            connections: 64,
            waiting: 32,
            waiting_per_address: 16,
            sessions: 8,
            viewers: 16,
            message_bytes: 16 << 20,
            side_px: 4096,
            // The frame of a phone, 1920x1440; more than full HD.
            pixels: 1920 * 1440,
            scene_bytes: 1 << 20,
            asset_bytes: 64 << 20,
            assets_bytes: 128 << 20,
            assets: 256,
            session_bytes: 1 << 30,
            // Half of the machine's memory; the other half is for frames and other programs.
            scenes_bytes: memory::of_the_machine().map_or(4 << 30, |bytes| bytes / 2),
            load: Duration::from_secs(20),
            triangles: 2_000_000,
            credits: 8,
            idle: Duration::from_secs(30),
            handshake: Duration::from_secs(5),
            hello: Duration::from_secs(5),
            hello_bytes: 64 << 10,
            request: Duration::from_secs(30),
            message: Duration::from_secs(20),
            unfinished_bytes: 256 << 20,
            frame: Duration::from_secs(5),
        }
    }
}

impl Bounds {
    /// The limits that the welcome message announces.
    pub fn limits(&self) -> Limits {
        Limits {
            message_bytes: self.message_bytes as u64,
            side_px: self.side_px,
            pixels: self.pixels as u64,
            scene_bytes: self.scene_bytes as u64,
            asset_bytes: self.asset_bytes,
            assets_bytes: self.assets_bytes,
            credits: self.credits,
        }
    }

    /// Size of the largest composite message, bytes: uncompressed picture and camera image, mask and depth.
    pub fn composite_bytes(&self) -> usize {
        self.pixels * (4 + 4 + 1 + 2) + 4096
    }
}

/// Everything `serve` needs.
#[derive(Debug, Clone)]
pub struct ServeConfig {
    /// Where to listen; port 0 takes a free one.
    pub listen: Listen,
    /// Certificate and key, to serve over TLS.
    pub tls: TlsFiles,
    /// Token that clients must present; required when other machines can reach the server.
    pub token: Option<String>,
    /// Origins (`https://host:port`) of pages that may connect, in addition to the server's own; `*` allows all.
    pub origins: Vec<String>,
    /// Recordings, or folders of recordings, to offer.
    pub recordings: Vec<PathBuf>,
    /// How the recordings are read.
    pub open: OpenOptions,
    /// Scene documents, or folders of them, to offer; the first is the default.
    pub scenes: Vec<PathBuf>,
    /// A scene to offer before all others, by name; its paths are absolute.
    pub first_scene: Option<(String, SceneDocument)>,
    /// Render settings that sessions start with.
    pub settings: RenderSettings,
    /// Whether `settings` override those of scene documents.
    pub fixed_settings: bool,
    /// Render threads, shared by all sessions; 0: one per core.
    pub threads: usize,
    /// Rendering backend.
    pub backend: Backend,
    /// Limits on clients.
    pub bounds: Bounds,
}

impl ServeConfig {
    /// A configuration that listens on this machine only and offers nothing yet.
    pub fn local(port: u16) -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], port)).into(),
            tls: TlsFiles::default(),
            token: None,
            origins: Vec::new(),
            recordings: Vec::new(),
            open: OpenOptions::default(),
            scenes: Vec::new(),
            first_scene: None,
            settings: RenderSettings::default(),
            fixed_settings: false,
            threads: 0,
            backend: Backend::Auto,
            bounds: Bounds::default(),
        }
    }

    /// Refuses configurations that are unsafe or cannot work.
    pub fn check(&self) -> Result<()> {
        self.backend.resolve()?;
        if self.token.is_none() && !self.listen.is_loopback() {
            bail!(
                "listen {}: expected a token (--token) for an address other machines can reach, got none",
                self.listen
            );
        }
        if self.token.as_ref().is_some_and(|t| t.trim().is_empty()) {
            bail!("token: expected at least one character, got an empty one");
        }
        let b = &self.bounds;
        let least = [
            ("connections", b.connections),
            ("waiting connections", b.waiting),
            ("waiting connections of an address", b.waiting_per_address),
            ("sessions", b.sessions),
            ("viewers", b.viewers),
            ("pixels", b.pixels),
            ("triangles", b.triangles),
            ("uploads", b.assets),
            ("credits", b.credits as usize),
            ("image side", b.side_px as usize),
        ];
        for (what, value) in least {
            if value == 0 {
                bail!("limit of {what}: expected at least 1, got 0");
            }
        }
        if b.message_bytes < 1024 || b.scene_bytes < 1024 {
            bail!("message and scene size: expected at least 1024 bytes");
        }
        if b.frame < Duration::from_millis(100) {
            bail!("frame deadline: expected at least 0.1 seconds");
        }
        if b.session_bytes < 1 << 20 || b.scenes_bytes < 1 << 20 {
            bail!("memory of scenes: expected at least 1 MiB");
        }
        if b.load.is_zero() {
            bail!("time to load a scene: expected more than 0 seconds");
        }
        if b.idle < Duration::from_secs(1) {
            bail!("idle timeout: expected at least 1 second");
        }
        let times = [b.handshake, b.hello, b.request, b.message];
        if times.iter().any(Duration::is_zero) {
            bail!("time for a handshake or message: expected at least 1 second, got 0");
        }
        Ok(())
    }
}
