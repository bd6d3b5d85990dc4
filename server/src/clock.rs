//! The single clock of the process: nanoseconds since the Unix epoch, advancing monotonically. `render` gets it as a
//! parameter and reads no clock of its own.

use std::sync::OnceLock;
use std::time::{Instant, SystemTime, UNIX_EPOCH};

/// The epoch time is read only once, so that an adjustment of the system clock cannot make a stage's duration
/// negative.
fn origin() -> (Instant, i64) {
    static ORIGIN: OnceLock<(Instant, i64)> = OnceLock::new();
    *ORIGIN.get_or_init(|| {
        let since = SystemTime::now()
            .duration_since(UNIX_EPOCH)
            .unwrap_or_default();
        (Instant::now(), since.as_nanos() as i64)
    })
}

/// The current time, nanoseconds since the Unix epoch.
pub fn now_ns() -> i64 {
    let (start, epoch_ns) = origin();
    epoch_ns + start.elapsed().as_nanos() as i64
}

/// The current time in the renderer's form: nanoseconds, of which only differences are meaningful.
pub fn render_clock() -> u64 {
    now_ns() as u64
}

/// The current time, microseconds: exact in a JavaScript number.
pub(crate) fn now_us() -> u64 {
    now_ns() as u64 / 1000
}

/// The instant at which the clock reads `ns`; for times in the past, the current instant.
pub(crate) fn instant_at(ns: i64) -> Instant {
    let wait = u64::try_from(ns - now_ns()).unwrap_or(0);
    Instant::now() + std::time::Duration::from_nanos(wait)
}
