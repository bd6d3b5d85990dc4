//! Limits on incomplete messages: a message that has begun must end in time, and the bytes buffered of
//! incomplete messages of all clients are bounded.
//!
//! The byte stream is parsed frame by frame (RFC 6455, section 5.2) without being changed; other
//! protocol errors are left to the WebSocket library.

use std::io;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::task::{Context, Poll};
use std::time::Duration;

use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Sleep, sleep};

use super::config::Bounds;

/// Longest payload of a control frame, bytes.
const MAX_CONTROL: u64 = 125;

/// Why reading a connection was stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub(super) enum Fault {
    /// A message took too long.
    #[error("a message did not end in time")]
    Slow,
    /// A message is larger than this client may send at present.
    #[error("a message is too large")]
    Large,
    /// The incomplete messages of all clients together are too large.
    #[error("too many bytes of unfinished messages")]
    Full,
}

/// Tracks the WebSocket frames of a client.
#[derive(Debug, Default)]
struct FrameScan {
    /// Header bytes of the current frame received so far.
    header: [u8; 14],
    header_len: usize,
    /// Payload bytes of the current frame still to come.
    left: u64,
    /// The frame is a control frame, which may come in the middle of a message.
    control: bool,
    /// The frame's last byte ends a message.
    last: bool,
    /// Bytes of the current message received so far.
    held: u64,
    /// Largest sizes, as announced by frame headers, of the first message and of any later one.
    largest: [u64; 2],
    /// Messages begun so far; the newest is incomplete if `held` is above 0.
    begun: u64,
}

impl FrameScan {
    /// Parses bytes that were read.
    fn feed(&mut self, mut bytes: &[u8]) {
        while !bytes.is_empty() {
            if self.left == 0 {
                let Some((&byte, rest)) = bytes.split_first() else {
                    return;
                };
                bytes = rest;
                self.head(byte);
            } else {
                let n = self.left.min(bytes.len() as u64);
                bytes = &bytes[n as usize..];
                self.left -= n;
                self.count(n);
                if self.left == 0 {
                    self.frame_ends();
                }
            }
        }
    }

    /// Parses a byte of a header.
    fn head(&mut self, byte: u8) {
        if self.header_len == 0 {
            self.control = byte & 0x08 != 0;
            self.last = byte & 0x80 != 0;
            if !self.control && self.held == 0 {
                self.begun += 1;
            }
        }
        self.header[self.header_len] = byte;
        self.header_len += 1;
        self.count(1);
        if self.header_len < 2 {
            return;
        }
        let mask = if self.header[1] & 0x80 != 0 { 4 } else { 0 };
        let length = match self.header[1] & 0x7F {
            126 => 2,
            127 => 8,
            _ => 0,
        };
        if self.header_len < 2 + length + mask {
            return;
        }
        let number = |bytes: &[u8]| bytes.iter().fold(0, |n, &b| n << 8 | u64::from(b));
        self.left = match length {
            0 => u64::from(self.header[1] & 0x7F),
            length => number(&self.header[2..2 + length]),
        };
        self.header_len = 0;
        // Refused here: the library would buffer all of it first.
        self.control &= self.left <= MAX_CONTROL;
        if !self.control {
            let largest = &mut self.largest[usize::from(self.begun > 1)];
            *largest = (*largest).max(self.held.saturating_add(self.left));
        }
        if self.left == 0 {
            self.frame_ends();
        }
    }

    fn count(&mut self, n: u64) {
        if !self.control {
            self.held += n;
        }
    }

    fn frame_ends(&mut self) {
        if !self.control && self.last {
            self.held = 0;
        }
    }
}

/// Budget for incomplete messages of all clients.
pub(super) struct Room {
    /// Reserved for each client.
    own: u64,
    /// Bytes left in the shared half.
    shared: AtomicU64,
}

impl Room {
    /// The budget that the configuration gives.
    pub(super) fn new(bounds: &Bounds) -> Arc<Self> {
        let half = bounds.unfinished_bytes / 2;
        let clients = (bounds.connections + bounds.waiting).max(1) as u64;
        Arc::new(Self {
            own: half / clients,
            shared: AtomicU64::new(half),
        })
    }
}

/// A client's part of the shared half; returned when dropped.
struct Loan {
    room: Arc<Room>,
    bytes: u64,
}

impl Loan {
    /// Takes or returns bytes, so that `held` bytes are covered; false if there are not enough.
    fn cover(&mut self, held: u64) -> bool {
        let wanted = held.saturating_sub(self.room.own);
        if wanted > self.bytes {
            let more = wanted - self.bytes;
            let taken =
                self.room
                    .shared
                    .fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| {
                        left.checked_sub(more)
                    });
            if taken.is_err() {
                return false;
            }
            self.bytes = wanted;
        } else if wanted < self.bytes && held == 0 {
            self.give_back();
        }
        true
    }

    fn give_back(&mut self) {
        let bytes = std::mem::take(&mut self.bytes);
        self.room.shared.fetch_add(bytes, Ordering::Relaxed);
    }
}

impl Drop for Loan {
    fn drop(&mut self) {
        self.give_back();
    }
}

