//! Reads recordings: folders of colour, depth and poses as RGB-D tools write them, on disk or zipped. The layout is
//! detected by the content, which is checked and read as registered [`RgbdFrame`]s.
//!
//! Each layout has a file that lists the frames, and an entry in the table in `layouts` (`tum`, `seven_scenes`,
//! `open3d`, `folders`, ...). A `Location` is a file or folder, on disk or in an archive, so layouts need not
//! distinguish them. Everything after the listing is shared: decoding, confidence, scaling of intrinsics,
//! registration of depth to colour (`register`).
//!
//! One bad item never makes the rest unreadable. A frame whose pose is lost (not finite, not a rotation, missing), or
//! whose picture is empty, cut, of an unknown format or of another size, is left out when the recording is opened; it
//! is counted and named in a note, and the others keep their times and order. Errors inside a picture are found only
//! when it is decoded: then that frame is an error that [`RecordingError::is_of_frame`] recognises, and a player
//! skips the frame.
//!
//! Colour and depth can be combined if depth is measured by a separate camera with known intrinsics, or if their
//! aspect ratios agree within one per cent (then they are one camera at two resolutions). All colour images of a
//! recording have the same size.

mod align;
mod archive;
mod args;
mod arkit_scenes;
mod camera_file;
mod camera_text;
mod container;
mod error;
mod excerpt;
mod folders;
mod given;
mod inspect;
mod layout;
mod layouts;
mod left_out;
mod location;
mod nerfstudio;
mod numbers;
mod open3d;
mod pictures;
mod polycam;
mod poses;
mod register;
mod replica;
mod rig;
mod scanner_app;
mod seven_scenes;
mod sieve;
mod source;
mod text;
mod times;
mod trajectory;
mod tum;
mod tum_lists;
pub mod tum_text;
mod writer;

pub use args::RecordingArgs;
pub use error::{Place, RecordingError};
pub use inspect::{Alignment, Inspection};
pub use register::register_depth;
pub use writer::{ColorFormat, TumWriter};

use std::path::{Path, PathBuf};

use crate::camera::{Intrinsics, Pose};
use crate::codec::{DepthMap, DepthSamples};
use crate::frame::{ColorImage, DepthImage, RgbdFrame};

use left_out::{LeftOut, name_of};
use location::Location;
use rig::{CameraModel, DepthRays, Rig};

/// Time between frames of recordings without time stamps, nanoseconds: 30 Hz.
const NOMINAL_PERIOD_NS: i64 = 33_333_333;

/// How to read a recording; the [`Default`] works for all known layouts.
#[derive(Debug, Clone)]
pub struct OpenOptions {
    /// `fx fy cx cy` of the colour camera at the size of the colour images; overrides the folder's.
    pub intrinsics: Option<[f64; 4]>,
    /// Depth units per metre; overrides the layout's.
    pub depth_units_per_metre: Option<f64>,
    /// Larger depth is invalid, metres, > 0.
    pub max_depth_m: f32,
    /// Largest difference between the time stamps of a depth frame and its colour frame, nanoseconds. Poses are
    /// interpolated over gaps up to five times as long. A value that is too small loses frames, one that is too large
    /// pairs pictures of different views.
    pub max_time_gap_ns: i64,
    /// Keep depth that the sensor marks as of low confidence.
    pub keep_low_confidence: bool,
    /// Accept a recording without poses; the camera is assumed not to move.
    pub assume_static: bool,
    /// A file of poses of the colour camera, world from camera, which overrides the folder's: TUM, Open3D `.log`,
    /// KITTI (12 or 16 numbers per line) or 4x4 blocks. Poses are matched to pictures by time if both have times,
    /// else by number, else by order.
    pub trajectory: Option<PathBuf>,
    /// `fx fy cx cy` of the depth camera at the size of the depth images: depth is warped into colour.
    pub depth_intrinsics: Option<[f64; 4]>,
    /// Transform from the depth camera's axes to the colour camera's, metres: depth is warped into colour.
    pub color_from_depth: Option<Pose>,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            intrinsics: None,
            depth_units_per_metre: None,
            max_depth_m: 10.0,
            max_time_gap_ns: 20_000_000,
            keep_low_confidence: false,
            assume_static: false,
            trajectory: None,
            depth_intrinsics: None,
            color_from_depth: None,
        }
    }
}

