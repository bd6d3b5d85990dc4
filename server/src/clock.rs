//! The process's one clock: nanoseconds since the Unix epoch, advancing monotonically. `render` is
//! given it and reads no clock of its own.

use std::sync::OnceLock;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// The epoch time is read once, so that an adjusted system clock cannot turn a stage's
/// duration negative.
fn origin() -> (Instant, i64) {
    static ORIGIN: OnceLock<(Instant, i64)> = OnceLock::new();
    *ORIGIN.get_or_init(|| {
        let since = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        (Instant::now(), since.as_nanos() as i64)
    })
}

/// Now, nanoseconds since the Unix epoch.
pub fn now_ns() -> i64 {
    let (start, epoch_ns) = origin();
    epoch_ns + start.elapsed().as_nanos() as i64
}

/// Now, in the form that the renderer takes: nanoseconds, of which only differences mean anything.
pub fn render_clock() -> u64 {
    now_ns() as u64
}

/// Now, microseconds: exact in a JavaScript number.
pub(crate) fn now_us() -> u64 {
    now_ns() as u64 / 1000
}

/// The moment at which the clock reads `ns`; the past becomes now.
pub(crate) fn instant_at(ns: i64) -> Instant {
    let wait = u64::try_from(ns - now_ns()).unwrap_or(0);
    Instant::now() + std::time::Duration::from_nanos(wait)
}
