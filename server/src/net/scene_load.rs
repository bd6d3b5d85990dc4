//! Loads a session's scenes on other threads ([`super::loaders`]) while the session keeps showing its current
//! scene.
//!
//! A session loads one scene at a time. A newer request cancels the load in progress and starts as soon as the
//! thread of that load is done. A load that exceeds its time limit is cancelled.

use std::panic::AssertUnwindSafe;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use ghostlight_proto::control::Reply;
use ghostlight_proto::{Code, WireError};
use tokio::sync::mpsc;

use super::catalog::{SceneLoad, SceneRenderer};
use super::loaders::{Job, Loaders};
use super::player::Player;
use super::session::Session;
use crate::frame::RgbdFrame;
use crate::render::RenderSettings;

/// A client's request for a scene.
pub(super) struct SceneRequest {
    /// Where to send its answer; `None` if it has been answered.
    pub(super) answer: Option<Answer>,
    /// The recording to play with it.
    pub(super) player: Option<Player>,
}

/// Where an answer goes.
pub(super) struct Answer {
    pub(super) id: Option<u64>,
    pub(super) kind: &'static str,
    pub(super) reply: mpsc::Sender<Reply>,
}

/// A loaded scene, or why it could not be loaded.
pub(super) type Loaded = Result<Box<dyn SceneRenderer>, WireError>;

/// A load that has not begun.
struct QueuedLoad {
    load: Box<dyn SceneLoad>,
    frame: Arc<RgbdFrame>,
    settings: RenderSettings,
    ask: SceneRequest,
}

/// A load in progress.
struct Running {
    /// `None` once the load is cancelled.
    ask: Option<SceneRequest>,
    stop: Arc<AtomicBool>,
    /// Whether a thread has started it.
    begun: Arc<AtomicBool>,
    result: Arc<Mutex<Option<Loaded>>>,
    until: Instant,
}

/// The loads of a session.
pub(super) struct SceneLoads {
    session: Arc<Session>,
    loaders: Arc<Loaders>,
    limit: Duration,
    running: Option<Running>,
    next: Option<QueuedLoad>,
}

impl SceneLoads {
    /// Without loads; `limit` is the time limit of each.
    pub(super) fn new(session: Arc<Session>, loaders: Arc<Loaders>, limit: Duration) -> Self {
        Self {
            session,
            loaders,
            limit,
            running: None,
            next: None,
        }
    }

    /// Whether a scene is being loaded or waits to be.
    pub(super) fn is_busy(&self) -> bool {
        self.next.is_some() || self.running.as_ref().is_some_and(|r| r.ask.is_some())
    }

    /// The latest time at which [`Self::poll`] has a result.
    pub(super) fn due(&self) -> Option<Instant> {
        let running = self.running.as_ref()?;
        running.ask.as_ref().map(|_| running.until)
    }

    /// Loads a scene and places it in a frame, under the settings that it will be rendered with. Returns the
    /// unanswered request that this one replaces, if any.
    pub(super) fn start(
        &mut self,
        load: Box<dyn SceneLoad>,
        frame: Arc<RgbdFrame>,
        settings: RenderSettings,
        ask: SceneRequest,
    ) -> Option<SceneRequest> {
        let waited = self.next.take().map(|wanted| wanted.ask);
        let superseded = waited.or_else(|| self.give_up());
        self.next = Some(QueuedLoad {
            load,
            frame,
            settings,
            ask,
        });
        self.start_next();
        superseded
    }

    /// Cancels the load in progress and returns its request.
    fn give_up(&mut self) -> Option<SceneRequest> {
        let running = self.running.as_mut()?;
        running.stop.store(true, Ordering::Relaxed);
        running.ask.take()
    }