/// A listed frame.
#[derive(Debug, Clone)]
struct Entry {
    color: Location,
    depth: Location,
    /// 8-bit confidence map; 0 is low.
    confidence: Option<Location>,
    time_ns: i64,
    /// Depth stamp minus colour stamp.
    depth_lag_ns: i64,
    /// World from the colour camera.
    pose: Pose,
    /// Intrinsics of this frame, if they vary between frames.
    focal: Option<[f64; 4]>,
}

/// Result of listing a folder.
#[derive(Debug)]
struct Listing {
    /// Name of the layout, for messages.
    layout: &'static str,
    entries: Vec<Entry>,
    rig: Rig,
    depth_units_per_metre: f64,
    /// Whether `time_ns` was measured.
    stamped: bool,
    /// Whether poses were measured for the depth camera. The entries always have poses of the colour camera.
    poses_of_depth: bool,
    /// Largest `|R Rt - I|` of all pose matrices, if poses are matrices.
    pose_deviation: Option<f64>,
    notes: Vec<String>,
}

/// A recording that is open for reading.
#[derive(Debug)]
pub struct Recording {
    root: PathBuf,
    listing: Listing,
    options: OpenOptions,
    intrinsics: Intrinsics,
}

impl Recording {
    /// Name of every layout, and the files that identify it, for messages.
    pub fn layouts() -> impl Iterator<Item = (&'static str, &'static str)> {
        layouts::all()
    }

    /// Whether a path can be opened: a folder, or a zip archive (recognised by its first bytes).
    pub fn is_container(path: &Path) -> bool {
        path.is_dir() || container::is_zip(path)
    }

    /// The error for a file with a recording in an unsupported form (`.bag`, `.mcap`, `.sens`, ...), which says how
    /// to convert it. `None` for other files.
    pub fn container_error(path: &Path) -> Option<RecordingError> {
        container::recognise(&path.into())
    }

