//! `ghostlight replay`.

use std::io::IsTerminal;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use anyhow::Result;
use ghostlight::clock;
use ghostlight::frame::{BoxError, RgbdFrame};
use ghostlight::output;
use ghostlight::recording::{OpenOptions, RecordingArgs};
use ghostlight::render::{Aov, Backend, Engine, Rendered};
use ghostlight::replay::{self, FrameRange, Output, ReplayOptions, Report};
use ghostlight::scene::ObjectFlags;
use ghostlight::settings;
use indicatif::{ProgressBar, ProgressStyle};

use super::input;

/// Render a scene into every frame of a recording.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:
  ghostlight replay my-recording --object duck.glb --out film.mp4
  ghostlight replay my-recording --object duck.glb --size 0.2 --material gold --place 50%,65% --out film.mp4
  ghostlight replay recordings/desk --scene recordings/scenes/teapot.json --out frames
  ghostlight replay my-recording --scene teapot.json --place 320,300 --out film.mp4
  ghostlight replay my-recording --scene teapot.json --frames 0..10 --aov mask,depth --out frames

A folder gets 000000.png, 000001.png, ... by position among the frames kept, and <aov>/000000.png.
Replaying into it again replaces them; other files in it stay. Nothing appears before the last
frame is finished. A film is H.264; pictures of odd size get their last row or column doubled.
Images beside the composite (--aov) are PNGs:
  mask    8 bits, share of the pixel that is virtual: 0 none, 255 all
  depth   16 bits, millimetres along the camera's axis (z) to the visible surface; 0 unknown
  normal  RGB = 255 (n + 1) / 2, camera axes x right, y down, z forward; black where unknown
  shadow  8 bits, light with the virtual objects divided by light without: 255 unchanged or more
  ambient 8 bits, the same for ambient light alone: contact shadows and reflected light
  real    sRGB, radiance of the real scene alone
  mixed   sRGB, radiance of the real scene with the virtual objects

--report and a film may be a link (followed), a fifo or /dev/stdout (written to, never replaced).
With --report, nothing is read or written while a frame is rendered, so that its times are those of
rendering alone. Without, reading and writing run in parallel and the whole is faster.")]
pub(crate) struct ReplayArgs {
    /// Folder of a recording, or a zip archive of one; `ghostlight inspect --help` lists the layouts
    recording: PathBuf,
    /// Scene document, JSON, or a mesh
    #[arg(long, value_name = "FILE", required_unless_present = "objects")]
    scene: Option<PathBuf>,
    #[command(flatten)]
    objects: ObjectFlags,
    /// Folder for PNG pictures, or a film if it ends in .mp4
    #[arg(long, value_name = "DIR|FILE.mp4")]
    out: PathBuf,
    /// Frames to replay, A up to but not including B, counted without frames left out; either may be omitted
    #[arg(long, value_name = "A..B")]
    frames: Option<FrameRange>,
    /// Render settings, JSON; every field is optional, and they win over the scene's own
    #[arg(long, value_name = "F.json")]
    settings: Option<PathBuf>,
    /// Images beside the composite: mask, depth, normal, shadow, ambient, real, mixed (units: see below)
    #[arg(long, value_name = "NAMES", value_delimiter = ',', value_parser = input::aov)]
    aov: Vec<Aov>,
    #[command(flatten)]
    read: RecordingArgs,
    /// Render threads; 0 for one per core
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u16).range(..=1024))]
    threads: u16,
    /// Rendering backend
    #[arg(long, value_enum, default_value_t)]
    backend: Backend,
    /// Times, counts and hashes per frame, JSON
    #[arg(long, value_name = "F.json")]
    report: Option<PathBuf>,
    /// Print nothing but errors
    #[arg(long)]
    quiet: bool,
}

/// A replay as given on the command line.
pub(crate) struct Job<'a> {
    pub(crate) recording: &'a Path,
    pub(crate) open: OpenOptions,
    pub(crate) scene: Option<&'a Path>,
    pub(crate) objects: &'a ObjectFlags,
    /// Used instead of the scene's own settings.
    pub(crate) settings: Option<settings::Parsed>,
    pub(crate) engine: Engine,
    pub(crate) options: ReplayOptions,
    pub(crate) quiet: bool,
}

