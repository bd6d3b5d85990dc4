//! All sessions of a server, and who may join them.

use std::collections::BTreeMap;
use std::net::IpAddr;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use ghostlight_proto::control::{CompositeRequest, Control, Hello, Planes, Role};
use ghostlight_proto::{Code, Codec, WireError};
use subtle::ConstantTimeEq;
use tokio::sync::watch;

use super::catalog::Catalog;
use super::config::ServeConfig;
use super::door::Door;
use super::fair::Gate;
use super::loaders::Loaders;
use super::metrics::{Metrics, Turned};
use super::render_thread::{Asker, RenderThread, Start};
use super::session::{Session, count, uncount};
use super::unfinished::Room;
use super::wrong_tokens::WrongTokens;
use crate::memory::Budget;

/// State shared by all connections.
pub(super) struct Hub {
    /// The validated configuration.
    pub(super) config: ServeConfig,
    /// Recordings and renderers.
    pub(super) catalog: Arc<dyn Catalog>,
    /// Counts of the whole server.
    pub(super) metrics: Arc<Metrics>,
    /// Divides the processor's time among sessions.
    gate: Arc<Gate>,
    /// Threads that load scenes.
    loaders: Arc<Loaders>,
    /// Memory budget of all sessions' scenes and uploads.
    memory: Budget,
    /// True once the server stops; nothing new is accepted.
    pub(super) stopping: watch::Sender<bool>,
    /// Every connection, before and after its hello.
    pub(super) door: Arc<Door>,
    /// Budget for incomplete messages.
    pub(super) room: Arc<Room>,
    wrong_tokens: WrongTokens,
    sessions: Mutex<BTreeMap<String, Arc<Session>>>,
    next: AtomicU64,
}

/// A client's handle to its session; dropping it ends the session if the client owns it.
pub(super) struct SessionHandle {
    /// The session.
    pub(super) session: Arc<Session>,
    /// Whether this client may change the session.
    pub(super) control: bool,
    client: u64,
    /// Planes of the composites that the client receives; `None` for a client that receives none.
    planes: watch::Sender<Option<CompositeRequest>>,
}

impl SessionHandle {
    /// Whether the session ends with this client.
    pub(super) fn is_owner(&self) -> bool {
        self.session.owner == self.client
    }

    /// The requested planes, as a channel that reports changes.
    pub(super) fn planes(&self) -> watch::Receiver<Option<CompositeRequest>> {
        self.planes.subscribe()
    }

    /// Changes the planes of this client's composites.
    pub(super) fn change_planes(&self, change: Planes) -> Result<(), WireError> {
        let Some(before) = *self.planes.borrow() else {
            return Err(WireError::new(
                Code::Forbidden,
                "planes",
                "a client that receives composites",
                "a client that receives none",
            ));
        };
        let after = change.applied_to(before);
        self.count_wants(Some(before), Some(after));
        self.planes.send_replace(Some(after));
        Ok(())
    }

    /// Counts the clients that want each plane, so that the renderer knows which to deliver. A plane that no
    /// client wanted before makes it render the newest frame again.
    fn count_wants(&self, before: Option<CompositeRequest>, after: Option<CompositeRequest>) {
        type Plane = fn(CompositeRequest) -> Codec;
        let counters = &self.session.counters;
        let planes: [(_, Plane); 2] = [
            (&counters.want_mask, |c| c.mask),
            (&counters.want_depth, |c| c.depth),
        ];
        let mut added = false;
        for (counter, plane) in planes {
            let wants = |asked: Option<CompositeRequest>| {
                asked.is_some_and(|asked| plane(asked) != Codec::None)
            };
            match (wants(before), wants(after)) {
                (false, true) => {
                    count(counter);
                    added = true;
                }
                (true, false) => uncount(counter),
                _ => {}
            }
        }
        if added {
            self.session.planes_changed();
        }
    }
}

impl Drop for SessionHandle {
    fn drop(&mut self) {
        let planes = *self.planes.borrow();
        if planes.is_some() {
            uncount(&self.session.counters.viewers);
            self.session.metrics().viewers.dec();
        }
        self.count_wants(planes, None);
        if self.is_owner() {
            self.session.stop("the session's owner left");
        }
    }
}

impl Hub {
    /// A hub without sessions.
    pub(super) fn new(config: ServeConfig, catalog: Arc<dyn Catalog>) -> Arc<Self> {
        let metrics = Arc::default();
        Arc::new(Self {
            door: Door::new(&config.bounds, Arc::clone(&metrics)),
            room: Room::new(&config.bounds),
            wrong_tokens: WrongTokens::default(),
            metrics,
            gate: Arc::new(Gate::new(catalog.threads())),
            catalog,
            // One thread per session; sessions that have ended may still hold one.
            loaders: Loaders::new(config.bounds.sessions),
            memory: Budget::new("all sessions", config.bounds.scenes_bytes),
            stopping: watch::Sender::new(false),
            sessions: Mutex::default(),
            next: AtomicU64::new(1),
            config,
        })
    }

    fn sessions(&self) -> MutexGuard<'_, BTreeMap<String, Arc<Session>>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Every session open, with the recording or producer it shows.
    pub(super) fn list(&self) -> Vec<Arc<Session>> {
        self.sessions().values().cloned().collect()
    }

    /// Whether a client's token equals the server's, compared in constant time.
    pub(super) fn token_fits(&self, given: Option<&str>) -> bool {
        let Some(token) = &self.config.token else {
            return true;
        };
        given.is_some_and(|given| token.as_bytes().ct_eq(given.as_bytes()).into())
    }