    fn start_next(&mut self) {
        if self.running.is_some() {
            return;
        }
        let Some(QueuedLoad {
            load,
            frame,
            settings,
            ask,
        }) = self.next.take()
        else {
            return;
        };
        let stop = Arc::new(AtomicBool::new(false));
        let result = Arc::new(Mutex::new(None));
        let begun = Arc::new(AtomicBool::new(false));
        let (session, place) = (Arc::clone(&self.session), Arc::clone(&result));
        let (flag, begins) = (Arc::clone(&stop), Arc::clone(&begun));
        let work = move || {
            begins.store(true, Ordering::Relaxed);
            let run = AssertUnwindSafe(|| match flag.load(Ordering::Relaxed) {
                false => load.run(&frame, &settings, &flag),
                true => Err(unwanted()),
            });
            let failed = |_| {
                let expected = "one that can be loaded";
                Err(WireError::new(Code::Internal, "scene", expected, "a fault"))
            };
            let loaded = std::panic::catch_unwind(run).unwrap_or_else(failed);
            *place.lock().unwrap_or_else(PoisonError::into_inner) = Some(loaded);
            session.scene_loaded();
        };
        let started = self.loaders.start(Job {
            stop: Arc::clone(&stop),
            run: Box::new(work),
        });
        if let Err(error) = started {
            let failed = WireError::new(Code::Internal, "scene", "a thread to load it", error);
            *result.lock().unwrap_or_else(PoisonError::into_inner) = Some(Err(failed));
            self.session.scene_loaded();
        }
        self.running = Some(Running {
            ask: Some(ask),
            stop,
            begun,
            result,
            until: Instant::now() + self.limit,
        });
    }

    /// The result of the load in progress, once there is one, and its request.
    pub(super) fn poll(&mut self) -> Option<(SceneRequest, Loaded)> {
        let running = self.running.as_mut()?;
        let place = Arc::clone(&running.result);
        let result = place.lock().unwrap_or_else(PoisonError::into_inner).take();
        match result {
            Some(loaded) => {
                let ask = running.ask.take();
                self.running = None;
                self.start_next();
                // Without a request, the load was cancelled and its result is dropped.
                ask.map(|ask| (ask, loaded))
            }
            None if running.ask.is_some() && running.until <= Instant::now() => {
                let limit = self.limit.as_secs_f64();
                let late = WireError::new(
                    Code::Scene,
                    "scene",
                    format_args!("at most {limit} s to load (the server's time limit for scenes)"),
                    match running.begun.load(Ordering::Relaxed) {
                        true => "more, so it was given up",
                        false => "as much of waiting for scenes of others: try again later",
                    },
                );
                self.give_up().map(|ask| (ask, Err(late)))
            }
            None => None,
        }
    }
}

/// The result of a load that was cancelled before it began.
fn unwanted() -> WireError {
    WireError::new(
        Code::Scene,
        "scene",
        "a scene that is still wanted",
        "a scene that was cancelled",
    )
}

