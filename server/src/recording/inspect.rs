//! Content of a recording, and notes on unusual content.

use std::fmt;

use serde::Serialize;

use crate::frame::{DepthImage, is_valid_depth};
use crate::numerics::percentile;

use super::Recording;
use super::align::{Aligner, Peak};
use super::error::RecordingError;
use super::left_out::{LeftOut, name_of};
use super::register::register_depth;
use super::rig::DepthRays;

/// Number of frames decoded for an inspection, evenly spread.
const SAMPLE_FRAMES: usize = 12;
/// A pause longer than this many median frame periods is a gap.
const GAP_FACTOR: f64 = 1.5;
/// Depth counts as registered if its edges are within this distance of colour edges, pixels of a 640-pixel image: a
/// Kinect's depth edges vary by two to three pixels, and its factory registration is off by up to four in the TUM
/// benchmark; unregistered sensors are off by fifteen and more.
const REGISTERED_PX: f64 = 5.0;
/// Least contrast of the best shift relative to the median shift; below it, the alignment is unclear.
const CLEAR_CONTRAST: f64 = 1.25;
/// Share of invalid depth above which it is reported as unusual.
const MUCH_INVALID: f64 = 0.4;
/// Deviation from a rotation above which a pose is reported as approximate; matrices in f32 printed with six digits
/// have less.
const ROUNDED_ROTATION: f64 = 1e-5;

/// Alignment of depth edges with colour edges.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "verdict")]
pub enum Alignment {
    /// Too few depth edges, or none with a colour edge.
    Unclear,
    /// Depth edges lie on colour edges.
    Registered {
        /// Best shift of depth onto colour, pixels.
        shift_px: (i32, i32),
    },
    /// Depth edges lie beside colour edges.
    Off {
        /// Best shift of depth onto colour, pixels; differs with depth.
        shift_px: (i32, i32),
    },
}

/// The result of [`Recording::inspect`]. `Display` is for people, `Serialize` for programs.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// The folder.
    pub path: String,
    /// Layout name.
    pub layout: &'static str,
    /// Frames kept.
    pub frames: usize,
    /// Colour width and height, pixels.
    pub color_size: (u32, u32),
    /// Depth width and height as stored, pixels.
    pub depth_size: (u32, u32),
    /// First to last frame, seconds.
    pub duration_s: f64,
    /// Frames per second (median period), 0 for a single frame.
    pub rate_hz: f64,
    /// Whether frames have time stamps; if not, 30 Hz is assumed.
    pub stamped: bool,
    /// Number of pauses longer than one and a half periods.
    pub gaps: usize,
    /// Longest pause between frames, milliseconds.
    pub longest_pause_ms: f64,
    /// `fx fy cx cy` of the colour camera, pixels.
    pub intrinsics: [f64; 4],
    /// Source of the intrinsics.
    pub intrinsics_origin: String,
    /// Intrinsics of the depth camera and their source, if it is a separate camera.
    pub depth_intrinsics: Option<String>,
    /// Depth units per metre.
    pub depth_units_per_metre: f64,
    /// Length of the camera's path, metres.
    pub path_length_m: f64,
    /// Sum of the camera's rotations between frames, degrees.
    pub turn_deg: f64,
    /// Depth of the sampled frames, metres: 1st percentile, median, 99th percentile; `None` without valid depth.
    pub depth_m: Option<[f64; 3]>,
    /// Share of stored depth that is invalid, 0..=1: minimum, mean and maximum over the sampled frames.
    pub invalid_share: [f64; 3],
    /// Mean share of colour pixels without depth after registration, 0..=1.
    pub uncovered_share: f64,
    /// Difference between depth stamp and colour stamp, milliseconds: median and maximum; `None` without stamps.
    pub color_depth_ms: Option<[f64; 2]>,
    /// Alignment of depth with colour, after registration.
    pub alignment: Alignment,
    /// The same before registration, if depth has a separate camera.
    pub alignment_before: Option<Alignment>,
    /// Number of frames decoded for the inspection.
    pub sampled: usize,
    /// Assumed defaults, and frames left out.
    pub notes: Vec<String>,
    /// Notes on unusual content.
    pub oddities: Vec<String>,
}

