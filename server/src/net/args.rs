//! Command-line arguments of `serve` and `send`.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};

use super::config::{Bounds, ServeConfig};
use super::listen::Listen;
use super::send::SendRun;
use super::send_config::{ControlFlag, Rate, SendConfig};
use super::send_report::SendReport;
use super::tls::TlsFiles;
use crate::output;
use crate::recording::RecordingArgs;
use crate::render::Backend;
use crate::scene::{ObjectFlags, SceneDocument};
use crate::settings;

/// Text at the end of the help of `serve`.
const LOGGING: &str = "\
Examples:
  ghostlight serve --recording my-recording --object duck.glb --size 0.2 --material gold
  ghostlight serve --recording recordings/desk --scene recordings/scenes
  ghostlight serve --recording my-recording --object duck.glb --place 50%,65%
  ghostlight serve --recording my-recording --trajectory poses.txt

Log lines go to stderr. RUST_LOG sets the level: debug, info (the default) or warn.";

/// Arguments of `serve`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = LOGGING)]
pub struct ServeArgs {
    /// Address to listen on, as 127.0.0.1:8080, [::1]:8080 or localhost:8080; port 0 picks a free
    /// port, :8080 means every address of this machine
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:8080")]
    pub listen: Listen,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would show it as help")]
    pub tls: TlsFiles,
    /// Token that clients must present; required for an address that other machines can reach
    #[arg(long, env = "GHOSTLIGHT_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Origin of another site whose pages may connect, as https://example.org; repeatable
    #[arg(long = "allow-origin", value_name = "ORIGIN")]
    pub origins: Vec<String>,
    /// Recording, or folder of recordings, to offer to viewers; repeatable
    #[arg(long = "recording", value_name = "PATH")]
    pub recordings: Vec<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would show it as help")]
    pub read: RecordingArgs,
    /// Scene document, mesh, or folder of documents, to offer; repeatable, the first is what
    /// viewers of recordings see unless they choose (clients that send frames name or upload theirs)
    #[arg(long = "scene", value_name = "PATH")]
    pub scenes: Vec<PathBuf>,
    #[command(flatten)]
    #[allow(missing_docs, reason = "clap would show it as help")]
    pub objects: ObjectFlags,
    /// Initial render settings of sessions (JSON); they override a scene's settings
    #[arg(long, value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// Render threads, shared by all sessions; 0: one per core
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub threads: usize,
    /// Rendering backend
    #[arg(long, value_enum, default_value_t)]
    pub backend: Backend,
    /// Maximum number of sessions
    #[arg(long, value_name = "N", default_value_t = Bounds::default().sessions)]
    pub max_sessions: usize,
    /// Maximum number of viewers per session
    #[arg(long, value_name = "N", default_value_t = Bounds::default().viewers)]
    pub max_viewers: usize,
    /// Maximum number of clients after their hello
    #[arg(long, value_name = "N", default_value_t = Bounds::default().connections)]
    pub max_connections: usize,
    /// Maximum number of connections before their hello; a new one replaces the oldest
    #[arg(long, value_name = "N", default_value_t = Bounds::default().waiting)]
    pub max_waiting: usize,
    /// Maximum of these from one address
    #[arg(long, value_name = "N", default_value_t = Bounds::default().waiting_per_address)]
    pub max_waiting_per_address: usize,
    /// Largest message, MiB
    #[arg(long, value_name = "MIB", default_value_t = Bounds::default().message_bytes >> 20)]
    pub max_message_mib: usize,
    /// Maximum memory of incomplete messages of all clients, MiB
    #[arg(long, value_name = "MIB", default_value_t = Bounds::default().unfinished_bytes >> 20)]
    pub max_unfinished_mib: u64,
    /// Largest image, pixels
    #[arg(long, value_name = "N", default_value_t = Bounds::default().pixels)]
    pub max_pixels: usize,
    /// Largest upload, MiB; uploads of a session may take twice as much
    #[arg(long, value_name = "MIB", default_value_t = Bounds::default().asset_bytes >> 20)]
    pub max_asset_mib: u64,
    /// Maximum memory of a session's scenes and uploads, MiB
    #[arg(long, value_name = "MIB", default_value_t = Bounds::default().session_bytes >> 20)]
    pub max_session_mib: u64,
    /// Maximum memory of all sessions' scenes and uploads, MiB [default: half of the machine's]
    #[arg(long, value_name = "MIB")]
    pub max_scene_mib: Option<u64>,
    /// Time limit for loading a scene, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = Bounds::default().load.as_secs_f64())]
    pub load_limit: f64,
    /// Maximum number of triangles in a scene
    #[arg(long, value_name = "N", default_value_t = Bounds::default().triangles)]
    pub max_triangles: usize,
    /// Timeout for clients that are silent or do not read, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = Bounds::default().idle.as_secs())]
    pub idle: u64,
    /// Timeout for each of TLS handshake, request head and hello, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = Bounds::default().handshake.as_secs())]
    pub handshake: u64,
    /// Timeout of a message from its first to its last byte, seconds
    #[arg(long, value_name = "SECONDS", default_value_t = Bounds::default().message.as_secs())]
    pub message_time: u64,
    /// Time limit of a frame, seconds; its sender then gets an error
    #[arg(long, value_name = "SECONDS", default_value_t = Bounds::default().frame.as_secs_f64())]
    pub frame_deadline: f64,
}

