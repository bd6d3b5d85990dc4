//! Renders a recording of a room: colour, Kinect-like depth, exact depth, poses, lights.
//!
//! Real recordings have no ground truth. Here depth, poses and lights are known, so results from the recording
//! can be compared with them. [`light`] computes the light of the room once, [`render`] renders it, [`sensor`]
//! simulates the depth sensor, and the result is written in TUM's layout.

mod caster;
mod geometry;
mod light;
mod meshes;
mod output;
mod path;
mod render;
mod room;
mod sensor;
mod solid;
mod texture;
mod things;
mod truth;

use std::path::{Path as FilePath, PathBuf};

use indicatif::ProgressBar;
use rayon::prelude::*;

pub use truth::{Depth, Lighting, TruthRoom};

pub use meshes::{ply, write_meshes};

use ghostlight::camera::{CameraError, Intrinsics};
use ghostlight::codec::CodecError;
use ghostlight::frame::DepthImage;
use ghostlight::output::Draft;
use ghostlight::recording::tum_text;
use light::BakeQuality;
use path::Path;
use render::{Lit, View};

/// What to render.
#[derive(Debug, Clone, PartialEq)]
pub struct SynthOptions {
    /// Folder to create; must be new or empty.
    pub out: PathBuf,
    /// Number of frames, 1..=100,000.
    pub frames: u32,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Seed of the camera path's sway and of the sensor noise. The room stays the same.
    pub seed: u32,
    /// Frames per second, 1..=1000.
    pub rate_hz: f64,
    /// Side of the grid of rays per pixel of colour, 1..=16.
    pub samples: u32,
    /// Whether to write `depth_exact/` beside `depth/`.
    pub exact_depth: bool,
    /// Coarse lighting, for tests: seconds instead of minutes.
    pub quick: bool,
}

impl Default for SynthOptions {
    /// The options of the bundled recording.
    fn default() -> Self {
        Self {
            out: PathBuf::from("desk"),
            frames: 72,
            width: 640,
            height: 480,
            seed: 1,
            rate_hz: 30.0,
            samples: 3,
            exact_depth: true,
            quick: false,
        }
    }
}

/// Figures of the finished recording.
#[derive(Debug, Clone, PartialEq)]
pub struct SynthSummary {
    /// Frames written.
    pub frames: u32,
    /// Bytes of all files.
    pub bytes: u64,
    /// Mean linear value of the colour images, 0..=1.
    pub mean_linear: f64,
    /// Share of colour pixels with a channel at 255, 0..=1.
    pub clipped_share: f64,
    /// Share of sensed pixels without depth, 0..=1.
    pub hole_share: f64,
}

/// Why a recording could not be made.
#[derive(Debug, thiserror::Error)]
pub enum SynthError {
    /// An option out of range.
    #[error("{field}: expected {expected}, got {got}")]
    Option {
        /// Which option.
        field: &'static str,
        /// What it must be.
        expected: &'static str,
        /// The given value.
        got: String,
    },
    /// An invalid image size.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The output folder is not empty.
    #[error("{}: expected a new or empty folder, got one with files in it", .0.display())]
    NotEmpty(PathBuf),
    /// A file could not be written.
    #[error("{}: {source}", path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// An image could not be encoded.
    #[error("{}: {source}", path.display())]
    Image {
        /// Which file.
        path: PathBuf,
        /// The encoder's error.
        source: CodecError,
    },
    /// The manifest could not be written as JSON.
    #[error("manifest.json: {0}")]
    Manifest(String),
}

impl SynthError {
    fn io(path: &FilePath, source: std::io::Error) -> Self {
        Self::Io {
            path: path.to_path_buf(),
            source,
        }
    }

    fn image(path: &FilePath, source: CodecError) -> Self {
        Self::Image {
            path: path.to_path_buf(),
            source,
        }
    }
}

impl SynthOptions {
    fn check(&self) -> Result<Intrinsics, SynthError> {
        let bad = |field, expected, got: String| {
            Err(SynthError::Option {
                field,
                expected,
                got,
            })
        };
        if !(1..=100_000).contains(&self.frames) {
            return bad("frames", "1 to 100000", self.frames.to_string());
        }
        if !(1..=16).contains(&self.samples) {
            return bad("samples", "1 to 16", self.samples.to_string());
        }
        if !(1.0..=1000.0).contains(&self.rate_hz) {
            return bad("rate_hz", "1 to 1000", self.rate_hz.to_string());
        }
        // Checks the size first, so that its error names the size.
        Intrinsics::new(525.0, 525.0, 319.5, 239.5, self.width, self.height)?;
        Ok(nominal_camera()?.scaled_to(self.width, self.height)?)
    }

