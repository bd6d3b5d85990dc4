//! Counts the errors of a traversal.

use crate::oracle::ghost::Verdict;
use ghostlight::ghost::GhostOutcome;

/// Number of rays for each kind of error.
#[derive(Debug, Default, Clone)]
pub(super) struct Tally {
    pub(super) rays: usize,
    pub(super) ambiguous: usize,
    pub(super) missed: usize,
    pub(super) false_hits: usize,
    /// Hits whose distance is wrong by more than 1 %.
    pub(super) wrong: usize,
    /// Environment instead of unknown or the reverse, without a hit in either case.
    pub(super) confused: usize,
    /// Rays whose outcomes from pyramid and plain walk differ in any bit.
    pub(super) differ: usize,
    /// Largest relative error of a hit.
    pub(super) largest: f64,
    /// Relative error of each hit, if kept.
    pub(super) relative: Vec<f64>,
}

impl Tally {
    pub(super) fn judge(&mut self, verdict: Verdict, outcome: GhostOutcome, keep: bool) {
        self.rays += 1;
        match (verdict, outcome) {
            (Verdict::AmbiguousHit, _) => self.ambiguous += 1,
            (Verdict::Hit { t, .. }, GhostOutcome::Hit(hit)) => {
                let error = (f64::from(hit.t) - t).abs() / t.abs();
                self.wrong += usize::from(error > 1e-2);
                self.largest = self.largest.max(error);
                if keep {
                    self.relative.push(error);
                }
            }
            (Verdict::Hit { .. }, _) => self.missed += 1,
            (_, GhostOutcome::Hit(_)) => self.false_hits += 1,
            (Verdict::Environment, GhostOutcome::Unknown)
            | (Verdict::Unknown, GhostOutcome::Environment) => self.confused += 1,
            (Verdict::AmbiguousMiss, _) => self.ambiguous += 1,
            _ => {}
        }
    }

    pub(super) fn add(mut self, other: Self) -> Self {
        self.rays += other.rays;
        self.ambiguous += other.ambiguous;
        self.missed += other.missed;
        self.false_hits += other.false_hits;
        self.wrong += other.wrong;
        self.confused += other.confused;
        self.differ += other.differ;
        self.largest = self.largest.max(other.largest);
        self.relative.extend(other.relative);
        self
    }
}
