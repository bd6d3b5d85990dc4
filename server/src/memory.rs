//! Memory budgets: memory is taken from a budget before it is allocated, and returned to it on drop.
//!
//! A budget may have a parent (a session's budget has that of the process): memory is taken from both, or from
//! neither.

use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// A limit on bytes held, shared by clones.
#[derive(Debug, Clone)]
pub struct Budget(Arc<Account>);

#[derive(Debug)]
struct Account {
    /// Name, such as "the session's scenes", for messages.
    name: &'static str,
    limit: u64,
    held: AtomicU64,
    parent: Option<Budget>,
}

/// A request for more memory than a budget has left.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{what}: expected at most {} (left of the {} for {name}), got {}", mib(.left), mib(.limit), mib(.asked))]
pub struct OverBudget {
    /// Use of the memory.
    pub what: String,
    /// Name of the budget.
    pub name: &'static str,
    /// Requested bytes.
    pub asked: u64,
    /// Available bytes.
    pub left: u64,
    /// Limit of the budget, bytes.
    pub limit: u64,
}

/// Bytes in MiB, for people.
fn mib(bytes: &u64) -> String {
    match bytes {
        0..0x10_0000 => format!("{bytes} bytes"),
        _ => format!("{:.1} MiB", *bytes as f64 / f64::from(1 << 20)),
    }
}

impl Budget {
    /// A budget of `limit` bytes; `name` is for messages.
    pub fn new(name: &'static str, limit: u64) -> Self {
        Self::with_parent(name, limit, None)
    }

    /// A budget without a limit.
    pub fn unlimited() -> Self {
        Self::new("everything", u64::MAX)
    }

    /// A budget of all memory of this machine: memory that would not fit is an error instead of the end of the
    /// process.
    pub fn of_the_machine() -> Self {
        Self::new("this machine", of_the_machine().unwrap_or(u64::MAX))
    }

    /// A part of this budget: memory is taken from both.
    pub fn part(&self, name: &'static str, limit: u64) -> Self {
        Self::with_parent(name, limit, Some(self.clone()))
    }

    fn with_parent(name: &'static str, limit: u64, parent: Option<Self>) -> Self {
        Self(Arc::new(Account {
            name,
            limit,
            held: AtomicU64::new(0),
            parent,
        }))
    }

    /// Bytes that are currently held.
    pub fn held(&self) -> u64 {
        self.0.held.load(Ordering::Relaxed)
    }

    /// Most bytes that may be held.
    pub fn limit(&self) -> u64 {
        self.0.limit
    }

    /// The parent budget.
    pub fn parent(&self) -> Option<&Self> {
        self.0.parent.as_ref()
    }

    /// Takes memory for `what`; it is returned when the result is dropped.
    pub fn take(&self, bytes: u64, what: &str) -> Result<Held, OverBudget> {
        let mut held = self.nothing();
        held.grow(bytes, what)?;
        Ok(held)
    }

    /// Takes memory from this budget alone, because the parent was already charged for it.
    pub fn take_here(&self, bytes: u64, what: &str) -> Result<Held, OverBudget> {
        self.charge(bytes, what)?;
        Ok(Held {
            budget: self.clone(),
            bytes,
            here: true,
        })
    }

    /// Holds no memory yet, and can grow.
    pub fn nothing(&self) -> Held {
        Held {
            budget: self.clone(),
            bytes: 0,
            here: false,
        }
    }

    fn charge(&self, bytes: u64, what: &str) -> Result<(), OverBudget> {
        let account = &self.0;
        let add = |held: u64| held.checked_add(bytes).filter(|&n| n <= account.limit);
        account
            .held
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, add)
            .map(|_| ())
            .map_err(|held| OverBudget {
                what: what.to_owned(),
                name: account.name,
                asked: bytes,
                left: account.limit.saturating_sub(held),
                limit: account.limit,
            })
    }

    fn refund(&self, bytes: u64) {
        self.0.held.fetch_sub(bytes, Ordering::Relaxed);
    }

    fn charge_all(&self, bytes: u64, what: &str) -> Result<(), OverBudget> {
        self.charge(bytes, what)?;
        if let Some(parent) = &self.0.parent {
            parent.charge_all(bytes, what).inspect_err(|_| {
                self.refund(bytes);
            })?;
        }
        Ok(())
    }

    fn refund_all(&self, bytes: u64) {
        self.refund(bytes);
        if let Some(parent) = &self.0.parent {
            parent.refund_all(bytes);
        }
    }
}