    fn quality(&self) -> (BakeQuality, f64) {
        if self.quick {
            let quality = BakeQuality {
                shadow_side: 4,
                gather_side: 3,
                final_side: 5,
                passes: 2,
            };
            (quality, 6.0)
        } else {
            let quality = BakeQuality {
                shadow_side: 14,
                gather_side: 9,
                final_side: 22,
                passes: 4,
            };
            (quality, 1.0)
        }
    }
}

/// TUM's nominal camera.
fn nominal_camera() -> Result<Intrinsics, CameraError> {
    Intrinsics::new(525.0, 525.0, 319.5, 239.5, 640, 480)
}

/// Depth of the room from one camera pose, without colour, so that no lighting is needed.
#[derive(Debug, Clone)]
pub struct RoomDepth {
    /// Exact up to rounding.
    pub exact: DepthImage,
    /// As a Kinect measures it: with noise, holes and quantization.
    pub sensed: DepthImage,
    /// Intrinsics of both.
    pub intrinsics: Intrinsics,
}

/// Depth as the camera of the bundled recording sees it in a frame, at any image size.
pub fn room_depth(width: u32, height: u32, index: u32) -> Result<RoomDepth, SynthError> {
    let options = SynthOptions {
        width,
        height,
        ..SynthOptions::default()
    };
    let intrinsics = options.check()?;
    let room = room::build(1.0);
    let time_s = frame_time_ns(index, options.rate_hz) as f64 * 1e-9;
    let view = View {
        intrinsics,
        pose: Path::new(options.seed).pose(time_s),
    };
    let exact = sensor::exact_depth(&room.geometry, &view);
    let noise = index ^ options.seed.rotate_left(16);
    let units = sensor::sense(&room.geometry, &view, &exact, noise);
    let exact = exact.z_m.iter().map(|&z| z as f32).collect();
    Ok(RoomDepth {
        exact: DepthImage::from_metres(width, height, exact),
        sensed: DepthImage::from_units(
            width,
            height,
            &units,
            sensor::UNITS_PER_METRE,
            DepthImage::MAX_M,
        ),
        intrinsics,
    })
}

/// Time of a frame, nanoseconds from the first, a whole number of microseconds.
fn frame_time_ns(index: u32, rate_hz: f64) -> i64 {
    (f64::from(index) * 1e6 / rate_hz).round() as i64 * 1_000
}

/// Renders a recording into `options.out`, which appears only when it is complete.
///
/// `progress` shows the work done; pass [`ProgressBar::hidden`] to hide it.
pub fn run(options: &SynthOptions, progress: &ProgressBar) -> Result<SynthSummary, SynthError> {
    let intrinsics = options.check()?;
    let occupied = match std::fs::read_dir(&options.out) {
        Ok(mut entries) => entries.next().is_some(),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => false,
        Err(error) => return Err(SynthError::io(&options.out, error)),
    };
    if occupied {
        return Err(SynthError::NotEmpty(options.out.clone()));
    }
    let fail = |error| SynthError::io(&options.out, error);
    let draft = Draft::folder(&options.out).map_err(fail)?;
    let summary = write(options, intrinsics, draft.path(), progress)?;
    draft.commit().map_err(fail)?;
    progress.finish_and_clear();
    Ok(summary)
}