pub(super) fn inspect(recording: &Recording) -> Result<Inspection, RecordingError> {
    let listing = &recording.listing;
    let n = recording.len();
    let k = recording.intrinsics;
    let mut sample = Sample::new(k.width);
    let indices: Vec<usize> = match n.min(SAMPLE_FRAMES) {
        1 => vec![0],
        count => (0..count).map(|i| i * (n - 1) / (count - 1)).collect(),
    };
    let mut unread = LeftOut::default();
    for &index in &indices {
        match sample.add(recording, index) {
            Ok(()) => {}
            Err(error) if error.is_of_frame() => {
                unread.add(name_of(&recording.listing.entries[index].color), error);
            }
            Err(error) => return Err(error),
        }
    }
    let mut notes = listing.notes.clone();
    let what = "sampled frames cannot be decoded; a replay leaves such frames out";
    unread.note(indices.len(), what, &mut notes);
    let sampled = indices.len() - unread.count();
    let times = recording.times_ns();
    let mut periods: Vec<f64> = times
        .windows(2)
        .map(|t| t[1].saturating_sub(t[0]) as f64 * 1e-9)
        .collect();
    periods.sort_by(f64::total_cmp);
    // The lower median: of two periods, the longer one is the gap.
    let period = (periods.len().checked_sub(1)).map_or(0.0, |last| periods[last / 2]);
    let entries = &listing.entries;
    let steps = entries.windows(2).map(|e| (e[0].pose, e[1].pose));
    let mut lags: Vec<f64> = entries
        .iter()
        .map(|e| e.depth_lag_ns.abs() as f64 * 1e-6)
        .collect();
    lags.sort_by(f64::total_cmp);
    let own_camera = match &listing.rig.depth {
        DepthRays::Own { camera, .. } => Some(camera),
        DepthRays::Registered => None,
    };
    let focal = |[fx, fy, cx, cy]: [f64; 4]| format!("fx {fx:.2} fy {fy:.2} cx {cx:.2} cy {cy:.2}");
    sample.depths.sort_by(f32::total_cmp);
    let at = |p| percentile(&sample.depths, p).map(f64::from);
    let mut inspection = Inspection {
        path: recording.root.display().to_string(),
        layout: listing.layout,
        frames: n,
        color_size: (k.width, k.height),
        depth_size: sample.depth_size,
        duration_s: (times[n - 1].saturating_sub(times[0])) as f64 * 1e-9,
        rate_hz: if period > 0.0 { 1.0 / period } else { 0.0 },
        stamped: listing.stamped,
        gaps: periods.iter().filter(|&&p| p > GAP_FACTOR * period).count(),
        longest_pause_ms: periods.last().map_or(0.0, |p| p * 1e3),
        intrinsics: [k.fx, k.fy, k.cx, k.cy],
        intrinsics_origin: listing.rig.color.origin.clone(),
        depth_intrinsics: own_camera.map(|c| format!("{} ({})", focal(c.focal), c.origin)),
        depth_units_per_metre: sample.units_per_metre,
        path_length_m: steps
            .clone()
            .map(|(a, b)| a.translation.distance(b.translation))
            .sum(),
        turn_deg: steps
            .map(|(a, b)| a.rotation.angle_between(b.rotation).to_degrees())
            .sum(),
        depth_m: at(0.01)
            .zip(at(0.5))
            .zip(at(0.99))
            .map(|((low, mid), high)| [low, mid, high]),
        invalid_share: sample.invalid_share(),
        uncovered_share: sample.uncovered / sampled.max(1) as f64,
        color_depth_ms: percentile(&lags, 0.5)
            .zip(lags.last().copied())
            .filter(|_| listing.stamped)
            .map(|(a, b)| [a, b]),
        alignment: verdict(sample.after.peak(), k.width),
        alignment_before: own_camera.map(|_| verdict(sample.before.peak(), k.width)),
        sampled,
        notes,
        oddities: sample.oddities(recording.options.max_depth_m),
    };
    general_oddities(&mut inspection, listing.pose_deviation);
    Ok(inspection)
}

fn general_oddities(inspection: &mut Inspection, pose_deviation: Option<f64>) {
    let mut odd = Vec::new();
    if let Some(deviation) = pose_deviation.filter(|d| *d > ROUNDED_ROTATION) {
        odd.push(format!("Rotations are only approximate (|R Rt - I| up to {deviation:.1e}); they were re-orthonormalised."));
    }
    let mean_invalid = inspection.invalid_share[1];
    if mean_invalid > MUCH_INVALID {
        odd.push(format!(
            "Much of the depth is invalid ({:.0} %).",
            mean_invalid * 100.0
        ));
    }
    if mean_invalid == 0.0 {
        odd.push(
            "No invalid depth at all: it was smoothed or filled before it was recorded.".to_owned(),
        );
    }
    if inspection.path_length_m == 0.0 && inspection.frames > 1 {
        odd.push("The camera never moves.".to_owned());
    }
    if let Alignment::Off { shift_px: (dx, dy) } = inspection.alignment {
        odd.push(format!("Depth edges lie about {:.0} px beside colour edges: depth may not be registered to colour.", f64::from(dx).hypot(f64::from(dy))));
    }
    inspection.oddities.splice(0..0, odd);
}

