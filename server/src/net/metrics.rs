//! Counts and times of the server, exported as Prometheus text.

use ghostlight_proto::{Code, Stamps};
use prometheus_client::encoding::prometheus_text;
use prometheus_client::metrics::counter::Counter;
use prometheus_client::metrics::family::Family;
use prometheus_client::metrics::gauge::Gauge;
use prometheus_client::metrics::histogram::Histogram;
use prometheus_client::registry::{Metric, Registry};

use crate::render::Stage;

/// Media type of [`Metrics::to_text`].
pub(super) use prometheus_client::encoding::prometheus_text::CONTENT_TYPE;

/// Upper bounds of the histograms' buckets, seconds.
const BUCKETS_S: [f64; 12] = [
    0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.033, 0.05, 0.1, 0.2, 0.5, 1.0,
];

/// One label, its name and value.
type Label = [(&'static str, &'static str); 1];
type Counters = Family<Label, Counter>;
type Histograms = Family<Label, Histogram>;

/// Adds a duration; a negative one counts as zero.
fn observe_ns(histogram: &Histogram, ns: i64) {
    histogram.observe(ns.max(0) as f64 * 1e-9);
}

/// Why connections and requests are turned away or closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Turned {
    /// Silent, and replaced by a newer connection.
    Dropped,
    /// No TLS handshake, request or hello in time.
    TimedOut,
    /// Too many clients.
    Full,
    /// A wrong token.
    WrongToken,
    /// A host or origin that does not belong to this server.
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

/// Steps of a frame through the service, in order.
#[derive(Debug)]
struct Steps {
    /// From arrival to the start of decoding.
    wait: Histogram,
    decode: Histogram,
    render: Histogram,
    /// From the end of rendering until a client had a credit.
    credit: Histogram,
    encode: Histogram,
    send: Histogram,
    received_to_sent: Histogram,
    /// From arrival until the client gave the composite's credit back.
    received_to_credit: Histogram,
}

/// Metrics of the whole server, summed over all sessions, including those that have ended.
#[derive(Debug)]
pub(super) struct Metrics {
    registry: Registry,
    /// Clients that have said a valid hello.
    pub(super) connections: Gauge,
    /// Connections without a valid hello yet.
    pub(super) waiting: Gauge,
    /// Open sessions.
    pub(super) sessions: Gauge,
    /// Clients that receive composites.
    pub(super) viewers: Gauge,
    /// Frames received from producers or due from recordings.
    pub(super) frames_received: Counter,
    /// Frames rendered.
    pub(super) frames_rendered: Counter,
    /// Frames replaced by newer ones before they were rendered.
    pub(super) frames_dropped: Counter,
    /// Frames answered with an error.
    pub(super) frames_refused: Counter,
    /// Composites sent.
    pub(super) composites_sent: Counter,
    /// Composites skipped for clients without credit.
    pub(super) composites_dropped: Counter,
    /// Bytes of composites sent.
    pub(super) composite_bytes: Counter,
    turned: Counters,
    errors: Counters,
    steps: Steps,
    /// From arrival at the server to drawing, as clients report it.
    received_to_drawn: Histogram,
    /// From arrival at the client to drawing, as clients report it.
    arrived_to_drawn: Histogram,
    stages: [Histogram; Stage::ALL.len()],
}

/// Creates and registers a metric. The encoder appends a full stop to the help text and `_total` to the names of
/// counters.
fn registered<M: Metric + Clone + Default>(registry: &mut Registry, name: &str, help: &str) -> M {
    let metric = M::default();
    registry.register(name, help, metric.clone());
    metric
}

impl Default for Metrics {
    fn default() -> Self {
        let mut registry = Registry::with_prefix("ghostlight");
        let all = &mut registry;
        let mut histograms = |name: &str, help: &str| {
            let family = Histograms::new_with_constructor(|| Histogram::new(BUCKETS_S));
            all.register(name, help, family.clone());
            family
        };
        let steps = histograms(
            "step_seconds",
            "Time of a frame in each step of the service",
        );
        let client = histograms("client_seconds", "Time of a frame as clients report it");
        let stages = histograms("stage_seconds", "Time of a frame in each render stage");
        let step = |name| steps.get_or_create(&[("step", name)]).clone();
        let client_step = |name| client.get_or_create(&[("step", name)]).clone();
        let stage = |stage: Stage| stages.get_or_create(&[("stage", stage.name())]).clone();
        let turned: Counters = registered(
            all,
            "turned_away",
            "Connections and requests turned away or closed, by reason",
        );
        // Every reason is listed from the start, with the value zero.
        for why in Turned::ALL {
            drop(turned.get_or_create(&[("reason", why.name())]));
        }
        Self {
            connections: registered(all, "connections", "Clients after their hello"),
            waiting: registered(all, "waiting", "Connections that have not said hello yet"),
            sessions: registered(all, "sessions", "Open sessions"),
            viewers: registered(all, "viewers", "Clients that receive composites"),
            frames_received: registered(
                all,
                "frames_received",
                "Frames received, or due in a recording",
            ),
            frames_rendered: registered(all, "frames_rendered", "Frames rendered"),
            frames_dropped: registered(
                all,
                "frames_dropped",
                "Frames replaced by newer ones before they were rendered",
            ),
            frames_refused: registered(all, "frames_refused", "Frames answered with an error"),
            composites_sent: registered(all, "composites_sent", "Composites sent"),
            composites_dropped: registered(
                all,
                "composites_dropped",
                "Composites skipped for clients without credit",
            ),
            composite_bytes: registered(all, "composite_bytes", "Bytes of composites sent"),
            turned,
            errors: registered(all, "errors", "Errors answered to clients"),
            steps: Steps {
                wait: step("wait"),
                decode: step("decode"),
                render: step("render"),
                credit: step("credit"),
                encode: step("encode"),
                send: step("send"),
                received_to_sent: step("received_to_sent"),
                received_to_credit: step("received_to_credit"),
            },
            received_to_drawn: client_step("received_to_drawn"),
            arrived_to_drawn: client_step("arrived_to_drawn"),
            stages: Stage::ALL.map(stage),
            registry,
        }
    }
}

