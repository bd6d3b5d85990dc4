//! Scales with their ticks, and labels that do not overlap.

use crate::compare::section::number;

/// Maps values to pixels along one axis.
#[derive(Debug, Clone)]
pub(super) struct Scale {
    log: bool,
    low: f64,
    high: f64,
    /// Pixels of `low` and of `high`.
    from: f64,
    to: f64,
    /// Pixel of zero on a logarithmic scale, if any value is zero.
    zero: Option<f64>,
}

/// Width of the lane for zero, pixels.
const LANE: f64 = 22.0;

impl Scale {
    /// A scale that shows all values (NaN is ignored), from pixel `from` to pixel `to`.
    pub(super) fn new(log: bool, values: &[f64], from: f64, to: f64) -> Self {
        let shown = |x: &f64| x.is_finite() && (!log || *x > 0.0);
        let inside = || values.iter().copied().filter(shown);
        let has_zero = log && values.contains(&0.0);
        let mut low = inside().fold(f64::INFINITY, f64::min);
        let mut high = inside().fold(f64::NEG_INFINITY, f64::max);
        if low > high {
            (low, high) = if log { (0.1, 1.0) } else { (0.0, 1.0) };
        }
        if log {
            // A margin beyond the outermost points; at least half a decade in all.
            let room = ((high / low).log10() * 0.06).max(0.12);
            let middle = ((0.5 - (high / low).log10()) * 0.5).max(0.0);
            low /= 10f64.powf(room + middle);
            high *= 10f64.powf(room + middle);
        } else {
            low = low.min(0.0);
            high += (high - low) * 0.06;
            if high <= low {
                high = low + 1.0;
            }
        }
        let sign = (to - from).signum();
        Self {
            log,
            low,
            high,
            from: if has_zero { from + sign * LANE } else { from },
            to,
            zero: has_zero.then_some(from + sign * 0.5 * LANE),
        }
    }

    /// The pixel of a value; `None` if it cannot be shown.
    pub(super) fn at(&self, x: f64) -> Option<f64> {
        let share = if self.log {
            if x == 0.0 {
                return self.zero;
            }
            (x / self.low).ln() / (self.high / self.low).ln()
        } else {
            (x - self.low) / (self.high - self.low)
        };
        share
            .is_finite()
            .then_some(self.from + share * (self.to - self.from))
    }

    /// Pixels and names of the ticks.
    pub(super) fn ticks(&self) -> Vec<(f64, String)> {
        let values = if self.log {
            self.log_ticks()
        } else {
            self.linear_ticks()
        };
        let zero = self.zero.map(|at| (at, "0".to_owned()));
        // A tick label beside that of zero would overlap it.
        let clear = |at: f64| self.zero.is_none_or(|zero| (at - zero).abs() >= 14.0);
        let named = values
            .into_iter()
            .filter_map(|x| Some((self.at(x).filter(|&at| clear(at))?, tick_name(x))));
        zero.into_iter().chain(named).collect()
    }

    fn log_ticks(&self) -> Vec<f64> {
        let decades = (self.high / self.low).log10();
        let first = self.low.log10().floor() as i32;
        let last = self.high.log10().ceil() as i32;
        let every = (decades / 6.0).ceil().max(1.0) as i32;
        let steps: &[f64] = if decades < 1.2 {
            &[1.0, 2.0, 3.0, 5.0, 7.0]
        } else if decades < 2.5 {
            &[1.0, 2.0, 5.0]
        } else {
            &[1.0]
        };
        (first..=last)
            .filter(|decade| decade.rem_euclid(every) == 0)
            .flat_map(|decade| steps.iter().map(move |step| step * 10f64.powi(decade)))
            .filter(|x| (self.low..=self.high).contains(x))
            .collect()
    }

    fn linear_ticks(&self) -> Vec<f64> {
        let raw = (self.high - self.low) / 5.0;
        let magnitude = 10f64.powf(raw.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .into_iter()
            .map(|factor| factor * magnitude)
            .find(|step| *step >= raw)
            .unwrap_or(raw);
        let first = (self.low / step).ceil() as i64;
        let last = (self.high / step).floor() as i64;
        (first..=last).map(|k| k as f64 * step).collect()
    }
}

/// A short number: 0.01, 1e-8, 200k.
fn tick_name(x: f64) -> String {
    if x >= 1e3 {
        for (unit, name) in [(1e9, "G"), (1e6, "M"), (1e3, "k")] {
            if x >= unit {
                return format!("{}{name}", number(x / unit));
            }
        }
    }
    if x != 0.0 && x.abs() < 1e-3 {
        return format!("{x:.0e}");
    }
    // Removes rounding errors as in 0.30000000000000004.
    ((x * 1e6).round() / 1e6).to_string()
}

/// A rectangle: left, top, right, bottom.
pub(super) type Rect = [f64; 4];

fn overlap(a: &Rect, b: &Rect) -> bool {
    a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3]
}