    /// Opens a folder or a zip archive of one: detects the layout, reads lists and poses, checks all pictures and
    /// decodes the first decodable frame, so that a recording that opens can be played.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Self, RecordingError> {
        check_options(path, options)?;
        let root = if container::is_zip(path) {
            Location::zip(path)?
        } else {
            std::fs::metadata(path).map_err(|source| RecordingError::Io {
                path: path.to_owned(),
                source,
            })?;
            Location::from(path)
        };
        let mut listing = layouts::list(&root, &given::listing_options(options))?;
        if let Some(units) = options.depth_units_per_metre {
            listing.depth_units_per_metre = units;
        }
        given::apply(&mut listing, &root, options)?;
        sieve::sieve(&mut listing);
        let mut recording = Self {
            root: path.to_owned(),
            options: options.clone(),
            // Replaced below by the intrinsics of the first frame, whose size is known only from its picture.
            intrinsics: Intrinsics {
                fx: 1.0,
                fy: 1.0,
                cx: 0.0,
                cy: 0.0,
                width: 1,
                height: 1,
            },
            listing,
        };
        let first = recording.read_first()?;
        recording.intrinsics = first.intrinsics;
        let k = first.intrinsics;
        let layout_units = recording.listing.depth_units_per_metre;
        let notes = &mut recording.listing.notes;
        if k.cx < -0.5 || k.cy < -0.5 || k.cx > f64::from(k.width) || k.cy > f64::from(k.height) {
            notes.push(format!(
                "The principal point ({:.1}, {:.1}) lies outside the {}x{} image.",
                k.cx, k.cy, k.width, k.height
            ));
        }
        match (&first.units.samples, options.depth_units_per_metre) {
            (DepthSamples::Metres(_), None) => {
                notes.push("Depth is floating point: taken as metres.".to_owned());
            }
            (DepthSamples::Millimetres(_), None) => notes.push(
                "Depth is floating point and mostly over 100: taken as millimetres.".to_owned(),
            ),
            _ => {}
        }
        if first.sensor_depth.invalid_share() == 1.0 {
            let units = options
                .depth_units_per_metre
                .unwrap_or_else(|| first.units.units_per_metre(layout_units));
            notes.push(format!(
                "Warning: the first frame has no valid depth at all (limit {} m, {units} units per metre).",
                options.max_depth_m
            ));
        }
        Ok(recording)
    }

    /// Decodes the first decodable frame; the frames before it are left out.
    fn read_first(&mut self) -> Result<RawFrame, RecordingError> {
        let n = self.listing.entries.len();
        let mut left = LeftOut::default();
        let mut first = None;
        for index in 0..n {
            match self.read(index) {
                Ok(raw) => {
                    first = Some(raw);
                    break;
                }
                Err(error) => left.add(name_of(&self.listing.entries[index].color), error),
            }
        }
        self.listing.entries.drain(..left.count());
        let what = "frames cannot be decoded and are left out";
        left.note(n, what, &mut self.listing.notes);
        first.ok_or_else(|| RecordingError::Empty {
            path: self.root.clone(),
            layout: self.listing.layout,
            reason: match self.listing.notes.as_slice() {
                [] => "nothing is listed".to_owned(),
                notes => notes.join(" "),
            },
        })
    }

    /// Number of frames kept.
    pub fn len(&self) -> usize {
        self.listing.entries.len()
    }

    /// Always false: a recording without frames does not open.
    pub fn is_empty(&self) -> bool {
        self.listing.entries.is_empty()
    }

    /// Name of the layout.
    pub fn layout(&self) -> &'static str {
        self.listing.layout
    }

    /// Notes for people: assumed defaults, frames left out, warnings. One sentence each.
    pub fn notes(&self) -> &[String] {
        &self.listing.notes
    }

    /// Intrinsics of the colour camera in the first frame.
    pub fn intrinsics(&self) -> Intrinsics {
        self.intrinsics
    }

    /// Capture times, nanoseconds, ascending; nominal 30 Hz if the layout has no stamps.
    pub fn times_ns(&self) -> Vec<i64> {
        self.listing.entries.iter().map(|e| e.time_ns).collect()
    }

    /// Poses of the colour camera, world from camera.
    pub fn poses(&self) -> Vec<Pose> {
        self.listing.entries.iter().map(|e| e.pose).collect()
    }

    /// Reads, decodes and registers a frame; `index` counts frames kept, from 0.
    pub fn frame(&self, index: usize) -> Result<RgbdFrame, RecordingError> {
        let raw = self.read_checked(index)?;
        let depth = register_depth(
            raw.sensor_depth,
            &raw.depth_intrinsics,
            &raw.color_from_depth,
            &raw.intrinsics,
        );
        let entry = &self.listing.entries[index];
        Ok(RgbdFrame {
            index: index as u64,
            time_ns: entry.time_ns,
            color: raw.color,
            depth,
            intrinsics: raw.intrinsics,
            pose: entry.pose,
        })
    }

    /// Inspects the recording's content and notes unusual content; decodes a sample of frames.
    pub fn inspect(&self) -> Result<Inspection, RecordingError> {
        inspect::inspect(self)
    }

    /// A frame before registration, checked to have the size of the recording.
    fn read_checked(&self, index: usize) -> Result<RawFrame, RecordingError> {
        let raw = self.read(index)?;
        let (width, height) = (self.intrinsics.width, self.intrinsics.height);
        if (raw.color.width, raw.color.height) != (width, height) {
            return Err(Place::file(&self.listing.entries[index].color).field(
                "image size",
                format!("{width}x{height} as in the first frame"),
                format!("{}x{}", raw.color.width, raw.color.height),
            ));
        }
        Ok(raw)
    }

    /// A frame before registration.
    fn read(&self, index: usize) -> Result<RawFrame, RecordingError> {
        let len = self.listing.entries.len();
        let entry = self
            .listing
            .entries
            .get(index)
            .ok_or(RecordingError::Index { index, len })?;
        let color = entry.color.color()?;
        let units = entry.depth.depth()?;
        let intrinsics =
            self.color_camera(entry)
                .for_image(color.width, color.height, &entry.color)?;
        let (depth_intrinsics, color_from_depth) = match &self.listing.rig.depth {
            DepthRays::Own {
                camera,
                color_from_depth,
            } => (
                camera.for_image(units.width, units.height, &entry.depth)?,
                *color_from_depth,
            ),
            DepthRays::Registered => (
                registered_camera(&intrinsics, &units, &entry.depth)?,
                Pose::IDENTITY,
            ),
        };
        let units_per_metre = self.units_per_metre(&units);
        let mut sensor_depth = units.to_image(units_per_metre, self.options.max_depth_m);
        if let Some(file) = &entry.confidence
            && !self.options.keep_low_confidence
        {
            drop_low_confidence(&mut sensor_depth, file)?;
        }
        Ok(RawFrame {
            color,
            units,
            sensor_depth,
            intrinsics,
            depth_intrinsics,
            color_from_depth,
        })
    }

    /// Depth units per metre of a depth image: the caller's value, else the one of the file's format.
    fn units_per_metre(&self, depth: &DepthMap) -> f64 {
        let layout = self.listing.depth_units_per_metre;
        let said = self.options.depth_units_per_metre;
        said.unwrap_or_else(|| depth.units_per_metre(layout))
    }

    fn color_camera(&self, entry: &Entry) -> CameraModel {
        let mut camera = self.listing.rig.color.clone();
        if let Some(focal) = entry.focal {
            camera.focal = focal;
        }
        camera
    }
}