pub(crate) fn run(args: &ReplayArgs) -> Result<()> {
    let threads = usize::from(args.threads);
    let engine = Engine::new(args.backend, threads, clock::render_clock)?;
    let mut aovs = args.aov.clone();
    aovs.sort_unstable();
    aovs.dedup();
    let report = Job {
        recording: &args.recording,
        open: args.read.options(),
        scene: args.scene.as_deref(),
        objects: &args.objects,
        settings: args.settings.as_deref().map(settings::load).transpose()?,
        options: ReplayOptions {
            backend: engine.backend(),
            frames: args.frames.unwrap_or_default(),
            aovs,
            output: Output::from_path(args.out.clone())?,
            measure: args.report.is_some(),
            report: args.report.clone(),
        },
        engine,
        quiet: args.quiet,
    }
    .run(|_| Ok(()))?;
    if !args.quiet {
        let summary = report.summary;
        output::print(format_args!(
            "{} frames in {}; rendering took {:.1} ms a frame ({:.1} fps)",
            summary.frames,
            args.out.display(),
            summary.median_ms,
            summary.fps
        ))?;
        let blind = report.frames.iter();
        let n_blind = blind.filter(|f| f.stats.unmeasured_pixels > 0).count();
        if n_blind > 0 {
            output::tell(format_args!(
                "note: in {n_blind} of {} frames virtual objects are shown where no depth was measured nearby; real objects in front of them are not known there (ghost.holes)",
                summary.frames
            ));
        }
        let frames = report.frames.iter();
        let lowered = frames.clone().filter(|frame| !frame.lowered.is_empty());
        let n_lowered = lowered.count();
        if n_lowered > 0 {
            let least = frames.max_by_key(|frame| frame.lowered.len());
            let what: Vec<String> = least
                .map(|frame| frame.lowered.iter().map(ToString::to_string).collect())
                .unwrap_or_default();
            output::print(format_args!(
                "{n_lowered} of {} frames were rendered at reduced quality to keep budget_ms, at most: {}",
                summary.frames,
                what.join(", ")
            ))?;
        }
    }
    Ok(())
}

impl Job<'_> {
    /// Runs the replay; `look` is called with every finished frame.
    pub(crate) fn run(
        self,
        mut look: impl FnMut(&Rendered) -> Result<(), BoxError>,
    ) -> Result<Report> {
        output::clean_up_on_signals()?;
        let mut recording = input::open_recording(self.recording, &self.open)?;
        let (document, folder) = self.objects.document(self.scene)?;
        let (settings, settings_notes) = match self.settings {
            Some(settings::Parsed { settings, notes }) => (settings, notes),
            None => (document.settings.unwrap_or_default(), Vec::new()),
        };
        let place = || input::place_scene(&document, &folder, &recording, &settings);
        let (scene, scene_notes) = self.engine.load(place)??;
        let mut renderer = self.engine.renderer(&scene)?;
        let notes = [
            recording.notes(),
            &settings_notes,
            &scene_notes,
            renderer.notes(),
        ]
        .concat();
        // On a terminal, notes come before the progress bar. Elsewhere they follow success, so that an error is
        // the only line.
        let terminal = std::io::stderr().is_terminal();
        if terminal && !self.quiet {
            tell(&notes);
        }
        let bar = progress_bar(self.quiet);
        let aovs = self.options.aovs.clone();
        let render = |frame: &RgbdFrame| {
            let rendered = renderer.render(frame, &settings, &aovs)?;
            look(&rendered)?;
            Ok(rendered)
        };
        let progress = |done: usize, total: usize| {
            bar.set_length(total as u64);
            bar.set_position(done as u64);
            ControlFlow::Continue(())
        };
        let report = replay::run(&mut recording, render, &self.options, progress);
        bar.finish_and_clear();
        let report = report?;
        if !terminal && !self.quiet {
            tell(&notes);
        }
        if !self.quiet {
            let left_out = report.left_out.iter();
            let unread = left_out.map(|l| format!("Frame {} is left out: {}.", l.index, l.reason));
            tell(&unread.collect::<Vec<_>>());
        }
        Ok(report)
    }
}

fn tell(notes: &[String]) {
    for note in notes {
        output::tell(format_args!("note: {note}"));
    }
}

/// A progress bar on a terminal; hidden elsewhere.
pub(crate) fn progress_bar(quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let template = "{wide_bar} {pos}/{len}  {per_sec}  {eta} left";
    let style = ProgressStyle::with_template(template);
    // The template is a constant. The default is used if a later indicatif no longer knows one of its fields.
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    // indicatif draws to stderr, and only if that is a terminal.
    ProgressBar::new(0).with_style(style)
}