/// Largest message that a client may send, bytes; may be raised.
pub(super) type Most = Arc<AtomicU64>;

/// A byte stream whose WebSocket messages are checked against the limits.
pub(super) struct Watched<S> {
    inner: S,
    scan: FrameScan,
    loan: Loan,
    most: Most,
    time: Duration,
    /// The deadline of the current message, and its number.
    deadline: Option<(u64, Pin<Box<Sleep>>)>,
    fault: Option<Fault>,
}

impl<S> Watched<S> {
    /// The stream of a client that may at present send messages of at most `most` bytes.
    pub(super) fn new(inner: S, room: &Arc<Room>, time: Duration, most: Most) -> Self {
        let loan = Loan {
            room: Arc::clone(room),
            bytes: 0,
        };
        Self {
            inner,
            scan: FrameScan::default(),
            loan,
            most,
            time,
            deadline: None,
            fault: None,
        }
    }

    /// The inner stream, to discard what is left to read.
    pub(super) fn into_inner(self) -> S {
        self.inner
    }

    fn most(&self) -> u64 {
        self.most.load(Ordering::Relaxed)
    }

    /// Whether a message after the first is larger than the client may send at present.
    fn is_too_large(&self) -> bool {
        self.scan.largest[1] > self.most()
    }

    fn take_in(&mut self, bytes: &[u8]) -> Result<(), Fault> {
        let first_is_whole = self.scan.begun > 0 && (self.scan.begun > 1 || self.scan.held == 0);
        self.scan.feed(bytes);
        if self.scan.largest[0] > self.most() || (first_is_whole && self.is_too_large()) {
            return Err(Fault::Large);
        }
        if !self.loan.cover(self.scan.held) {
            return Err(Fault::Full);
        }
        if self.scan.held == 0 {
            self.deadline = None;
        } else if self
            .deadline
            .as_ref()
            .is_none_or(|(n, _)| *n != self.scan.begun)
        {
            self.deadline = Some((self.scan.begun, Box::pin(sleep(self.time))));
        }
        Ok(())
    }

    fn late(&mut self, cx: &mut Context<'_>) -> bool {
        match &mut self.deadline {
            Some((_, deadline)) => deadline.as_mut().poll(cx).is_ready(),
            None => false,
        }
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = self.get_mut();
        if this.fault.is_none() && this.late(cx) {
            this.fault = Some(Fault::Slow);
        }
        // Bytes read together with the first message are checked only at the next read: by then the first message
        // may have raised the limit.
        if this.fault.is_none() && this.is_too_large() {
            this.fault = Some(Fault::Large);
        }
        if let Some(fault) = this.fault {
            return Poll::Ready(Err(io::Error::other(fault)));
        }
        let before = buf.filled().len();
        std::task::ready!(Pin::new(&mut this.inner).poll_read(cx, buf))?;
        if let Err(fault) = this.take_in(&buf.filled()[before..]) {
            this.fault = Some(fault);
            buf.set_filled(before);
            return Poll::Ready(Err(io::Error::other(fault)));
        }
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(
        self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.get_mut().inner).poll_write(cx, bytes)
    }