/// Position of a label.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Label {
    pub(super) x: f64,
    /// Position of the baseline.
    pub(super) y: f64,
    /// `start`, `middle` or `end`.
    pub(super) anchor: &'static str,
}

/// Places labels beside their points one by one, so that they cover neither a point nor an earlier label.
#[derive(Debug)]
pub(super) struct Labels {
    taken: Vec<Rect>,
    area: Rect,
}

impl Labels {
    /// Points are treated as discs of this radius.
    const POINT: f64 = 5.0;
    /// Height of a line, and mean width of a letter at this height.
    const LINE: f64 = 13.0;
    const LETTER: f64 = 6.2;

    pub(super) fn new(points: &[(f64, f64)], area: Rect) -> Self {
        let r = Self::POINT;
        let taken = points
            .iter()
            .map(|&(x, y)| [x - r, y - r, x + r, y + r])
            .collect();
        Self { taken, area }
    }

    /// `None` if there is no space for the label; the table below the plot has the name.
    pub(super) fn place(&mut self, (x, y): (f64, f64), text: &str) -> Option<Label> {
        let width = text.chars().count() as f64 * Self::LETTER;
        let (gap, line) = (Self::POINT + 3.0, Self::LINE);
        let middle = y + 0.32 * line;
        let candidates = [
            (x + gap, middle, "start"),
            (x - gap, middle, "end"),
            (x, y - gap, "middle"),
            (x, y + gap + 0.7 * line, "middle"),
            (x + gap * 0.7, y - gap * 0.8, "start"),
            (x - gap * 0.7, y - gap * 0.8, "end"),
            (x + gap * 0.7, y + gap * 0.4 + 0.7 * line, "start"),
            (x - gap * 0.7, y + gap * 0.4 + 0.7 * line, "end"),
        ];
        for (x, y, anchor) in candidates {
            let left = match anchor {
                "start" => x,
                "end" => x - width,
                _ => x - 0.5 * width,
            };
            let rect = [left, y - 0.8 * line, left + width, y + 0.2 * line];
            let inside = rect[0] >= self.area[0]
                && rect[1] >= self.area[1]
                && rect[2] <= self.area[2]
                && rect[3] <= self.area[3];
            if inside && !self.taken.iter().any(|taken| overlap(taken, &rect)) {
                self.taken.push(rect);
                return Some(Label { x, y, anchor });
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_scale_keeps_order_and_gives_zero_a_lane() {
        let scale = Scale::new(true, &[1e-8, 0.0, 3.0, f64::NAN], 300.0, 10.0);
        let at: Vec<f64> = [0.0, 1e-8, 1e-4, 3.0]
            .map(|x| scale.at(x).unwrap())
            .to_vec();
        assert!(at.windows(2).all(|w| w[0] > w[1]), "{at:?}");
        assert!(at.iter().all(|&y| (10.0..=300.0).contains(&y)), "{at:?}");
        assert_eq!(scale.at(f64::NAN), None);
        assert_eq!(scale.at(-1.0), None);
        assert_eq!(scale.ticks()[0].1, "0");
        assert_eq!(Scale::new(true, &[1.0], 0.0, 1.0).at(0.0), None);
    }

    #[test]
    fn ticks_are_few_and_round() {
        for (log, values, some) in [
            (false, [0.0, 31.0], "10"),
            (false, [0.1, 0.9], "0.2"),
            (true, [2.0, 300.0], "100"),
            (true, [1e-9, 1.0], "1e-6"),
            (true, [1e3, 2e6], "10k"),
            (true, [5.0, 5.0], "5"),
        ] {
            let ticks = Scale::new(log, &values, 0.0, 400.0).ticks();
            let names: Vec<&str> = ticks.iter().map(|(_, name)| name.as_str()).collect();
            assert!((2..=10).contains(&names.len()), "{values:?}: {names:?}");
            assert!(names.contains(&some), "{values:?}: {names:?}");
        }
        // There is a scale even without values.
        assert!(!Scale::new(true, &[f64::NAN], 0.0, 1.0).ticks().is_empty());
        assert!(!Scale::new(false, &[], 0.0, 1.0).ticks().is_empty());
    }

    #[test]
    fn labels_never_overlap() {
        let points: Vec<(f64, f64)> = (0..40)
            .map(|k| {
                (
                    60.0 + f64::from(k % 8) * 30.0,
                    50.0 + f64::from(k / 8) * 9.0,
                )
            })
            .collect();
        let mut labels = Labels::new(&points, [0.0, 0.0, 400.0, 300.0]);
        let placed = points
            .iter()
            .filter(|&&point| labels.place(point, "adaptive 20").is_some())
            .count();
        assert!(placed > 3 && placed < 40, "{placed}");
        let texts = &labels.taken[points.len()..];
        for (i, a) in texts.iter().enumerate() {
            assert!(!texts[i + 1..].iter().any(|b| overlap(a, b)));
        }
    }
}
