//! Writes recordings in the TUM layout, which `tum` reads.

use std::path::{Path, PathBuf};

use crate::camera::Pose;
use crate::codec::png::Effort;
use crate::codec::{DepthUnits, jpeg, png};
use crate::frame::ColorImage;

use super::error::{Place, RecordingError};
use super::tum_text;

/// How colour is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColorFormat {
    /// Lossless.
    Png,
    /// Lossy, quality 1..=100.
    Jpeg(u8),
}

impl ColorFormat {
    fn extension(self) -> &'static str {
        match self {
            Self::Png => "png",
            Self::Jpeg(_) => "jpg",
        }
    }
}

/// Writes a TUM recording frame by frame; the lists are written last, so that an incomplete recording is not mistaken
/// for a complete one.
#[derive(Debug)]
pub struct TumWriter {
    root: PathBuf,
    color: ColorFormat,
    /// Poses of the frames written so far.
    poses: Vec<(i64, Pose)>,
}

impl TumWriter {
    /// Creates the folder with `rgb/` and `depth/`. The folder must not contain a TUM recording.
    pub fn create(root: &Path, color: ColorFormat) -> Result<Self, RecordingError> {
        for name in ["rgb.txt", "depth.txt", "groundtruth.txt"] {
            let path = root.join(name);
            if path.exists() {
                return Err(Place::file(&path).field(
                    "output",
                    "a new recording's folder",
                    "one that holds a recording",
                ));
            }
        }
        for folder in ["rgb", "depth"] {
            let path = root.join(folder);
            std::fs::create_dir_all(&path).map_err(|source| RecordingError::Io { path, source })?;
        }
        Ok(Self {
            root: root.to_owned(),
            color,
            poses: Vec::new(),
        })
    }

    /// Adds a frame: colour, registered depth (5000 units per metre unless the folder's `manifest.json` says
    /// otherwise, 0 is invalid), capture time (ascending, nanoseconds, stored in microseconds) and world-from-camera
    /// pose.
    pub fn push(
        &mut self,
        color: &ColorImage,
        depth: &DepthUnits,
        time_ns: i64,
        pose: &Pose,
    ) -> Result<(), RecordingError> {
        let micros = time_ns.div_euclid(1000);
        if time_ns < 0
            || self
                .poses
                .last()
                .is_some_and(|(last, _)| micros <= last.div_euclid(1000))
        {
            let expected = "ascending nanoseconds >= 0, at least a microsecond apart";
            return Err(Place::file(&self.root).field(
                "time of a frame",
                expected,
                time_ns.to_string(),
            ));
        }
        let stamp = tum_text::stamp(time_ns);
        let bytes = match self.color {
            ColorFormat::Jpeg(quality) => jpeg::encode(color, quality)?,
            ColorFormat::Png => {
                let rgb: Vec<u8> = color
                    .rgba
                    .iter()
                    .flat_map(|&[r, g, b, _]| [r, g, b])
                    .collect();
                png::encode_rgb8(color.width, color.height, &rgb, Effort::Small)?
            }
        };
        let depth_png = png::encode_gray16(depth.width, depth.height, &depth.units, Effort::Small)?;
        let extension = self.color.extension();
        self.write(&format!("rgb/{stamp}.{extension}"), &bytes)?;
        self.write(&format!("depth/{stamp}.png"), &depth_png)?;
        self.poses.push((time_ns, *pose));
        Ok(())
    }

    /// Writes the lists.
    pub fn finish(self) -> Result<(), RecordingError> {
        let times: Vec<i64> = self.poses.iter().map(|(time, _)| *time).collect();
        let depth_txt = tum_text::image_list("depth maps", "depth", "png", &times);
        let rgb_txt = tum_text::image_list("color images", "rgb", self.color.extension(), &times);
        let groundtruth_txt = tum_text::trajectory(&self.poses);
        self.write("groundtruth.txt", groundtruth_txt.as_bytes())?;
        self.write("depth.txt", depth_txt.as_bytes())?;
        self.write("rgb.txt", rgb_txt.as_bytes())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), RecordingError> {
        let path = self.root.join(name);
        std::fs::write(&path, bytes).map_err(|source| RecordingError::Io { path, source })
    }
}
