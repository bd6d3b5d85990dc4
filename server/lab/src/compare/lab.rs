//! What experiments use: options, threads, progress, views and scenes.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::{Context, Result, ensure};
use indicatif::{ProgressBar, ProgressStyle};

use ghostlight::clock::render_clock;
use ghostlight::frame::RgbdFrame;
use ghostlight::ghost::DepthPlanes;
use ghostlight::recording::{OpenOptions, Recording};
use ghostlight::render::{Backend, Engine, RenderSettings};
use ghostlight::scene::{PlacementFrame, Scene, SceneDocument};

/// Options for running experiments.
#[derive(Debug, Clone)]
pub struct LabOptions {
    /// Fewer rays, smaller pictures, fewer rounds: minutes become seconds, bounds stay.
    pub quick: bool,
    /// Threads; 0 for one per core.
    pub threads: usize,
    /// Rendering backend.
    pub backend: Backend,
    /// Folder that holds `recordings/`.
    pub home: PathBuf,
    /// Folder of real recordings, if there is one.
    pub data: Option<PathBuf>,
    /// Print no progress.
    pub quiet: bool,
}

/// The environment passed to every experiment.
#[derive(Debug)]
pub struct Lab {
    options: LabOptions,
    pool: rayon::ThreadPool,
    engine: Engine,
    experiment: &'static str,
    bar: ProgressBar,
    views: Option<Vec<View>>,
}

/// A frame to render objects into.
#[derive(Debug, Clone)]
pub struct View {
    /// Name for people.
    pub name: &'static str,
    /// The first frame of a recording.
    pub frame: RgbdFrame,
    /// A pixel of it where an object can be placed.
    pub place: [f64; 2],
    /// Largest size of that object, metres.
    pub size_m: f64,
    /// Whether it was recorded with a real camera.
    pub real: bool,
}

/// Name, folder, pixel and size of the recordings that [`LabOptions::data`] may contain.
const REAL: [(&str, &str, [f64; 2], f64); 3] = [
    (
        "7-Scenes RedKitchen",
        "7scenes-redkitchen",
        [500.0, 300.0],
        0.3,
    ),
    (
        "TUM freiburg1 desk",
        "rgbd_dataset_freiburg1_desk-snippet",
        [450.0, 190.0],
        0.3,
    ),
    (
        "iPhone LiDAR",
        "iphone-lidar-3dscannerapp",
        [1300.0, 1150.0],
        0.12,
    ),
];

impl Lab {
    /// A lab with its own threads. A data folder that is given must exist.
    pub fn new(options: LabOptions) -> Result<Self> {
        if let Some(data) = &options.data {
            ensure!(
                data.is_dir(),
                "{}: expected a folder of real recordings, found none",
                data.display()
            );
        }
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(options.threads)
            .build()
            .context("threads")?;
        let engine = Engine::new(options.backend, options.threads, render_clock)?;
        Ok(Self {
            options,
            pool,
            engine,
            experiment: "",
            bar: ProgressBar::hidden(),
            views: None,
        })
    }

    /// Creates renderers.
    pub fn engine(&self) -> &Engine {
        &self.engine
    }

    /// Whether the run should be short rather than thorough.
    pub fn quick(&self) -> bool {
        self.options.quick
    }

    /// One value for a quick run, another for a full one.
    pub fn pick<T>(&self, quick: T, full: T) -> T {
        if self.quick() { quick } else { full }
    }

    /// Rounds of a paired timing.
    pub fn rounds(&self) -> usize {
        self.pick(3, 7)
    }

    /// Threads for references and for frames.
    pub fn pool(&self) -> &rayon::ThreadPool {
        &self.pool
    }

    /// The folder that holds `recordings/`.
    pub fn home(&self) -> &Path {
        &self.options.home
    }

    /// Shows the current activity, in a few words.
    pub fn phase(&self, what: &str) {
        if self.bar.is_hidden() {
            if !self.options.quiet {
                ghostlight::output::tell(format_args!("{}: {what}", self.experiment));
            }
        } else {
            self.bar.set_message(format!("{}: {what}", self.experiment));
        }
    }

    /// Begins an experiment; progress is shown under its name.
    pub(super) fn begin(&mut self, experiment: &'static str) {
        self.end();
        self.experiment = experiment;
        if !self.options.quiet && std::io::stderr().is_terminal() {
            self.bar = ProgressBar::new_spinner();
            if let Ok(style) = ProgressStyle::with_template("{spinner} {elapsed} {msg}") {
                self.bar.set_style(style);
            }
            self.bar.enable_steady_tick(Duration::from_millis(120));
        }
    }

    /// Ends the progress of an experiment.
    pub(super) fn end(&mut self) {
        self.bar.finish_and_clear();
        self.bar = ProgressBar::hidden();
    }

    /// The bundled view first, then every real one that exists. A missing recording in `data` is no error: the
    /// report names the recordings used.
    pub fn views(&mut self) -> Result<&[View]> {
        if self.views.is_none() {
            self.views = Some(self.open_views()?);
        }
        Ok(self.views.as_deref().unwrap_or_default())
    }

    fn open_views(&self) -> Result<Vec<View>> {
        let desk = self.options.home.join("recordings/desk");
        let mut views = vec![View {
            name: "bundled desk",
            frame: first_frame(&desk)?,
            place: [316.0, 285.0],
            size_m: 0.3,
            real: false,
        }];
        if let Some(data) = &self.options.data {
            for (name, folder, place, size_m) in REAL {
                let folder = data.join(folder);
                if folder.is_dir() {
                    views.push(View {
                        name,
                        frame: first_frame(&folder)?,
                        place,
                        size_m,
                        real: true,
                    });
                }
            }
        }
        Ok(views)
    }

    /// The bundled view.
    pub fn desk(&mut self) -> Result<View> {
        Ok(self.views()?[0].clone())
    }

    /// A bundled scene document, placed in a frame of the bundled recording.
    pub fn bundled_scene(&self, name: &str, frame: &RgbdFrame) -> Result<Scene> {
        let path = self.options.home.join("recordings/scenes").join(name);
        let (document, folder) = SceneDocument::load(&path)?;
        resolve(&document, &folder, frame)
    }

    /// A scene document given as text; its paths are relative to `recordings/scenes`.
    pub fn scene(&self, text: &str, frame: &RgbdFrame) -> Result<Scene> {
        let document = SceneDocument::parse(text, self.experiment)?;
        let folder = self.options.home.join("recordings/scenes");
        resolve(&document, &folder, frame)
    }
}

fn first_frame(folder: &Path) -> Result<RgbdFrame> {
    Ok(Recording::open(folder, &OpenOptions::default())?.frame(0)?)
}

fn resolve(document: &SceneDocument, folder: &Path, frame: &RgbdFrame) -> Result<Scene> {
    let settings = RenderSettings::default().ghost;
    let surface = DepthPlanes::new(&frame.depth, &frame.intrinsics, &settings);
    let frame = PlacementFrame {
        frame,
        surface: &surface,
    };
    Ok(document.resolve(folder, &frame)?.0)
}