impl Metrics {
    /// Counts an error answered to a client.
    pub(super) fn error(&self, code: Code) {
        self.errors.get_or_create(&[("code", code.name())]).inc();
    }

    /// Counts a connection or request that was turned away.
    pub(super) fn turned(&self, why: Turned) {
        self.turned.get_or_create(&[("reason", why.name())]).inc();
    }

    /// Times of a frame up to its composite.
    pub(super) fn rendered(&self, stamps: &Stamps, stage_ns: &[u64]) {
        self.frames_rendered.inc();
        let steps = &self.steps;
        observe_ns(&steps.wait, stamps.decode_start_ns - stamps.received_ns);
        observe_ns(&steps.decode, stamps.decoded_ns - stamps.decode_start_ns);
        observe_ns(&steps.render, stamps.render_end_ns - stamps.render_start_ns);
        for (histogram, &ns) in self.stages.iter().zip(stage_ns) {
            observe_ns(histogram, i64::try_from(ns).unwrap_or(i64::MAX));
        }
    }

    /// Times of a composite sent to one client; `written_ns` is when the socket had accepted it.
    pub(super) fn sent(&self, stamps: &Stamps, written_ns: i64, bytes: usize) {
        self.composites_sent.inc();
        self.composite_bytes.inc_by(bytes as u64);
        let steps = &self.steps;
        observe_ns(&steps.credit, stamps.encode_start_ns - stamps.render_end_ns);
        observe_ns(&steps.encode, stamps.encoded_ns - stamps.encode_start_ns);
        observe_ns(&steps.send, written_ns - stamps.sent_ns);
        observe_ns(&steps.received_to_sent, stamps.sent_ns - stamps.received_ns);
    }

    /// Time from a frame's arrival until a client returned the credit of its composite: the server's own measure
    /// of the latency that clients see.
    pub(super) fn credited(&self, ns: i64) {
        observe_ns(&self.steps.received_to_credit, ns);
    }

    /// Times that a client reports of its newest composite, microseconds.
    pub(super) fn drawn(&self, latency_us: Option<u32>, draw_us: Option<u32>) {
        for (histogram, us) in [
            (&self.received_to_drawn, latency_us),
            (&self.arrived_to_drawn, draw_us),
        ] {
            if let Some(us) = us {
                observe_ns(histogram, i64::from(us) * 1000);
            }
        }
    }

    /// The metrics in Prometheus text format 0.0.4.
    pub(super) fn to_text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = prometheus_text::encode(&mut text, &self.registry);
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_are_cumulative_and_none_is_lost() {
        let metrics = Metrics::default();
        for ns in [400_000, 600_000, 4_000_000_000, -5] {
            observe_ns(&metrics.steps.decode, ns);
        }
        metrics.error(Code::Decode);
        metrics.error(Code::Decode);
        metrics.sessions.inc();
        metrics.frames_dropped.inc_by(3);
        metrics.turned(Turned::Protocol);
        let text = metrics.to_text();
        for line in [
            "ghostlight_step_seconds_bucket{step=\"decode\",le=\"0.0005\"} 2",
            "ghostlight_step_seconds_bucket{step=\"decode\",le=\"1\"} 3",
            "ghostlight_step_seconds_bucket{step=\"decode\",le=\"+Inf\"} 4",
            "ghostlight_step_seconds_count{step=\"decode\"} 4",
            "ghostlight_sessions 1",
            "# TYPE ghostlight_frames_dropped_total counter",
            "# HELP ghostlight_frames_dropped_total Frames replaced by newer ones before they were rendered.",
            "ghostlight_frames_dropped_total 3",
            "ghostlight_client_seconds_count{step=\"arrived_to_drawn\"} 0",
            "ghostlight_errors_total{code=\"decode\"} 2",
            "ghostlight_turned_away_total{reason=\"protocol\"} 1",
            "ghostlight_turned_away_total{reason=\"full\"} 0",
        ] {
            assert!(text.lines().any(|l| l == line), "{line} not in\n{text}");
        }
    }
}
