//! Measurements of a run of `send`.

use std::fmt;

use ghostlight_proto::Stamps;
use serde::{Serialize, Serializer};

use crate::numerics::percentile;

/// Order statistics of a duration, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Percentiles {
    /// The median.
    pub median_ms: f64,
    /// The 95th percentile.
    pub p95_ms: f64,
    /// The 99th percentile.
    pub p99_ms: f64,
    /// The longest.
    pub max_ms: f64,
}

impl Percentiles {
    /// Percentiles (nearest rank) of nanoseconds in any order; all zero if there are none.
    pub fn of(samples_ns: &[i64]) -> Self {
        let mut sorted = samples_ns.to_vec();
        sorted.sort_unstable();
        let at = |share: f64| {
            let ns = percentile(&sorted, share);
            ns.map_or(0.0, |ns| ns as f64 * 1e-6)
        };
        Self {
            median_ms: at(0.5),
            p95_ms: at(0.95),
            p99_ms: at(0.99),
            max_ms: at(1.0),
        }
    }
}

/// Steps from capture to the composite's arrival, in order; they add up to `total`.
const STEPS: [&str; 9] = [
    "upload", "wait", "decode", "queue", "render", "credit", "encode", "write", "download",
];

/// The outcome of a run.
#[derive(Debug, Clone, Serialize)]
pub struct SendReport {
    /// URL of the server.
    pub url: String,
    /// Path of the recording.
    pub recording: String,
    /// `realtime` or `max`.
    pub rate: &'static str,
    /// Time from the first frame sent to the last composite, seconds.
    pub seconds: f64,
    /// Frames sent.
    pub frames_sent: u64,
    /// Distinct frames whose composite arrived.
    pub composites: u64,
    /// Composites per second.
    pub fps: f64,
    /// Frames that the server replaced by newer ones before rendering.
    pub frames_dropped: u64,
    /// Composites that the server skipped because this client had no credit left.
    pub composites_dropped: u64,
    /// Frames that the server answered with an error.
    pub frames_refused: u64,
    /// Frames sent without a reply: neither composite nor drop nor error.
    pub frames_lost: u64,
    /// Times that a lost connection was replaced.
    pub reconnects: u64,
    /// Why the run ended before everything was sent; `None` if it did not.
    pub ended: Option<String>,
    /// Time from capture to arrival of the composite.
    pub latency: Percentiles,
    /// Median latency of the last tenth of the run minus that of the first, ms; positive if a queue grows.
    pub drift_ms: f64,
    /// Steps in between; upload and download depend on clocks that are matched to within half a round trip.
    #[serde(serialize_with = "as_object")]
    pub steps: Vec<(String, Percentiles)>,
    /// Times of the render stages, by their names in the welcome message.
    #[serde(serialize_with = "as_object")]
    pub stages: Vec<(String, Percentiles)>,
    /// Bytes sent in frames.
    pub bytes_up: u64,
    /// Bytes received in composites.
    pub bytes_down: u64,
    /// The first few error messages of the server.
    pub errors: Vec<String>,
}

/// Serializes pairs as a JSON object, in their order.
fn as_object<S: Serializer>(
    pairs: &[(String, Percentiles)],
    serializer: S,
) -> Result<S::Ok, S::Error> {
    serializer.collect_map(pairs.iter().map(|(name, times)| (name, times)))
}

/// Times collected during a run.
#[derive(Debug, Default)]
pub(super) struct Gathered {
    pub(super) latency_ns: Vec<i64>,
    steps_ns: [Vec<i64>; STEPS.len()],
    stages_us: Vec<Vec<i64>>,
}

impl Gathered {
    /// Adds a composite, with the times of capture and of arrival on this machine's clock; `offset_ns` is the
    /// server's clock minus this machine's.
    pub(super) fn add(
        &mut self,
        captured_ns: i64,
        arrived_ns: i64,
        offset_ns: i64,
        stamps: &Stamps,
        stage_us: &[u32],
    ) {
        self.latency_ns.push(arrived_ns - captured_ns);
        let [
            received,
            decode,
            decoded,
            render,
            rendered,
            encode,
            encoded,
            sent,
        ] = stamps.to_array();
        let steps = [
            received - offset_ns - captured_ns,
            decode - received,
            decoded - decode,
            render - decoded,
            rendered - render,
            encode - rendered,
            encoded - encode,
            sent - encoded,
            arrived_ns - (sent - offset_ns),
        ];
        for (all, step) in self.steps_ns.iter_mut().zip(steps) {
            all.push(step);
        }
        self.stages_us
            .resize(self.stages_us.len().max(stage_us.len()), Vec::new());
        for (all, &us) in self.stages_us.iter_mut().zip(stage_us) {
            all.push(i64::from(us) * 1000);
        }
    }

