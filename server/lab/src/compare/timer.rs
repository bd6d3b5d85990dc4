//! Timing whose ratios are reliable on a busy machine.

use std::time::{Duration, Instant};

use ghostlight::numerics::percentile;

/// A turn lasts at least this long. The first run of a turn finds caches as the previous variant and other
/// programs left them. That hardly affects a run of a second, but a run of a millisecond would be timed in a
/// state in which it is not used.
const TURN: Duration = Duration::from_millis(30);

/// Seconds per run, for each variant. All variants run in turn within each round, so that disturbances of the
/// machine affect all alike, and the median round of each counts. Within a turn, a fast variant runs several
/// times. `run` is called once per variant before the rounds, so that buffers are allocated.
pub fn take_turns<T>(rounds: usize, variants: &mut [T], mut run: impl FnMut(&mut T)) -> Vec<f64> {
    for variant in &mut *variants {
        run(variant);
    }
    let mut seconds = vec![Vec::with_capacity(rounds); variants.len()];
    for _ in 0..rounds.max(1) {
        for (variant, seconds) in variants.iter_mut().zip(&mut seconds) {
            let (start, mut runs) = (Instant::now(), 0);
            let elapsed = loop {
                run(variant);
                runs += 1;
                let elapsed = start.elapsed();
                if elapsed >= TURN {
                    break elapsed;
                }
            };
            seconds.push(elapsed.as_secs_f64() / f64::from(runs));
        }
    }
    seconds
        .into_iter()
        .map(|mut seconds| median(&mut seconds))
        .collect()
}

/// The middle value, the lower one of two; NaN if empty. Sorts the values.
pub fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// The least value such that the given share of all values does not exceed it; NaN if empty. Sorts the values.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    percentile(values, share).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn variants_take_turns_after_one_warm_up() {
        let mut order = Vec::new();
        let seconds = take_turns(2, &mut ['a', 'b'], |&mut name| order.push(name));
        assert_eq!(order[..2], ['a', 'b']);
        order.dedup();
        assert_eq!(order, ['a', 'b', 'a', 'b', 'a', 'b']);
        assert!(seconds.len() == 2 && seconds.iter().all(|&s| s < TURN.as_secs_f64()));
    }

    #[test]
    fn quantiles() {
        let mut values = [5.0, 1.0, 3.0];
        assert_eq!(median(&mut values), 3.0);
        assert_eq!(quantile(&mut values, 0.99), 5.0);
        assert_eq!(quantile(&mut values, 0.0), 1.0);
        assert_eq!(quantile(&mut values, 1.0), 5.0);
        assert!(median(&mut []).is_nan());
    }
}
