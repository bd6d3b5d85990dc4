//! Admission of connections. Those without a valid hello are counted in a pool of their own, so that a client
//! without the token cannot take the place of one with it.
//!
//! The pool never refuses a new connection. When it is full, the oldest connection of the address with the most
//! connections is closed. Connections younger than [`YOUNG`] are not closed, even if the pool then exceeds its
//! size for a moment: a client that says hello without delay always gets in.

use std::collections::BTreeMap;
use std::net::{IpAddr, Ipv6Addr};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::config::Bounds;
use super::metrics::{Metrics, Turned};

/// A connection younger than this is closed only if the pool is [`CROWD`] times full.
const YOUNG: Duration = Duration::from_secs(1);

/// How many times its size the pool may reach by sparing young connections. Each costs a file handle and a few
/// KiB.
const CROWD: usize = 16;

/// The part of an address that identifies one user: the whole IPv4 address, the network half of an IPv6 address.
pub(super) fn peer_of(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) => {
            let network = u128::from(v6) & !u128::from(u64::MAX);
            // The loopback address and others without a network half are used whole.
            let whole = if network == 0 {
                u128::from(v6)
            } else {
                network
            };
            IpAddr::V6(Ipv6Addr::from(whole))
        }
        v4 => v4,
    }
}

struct Waiting {
    peer: IpAddr,
    since: Instant,
    dropped: watch::Sender<bool>,
}

#[derive(Default)]
struct Pool {
    next: u64,
    /// Waiting connections by age: the first has been silent longest.
    waiting: BTreeMap<u64, Waiting>,
    /// Clients, counted after a valid hello.
    inside: usize,
}

impl Pool {
    /// For each peer, how many connections wait, and the oldest of them.
    fn peers(&self) -> BTreeMap<IpAddr, (usize, u64)> {
        let mut peers = BTreeMap::new();
        for (&number, waiting) in &self.waiting {
            peers.entry(waiting.peer).or_insert((0, number)).0 += 1;
        }
        peers
    }

    /// The connection to close for a new one of `peer`, if one must be closed.
    fn victim(&self, peer: IpAddr, limits: &Limits, now: Instant) -> Option<u64> {
        let peers = self.peers();
        let of_peer = peers.get(&peer).copied().unwrap_or_default();
        let (oldest, crowded) = if of_peer.0 >= limits.per_peer {
            (of_peer.1, of_peer.0 >= limits.per_peer * CROWD)
        } else if self.waiting.len() >= limits.waiting {
            let greediest = peers
                .into_values()
                .max_by_key(|&(n, oldest)| (n, std::cmp::Reverse(oldest)));
            (greediest?.1, self.waiting.len() >= limits.waiting * CROWD)
        } else {
            return None;
        };
        let age = now.saturating_duration_since(self.waiting.get(&oldest)?.since);
        (crowded || age >= YOUNG).then_some(oldest)
    }
}

/// Limits on connections.
struct Limits {
    waiting: usize,
    per_peer: usize,
    inside: usize,
}

/// Every connection of a server, waiting or admitted.
pub(super) struct Door {
    limits: Limits,
    metrics: Arc<Metrics>,
    pool: Mutex<Pool>,
    open: watch::Sender<usize>,
}

/// A connection's place in the waiting pool, later among the clients; returned when dropped.
pub(super) struct Ticket {
    door: Arc<Door>,
    peer: IpAddr,
    number: Mutex<u64>,
    inside: AtomicBool,
    dropped: watch::Receiver<bool>,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every critical section leaves its data consistent, so a poisoned lock is usable.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Door {
    /// Without connections yet.
    pub(super) fn new(bounds: &Bounds, metrics: Arc<Metrics>) -> Arc<Self> {
        Arc::new(Self {
            limits: Limits {
                waiting: bounds.waiting,
                per_peer: bounds.waiting_per_address,
                inside: bounds.connections,
            },
            metrics,
            pool: Mutex::default(),
            open: watch::Sender::new(0),
        })
    }

    /// The number of open connections of every kind.
    pub(super) fn open(&self) -> watch::Receiver<usize> {
        self.open.subscribe()
    }

    /// Takes a place for a new connection; closes an older connection if there is none.
    pub(super) fn take(self: &Arc<Self>, address: IpAddr) -> Arc<Ticket> {
        self.take_at(address, Instant::now())
    }

    fn take_at(self: &Arc<Self>, address: IpAddr, now: Instant) -> Arc<Ticket> {
        let peer = peer_of(address);
        let mut pool = lock(&self.pool);
        while let Some(number) = pool.victim(peer, &self.limits, now)
            && let Some(waiting) = pool.waiting.remove(&number)
        {
            waiting.dropped.send_replace(true);
            self.metrics.waiting.dec();
            self.metrics.turned(Turned::Dropped);
        }
        let number = pool.next;
        pool.next += 1;
        let dropped = watch::Sender::new(false);
        let ticket = Ticket {
            door: Arc::clone(self),
            peer,
            number: Mutex::new(number),
            inside: AtomicBool::new(false),
            dropped: dropped.subscribe(),
        };
        let waiting = Waiting {
            peer,
            since: now,
            dropped,
        };
        pool.waiting.insert(number, waiting);
        self.metrics.waiting.inc();
        self.open.send_modify(|n| *n += 1);
        Arc::new(ticket)
    }
}

impl Ticket {
    /// The client's address.
    pub(super) fn peer(&self) -> IpAddr {
        self.peer
    }