fn write(
    options: &SynthOptions,
    intrinsics: Intrinsics,
    folder: &FilePath,
    progress: &ProgressBar,
) -> Result<SynthSummary, SynthError> {
    let (quality, coarseness) = options.quality();
    let room = room::build(coarseness);
    progress.set_message("lighting the room");
    progress.set_length(light::bake_steps(&room.geometry, quality));
    let baked = light::bake(&room.geometry, &room.lights, quality, &|n| progress.inc(n));
    let lit = Lit {
        room: &room,
        baked: &baked,
    };
    progress.set_message("filming");
    progress.set_position(0);
    progress.set_length(u64::from(options.frames));

    let mut folders = vec!["rgb", "depth"];
    if options.exact_depth {
        folders.push("depth_exact");
    }
    for name in &folders {
        let path = folder.join(name);
        std::fs::create_dir(&path).map_err(|e| SynthError::io(&path, e))?;
    }
    let path = Path::new(options.seed);
    let times: Vec<i64> = (0..options.frames)
        .map(|i| frame_time_ns(i, options.rate_hz))
        .collect();
    let stamps: Vec<i64> = times.iter().map(|t| output::START_NS + t).collect();
    let (width, height) = (intrinsics.width, intrinsics.height);
    let (mut linear, mut clipped, mut holes) = (0f64, 0usize, 0usize);
    for (frame, (&time, &stamp)) in (0u32..).zip(times.iter().zip(&stamps)) {
        let view = View {
            intrinsics,
            pose: path.pose(time as f64 * 1e-9),
        };
        // The noise differs for each seed and frame.
        let noise = frame ^ options.seed.rotate_left(16);
        let rgb: Vec<[u8; 3]> = (0..height)
            .into_par_iter()
            .flat_map_iter(|row| lit.color_row(&view, row, options.samples, noise))
            .collect();
        let exact = sensor::exact_depth(&room.geometry, &view);
        let sensed = sensor::sense(&room.geometry, &view, &exact, noise);
        linear += rgb
            .iter()
            .flatten()
            .map(|&c| f64::from(ghostlight::numerics::linear_from_srgb(c)))
            .sum::<f64>();
        clipped += rgb.iter().filter(|p| p.contains(&255)).count();
        holes += sensed.iter().filter(|&&d| d == 0).count();
        let name = tum_text::stamp(stamp);
        let file = |folder_name: &str, extension: &str| {
            folder.join(folder_name).join(format!("{name}.{extension}"))
        };
        output::write_color(&file("rgb", "jpg"), width, height, &rgb)?;
        output::write_depth(&file("depth", "png"), width, height, &sensed)?;
        if options.exact_depth {
            let units: Vec<u16> = exact.z_m.iter().map(|&z| sensor::units(z)).collect();
            output::write_depth(&file("depth_exact", "png"), width, height, &units)?;
        }
        progress.inc(1);
    }
    write_lists(options, &path, folder, &stamps)?;
    let first = path.pose(0.0).inverse();
    let (u, v) = intrinsics.project(first.transform_point(room::FREE_SPOT));
    let place = [u.round().max(0.0) as u32, v.round().max(0.0) as u32];
    let manifest = output::manifest(options, &intrinsics, &room.lights, place)?;
    output::write_text(&folder.join("manifest.json"), &manifest)?;
    let n = f64::from(options.frames) * intrinsics.n_pixels() as f64;
    Ok(SynthSummary {
        frames: options.frames,
        bytes: folder_bytes(folder)?,
        mean_linear: linear / (3.0 * n),
        clipped_share: clipped as f64 / n,
        hole_share: holes as f64 / n,
    })
}

fn write_lists(
    options: &SynthOptions,
    path: &Path,
    folder: &FilePath,
    stamps: &[i64],
) -> Result<(), SynthError> {
    let mut lists = vec![
        ("rgb", "color images", "jpg"),
        ("depth", "depth maps of a simulated Kinect", "png"),
    ];
    if options.exact_depth {
        lists.push(("depth_exact", "exact depth maps", "png"));
    }
    for (name, title, extension) in lists {
        let text = tum_text::image_list(title, name, extension, stamps);
        output::write_text(&folder.join(format!("{name}.txt")), &text)?;
    }
    // Times of the ground-truth poses: the 100 Hz of a motion-capture system, and the time of every frame.
    let last = stamps.last().copied().unwrap_or(output::START_NS);
    let mut pose_times: Vec<i64> = (0..)
        .map(|k| output::START_NS + k * 10_000_000)
        .take_while(|&t| t < last)
        .chain(stamps.iter().copied())
        .collect();
    pose_times.sort_unstable();
    pose_times.dedup();
    let poses: Vec<_> = pose_times
        .into_iter()
        .map(|t| (t, path.pose((t - output::START_NS) as f64 * 1e-9)))
        .collect();
    output::write_text(
        &folder.join("groundtruth.txt"),
        &tum_text::trajectory(&poses),
    )
}

fn folder_bytes(folder: &FilePath) -> Result<u64, SynthError> {
    let mut bytes = 0;
    for entry in std::fs::read_dir(folder).map_err(|e| SynthError::io(folder, e))? {
        let path = entry.map_err(|e| SynthError::io(folder, e))?.path();
        bytes += if path.is_dir() {
            folder_bytes(&path)?
        } else {
            path.metadata().map_err(|e| SynthError::io(&path, e))?.len()
        };
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests;