    fn poll_flush(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().inner).poll_flush(cx)
    }

    fn poll_shutdown(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.get_mut().inner).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream, duplex};

    /// A masked frame of a client: opcode with the FIN bit, and payload.
    fn frame(first: u8, payload: usize) -> Vec<u8> {
        let mut bytes = vec![first];
        match payload {
            0..126 => bytes.push(0x80 | payload as u8),
            126..65536 => {
                bytes.push(0x80 | 126);
                bytes.extend((payload as u16).to_be_bytes());
            }
            _ => {
                bytes.push(0x80 | 127);
                bytes.extend((payload as u64).to_be_bytes());
            }
        }
        bytes.extend([9, 8, 7, 6]);
        bytes.resize(bytes.len() + payload, 0x88);
        bytes
    }

    fn watched(
        unfinished: u64,
        most: u64,
        time: Duration,
    ) -> (DuplexStream, Watched<DuplexStream>) {
        let (near, far) = duplex(1 << 20);
        let bounds = Bounds {
            connections: 1,
            waiting: 1,
            unfinished_bytes: unfinished,
            ..Bounds::default()
        };
        let most = Arc::new(AtomicU64::new(most));
        (near, Watched::new(far, &Room::new(&bounds), time, most))
    }

    fn fault_of(error: &io::Error) -> Option<Fault> {
        error.get_ref()?.downcast_ref::<Fault>().copied()
    }

    proptest! {
        /// The scan is right however the bytes are split into reads.
        #[test]
        fn frames_are_followed_through_any_cuts(
            sizes in prop::collection::vec(prop_oneof![0usize..300, 65_000usize..66_000], 1..6),
            cuts in prop::collection::vec(1usize..40_000, 1..8),
        ) {
            // Each message in two fragments, with a ping between them and one after.
            let mut bytes = Vec::new();
            let mut ends = Vec::new();
            for &size in &sizes {
                bytes.extend(frame(0x02, size));
                bytes.extend(frame(0x89, size % 126));
                bytes.extend(frame(0x80, size / 2));
                ends.push(bytes.len());
                bytes.extend(frame(0x8A, 3));
            }
            let mut scan = FrameScan::default();
            let (mut at, mut cuts) = (0, cuts.iter().cycle());
            while at < bytes.len() {
                let n = (*cuts.next().unwrap()).min(bytes.len() - at);
                scan.feed(&bytes[at..at + n]);
                at += n;
                let finished = ends.iter().filter(|&&end| end <= at).count() as u64;
                // In the ping that follows a message, no message is in progress.
                let idle = ends.iter().any(|&end| (end..=end + 9).contains(&at));
                prop_assert_eq!(scan.held == 0, idle, "at {} of {:?}", at, ends);
                prop_assert_eq!(scan.begun, finished + u64::from(!idle));
            }
        }

        #[test]
        fn any_bytes_can_be_fed(bytes in prop::collection::vec(any::<u8>(), 0..2000)) {
            let mut scan = FrameScan::default();
            scan.feed(&bytes);
            prop_assert!(scan.held <= bytes.len() as u64);
        }
    }

    #[tokio::test]
    async fn an_announced_size_is_enough_to_refuse() {
        let whole = || watched(1 << 20, 1000, Duration::from_secs(60));
        let (mut near, mut far) = whole();
        near.write_all(&frame(0x81, 1200)).await.unwrap();
        let error = far.read(&mut vec![0; 4096]).await.unwrap_err();
        assert_eq!(fault_of(&error), Some(Fault::Large));
        let (mut near, mut far) = whole();
        near.write_all(&frame(0x81, 500)).await.unwrap();
        let mut buffer = vec![0; 4096];
        assert!(far.read(&mut buffer).await.is_ok());
        near.write_all(&frame(0x81, 5000)[..10]).await.unwrap();
        let error = far.read(&mut buffer).await.unwrap_err();
        assert_eq!(fault_of(&error), Some(Fault::Large));
    }

    #[tokio::test]
    async fn what_follows_the_first_message_at_once_is_its_affair() {
        for raised in [false, true] {
            let (mut near, mut far) = watched(1 << 20, 1000, Duration::from_secs(60));
            let hello = frame(0x81, 500);
            let both = [hello.as_slice(), &frame(0x82, 5000)[..1000]].concat();
            near.write_all(&both).await.unwrap();
            let mut buffer = vec![0; 4096];
            assert_eq!(far.read(&mut buffer).await.unwrap(), both.len());
            if raised {
                far.most.store(u64::MAX, Ordering::Relaxed);
            }
            near.write_all(&[0; 100]).await.unwrap();
            let more = far.read(&mut buffer).await;
            let fault = more.as_ref().err().and_then(fault_of);
            assert_eq!(fault, (!raised).then_some(Fault::Large));
        }
    }

    #[tokio::test]
    async fn a_message_in_dribs_runs_out_of_time_and_pings_do_not_help() {
        let (mut near, mut far) = watched(1 << 20, 1 << 20, Duration::from_millis(300));
        let writing = async {
            near.write_all(&frame(0x02, 10)).await.unwrap();
            // Waits up to a minute, far longer than it should take.
            for _ in 0..600 {
                near.write_all(&frame(0x89, 3)).await.unwrap();
                near.write_all(&frame(0x00, 1)).await.unwrap();
                tokio::time::sleep(Duration::from_millis(100)).await;
            }
        };
        let reading = async {
            let mut buffer = vec![0; 4096];
            loop {
                if let Err(error) = far.read(&mut buffer).await {
                    return fault_of(&error);
                }
            }
        };
        tokio::select! {
            () = writing => panic!("it never ran out"),
            fault = reading => assert_eq!(fault, Some(Fault::Slow)),
        }
    }

    #[tokio::test]
    async fn whole_messages_and_silence_between_them_take_any_time() {
        let (mut near, mut far) = watched(1 << 20, 1 << 20, Duration::from_millis(20));
        let mut buffer = vec![0; 4096];
        for _ in 0..5 {
            near.write_all(&frame(0x82, 100)).await.unwrap();
            assert!(far.read(&mut buffer).await.is_ok());
            let nothing = tokio::time::timeout(Duration::from_millis(60), far.read(&mut buffer));
            assert!(nothing.await.is_err());
        }
    }

    #[tokio::test]
    async fn room_is_lent_and_given_back() {
        let bounds = Bounds {
            connections: 3,
            waiting: 1,
            unfinished_bytes: 8000,
            ..Bounds::default()
        };
        let room = Room::new(&bounds);
        let mut loans: Vec<Loan> = (0..3)
            .map(|_| Loan {
                room: Arc::clone(&room),
                bytes: 0,
            })
            .collect();
        // Each client has 1000 of its own; 4000 are shared.
        assert!(loans[0].cover(4500));
        assert!(!loans[1].cover(1501));
        assert!(loans[1].cover(1500) && loans[2].cover(1000));
        assert!(!loans[2].cover(1001));
        assert!(loans[0].cover(0));
        assert!(loans[2].cover(4000));
        drop(loans);
        assert_eq!(room.shared.load(Ordering::Relaxed), 4000);
    }
}
