//! `ghostlight demo`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use ghostlight::clock::render_clock;
use ghostlight::net::args::first_scene;
use ghostlight::net::{self, Listen, ServeConfig, TlsFiles};
use ghostlight::output;
use ghostlight::recording::OpenOptions;
use ghostlight::render::{Backend, Engine};
use ghostlight::replay::{FrameRange, Output, ReplayOptions, png_of};
use ghostlight::scene::ObjectFlags;

use super::bundled::{Home, RECORDING, SCENE, SCENES};
use super::replay::Job;

/// Serve the bundled recording with a teapot, for viewing in a browser.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight demo                         serve; open the page it names
  ghostlight demo --listen 127.0.0.1:9000
  ghostlight demo --out /tmp/ghostlight   a film instead of a page
  ghostlight demo --object duck.glb --size 0.15 --material gold --place 50%,65%

With --out it writes demo.mp4 and its first frame, demo.png, prints the rendering
speed, and ends. Otherwise log lines go to stderr; RUST_LOG sets the level: debug, info (the
default) or warn.")]
pub(crate) struct DemoArgs {
    /// Address of the page; port 0 picks a free port
    #[arg(
        long,
        value_name = "ADDRESS",
        default_value = "127.0.0.1:8080",
        conflicts_with = "out"
    )]
    listen: Listen,
    #[command(flatten)]
    tls: TlsFiles,
    #[command(flatten)]
    objects: ObjectFlags,
    /// Rendering backend
    #[arg(long, value_enum, default_value_t)]
    backend: Backend,
    /// Folder for a film and a picture, instead of serving
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub(crate) fn run(args: &DemoArgs) -> Result<()> {
    let home = Home::find()?;
    match &args.out {
        Some(out) => film(&home, out, &args.objects, args.backend),
        None => net::serve(ServeConfig {
            listen: args.listen.clone(),
            tls: args.tls.clone(),
            recordings: vec![home.join(RECORDING)],
            // A viewer sees the first scene at once.
            first_scene: first_scene(&args.objects, &[home.join(SCENE)])?,
            scenes: vec![home.join(SCENE), home.join(SCENES)],
            backend: args.backend,
            ..ServeConfig::local(0)
        }),
    }
}

/// Writes the film and its first frame.
fn film(home: &Home, out: &Path, objects: &ObjectFlags, backend: Backend) -> Result<()> {
    let film = out.join("demo.mp4");
    let picture = out.join("demo.png");
    let mut first = None;
    let scene = home.join(SCENE);
    let engine = Engine::new(backend, 0, render_clock)?;
    let report = Job {
        recording: &home.join(RECORDING),
        open: OpenOptions::default(),
        // Objects given by the user replace the teapot.
        scene: objects.objects.is_empty().then_some(scene.as_path()),
        objects,
        settings: None,
        options: ReplayOptions {
            backend: engine.backend(),
            frames: FrameRange::default(),
            aovs: Vec::new(),
            output: Output::Film(film.clone()),
            report: None,
            measure: true,
        },
        engine,
        quiet: false,
    }
    .run(|rendered| {
        if first.is_none() {
            first = Some(png_of(&rendered.color)?);
        }
        Ok(())
    })?;
    let png = first.unwrap_or_default();
    output::write_file(&picture, &png).with_context(|| picture.display().to_string())?;
    let summary = report.summary;
    output::print(format_args!(
        "film:    {}\npicture: {}\n{} frames; rendering took {:.1} ms a frame ({:.1} fps)",
        film.display(),
        picture.display(),
        summary.frames,
        summary.median_ms,
        summary.fps
    ))?;
    Ok(())
}