/// Sums over the sampled frames.
struct Sample {
    depths: Vec<f32>,
    invalid: Vec<f64>,
    uncovered: f64,
    depth_size: (u32, u32),
    after: Aligner,
    before: Aligner,
    /// Units per metre of the last frame.
    units_per_metre: f64,
    n_units: usize,
    /// Number of depth pixels beyond the requested range.
    far: usize,
    /// Frames with pixels of 65535, and the number of these pixels.
    saturated: Vec<(usize, usize)>,
    /// Frames without any valid depth.
    blind: Vec<usize>,
}

impl Sample {
    fn new(width: u32) -> Self {
        Self {
            depths: Vec::new(),
            invalid: Vec::new(),
            uncovered: 0.0,
            depth_size: (0, 0),
            after: Aligner::new(width),
            before: Aligner::new(width),
            units_per_metre: 1.0,
            n_units: 0,
            far: 0,
            saturated: Vec::new(),
            blind: Vec::new(),
        }
    }

    fn add(&mut self, recording: &Recording, index: usize) -> Result<(), RecordingError> {
        // One in this many depths is sampled for the percentiles.
        const STRIDE: usize = 17;
        let raw = recording.read_checked(index)?;
        let (width, height) = (raw.units.width, raw.units.height);
        let max_m = recording.options.max_depth_m;
        self.units_per_metre = recording.units_per_metre(&raw.units);
        let limit = f64::from(max_m) * self.units_per_metre;
        self.n_units += raw.sensor_depth.z_m.len();
        self.far += raw.units.n_beyond(limit);
        let saturated = raw.units.n_saturated();
        if saturated > 0 {
            self.saturated.push((index, saturated));
        }
        let invalid = raw.sensor_depth.invalid_share();
        if invalid == 1.0 {
            self.blind.push(index);
        }
        self.invalid.push(invalid);
        self.depth_size = (width, height);
        self.depths.extend(
            raw.sensor_depth
                .z_m
                .iter()
                .copied()
                .step_by(STRIDE)
                .filter(|&z| is_valid_depth(z)),
        );
        if let DepthRays::Own { .. } = recording.listing.rig.depth {
            self.before.add(
                &raw.color,
                &stretched(&raw.sensor_depth, raw.color.width, raw.color.height),
            );
        }
        let depth = register_depth(
            raw.sensor_depth,
            &raw.depth_intrinsics,
            &raw.color_from_depth,
            &raw.intrinsics,
        );
        self.uncovered += depth.invalid_share();
        self.after.add(&raw.color, &depth);
        Ok(())
    }

    fn oddities(&self, max_m: f32) -> Vec<String> {
        // Every sensor has a few outlier pixels.
        const WORTH_A_WORD: f64 = 1e-3;
        let mut odd = Vec::new();
        if !self.saturated.is_empty() {
            let pixels: usize = self.saturated.iter().map(|(_, n)| n).sum();
            let frames: Vec<String> = self.saturated.iter().map(|(i, _)| i.to_string()).collect();
            odd.push(format!(
                "{pixels} depth pixels are 65535, treated as invalid (sampled frames {}).",
                frames.join(", ")
            ));
        }
        let far = self.far as f64 / self.n_units.max(1) as f64;
        if far > WORTH_A_WORD {
            odd.push(format!(
                "{:.1} % of depth lies beyond {max_m} m, treated as invalid.",
                far * 100.0
            ));
        }
        if !self.blind.is_empty() {
            let frames: Vec<String> = self.blind.iter().map(ToString::to_string).collect();
            odd.push(format!(
                "No valid depth at all in sampled frames {}.",
                frames.join(", ")
            ));
        }
        odd
    }

    fn invalid_share(&self) -> [f64; 3] {
        let mean = self.invalid.iter().sum::<f64>() / self.invalid.len().max(1) as f64;
        let least = self.invalid.iter().copied().fold(1.0, f64::min);
        [
            least,
            mean,
            self.invalid.iter().copied().fold(0.0, f64::max),
        ]
    }
}