    pub(super) fn drift_ms(&self) -> f64 {
        let n = (self.latency_ns.len() / 10)
            .max(1)
            .min(self.latency_ns.len());
        let first = Percentiles::of(&self.latency_ns[..n]);
        let last = Percentiles::of(&self.latency_ns[self.latency_ns.len() - n..]);
        last.median_ms - first.median_ms
    }

    pub(super) fn steps(&self) -> Vec<(String, Percentiles)> {
        let steps = STEPS.iter().zip(&self.steps_ns);
        steps
            .map(|(name, ns)| ((*name).to_owned(), Percentiles::of(ns)))
            .collect()
    }

    pub(super) fn stages(&self, names: &[String]) -> Vec<(String, Percentiles)> {
        let stages = names.iter().zip(&self.stages_us);
        stages
            .map(|(name, ns)| (name.clone(), Percentiles::of(ns)))
            .collect()
    }
}

impl fmt::Display for SendReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{} -> {} ({})", self.recording, self.url, self.rate)?;
        writeln!(
            f,
            "{} frames in {:.1} s: {} composites ({:.1} fps), {} dropped, {} skipped, {} refused, {} lost",
            self.frames_sent,
            self.seconds,
            self.composites,
            self.fps,
            self.frames_dropped,
            self.composites_dropped,
            self.frames_refused,
            self.frames_lost
        )?;
        let mb = |bytes: u64| bytes as f64 * 1e-6 / self.seconds.max(1e-9);
        writeln!(
            f,
            "{:.1} MB/s up, {:.1} MB/s down, latency drift {:+.1} ms",
            mb(self.bytes_up),
            mb(self.bytes_down),
            self.drift_ms
        )?;
        writeln!(
            f,
            "{:<14}{:>9}{:>9}{:>9}{:>9}",
            "ms", "median", "p95", "p99", "max"
        )?;
        let mut row = |name: &str, p: &Percentiles| {
            writeln!(
                f,
                "{name:<14}{:>9.2}{:>9.2}{:>9.2}{:>9.2}",
                p.median_ms, p.p95_ms, p.p99_ms, p.max_ms
            )
        };
        for (name, step) in &self.steps {
            row(name, step)?;
            if name == "render" {
                for (stage, times) in &self.stages {
                    row(&format!("  {stage}"), times)?;
                }
            }
        }
        row("latency", &self.latency)?;
        if self.reconnects > 0 {
            writeln!(f, "reconnected {} times", self.reconnects)?;
        }
        for error in &self.errors {
            writeln!(f, "error: {error}")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_are_nearest_rank() {
        let ns: Vec<i64> = (1..=100).rev().map(|ms| ms * 1_000_000).collect();
        let p = Percentiles::of(&ns);
        let got = [p.median_ms, p.p95_ms, p.p99_ms, p.max_ms];
        for (got, expected) in got.into_iter().zip([50.0, 95.0, 99.0, 100.0]) {
            assert!((got - expected).abs() < 1e-9, "{got} {expected}");
        }
        assert_eq!(Percentiles::of(&[]), Percentiles::default());
        assert!((Percentiles::of(&[7_000_000]).median_ms - 7.0).abs() < 1e-9);
    }

    #[test]
    fn steps_add_up_to_the_latency() {
        let stamps = Stamps {
            received_ns: 1_010,
            decode_start_ns: 1_020,
            decoded_ns: 1_040,
            render_start_ns: 1_041,
            render_end_ns: 1_100,
            encode_start_ns: 1_101,
            encoded_ns: 1_120,
            sent_ns: 1_121,
        };
        let mut gathered = Gathered::default();
        gathered.add(0, 140, 1_000, &stamps, &[5, 6]);
        let sum: i64 = gathered.steps_ns.iter().map(|s| s[0]).sum();
        assert_eq!(sum, gathered.latency_ns[0]);
        assert_eq!(gathered.stages_us, [[5_000], [6_000]]);
    }
}