impl Drop for SceneLoads {
    fn drop(&mut self) {
        self.give_up();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::{Receiver, Sender, channel};

    use ghostlight_proto::control::{Control, ObjectInfo};

    use super::*;
    use crate::camera::{Intrinsics, Pose};
    use crate::frame::{ColorImage, DepthImage};
    use crate::memory::Budget;

    /// A load that fails with its name as the message when told to or when stopped.
    struct Slow {
        name: &'static str,
        begun: Sender<&'static str>,
        end: Receiver<()>,
    }

    impl Slow {
        /// A slow load, and the sender that ends it.
        fn load(
            name: &'static str,
            begun: &Sender<&'static str>,
        ) -> (Box<dyn SceneLoad>, Sender<()>) {
            let (end, ends) = channel();
            let slow = Self {
                name,
                begun: begun.clone(),
                end: ends,
            };
            (Box::new(slow), end)
        }
    }

    impl SceneLoad for Slow {
        fn name(&self) -> Option<String> {
            None
        }
        fn objects(&self) -> Vec<ObjectInfo> {
            Vec::new()
        }
        fn run(
            self: Box<Self>,
            _: &RgbdFrame,
            _: &RenderSettings,
            stop: &Arc<AtomicBool>,
        ) -> Loaded {
            self.begun.send(self.name).unwrap();
            let mut got = self.name;
            while self.end.recv_timeout(Duration::from_millis(1)).is_err() {
                if stop.load(Ordering::Relaxed) {
                    got = "stopped";
                    break;
                }
            }
            Err(WireError::new(Code::Scene, "scene", "a scene", got))
        }
    }

    fn frame() -> Arc<RgbdFrame> {
        Arc::new(RgbdFrame {
            index: 0,
            time_ns: 0,
            color: ColorImage::filled(1, 1, [0, 0, 0, 255]),
            depth: DepthImage::from_metres(1, 1, vec![1.0]),
            intrinsics: Intrinsics::new(1.0, 1.0, 0.0, 0.0, 1, 1).unwrap(),
            pose: Pose::IDENTITY,
        })
    }

    fn loads(limit: Duration) -> SceneLoads {
        let memory = Budget::unlimited();
        let (session, _) = Session::new(1, None, Control::Owner, 1, Arc::default(), memory);
        SceneLoads::new(session, Loaders::new(1), limit)
    }

    fn ask(id: u64) -> SceneRequest {
        let (reply, _) = mpsc::channel(1);
        let id = Some(id);
        SceneRequest {
            answer: Some(Answer {
                id,
                kind: "scene",
                reply,
            }),
            player: None,
        }
    }

    fn id_of(ask: Option<SceneRequest>) -> Option<u64> {
        ask?.answer?.id
    }

    fn wait(loads: &mut SceneLoads) -> (Option<u64>, String) {
        loop {
            if let Some((ask, loaded)) = loads.poll() {
                let error = loaded.err().map(|e| e.to_string()).unwrap_or_default();
                return (id_of(Some(ask)), error);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn the_newest_wins_and_one_is_loaded_at_a_time() {
        let mut loads = loads(Duration::from_secs(3600));
        let (begun, begins) = channel();
        let slow = |name| Slow::load(name, &begun);
        let ((a, _a), (b, _b), (c, end_c)) = (slow("a"), slow("b"), slow("c"));
        assert!(!loads.is_busy());
        assert!(
            loads
                .start(a, frame(), RenderSettings::default(), ask(1))
                .is_none()
        );
        assert_eq!(begins.recv(), Ok("a"));
        // The second load cancels the first; the third replaces the second before it has begun.
        assert_eq!(
            id_of(loads.start(b, frame(), RenderSettings::default(), ask(2))),
            Some(1)
        );
        assert_eq!(
            id_of(loads.start(c, frame(), RenderSettings::default(), ask(3))),
            Some(2)
        );
        assert!(loads.is_busy());
        end_c.send(()).unwrap();
        let (id, error) = wait(&mut loads);
        assert_eq!(id, Some(3));
        assert!(error.contains('c') && !error.contains("stopped"), "{error}");
        assert_eq!(begins.recv(), Ok("c"));
        assert!(!loads.is_busy() && loads.due().is_none());
    }

    #[test]
    fn one_that_waits_too_long_for_a_thread_says_so() {
        let (begun, begins) = channel();
        let slow = |name| Slow::load(name, &begun);
        let mut first = loads(Duration::from_secs(3600));
        let mut second = loads(Duration::from_millis(20));
        second.loaders = Arc::clone(&first.loaders);
        let ((a, end_a), (b, _b)) = (slow("a"), slow("b"));
        first.start(a, frame(), RenderSettings::default(), ask(1));
        assert_eq!(begins.recv(), Ok("a"));
        second.start(b, frame(), RenderSettings::default(), ask(2));
        let (id, error) = wait(&mut second);
        assert_eq!(id, Some(2));
        assert!(error.contains("waiting for scenes of others"), "{error}");
        end_a.send(()).unwrap();
        assert_eq!(wait(&mut first).0, Some(1));
        // It never began.
        while second.running.is_some() {
            assert!(second.poll().is_none());
            std::thread::sleep(Duration::from_millis(1));
        }
        assert!(begins.try_recv().is_err());
    }

    #[test]
    fn one_that_takes_too_long_is_given_up_with_one_error() {
        let mut loads = loads(Duration::from_millis(20));
        let (begun, _begins) = channel();
        let (_end, end) = channel();
        let slow = Box::new(Slow {
            name: "a",
            begun,
            end,
        });
        loads.start(slow, frame(), RenderSettings::default(), ask(7));
        assert!(loads.due().is_some());
        let (id, error) = wait(&mut loads);
        assert_eq!(id, Some(7));
        assert!(error.contains("at most 0.02 s"), "{error}");
        assert!(!loads.is_busy());
        // The thread sees the stop flag, and its result is dropped.
        while loads.running.is_some() {
            assert!(loads.poll().is_none());
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}