/// Depth scaled to the size of colour, without any other registration.
fn stretched(depth: &DepthImage, width: u32, height: u32) -> DepthImage {
    let at = |i: u32, to: u32, from: u32| (u64::from(i) * u64::from(from) / u64::from(to)) as usize;
    let pixels = (0..height).flat_map(|y| {
        let row = at(y, height, depth.height) * depth.width as usize;
        (0..width).map(move |x| depth.z_m[row + at(x, width, depth.width)])
    });
    DepthImage::from_metres(width, height, pixels.collect())
}

fn verdict(peak: Option<Peak>, width: u32) -> Alignment {
    let Some(peak) = peak.filter(|p| p.contrast_best >= CLEAR_CONTRAST * p.contrast_median) else {
        return Alignment::Unclear;
    };
    let (dx, dy) = peak.shift_px;
    let shift = f64::from(dx).hypot(f64::from(dy)) * 640.0 / f64::from(width.max(1));
    // If the current position is nearly as good as the best one, alignment is not reported as off.
    let good_here = peak.contrast_here - peak.contrast_median
        >= 0.9 * (peak.contrast_best - peak.contrast_median);
    if shift <= REGISTERED_PX || good_here {
        Alignment::Registered {
            shift_px: peak.shift_px,
        }
    } else {
        Alignment::Off {
            shift_px: peak.shift_px,
        }
    }
}

impl fmt::Display for Alignment {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unclear => f.write_str("is unclear from these frames"),
            Self::Registered { shift_px: (dx, dy) } => {
                write!(f, "depth looks registered (best shift {dx:+} {dy:+} px)")
            }
            Self::Off { shift_px: (dx, dy) } => {
                let length = f64::from(*dx).hypot(f64::from(*dy));
                write!(f, "depth looks off by about {length:.0} px ({dx:+} {dy:+})")
            }
        }
    }
}

impl fmt::Display for Inspection {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut row = |name: &str, value: String| writeln!(f, "{name:<14}{value}");
        let ((cw, ch), (dw, dh)) = (self.color_size, self.depth_size);
        let [fx, fy, cx, cy] = self.intrinsics;
        row("recording", self.path.clone())?;
        row("layout", self.layout.to_owned())?;
        row("frames", format!("{}", self.frames))?;
        row("size", format!("colour {cw}x{ch}, depth {dw}x{dh}"))?;
        let nominal = if self.stamped {
            ""
        } else {
            " (no time stamps: nominal)"
        };
        row(
            "duration",
            format!(
                "{:.2} s at {:.1} Hz{nominal}",
                self.duration_s, self.rate_hz
            ),
        )?;
        row(
            "gaps",
            format!(
                "{}, longest pause {:.0} ms",
                self.gaps, self.longest_pause_ms
            ),
        )?;
        row(
            "intrinsics",
            format!(
                "fx {fx:.2} fy {fy:.2} cx {cx:.2} cy {cy:.2} ({})",
                self.intrinsics_origin
            ),
        )?;
        if let Some(depth) = &self.depth_intrinsics {
            row("depth camera", depth.clone())?;
        }
        row(
            "camera path",
            format!("{:.3} m, {:.1} degrees", self.path_length_m, self.turn_deg),
        )?;
        row(
            "depth",
            match self.depth_m {
                Some([low, mid, high]) => format!(
                    "{low:.2} to {high:.2} m, median {mid:.2} m ({} units per metre)",
                    self.depth_units_per_metre
                ),
                None => format!(
                    "none valid ({} units per metre)",
                    self.depth_units_per_metre
                ),
            },
        )?;
        let [least, mean, most] = self.invalid_share.map(|share| share * 100.0);
        row(
            "invalid depth",
            format!(
                "{mean:.1} % ({least:.1} to {most:.1}); {:.1} % of colour pixels without depth",
                self.uncovered_share * 100.0
            ),
        )?;
        if let Some([median, largest]) = self.color_depth_ms {
            row(
                "colour-depth",
                format!("{median:.1} ms apart, at most {largest:.1} ms"),
            )?;
        }
        row("alignment", self.alignment.to_string())?;
        if let Some(before) = self.alignment_before {
            row("  as recorded", before.to_string())?;
        }
        row("sampled", format!("{} frames", self.sampled))?;
        for (name, list) in [("note", &self.notes), ("odd", &self.oddities)] {
            for text in list {
                row(name, text.clone())?;
            }
        }
        Ok(())
    }
}