/// Memory taken from a budget; returned on drop.
#[derive(Debug)]
pub struct Held {
    budget: Budget,
    bytes: u64,
    /// Taken only from this budget, not from its parent.
    here: bool,
}

impl Held {
    /// Number of bytes held.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Takes more memory; on an error nothing changes.
    pub fn grow(&mut self, bytes: u64, what: &str) -> Result<(), OverBudget> {
        if self.here {
            self.budget.charge(bytes, what)?;
        } else {
            self.budget.charge_all(bytes, what)?;
        }
        self.bytes += bytes;
        Ok(())
    }

    /// Returns the memory beyond `bytes`.
    pub fn shrink_to(&mut self, bytes: u64) {
        let back = self.bytes.saturating_sub(bytes);
        if self.here {
            self.budget.refund(back);
        } else {
            self.budget.refund_all(back);
        }
        self.bytes -= back;
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        self.shrink_to(0);
    }
}

impl fmt::Display for Budget {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} of {}", mib(&self.held()), mib(&self.limit()))
    }
}

/// Memory of this machine, bytes; `None` if unknown.
pub fn of_the_machine() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find(|line| line.starts_with("MemTotal:"))?;
    let kib: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib << 10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_taken_is_given_back_and_the_error_says_how_much_is_left() {
        let process = Budget::new("all sessions' scenes", 100);
        let session = process.part("the session's scenes", 80);
        let mut held = session.take(50, "a mesh").unwrap();
        assert_eq!((session.held(), process.held()), (50, 50));
        let error = session.take(31, "a tree").unwrap_err();
        assert_eq!(
            error.to_string(),
            "a tree: expected at most 30 bytes (left of the 80 bytes for the session's scenes), got 31 bytes"
        );
        // The available memory is less than the other session's own limit, because the process is full.
        let other = process.part("the session's scenes", 80);
        let error = other.take(60, "a picture").unwrap_err();
        assert_eq!((error.name, error.left), ("all sessions' scenes", 50));
        assert_eq!((other.held(), process.held()), (0, 50));
        held.grow(30, "a mesh").unwrap();
        assert!(held.grow(1, "a mesh").is_err());
        assert_eq!(held.bytes(), 80);
        held.shrink_to(10);
        assert_eq!((session.held(), process.held()), (10, 10));
        drop(held);
        assert_eq!((session.held(), process.held()), (0, 0));
        let here = session.take_here(70, "shared").unwrap();
        assert_eq!((session.held(), process.held()), (70, 0));
        drop(here);
        assert_eq!(session.held(), 0);
        assert!(session.take(u64::MAX, "everything").is_err());
    }

    proptest! {
        /// For any sequence of taking and returning memory, budgets hold exactly the memory in use, never more than
        /// their limit.
        #[test]
        fn budgets_hold_what_is_out(steps in prop::collection::vec((0usize..2, 0u64..60, any::<bool>()), 0..60)) {
            let process = Budget::new("all", 100);
            let sessions = [process.part("one", 70), process.part("other", 90)];
            let mut out: Vec<(usize, Held)> = Vec::new();
            for (who, bytes, take) in steps {
                if take {
                    let room = sessions[who].limit() - sessions[who].held();
                    let room = room.min(process.limit() - process.held());
                    let taken = sessions[who].take(bytes, "x");
                    prop_assert_eq!(taken.is_ok(), bytes <= room);
                    out.extend(taken.ok().map(|held| (who, held)));
                } else if !out.is_empty() {
                    out.swap_remove(bytes as usize % out.len());
                }
                let sum = |who: usize| out.iter().filter(|o| o.0 == who).map(|o| o.1.bytes()).sum::<u64>();
                prop_assert_eq!([sessions[0].held(), sessions[1].held()], [sum(0), sum(1)]);
                prop_assert_eq!(process.held(), sum(0) + sum(1));
            }
        }
    }
}