impl ServeArgs {
    /// The server's configuration, validated.
    pub fn config(&self) -> Result<ServeConfig> {
        let mib = |n: usize| n.saturating_mul(1 << 20);
        let frame = Duration::try_from_secs_f64(self.frame_deadline).with_context(|| {
            format!(
                "--frame-deadline: expected seconds from 0.1, got {}",
                self.frame_deadline
            )
        })?;
        let load = Duration::try_from_secs_f64(self.load_limit).with_context(|| {
            let got = self.load_limit;
            format!("--load-limit: expected seconds above 0, got {got}")
        })?;
        let asset_bytes = self.max_asset_mib.saturating_mul(1 << 20);
        let config = ServeConfig {
            listen: self.listen.clone(),
            tls: self.tls.clone(),
            token: self.token.clone(),
            origins: self.origins.clone(),
            recordings: self.recordings.clone(),
            open: self.read.options(),
            scenes: self.scenes.clone(),
            first_scene: first_scene(&self.objects, &self.scenes)?,
            settings: settings::load_given(self.settings.as_deref())?.unwrap_or_default(),
            fixed_settings: self.settings.is_some(),
            threads: self.threads,
            backend: self.backend,
            bounds: Bounds {
                connections: self.max_connections,
                waiting: self.max_waiting,
                waiting_per_address: self.max_waiting_per_address,
                sessions: self.max_sessions,
                viewers: self.max_viewers,
                message_bytes: mib(self.max_message_mib),
                pixels: self.max_pixels,
                asset_bytes,
                assets_bytes: asset_bytes.saturating_mul(2),
                triangles: self.max_triangles,
                session_bytes: self.max_session_mib.saturating_mul(1 << 20),
                scenes_bytes: self
                    .max_scene_mib
                    .map_or(Bounds::default().scenes_bytes, |n| {
                        n.saturating_mul(1 << 20)
                    }),
                load,
                idle: Duration::from_secs(self.idle),
                handshake: Duration::from_secs(self.handshake),
                hello: Duration::from_secs(self.handshake),
                message: Duration::from_secs(self.message_time),
                unfinished_bytes: self.max_unfinished_mib.saturating_mul(1 << 20),
                frame,
                ..Bounds::default()
            },
        };
        config.check()?;
        Ok(config)
    }

    /// Serves until it gets a stop signal.
    pub fn run(&self) -> Result<()> {
        super::serve(self.config()?)
    }
}

/// The scene described by command-line flags, offered before all others: the objects given by flags, or else the
/// first scene with the changes given by flags. `None` without such flags. Named after its first object or its
/// file.
pub fn first_scene(
    flags: &ObjectFlags,
    scenes: &[PathBuf],
) -> Result<Option<(String, SceneDocument)>> {
    if flags.is_empty() {
        return Ok(None);
    }
    let scene = match flags.objects.first() {
        // Offered as a separate scene beside the others.
        Some(_) => None,
        None => scenes.first().filter(|path| path.is_file()),
    };
    let (mut document, folder) = flags.document(scene.map(PathBuf::as_path))?;
    let folder = std::path::absolute(&folder).unwrap_or(folder);
    let absolute = |path: &mut String| {
        *path = folder.join(&*path).to_string_lossy().into_owned();
    };
    document
        .objects
        .iter_mut()
        .for_each(|o| absolute(&mut o.mesh));
    if let Some(environment) = &mut document.environment {
        absolute(&mut environment.map);
    }
    let file = flags.objects.first().or(scene);
    let name = file.and_then(|file| file.file_stem()).unwrap_or_default();
    Ok(Some((name.to_string_lossy().into_owned(), document)))
}

