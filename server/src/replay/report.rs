//! Times, counts and hashes of a replay, as JSON.

use serde::ser::{Serialize, SerializeMap, Serializer};
use twox_hash::XxHash3_128;

use super::{Rendered, Stage};
use crate::numerics::percentile;
use crate::render::{Backend, FrameStats, Lowered};

/// Stage of reading and decoding in [`FrameReport::stages_ms`].
pub(super) const READ: &str = "read";
/// Stage of encoding and writing.
pub(super) const WRITE: &str = "write";

/// Milliseconds for each named stage, in the order in which they ran; a JSON object.
#[derive(Debug, Clone, PartialEq)]
pub struct StageTimes(Vec<(&'static str, f64)>);

impl StageTimes {
    /// Milliseconds of a stage, by its name.
    pub fn get(&self, name: &str) -> Option<f64> {
        let found = self.0.iter().find(|(stage, _)| *stage == name);
        found.map(|&(_, ms)| ms)
    }
}

impl Serialize for StageTimes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut map = serializer.serialize_map(Some(self.0.len()))?;
        for (name, ms) in &self.0 {
            map.serialize_entry(name, ms)?;
        }
        map.end()
    }
}

/// One frame.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct FrameReport {
    /// Index of the frame; frames left out when the recording was opened do not count.
    pub index: usize,
    /// XXH3, 128 bits with seed 0, of the composite's RGBA bytes, rows from the top; 32
    /// hexadecimal digits (what `xxhsum -H2` prints for those bytes).
    pub hash: String,
    /// Time from decoded frame to finished RGBA.
    pub total_ms: f64,
    /// Every stage of [`Stage::ALL`]; also `read` and `write`, which are not part of `total_ms`.
    pub stages_ms: StageTimes,
    /// Counts of the frame.
    pub stats: FrameStats,
    /// Settings reduced to keep `budget_ms`; absent if none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lowered: Vec<Lowered>,
}

impl FrameReport {
    pub(super) fn new(index: usize, rendered: &Rendered) -> Self {
        let ms = |ns: u64| ns as f64 * 1e-6;
        let stages = Stage::ALL.iter().zip(rendered.stage_ns);
        Self {
            index,
            hash: format!("{:032x}", XxHash3_128::oneshot(rendered.color.bytes())),
            total_ms: ms(rendered.total_ns),
            stages_ms: StageTimes(stages.map(|(stage, ns)| (stage.name(), ms(ns))).collect()),
            stats: rendered.stats,
            lowered: rendered.lowered.clone(),
        }
    }

    pub(super) fn add_stage(&mut self, name: &'static str, ms: f64) {
        self.stages_ms.0.push((name, ms));
    }
}

/// A frame that could not be read.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct LeftOut {
    /// Index of the frame, counted like [`FrameReport::index`]; no picture with this number was written.
    pub index: usize,
    /// Why, in one line.
    pub reason: String,
}

/// Summary of all frames.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct Summary {
    /// Frames rendered.
    pub frames: usize,
    /// Median of `total_ms`.
    pub median_ms: f64,
    /// 95th percentile of `total_ms` (nearest rank).
    pub p95_ms: f64,
    /// 1000 / `median_ms`.
    pub fps: f64,
}

/// The report of a replay.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Report {
    /// Rendering backend.
    pub backend: Backend,
    /// Per frame, in order.
    pub frames: Vec<FrameReport>,
    /// Frames that could not be read, in order; absent if none.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<LeftOut>,
    /// Summary of all frames.
    pub summary: Summary,
}

impl Report {
    pub(super) fn new(backend: Backend, frames: Vec<FrameReport>, left_out: Vec<LeftOut>) -> Self {
        let mut times: Vec<f64> = frames.iter().map(|frame| frame.total_ms).collect();
        times.sort_by(f64::total_cmp);
        let n = times.len();
        let at = |i: usize| times.get(i).copied().unwrap_or(0.0);
        let median_ms = (at(n / 2) + at(n.saturating_sub(1) / 2)) * 0.5;
        Self {
            backend,
            summary: Summary {
                frames: n,
                median_ms,
                p95_ms: percentile(&times, 0.95).unwrap_or(0.0),
                // The clock may be too coarse for an empty scene: at least a nanosecond is assumed.
                fps: 1e3 / median_ms.max(1e-6),
            },
            frames,
            left_out,
        }
    }

    pub(super) fn to_json(&self) -> String {
        // The report has only numbers, strings and string keys, so serializing it cannot fail.
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }
}