    /// Counts and logs a wrong token; returns how long its answer is delayed.
    pub(super) fn wrong_token(&self, peer: IpAddr) -> Duration {
        self.metrics.turned(Turned::WrongToken);
        let verdict = self.wrong_tokens.tried(peer, Instant::now());
        if verdict.to_log > 0 {
            tracing::warn!(address = %peer, tries = verdict.to_log, "wrong token");
        }
        verdict.delay
    }

    /// Finds or starts the session that a hello with the right token asks for; later errors of its scene are sent
    /// to `asker`. Reads files: do not call it on a thread that serves sockets.
    pub(super) fn join(
        self: &Arc<Self>,
        hello: &Hello,
        asker: Asker,
    ) -> Result<SessionHandle, WireError> {
        let client = self.next.fetch_add(1, Ordering::Relaxed);
        let (session, control) = match (&hello.role, &hello.session) {
            (Role::Viewer, Some(id)) => {
                let session = self.sessions().get(id).cloned().ok_or_else(|| {
                    WireError::new(
                        Code::NotFound,
                        "hello, session",
                        "a session that is open",
                        id,
                    )
                })?;
                let control = session.control == Control::Anyone;
                (session, control)
            }
            _ => (self.start(hello, client, asker)?, true),
        };
        self.admit_client(session, control, client, hello)
    }

    /// Adds a client to a session, unless the session has too many viewers.
    fn admit_client(
        &self,
        session: Arc<Session>,
        control: bool,
        client: u64,
        hello: &Hello,
    ) -> Result<SessionHandle, WireError> {
        let handle = SessionHandle {
            control,
            client,
            planes: watch::Sender::new(hello.composite),
            session,
        };
        handle.count_wants(None, hello.composite);
        if hello.composite.is_some() {
            let viewers = &handle.session.counters.viewers;
            count(viewers);
            self.metrics.viewers.inc();
            let bound = self.config.bounds.viewers as u64;
            if viewers.load(Ordering::Relaxed) > bound {
                return Err(WireError::new(
                    Code::Limit,
                    "viewers of the session",
                    format_args!("at most {bound}"),
                    "one more",
                ));
            }
        }
        Ok(handle)
    }

    fn start(
        self: &Arc<Self>,
        hello: &Hello,
        client: u64,
        asker: Asker,
    ) -> Result<Arc<Session>, WireError> {
        let recording = match hello.role {
            Role::Producer => None,
            Role::Viewer => Some(self.recording_for(hello)?),
        };
        let scene = hello.scene.clone().or_else(|| {
            let first = self.catalog.scenes().into_iter().next();
            first.filter(|_| recording.is_some()).map(|s| s.name)
        });
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let (session, publisher) = Session::new(
            number,
            (hello.role == Role::Producer).then(|| hello.name.clone()),
            hello.control,
            client,
            Arc::clone(&self.metrics),
            self.memory
                .part("the session", self.config.bounds.session_bytes),
        );
        self.admit(&session)?;
        let guard = Registered {
            hub: Arc::clone(self),
            session: Arc::clone(&session),
        };
        let start = Start {
            recording,
            scene,
            asker,
            settings: self.config.settings,
            fixed_settings: self.config.fixed_settings,
            deadline: self.config.bounds.frame,
            load_limit: self.config.bounds.load,
            gate: Arc::clone(&self.gate),
            loaders: Arc::clone(&self.loaders),
        };
        let thread = RenderThread::new(
            Arc::clone(&session),
            publisher,
            Arc::clone(&self.catalog),
            start,
        )?;
        std::thread::Builder::new()
            .name(format!("session s{number}"))
            .spawn(move || {
                let _guard = guard;
                thread.run();
            })
            .map_err(|e| WireError::new(Code::Internal, "session", "a thread for it", e))?;
        Ok(session)
    }

    fn recording_for(&self, hello: &Hello) -> Result<String, WireError> {
        if let Some(name) = &hello.recording {
            return Ok(name.clone());
        }
        match self.catalog.recordings().into_iter().next() {
            Some(first) => Ok(first.name),
            None => Err(WireError::new(
                Code::NotFound,
                "hello, session",
                "a session to watch, as the server has no recordings to play",
                "none",
            )),
        }
    }

    fn admit(&self, session: &Arc<Session>) -> Result<(), WireError> {
        let refuse = |expected: String, got: &str| {
            Err(WireError::new(Code::Limit, "sessions", expected, got))
        };
        let mut sessions = self.sessions();
        // Checked under the lock that `stop` holds while it ends all sessions.
        if *self.stopping.borrow() {
            return refuse("a running server".to_owned(), "one that is stopping");
        }
        let bound = self.config.bounds.sessions;
        if sessions.len() >= bound {
            return refuse(format!("at most {bound}"), "one more");
        }
        sessions.insert(session.id.clone(), Arc::clone(session));
        self.metrics.sessions.inc();
        Ok(())
    }

    /// Ends every session after its current frame, and accepts no more.
    pub(super) fn stop(&self, reason: &str) {
        let sessions = self.sessions();
        self.stopping.send_replace(true);
        for session in sessions.values() {
            session.finish(reason);
        }
    }
}

/// Removes a session from the list when its thread ends, even by a panic.
struct Registered {
    hub: Arc<Hub>,
    session: Arc<Session>,
}

impl Drop for Registered {
    fn drop(&mut self) {
        if std::thread::panicking() {
            self.session.stop("the session failed");
        }
        self.hub.sessions().remove(&self.session.id);
        self.hub.gate.forget(self.session.number);
        self.hub.metrics.sessions.dec();
    }
}