    /// The connection made progress: it counts as the youngest in the pool again.
    pub(super) fn renew(&self) {
        let mut pool = lock(&self.door.pool);
        let mut number = lock(&self.number);
        if let Some(mut waiting) = pool.waiting.remove(&number) {
            waiting.since = Instant::now();
            *number = pool.next;
            pool.next += 1;
            pool.waiting.insert(*number, waiting);
        }
    }

    /// Moves the connection from the waiting pool to the clients; false if there are too many clients.
    pub(super) fn enter(&self) -> bool {
        let mut pool = lock(&self.door.pool);
        if pool.inside >= self.door.limits.inside {
            drop(pool);
            self.door.metrics.turned(Turned::Full);
            return false;
        }
        pool.inside += 1;
        self.leave_pool(&mut pool);
        self.inside.store(true, Ordering::Relaxed);
        self.door.metrics.connections.inc();
        true
    }

    /// Resolves when this connection is to be closed in favour of a newer one; never once it is a client.
    pub(super) async fn dropped(&self) {
        let mut dropped = self.dropped.clone();
        if dropped.wait_for(|&d| d).await.is_err() {
            // It left the pool by itself.
            std::future::pending::<()>().await;
        }
    }

    fn leave_pool(&self, pool: &mut Pool) {
        if pool.waiting.remove(&lock(&self.number)).is_some() {
            self.door.metrics.waiting.dec();
        }
    }
}

impl Drop for Ticket {
    fn drop(&mut self) {
        let mut pool = lock(&self.door.pool);
        self.leave_pool(&mut pool);
        if self.inside.load(Ordering::Relaxed) {
            pool.inside -= 1;
            self.door.metrics.connections.dec();
        }
        drop(pool);
        self.door.open.send_modify(|n| *n -= 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn door(waiting: usize, waiting_per_address: usize, connections: usize) -> Arc<Door> {
        let bounds = Bounds {
            waiting,
            waiting_per_address,
            connections,
            ..Bounds::default()
        };
        Door::new(&bounds, Arc::default())
    }

    fn from(last: u8) -> IpAddr {
        IpAddr::from([10, 0, 0, last])
    }

    fn is_dropped(ticket: &Ticket) -> bool {
        *ticket.dropped.borrow()
    }

    /// A connection that arrives when the others are no longer young.
    fn late(door: &Arc<Door>, address: IpAddr) -> Arc<Ticket> {
        let n = lock(&door.pool).next as u32;
        door.take_at(address, Instant::now() + YOUNG * (n + 1))
    }

    #[test]
    fn an_address_makes_room_for_itself_first() {
        let door = door(8, 3, 8);
        let other = late(&door, from(1));
        let mine: Vec<_> = (0..5).map(|_| late(&door, from(2))).collect();
        let dropped: Vec<bool> = mine.iter().map(|t| is_dropped(t)).collect();
        assert_eq!(dropped, [true, true, false, false, false]);
        assert!(!is_dropped(&other));
    }

    #[test]
    fn the_oldest_of_the_greediest_address_makes_room() {
        let door = door(6, 4, 8);
        let lone = late(&door, from(1));
        let many: Vec<_> = (0..4).map(|_| late(&door, from(2))).collect();
        let few = late(&door, from(3));
        let newcomer = late(&door, from(4));
        assert!(is_dropped(&many[0]) && !is_dropped(&many[1]));
        assert!(!is_dropped(&lone) && !is_dropped(&few) && !is_dropped(&newcomer));
        // A connection that made progress meanwhile is no longer the oldest.
        many[1].renew();
        let _another = late(&door, from(5));
        assert!(is_dropped(&many[2]) && !is_dropped(&many[1]));
    }

    #[test]
    fn the_young_stay_until_there_is_a_crowd_and_then_all_the_old_go() {
        let door = door(4, 3, 8);
        let now = Instant::now();
        let crowd: Vec<_> = (0..3 * CROWD).map(|_| door.take_at(from(1), now)).collect();
        assert!(crowd.iter().all(|t| !is_dropped(t)));
        let _one_more = door.take_at(from(1), now);
        assert!(is_dropped(&crowd[0]) && !is_dropped(&crowd[1]));
        let _later = door.take_at(from(1), now + YOUNG);
        assert!(crowd[..crowd.len() - 1].iter().all(|t| is_dropped(t)));
        assert_eq!(lock(&door.pool).waiting.len(), 3);
    }

    #[test]
    fn places_inside_are_counted_apart_and_given_back() {
        let door = door(2, 2, 1);
        let owner = door.take(from(1));
        assert!(owner.enter());
        let crowd: Vec<_> = (0..50).map(|_| door.take(from(1))).collect();
        assert!(!is_dropped(&owner));
        assert!(!crowd[49].enter(), "all places inside are taken");
        drop(owner);
        assert!(crowd[49].enter());
        drop(crowd);
        assert_eq!(*door.open().borrow(), 0);
        let pool = lock(&door.pool);
        assert_eq!((pool.waiting.len(), pool.inside), (0, 0));
    }

    #[test]
    fn one_network_of_ipv6_is_one_peer() {
        let peer = |text: &str| peer_of(text.parse().unwrap());
        assert_eq!(peer("2001:db8::1"), peer("2001:db8::ffff:1"));
        assert_ne!(peer("2001:db8::1"), peer("2001:db8:0:1::1"));
        assert_eq!(peer("::ffff:10.0.0.1"), peer("10.0.0.1"));
        assert_ne!(peer("10.0.0.1"), peer("10.0.0.2"));
        assert_ne!(peer("::1"), peer("::2"));
    }
}
