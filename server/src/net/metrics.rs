//! Counts and stage times, as Prometheus text.

use std::fmt::Write;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};

use ghostlight_proto::{Code, Stamps};

use crate::render::Stage;

/// Upper bounds of the histograms' buckets, seconds.
const BUCKETS_S: [f64; 12] = [
    0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.033, 0.05, 0.1, 0.2, 0.5, 1.0,
];

/// Durations, in buckets.
#[derive(Debug, Default)]
pub(super) struct Histogram {
    buckets: [AtomicU64; BUCKETS_S.len()],
    count: AtomicU64,
    sum_ns: AtomicU64,
}

impl Histogram {
    /// Adds a duration; one that is negative counts as none.
    pub(super) fn record_ns(&self, ns: i64) {
        let ns = u64::try_from(ns).unwrap_or(0);
        let seconds = ns as f64 * 1e-9;
        if let Some(i) = BUCKETS_S.iter().position(|&bound| seconds <= bound) {
            self.buckets[i].fetch_add(1, Ordering::Relaxed);
        }
        self.count.fetch_add(1, Ordering::Relaxed);
        self.sum_ns.fetch_add(ns, Ordering::Relaxed);
    }

    fn write(&self, out: &mut String, name: &str, label: &str) {
        let mut below = 0;
        for (bound, bucket) in BUCKETS_S.iter().zip(&self.buckets) {
            below += bucket.load(Ordering::Relaxed);
            let _ = writeln!(out, "{name}_bucket{{{label},le=\"{bound}\"}} {below}");
        }
        let count = self.count.load(Ordering::Relaxed);
        let sum = self.sum_ns.load(Ordering::Relaxed) as f64 * 1e-9;
        let _ = writeln!(out, "{name}_bucket{{{label},le=\"+Inf\"}} {count}");
        let _ = writeln!(out, "{name}_sum{{{label}}} {sum}");
        let _ = writeln!(out, "{name}_count{{{label}}} {count}");
    }
}

/// Steps of a frame through the service, in order.
const STEPS: [&str; 8] = [
    "wait",
    "decode",
    "render",
    "credit",
    "encode",
    "send",
    "received_to_sent",
    "received_to_credit",
];

/// Times that clients report of the composites they drew.
const CLIENT_STEPS: [&str; 2] = ["received_to_drawn", "arrived_to_drawn"];

/// Why connections and requests are turned away or closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turned {
    /// Silent, and replaced by a new connection.
    Dropped,
    /// No TLS handshake, request or hello in time.
    TimedOut,
    /// Too many clients.
    Full,
    /// A wrong token.
    WrongToken,
    /// A host or origin that is not this server's.
    Foreign,
    /// A message that took too long.
    SlowMessage,
    /// Too many bytes of unfinished messages.
    Unfinished,
    /// Invalid WebSocket frames, or text that is not UTF-8.
    Protocol,
}

impl Turned {
    const ALL: [Self; 8] = [
        Self::Dropped,
        Self::TimedOut,
        Self::Full,
        Self::WrongToken,
        Self::Foreign,
        Self::SlowMessage,
        Self::Unfinished,
        Self::Protocol,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Dropped => "dropped",
            Self::TimedOut => "timed_out",
            Self::Full => "full",
            Self::WrongToken => "wrong_token",
            Self::Foreign => "foreign",
            Self::SlowMessage => "slow_message",
            Self::Unfinished => "unfinished",
            Self::Protocol => "protocol",
        }
    }
}

