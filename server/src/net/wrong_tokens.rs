//! Delays and logs wrong tokens, by address. A right token is never delayed, so an attacker cannot lock out the
//! owner.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Delay of the response to the first wrong token; each further one doubles it.
const FIRST_DELAY: Duration = Duration::from_millis(100);

/// Longest delay.
const MAX_DELAY: Duration = Duration::from_secs(4);

/// An address without a wrong token for this long starts again at the first delay.
const FORGET: Duration = Duration::from_secs(60);

/// Time between two log lines about one address.
const LOG_PERIOD: Duration = Duration::from_secs(10);

/// Most log lines about all addresses in one period.
const MAX_LINES: u32 = 20;

/// Most addresses remembered; beyond it, the one without an attempt for the longest time is forgotten.
const MAX_ADDRESSES: usize = 1024;

struct Record {
    tries: u32,
    last: Instant,
    logged: Option<Instant>,
    unlogged: u64,
}

#[derive(Default)]
struct Table {
    records: BTreeMap<IpAddr, Record>,
    /// Start of the current period of log lines, and lines in it.
    lines: Option<(Instant, u32)>,
}

/// How to treat a wrong token.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Verdict {
    /// How long the response is delayed.
    pub(super) delay: Duration,
    /// Number of wrong tokens to report in one log line now; 0 if no line is due.
    pub(super) to_log: u64,
}

/// Wrong tokens, by address.
#[derive(Default)]
pub(super) struct WrongTokens(Mutex<Table>);

impl WrongTokens {
    /// Counts a wrong token.
    pub(super) fn tried(&self, peer: IpAddr, now: Instant) -> Verdict {
        let mut table = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let table = &mut *table;
        if table.records.len() >= MAX_ADDRESSES && !table.records.contains_key(&peer) {
            let quietest = table.records.iter().min_by_key(|(_, r)| r.last);
            if let Some(peer) = quietest.map(|(&peer, _)| peer) {
                table.records.remove(&peer);
            }
        }
        let record = table.records.entry(peer).or_insert(Record {
            tries: 0,
            last: now,
            logged: None,
            unlogged: 0,
        });
        if now.saturating_duration_since(record.last) > FORGET {
            record.tries = 0;
        }
        let delay = FIRST_DELAY
            .saturating_mul(1 << record.tries.min(10))
            .min(MAX_DELAY);
        record.tries = record.tries.saturating_add(1);
        record.last = now;
        record.unlogged += 1;
        let recent = |at: Instant| now.saturating_duration_since(at) < LOG_PERIOD;
        let (start, lines) = table
            .lines
            .filter(|&(at, _)| recent(at))
            .unwrap_or((now, 0));
        let due = !record.logged.is_some_and(recent) && lines < MAX_LINES;
        table.lines = Some((start, lines + u32::from(due)));
        if due {
            record.logged = Some(now);
        }
        Verdict {
            delay,
            to_log: if due {
                std::mem::take(&mut record.unlogged)
            } else {
                0
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn from(n: u32) -> IpAddr {
        IpAddr::from(n.to_be_bytes())
    }

    #[test]
    fn the_delay_grows_for_one_address_only_and_is_forgotten() {
        let wrong = WrongTokens::default();
        let start = Instant::now();
        let delays: Vec<u128> = (0..8)
            .map(|_| wrong.tried(from(1), start).delay.as_millis())
            .collect();
        assert_eq!(delays, [100, 200, 400, 800, 1600, 3200, 4000, 4000]);
        assert_eq!(wrong.tried(from(2), start).delay, FIRST_DELAY);
        let later = start + FORGET + Duration::from_secs(1);
        assert_eq!(wrong.tried(from(1), later).delay, FIRST_DELAY);
    }

    #[test]
    fn log_lines_are_few_and_count_every_try() {
        let wrong = WrongTokens::default();
        let start = Instant::now();
        let lines: Vec<u64> = (0..100)
            .map(|_| wrong.tried(from(1), start).to_log)
            .collect();
        assert_eq!(lines[0], 1);
        assert_eq!(lines[1..].iter().sum::<u64>(), 0);
        let later = start + LOG_PERIOD;
        assert_eq!(wrong.tried(from(1), later).to_log, 100);
    }

    #[test]
    fn many_addresses_cost_neither_lines_nor_memory() {
        let wrong = WrongTokens::default();
        let start = Instant::now();
        let lines = (0..5000)
            .filter(|&n| wrong.tried(from(n), start).to_log > 0)
            .count();
        assert_eq!(lines, MAX_LINES as usize);
        assert_eq!(wrong.0.lock().unwrap().records.len(), MAX_ADDRESSES);
    }
}
