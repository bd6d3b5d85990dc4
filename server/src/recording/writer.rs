//! Writes recordings in the TUM layout, as `tum` reads them.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use crate::camera::Pose;
use crate::codec::png::Effort;
use crate::codec::{DepthUnits, jpeg, png};
use crate::frame::ColorImage;

use super::error::{Place, RecordingError};

/// How colour is stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColorFormat {
    /// Lossless.
    Png,
    /// Lossy, quality 1..=100.
    Jpeg(u8),
}

/// Writes a TUM recording frame by frame; the lists come last, so that a recording cut short is
/// not taken for a whole one.
#[derive(Debug)]
pub struct TumWriter {
    root: PathBuf,
    color: ColorFormat,
    rgb_txt: String,
    depth_txt: String,
    groundtruth_txt: String,
    last_time_ns: Option<i64>,
}

impl TumWriter {
    /// Makes the folder and its `rgb/` and `depth/`. The folder must not hold a TUM recording
    /// already.
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
            rgb_txt: "# timestamp filename\n".to_owned(),
            depth_txt: "# timestamp filename\n".to_owned(),
            groundtruth_txt: "# timestamp tx ty tz qx qy qz qw\n".to_owned(),
            last_time_ns: None,
        })
    }

    /// Adds a frame: colour, registered depth (5000 units per metre unless the folder's
    /// `manifest.json` says otherwise, 0 invalid), capture time (ascending, nanoseconds, kept to
    /// the microsecond) and world-from-camera pose.
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
                .last_time_ns
                .is_some_and(|last| micros <= last.div_euclid(1000))
        {
            let expected = "ascending nanoseconds >= 0, at least a microsecond apart";
            return Err(Place::file(&self.root).field(
                "time of a frame",
                expected,
                time_ns.to_string(),
            ));
        }
        let stamp = format!("{}.{:06}", micros / 1_000_000, micros % 1_000_000);
        let (extension, bytes) = match self.color {
            ColorFormat::Jpeg(quality) => ("jpg", jpeg::encode(color, quality)?),
            ColorFormat::Png => {
                let rgb: Vec<u8> = color
                    .rgba
                    .iter()
                    .flat_map(|&[r, g, b, _]| [r, g, b])
                    .collect();
                (
                    "png",
                    png::encode_rgb8(color.width, color.height, &rgb, Effort::Small)?,
                )
            }
        };
        let rgb_name = format!("rgb/{stamp}.{extension}");
        let depth_name = format!("depth/{stamp}.png");
        let depth_png = png::encode_gray16(depth.width, depth.height, &depth.units, Effort::Small)?;
        self.write(&rgb_name, &bytes)?;
        self.write(&depth_name, &depth_png)?;
        let (t, q) = (pose.translation, pose.rotation);
        // Writing to a string cannot fail.
        let _ = writeln!(self.rgb_txt, "{stamp} {rgb_name}");
        let _ = writeln!(self.depth_txt, "{stamp} {depth_name}");
        // Micrometres and 1e-9 of a turn: the noise of no tracker.
        let _ = writeln!(
            self.groundtruth_txt,
            "{stamp} {:.6} {:.6} {:.6} {:.9} {:.9} {:.9} {:.9}",
            t.x, t.y, t.z, q.x, q.y, q.z, q.w
        );
        self.last_time_ns = Some(time_ns);
        Ok(())
    }

    /// Writes the lists.
    pub fn finish(self) -> Result<(), RecordingError> {
        self.write("groundtruth.txt", self.groundtruth_txt.as_bytes())?;
        self.write("depth.txt", self.depth_txt.as_bytes())?;
        self.write("rgb.txt", self.rgb_txt.as_bytes())
    }

    fn write(&self, name: &str, bytes: &[u8]) -> Result<(), RecordingError> {
        let path = self.root.join(name);
        std::fs::write(&path, bytes).map_err(|source| RecordingError::Io { path, source })
    }
}