/// Counts of the whole server; sums over sessions that are gone as well.
#[derive(Debug, Default)]
pub(super) struct Metrics {
    /// Clients past their hello.
    pub(super) connections: AtomicU64,
    /// Connections before it.
    pub(super) waiting: AtomicU64,
    turned: [AtomicU64; Turned::ALL.len()],
    /// Sessions open.
    pub(super) sessions: AtomicU64,
    /// Clients that receive composites.
    pub(super) viewers: AtomicU64,
    /// Frames received from producers or due from recordings.
    pub(super) frames_received: AtomicU64,
    /// Frames rendered.
    pub(super) frames_rendered: AtomicU64,
    /// Frames replaced by newer ones before they were rendered.
    pub(super) frames_dropped: AtomicU64,
    /// Frames in error.
    pub(super) frames_refused: AtomicU64,
    /// Composites sent.
    pub(super) composites_sent: AtomicU64,
    /// Composites skipped for clients without credit.
    pub(super) composites_dropped: AtomicU64,
    /// Bytes of composites sent.
    pub(super) composite_bytes: AtomicU64,
    errors: Mutex<Vec<(Code, u64)>>,
    steps: [Histogram; STEPS.len()],
    client_steps: [Histogram; CLIENT_STEPS.len()],
    stages: [Histogram; Stage::ALL.len()],
}

/// Adds one.
pub(super) fn count(counter: &AtomicU64) {
    counter.fetch_add(1, Ordering::Relaxed);
}

/// Subtracts one.
pub(super) fn uncount(counter: &AtomicU64) {
    counter.fetch_sub(1, Ordering::Relaxed);
}

impl Metrics {
    /// Counts an error answered to a client.
    pub(super) fn error(&self, code: Code) {
        let mut errors = self.errors.lock().unwrap_or_else(PoisonError::into_inner);
        match errors.iter_mut().find(|(c, _)| *c == code) {
            Some((_, n)) => *n += 1,
            None => errors.push((code, 1)),
        }
    }

    /// Counts a connection or request that was turned away.
    pub(super) fn turned(&self, why: Turned) {
        count(&self.turned[why as usize]);
    }

    /// Times of a frame up to its composite.
    pub(super) fn rendered(&self, stamps: &Stamps, stage_ns: &[u64]) {
        count(&self.frames_rendered);
        self.steps[0].record_ns(stamps.decode_start_ns - stamps.received_ns);
        self.steps[1].record_ns(stamps.decoded_ns - stamps.decode_start_ns);
        self.steps[2].record_ns(stamps.render_end_ns - stamps.render_start_ns);
        for (histogram, &ns) in self.stages.iter().zip(stage_ns) {
            histogram.record_ns(i64::try_from(ns).unwrap_or(i64::MAX));
        }
    }

    /// Times of a composite to one client; `written_ns`: the socket had taken it.
    pub(super) fn sent(&self, stamps: &Stamps, written_ns: i64, bytes: usize) {
        count(&self.composites_sent);
        self.composite_bytes
            .fetch_add(bytes as u64, Ordering::Relaxed);
        self.steps[3].record_ns(stamps.encode_start_ns - stamps.render_end_ns);
        self.steps[4].record_ns(stamps.encoded_ns - stamps.encode_start_ns);
        self.steps[5].record_ns(written_ns - stamps.sent_ns);
        self.steps[6].record_ns(stamps.sent_ns - stamps.received_ns);
    }

    /// Time from a frame's arrival to the moment a client had drawn its composite and said so:
    /// the server's own measure of what clients see.
    pub(super) fn credited(&self, ns: i64) {
        self.steps[7].record_ns(ns);
    }

    /// Times that a client reports of its newest composite, microseconds.
    pub(super) fn drawn(&self, latency_us: Option<u32>, draw_us: Option<u32>) {
        for (histogram, us) in self.client_steps.iter().zip([latency_us, draw_us]) {
            if let Some(us) = us {
                histogram.record_ns(i64::from(us) * 1000);
            }
        }
    }

