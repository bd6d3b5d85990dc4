//! The rate at which a producer captures frames, from their time stamps.

use std::collections::VecDeque;

/// The period is the median of this many gaps between frames.
const GAPS: usize = 15;
/// Fewest gaps from which a rate is determined.
const FEWEST: usize = 5;
/// A source faster than 200 Hz or slower than 1 Hz has no rate to be kept.
const PERIODS_NS: std::ops::RangeInclusive<i64> = 5_000_000..=1_000_000_000;

/// The last capture times.
#[derive(Debug, Default)]
pub(super) struct Rate {
    last_ns: Option<i64>,
    gaps_ns: VecDeque<i64>,
}

impl Rate {
    /// Records the capture time of a frame, on any clock.
    pub(super) fn add(&mut self, capture_ns: i64) {
        if let Some(last_ns) = self.last_ns.replace(capture_ns) {
            match capture_ns.checked_sub(last_ns) {
                Some(gap) if gap > 0 => {
                    self.gaps_ns.push_back(gap);
                    if self.gaps_ns.len() > GAPS {
                        self.gaps_ns.pop_front();
                    }
                }
                // Another recording, or the same one from its start.
                _ => {}
            }
        }
    }

    /// The median gap, nanoseconds; `None` while it is unknown.
    pub(super) fn period_ns(&self) -> Option<i64> {
        if self.gaps_ns.len() < FEWEST {
            return None;
        }
        let mut gaps: Vec<i64> = self.gaps_ns.iter().copied().collect();
        gaps.sort_unstable();
        Some(gaps[gaps.len() / 2]).filter(|period| PERIODS_NS.contains(period))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn period(times_ms: impl IntoIterator<Item = i64>) -> Option<i64> {
        let mut rate = Rate::default();
        for ms in times_ms {
            rate.add(ms * 1_000_000);
        }
        rate.period_ns()
    }

    #[test]
    fn the_rate_is_the_median_gap_of_the_last_frames() {
        assert_eq!(period((0..6).map(|i| i * 33)), Some(33_000_000));
        // Too few frames, and times that give no rate.
        assert_eq!(period((0..5).map(|i| i * 33)), None);
        assert_eq!(period([7; 100]), None);
        assert_eq!(period((0..100).map(|i| i * 2)), None);
        assert_eq!(period((0..100).map(|i| i * 2000)), None);
        assert_eq!(period((0..100).rev()), None);
        // A gap, a jump back, and the extremes of the clock change nothing.
        let odd = (0..10).map(|i| i * 20).chain([900, 0, 20, 40]);
        assert_eq!(period(odd), Some(20_000_000));
        let mut rate = Rate::default();
        for ns in [i64::MIN, i64::MAX, i64::MIN] {
            rate.add(ns);
        }
        assert_eq!(rate.period_ns(), None);
        // The newest frames count.
        let slower = (0..50)
            .map(|i| i * 33)
            .chain((0..20).map(|i| 2000 + i * 100));
        assert_eq!(period(slower), Some(100_000_000));
    }
}