/// A frame before registration.
struct RawFrame {
    color: ColorImage,
    units: DepthMap,
    sensor_depth: DepthImage,
    intrinsics: Intrinsics,
    depth_intrinsics: Intrinsics,
    color_from_depth: Pose,
}

/// The colour camera at the resolution of registered depth.
fn registered_camera(
    color: &Intrinsics,
    depth: &DepthMap,
    file: &Location,
) -> Result<Intrinsics, RecordingError> {
    let (size, color_size) = ((depth.width, depth.height), (color.width, color.height));
    if size == color_size {
        return Ok(*color);
    }
    if !rig::same_aspect(size, color_size) {
        return Err(Place::file(file).field(
            "depth size",
            format!(
                "{}x{} or its aspect ratio, as the colour image",
                color.width, color.height
            ),
            format!("{}x{}", depth.width, depth.height),
        ));
    }
    color
        .scaled_to(depth.width, depth.height)
        .map_err(|e| Place::file(file).camera(e))
}

fn drop_low_confidence(depth: &mut DepthImage, file: &Location) -> Result<(), RecordingError> {
    let confidence = file.gray8()?;
    if (confidence.width, confidence.height) != (depth.width, depth.height) {
        return Err(Place::file(file).field(
            "confidence size",
            format!("{}x{} as the depth image", depth.width, depth.height),
            format!("{}x{}", confidence.width, confidence.height),
        ));
    }
    for (z, confidence) in depth.z_m.iter_mut().zip(confidence.values) {
        if confidence == 0 {
            *z = DepthImage::INVALID;
        }
    }
    Ok(())
}

fn check_options(path: &Path, options: &OpenOptions) -> Result<(), RecordingError> {
    let place = Place::file(path);
    if let Some(focal) = options.intrinsics {
        text::check_focal(focal, &place)?;
    }
    if let Some(units) = options.depth_units_per_metre {
        rig::check_units(units, &place)?;
    }
    if options.max_depth_m.is_nan() || options.max_depth_m <= 0.0 {
        let got = options.max_depth_m.to_string();
        return Err(place.field("largest depth", "a number of metres > 0", got));
    }
    if options.max_time_gap_ns < 0 {
        let got = options.max_time_gap_ns.to_string();
        return Err(place.field("largest time gap", "nanoseconds >= 0", got));
    }
    Ok(())
}

#[cfg(test)]
mod tests;