    /// Prometheus text format 0.0.4.
    pub(super) fn to_text(&self) -> String {
        let mut out = String::new();
        let head = |out: &mut String, name: &str, kind: &str, help: &str| {
            let _ = writeln!(out, "# HELP ghostlight_{name} {help}");
            let _ = writeln!(out, "# TYPE ghostlight_{name} {kind}");
        };
        for (name, value, help) in [
            (
                "connections",
                &self.connections,
                "Clients past their hello.",
            ),
            (
                "waiting",
                &self.waiting,
                "Connections that have not said hello yet.",
            ),
            ("sessions", &self.sessions, "Sessions open."),
            ("viewers", &self.viewers, "Clients that receive composites."),
        ] {
            head(&mut out, name, "gauge", help);
            let _ = writeln!(out, "ghostlight_{name} {}", value.load(Ordering::Relaxed));
        }
        for (name, value, help) in [
            (
                "frames_received_total",
                &self.frames_received,
                "Frames that arrived, or fell due in a recording.",
            ),
            (
                "frames_rendered_total",
                &self.frames_rendered,
                "Frames rendered.",
            ),
            (
                "frames_dropped_total",
                &self.frames_dropped,
                "Frames replaced by newer ones before they were rendered.",
            ),
            (
                "frames_refused_total",
                &self.frames_refused,
                "Frames in error.",
            ),
            (
                "composites_sent_total",
                &self.composites_sent,
                "Composites sent.",
            ),
            (
                "composites_dropped_total",
                &self.composites_dropped,
                "Composites skipped for clients without credit.",
            ),
            (
                "composite_bytes_total",
                &self.composite_bytes,
                "Bytes of composites sent.",
            ),
        ] {
            head(&mut out, name, "counter", help);
            let _ = writeln!(out, "ghostlight_{name} {}", value.load(Ordering::Relaxed));
        }
        head(
            &mut out,
            "turned_away_total",
            "counter",
            "Connections and requests turned away or closed, by reason.",
        );
        for (why, n) in Turned::ALL.iter().zip(&self.turned) {
            let n = n.load(Ordering::Relaxed);
            let _ = writeln!(
                out,
                "ghostlight_turned_away_total{{reason=\"{}\"}} {n}",
                why.name()
            );
        }
        head(
            &mut out,
            "errors_total",
            "counter",
            "Errors answered to clients.",
        );
        let errors = self.errors.lock().unwrap_or_else(PoisonError::into_inner);
        for (code, n) in errors.iter() {
            let _ = writeln!(
                out,
                "ghostlight_errors_total{{code=\"{}\"}} {n}",
                code.name()
            );
        }
        drop(errors);
        let stages = Stage::ALL.map(Stage::name);
        let families: [(_, _, &[&str], &[Histogram], _); 3] = [
            (
                "step_seconds",
                "step",
                &STEPS,
                &self.steps,
                "Time of a frame in each step of the service.",
            ),
            (
                "client_seconds",
                "step",
                &CLIENT_STEPS,
                &self.client_steps,
                "Time of a frame as clients report it.",
            ),
            (
                "stage_seconds",
                "stage",
                &stages,
                &self.stages,
                "Time of a frame in each render stage.",
            ),
        ];
        for (name, key, labels, histograms, help) in families {
            head(&mut out, name, "histogram", help);
            for (label, histogram) in labels.iter().zip(histograms) {
                let label = format!("{key}=\"{label}\"");
                histogram.write(&mut out, &format!("ghostlight_{name}"), &label);
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_cumulative_and_none_is_lost() {
        let metrics = Metrics::default();
        for ns in [400_000, 600_000, 4_000_000_000, -5] {
            metrics.steps[1].record_ns(ns);
        }
        metrics.error(Code::Decode);
        metrics.error(Code::Decode);
        for (i, &why) in Turned::ALL.iter().enumerate() {
            assert_eq!(why as usize, i);
        }
        metrics.turned(Turned::Protocol);
        let text = metrics.to_text();
        for line in [
            "ghostlight_step_seconds_bucket{step=\"decode\",le=\"0.0005\"} 2",
            "ghostlight_step_seconds_bucket{step=\"decode\",le=\"1\"} 3",
            "ghostlight_step_seconds_bucket{step=\"decode\",le=\"+Inf\"} 4",
            "ghostlight_step_seconds_count{step=\"decode\"} 4",
            "ghostlight_errors_total{code=\"decode\"} 2",
            "ghostlight_turned_away_total{reason=\"protocol\"} 1",
            "ghostlight_turned_away_total{reason=\"full\"} 0",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} not in\n{text}");
        }
    }
}
