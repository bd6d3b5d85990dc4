//! Time stamps: decimal seconds, or integer milli-, micro- or nanoseconds.

use super::text::TextFile;

/// The unit of a file's stamps, as a power of ten of nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TimeUnit {
    /// A unit is 10^this nanoseconds.
    power: u32,
}

impl TimeUnit {
    pub(super) const SECONDS: Self = Self { power: 9 };
    const MILLISECONDS: Self = Self { power: 6 };
    const MICROSECONDS: Self = Self { power: 3 };
    const NANOSECONDS: Self = Self { power: 0 };

    /// Name, for people.
    pub(super) fn name(self) -> &'static str {
        match self.power {
            9 => "seconds",
            6 => "milliseconds",
            3 => "microseconds",
            _ => "nanoseconds",
        }
    }

    /// Determines the unit of a list of stamps. Times since 1970 are recognised by their size; integers with another
    /// origin by the median step, which is a frame or pose period: between two milliseconds and some seconds.
    pub(super) fn of<'a>(words: impl Iterator<Item = &'a str>) -> Self {
        // Seconds reach 1e11 in the year 5138, and milliseconds reach 1e14 then. A tenth of these values was in 1986:
        // there are no earlier recordings.
        const TIMES_SINCE_1970: [(f64, TimeUnit); 3] = [
            (1e17, TimeUnit::NANOSECONDS),
            (1e14, TimeUnit::MICROSECONDS),
            (1e11, TimeUnit::MILLISECONDS),
        ];
        const STEPS: [(f64, TimeUnit); 3] = [
            (1e6, TimeUnit::NANOSECONDS),
            (1.5e3, TimeUnit::MICROSECONDS),
            (5.0, TimeUnit::MILLISECONDS),
        ];
        let mut whole = true;
        let mut times: Vec<f64> = words
            .filter_map(|word| {
                let time: f64 = word.parse().ok()?;
                whole &= word.bytes().all(|b| b.is_ascii_digit());
                time.is_finite().then_some(time)
            })
            .collect();
        times.sort_by(f64::total_cmp);
        let pick = |table: [(f64, TimeUnit); 3], value: f64| {
            let found = table.into_iter().find(|(from, _)| value >= *from);
            found.map_or(Self::SECONDS, |(_, unit)| unit)
        };
        let median = times.get(times.len() / 2).copied().unwrap_or(0.0);
        let by_size = pick(TIMES_SINCE_1970, median);
        if by_size != Self::SECONDS || !whole || median >= 1e9 {
            return by_size;
        }
        let mut steps: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        steps.retain(|step| *step > 0.0);
        steps.sort_by(f64::total_cmp);
        pick(STEPS, steps.get(steps.len() / 2).copied().unwrap_or(0.0))
    }

    /// The unit of a file whose lines begin with a stamp.
    pub(super) fn of_file(file: &TextFile) -> Self {
        let lines: Vec<_> = file.lines().filter_map(Result::ok).collect();
        Self::of(lines.iter().filter_map(|line| line.words.first().copied()))
    }

    /// A stamp in nanoseconds, exact to the last digit (an f64 of Unix time has a resolution of only a quarter of a
    /// microsecond). Digits below a nanosecond are truncated.
    pub(super) fn parse_ns(self, word: &str) -> Option<i64> {
        let (sign, digits) = match word.strip_prefix('-') {
            Some(rest) => (-1, rest),
            None => (1, word.strip_prefix('+').unwrap_or(word)),
        };
        // A comma is the decimal point in some locales.
        let (whole, fraction) = digits.split_once(['.', ',']).unwrap_or((digits, ""));
        let plain = |s: &str| s.bytes().all(|b| b.is_ascii_digit());
        if plain(whole) && plain(fraction) && !(whole.is_empty() && fraction.is_empty()) {
            let units: i64 = if whole.is_empty() {
                0
            } else {
                whole.parse().ok()?
            };
            let mut nanos = 0;
            for i in 0..self.power as usize {
                nanos = nanos * 10 + i64::from(fraction.as_bytes().get(i).map_or(0, |b| b - b'0'));
            }
            return units
                .checked_mul(10i64.pow(self.power))?
                .checked_add(nanos)?
                .checked_mul(sign);
        }
        // Exponents, as numeric tools write them.
        let units: f64 = word.parse().ok()?;
        ns_from_f64(units * 10f64.powi(self.power as i32))
    }
}

/// Seconds in nanoseconds; `None` for NaN and values beyond i64.
pub(super) fn time_ns_from_secs(seconds: f64) -> Option<i64> {
    ns_from_f64(seconds * 1e9)
}

fn ns_from_f64(nanos: f64) -> Option<i64> {
    // 2^63 is exactly representable; all smaller values can be converted.
    (nanos.abs() < 9_223_372_036_854_775_808.0).then_some(nanos as i64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_are_exact_in_every_unit() {
        let ns = |word| TimeUnit::SECONDS.parse_ns(word);
        assert_eq!(ns("1305031453.359684"), Some(1_305_031_453_359_684_000));
        assert_eq!(ns("1305031453,359684"), Some(1_305_031_453_359_684_000));
        assert_eq!(ns("+7"), Some(7_000_000_000));
        for (word, unit) in [
            ("1305031453359684001", TimeUnit::NANOSECONDS),
            ("1305031453359684.001", TimeUnit::MICROSECONDS),
            ("1305031453359.684001", TimeUnit::MILLISECONDS),
        ] {
            assert_eq!(unit.parse_ns(word), Some(1_305_031_453_359_684_001));
        }
        assert_eq!(ns("99999999999"), None);
    }

    #[test]
    fn the_unit_is_told_by_size_or_step() {
        for (words, expected) in [
            ("1305031453.36 1305031453.39", TimeUnit::SECONDS),
            ("1305031453 1305031454", TimeUnit::SECONDS),
            ("1.305031453e+18 1.305031454e+18", TimeUnit::NANOSECONDS),
            ("1305031453359684000", TimeUnit::NANOSECONDS),
            ("1305031453359684", TimeUnit::MICROSECONDS),
            ("1305031453359", TimeUnit::MILLISECONDS),
            ("0 33 67 100", TimeUnit::MILLISECONDS),
            ("0 33333 66667", TimeUnit::MICROSECONDS),
            ("0 33333333 66666667", TimeUnit::NANOSECONDS),
            ("0 1 2 3", TimeUnit::SECONDS),
            ("0 0.033 100.5", TimeUnit::SECONDS),
            ("x nan", TimeUnit::SECONDS),
            ("", TimeUnit::SECONDS),
        ] {
            let unit = TimeUnit::of(words.split_whitespace());
            assert_eq!(unit, expected, "{words}");
        }
    }
}
