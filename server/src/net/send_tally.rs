//! Counts over all connections of a run of `send`.

use std::collections::BTreeMap;

use ghostlight_proto::Composite;
use ghostlight_proto::control::ErrorReport;

use super::send_config::{Rate, SendConfig};
use super::send_report::{Gathered, Percentiles, SendReport};
use crate::clock;

/// Errors of the server kept for the report.
const MAX_ERRORS: usize = 10;

/// Counts of a run.
#[derive(Default)]
pub(super) struct Tally {
    /// Names of the render stages.
    pub(super) stages: Vec<String>,
    /// Sequence number of the next frame.
    pub(super) next: u64,
    /// Capture times of frames without a reply yet, by sequence number.
    pub(super) under_way: BTreeMap<u64, i64>,
    /// Distinct frames whose composite arrived.
    pub(super) composites: u64,
    /// Bytes of frames sent.
    pub(super) bytes_up: u64,
    /// Times that a lost connection was replaced.
    pub(super) reconnects: u64,
    /// When the first frame was sent, on this machine's clock.
    pub(super) start_ns: i64,
    last_ns: i64,
    bytes_down: u64,
    refused: u64,
    /// Dropped frames and composites: of sessions that have ended, and of the current one.
    dropped_before: [u64; 2],
    dropped: [u64; 2],
    gathered: Gathered,
    errors: Vec<String>,
}

impl Tally {
    /// Counts a composite; `offset_ns` is the server's clock minus this machine's.
    pub(super) fn composite(
        &mut self,
        bytes: &[u8],
        arrived_ns: i64,
        offset_ns: i64,
    ) -> anyhow::Result<()> {
        let header = Composite::decode(bytes)?.header;
        self.bytes_down += bytes.len() as u64;
        self.dropped = [header.dropped_frames, header.dropped_composites];
        // A frame rendered again after a change is not counted twice.
        if let Some(captured_ns) = self.under_way.remove(&header.sequence) {
            self.composites += 1;
            self.last_ns = arrived_ns;
            self.gathered.add(
                captured_ns,
                arrived_ns,
                offset_ns,
                &header.stamps,
                &header.stage_us,
            );
        }
        // Frames come back in order, so earlier ones were dropped on the way.
        self.under_way = self.under_way.split_off(&header.sequence);
        Ok(())
    }

    /// Counts an error of the server that does not end the run.
    pub(super) fn error(&mut self, error: &ErrorReport) {
        if let Some(sequence) = error.sequence {
            self.refused += 1;
            self.under_way.remove(&sequence);
        }
        self.note(format!(
            "{}: expected {}, got {}",
            error.what, error.expected, error.got
        ));
    }

    /// Adds a line to the report, if there is room.
    pub(super) fn note(&mut self, text: String) {
        if self.errors.len() < MAX_ERRORS {
            self.errors.push(text);
        }
    }

    /// The session is over; the next one counts from 0. Frames in flight are lost.
    pub(super) fn session_over(&mut self) {
        for (before, now) in self.dropped_before.iter_mut().zip(&mut self.dropped) {
            *before += std::mem::take(now);
        }
        self.under_way.clear();
    }

    /// The report; `ended` says why the run ended before everything was sent.
    pub(super) fn report(&self, config: &SendConfig, ended: Option<String>) -> SendReport {
        let end_ns = match self.last_ns {
            0 if self.start_ns > 0 => clock::now_ns(),
            last => last,
        };
        let seconds = (end_ns.max(self.start_ns) - self.start_ns) as f64 * 1e-9;
        let [frames_dropped, composites_dropped] =
            [0, 1].map(|i| self.dropped_before[i] + self.dropped[i]);
        let heard = self.composites + frames_dropped + composites_dropped + self.refused;
        SendReport {
            url: config.url.clone(),
            recording: config.recording.display().to_string(),
            rate: match config.rate {
                Rate::Realtime => "realtime",
                Rate::Max => "max",
            },
            seconds,
            frames_sent: self.next,
            composites: self.composites,
            fps: self.composites as f64 / seconds.max(1e-9),
            frames_dropped,
            composites_dropped,
            frames_refused: self.refused,
            frames_lost: self.next.saturating_sub(heard),
            reconnects: self.reconnects,
            ended,
            latency: Percentiles::of(&self.gathered.latency_ns),
            drift_ms: self.gathered.drift_ms(),
            steps: self.gathered.steps(),
            stages: self.gathered.stages(&self.stages),
            bytes_up: self.bytes_up,
            bytes_down: self.bytes_down,
            errors: self.errors.clone(),
        }
    }
}