/// Arguments of `send`.
#[derive(Debug, Clone, clap::Args)]
#[command(after_help = "Examples:
  ghostlight send my-recording --url ws://127.0.0.1:8080/ws --scene teapot.json
  ghostlight send my-recording --url ws://127.0.0.1:8080/ws --scene duck.glb --control anyone")]
pub struct SendArgs {
    /// Recording to send
    pub recording: PathBuf,
    /// How to read it.
    #[command(flatten)]
    pub read: RecordingArgs,
    /// Server, as ws://127.0.0.1:8080/ws, or wss:// if it serves over TLS
    #[arg(long)]
    pub url: String,
    /// Certificate authority (PEM) of a wss:// server; the system's by default
    #[arg(long, value_name = "FILE")]
    pub ca: Option<PathBuf>,
    /// How fast frames are sent
    #[arg(long, value_enum, default_value_t)]
    pub rate: Rate,
    /// The server's token
    #[arg(long, env = "GHOSTLIGHT_TOKEN", hide_env_values = true)]
    pub token: Option<String>,
    /// Who may change scene, settings and placement: the sender alone, or its viewers too
    #[arg(long, value_enum, default_value_t)]
    pub control: ControlFlag,
    /// Scene document to upload with its meshes, or a mesh
    #[arg(long, value_name = "FILE", conflicts_with = "server_scene")]
    pub scene: Option<PathBuf>,
    /// Name of one of the server's scenes
    #[arg(long, value_name = "NAME")]
    pub server_scene: Option<String>,
    /// Render settings (JSON)
    #[arg(long, value_name = "FILE")]
    pub settings: Option<PathBuf>,
    /// Repeat the recording for this many seconds
    #[arg(long, value_name = "S")]
    pub seconds: Option<f64>,
    /// JPEG quality of the colour sent, 1 to 100
    #[arg(long, default_value_t = 90, value_parser = clap::value_parser!(u8).range(1..=100))]
    pub quality: u8,
    /// Reconnection attempts after a lost connection, with growing delays; a composite resets the
    /// count
    #[arg(long, value_name = "N", default_value_t = SendConfig::RETRIES)]
    pub retries: u32,
    /// Write the measurements to this file (JSON), even if the run fails
    #[arg(long, value_name = "FILE")]
    pub report: Option<PathBuf>,
}

impl SendArgs {
    /// The client's configuration.
    pub fn config(&self) -> Result<SendConfig> {
        let duration = match self.seconds {
            None => None,
            Some(seconds) => Some(
                Duration::try_from_secs_f64(seconds)
                    .with_context(|| format!("--seconds: expected a time from 0, got {seconds}"))?,
            ),
        };
        Ok(SendConfig {
            recording: self.recording.clone(),
            open: self.read.options(),
            url: self.url.clone(),
            ca: self.ca.clone(),
            rate: self.rate,
            token: self.token.clone(),
            control: self.control,
            scene: self.scene.clone(),
            server_scene: self.server_scene.clone(),
            settings: settings::load_given(self.settings.as_deref())?,
            duration,
            quality: self.quality,
            retries: self.retries,
        })
    }

    /// Sends, prints the table, writes the report, and then says how the run ended.
    pub fn run(&self) -> Result<()> {
        let SendRun { report, result } = super::send(&self.config()?)?;
        let written = self.write_report(&report);
        if report.frames_sent > 0 {
            output::print(report.to_string().trim_end())?;
            if self.scene.is_none() && self.server_scene.is_none() {
                output::tell(
                    "note: no --scene and no --server-scene: nothing virtual was added to the frames",
                );
            }
        }
        match (result, written) {
            (Ok(()), written) => written,
            // The reason that the run ended matters more than the missing report.
            (Err(ended), Err(error)) => {
                output::tell(format_args!("note: the report was not written: {error:#}"));
                Err(ended)
            }
            (ended, Ok(())) => ended,
        }
    }

    fn write_report(&self, report: &SendReport) -> Result<()> {
        let Some(path) = &self.report else {
            return Ok(());
        };
        let mut text = serde_json::to_string_pretty(report)?;
        text.push('\n');
        output::write_file(path, text.as_bytes()).with_context(|| path.display().to_string())
    }
}
