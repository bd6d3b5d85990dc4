//! The render thread of a session: takes the newest frame, renders it, publishes the composite.
//!
//! It is an operating system thread and never one that serves sockets, so a long frame delays no other session.

mod publish;
mod scene;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use ghostlight_proto::control::{
    Done, ObjectInfo, Place, Reply, Request, SceneChoice, Source, State,
};
use ghostlight_proto::{Code, Codec, Frame, Stamps, WireError};
use tokio::sync::mpsc;

use self::scene::{Answered, no_frame};
use super::catalog::{Catalog, SceneLoad, SceneRenderer, Unrendered};
use super::decode::FrameDecoder;
use super::fair::Gate;
use super::frame_watch::{FrameWatch, Why};
use super::loaders::Loaders;
use super::player::Player;
use super::scene_load::{Answer, SceneLoads};
use super::session::{Command, Incoming, Publisher, Session, Work};
use crate::clock;
use crate::frame::RgbdFrame;
use crate::render::{Aov, RenderSettings};
use crate::settings::{self, LoadSettingsError, Parsed};

/// Least time between renders whose only purpose is to add planes that a client requests: a viewer must not be
/// able to keep the renderer busy.
const PLANES_PERIOD: Duration = Duration::from_millis(100);

/// Time budget of a frame without a `budget_ms`, as a share of the source's period; the rest is for
/// reading, decoding and encoding.
const BUDGET_SHARE: f32 = 0.85;

/// The client that asked for a scene: the number of its request, and where errors about it go.
pub(super) type Asker = (Option<u64>, mpsc::Sender<Reply>);

/// What a session starts with.
pub(super) struct Start {
    /// Recording to play; none for a producer's frames.
    pub(super) recording: Option<String>,
    /// Name of one of the server's scenes.
    pub(super) scene: Option<String>,
    /// The client that asked for the scene, for errors that occur when it is placed in the first frame.
    pub(super) asker: Asker,
    /// Render settings.
    pub(super) settings: RenderSettings,
    /// Threads that load scenes.
    pub(super) loaders: Arc<Loaders>,
    /// Time limit for loading a scene.
    pub(super) load_limit: Duration,
    /// Whether `settings` override those of scene documents.
    pub(super) fixed_settings: bool,
    /// Time limit for one frame.
    pub(super) deadline: Duration,
    /// Divides the processor's time among sessions.
    pub(super) gate: Arc<Gate>,
}

/// A decoded frame, and the data about it that its composite carries.
struct Decoded {
    frame: Arc<RgbdFrame>,
    camera_jpeg: Option<axum::body::Bytes>,
    stamps: Stamps,
}

/// State of the thread.
pub(super) struct RenderThread {
    session: Arc<Session>,
    publisher: Publisher,
    catalog: Arc<dyn Catalog>,
    renderer: Box<dyn SceneRenderer>,
    player: Option<Player>,
    settings: RenderSettings,
    /// Settings for scenes without their own: the server's, or those that a client set.
    own_settings: RenderSettings,
    /// Settings of scene documents are ignored.
    fixed_settings: bool,
    gate: Arc<Gate>,
    deadline: Duration,
    /// Frames cancelled in a row because scene or settings changed.
    given_up: u32,
    /// `Some` if the newest frame was cancelled because of a change before it was shown. The value says whether
    /// it was a new frame rather than one rendered again.
    unfinished: Option<bool>,
    /// The owner has been warned that frames of this scene take too long.
    owner_warned: bool,
    last: Option<Decoded>,
    serial: u64,
    /// The client that sent the scene, for errors that occur when it is placed in the first frame.
    scene_from: Option<Asker>,
    /// The scene that waits for a first frame to be placed in.
    waiting: Option<Box<dyn SceneLoad>>,
    /// Scenes being loaded.
    loads: SceneLoads,
    /// Whether a scene has been loaded; before that, there is no object to place or turn.
    has_scene: bool,
    /// Name and objects of the scene that waits or is being loaded, while no scene is shown.
    coming: Option<(Option<String>, Vec<ObjectInfo>)>,
    /// Nothing is shown until the first scene is loaded, or until this time.
    hold_until: Option<Instant>,
    /// Queued requests about objects of the scene being loaded.
    after: Vec<Command>,
    /// The newest frame is to be rendered again, with newly requested planes.
    wanting_planes: bool,
    /// When that last happened.
    planes_at: Instant,
}

impl RenderThread {
    /// Opens recording and scene.
    pub(super) fn new(
        session: Arc<Session>,
        publisher: Publisher,
        catalog: Arc<dyn Catalog>,
        start: Start,
    ) -> Result<Self, WireError> {
        let player = match &start.recording {
            Some(name) => Some(Player::new(name, catalog.open(name)?)),
            None => None,
        };
        let mut thread = Self {
            publisher,
            renderer: catalog.renderer(&session.memory)?,
            loads: SceneLoads::new(Arc::clone(&session), start.loaders, start.load_limit),
            session,
            catalog,
            player,
            settings: start.settings,
            own_settings: start.settings,
            fixed_settings: start.fixed_settings,
            gate: start.gate,
            deadline: start.deadline,
            given_up: 0,
            unfinished: None,
            owner_warned: false,
            last: None,
            serial: 0,
            scene_from: start.scene.is_some().then_some(start.asker),
            waiting: None,
            has_scene: false,
            coming: None,
            hold_until: None,
            after: Vec::new(),
            wanting_planes: false,
            planes_at: Instant::now(),
        };
        if let Some(name) = start.scene {
            thread.set_scene(&SceneChoice::Name(name), None, None)?;
        }
        thread.publish_state();
        Ok(thread)
    }

    /// Runs until the session is stopped.
    pub(super) fn run(mut self) {
        loop {
            let due = self.player.as_ref().map(Player::due);
            let again = self.wanting_planes.then(|| self.planes_at + PLANES_PERIOD);
            let until = due.into_iter().chain(again);
            let until = until.chain(self.loads.due()).chain(self.hold_until).min();
            let Work {
                frame,
                commands,
                planes_changed,
                stop,
            } = self.session.wait(until);
            self.wanting_planes |= planes_changed;
            let unfinished = self.unfinished.take();
            self.hold_until = self.hold_until.filter(|&until| until > Instant::now());
            let mut changed = self.take_scene();
            for command in commands {
                if self.session.is_over() {
                    break;
                }
                changed |= self.carry_out(command);
            }
            if self.session.is_over() {
                return;
            }
            changed |= unfinished.is_some();
            let unshown = unfinished == Some(true);
            if let Some(incoming) = &frame
                && self.take(incoming)
            {
                changed = false;
            }
            let mut fresh = frame.is_none() && !stop && self.play();
            if unshown && (fresh || frame.is_some()) {
                self.session.count_dropped(1);
            }
            fresh |= unshown && frame.is_none();
            if self.wanting_planes && self.planes_at + PLANES_PERIOD <= Instant::now() {
                changed = true;
                self.planes_at = Instant::now();
            }
            if (fresh || changed) && !stop {
                self.render(fresh);
            }
            if stop {
                self.last_words(unshown || self.unfinished == Some(true));
                return;
            }
        }
    }

    /// Decodes and renders a producer's frame. An error is answered, and the last good frame stays.
    fn take(&mut self, incoming: &Incoming) -> bool {
        if self.waiting.is_some() || self.is_held() {
            return self.take_unshown(incoming);
        }
        let decode_start_ns = clock::now_ns();
        let aovs = self.aovs();
        let settings = self.settings_in_force();
        let watch = FrameWatch::begin(&self.session, &self.gate, self.deadline, self.given_up);
        let jpeg = incoming.header.color_codec == Codec::Jpeg;
        let taken = Frame::decode(&incoming.message).and_then(|frame| {
            let start = incoming.message.len() - frame.color.len() - frame.depth.len();
            let color = start..start + frame.color.len();
            let decoder = FrameDecoder::new(&frame);
            let (frame, rendered) = self
                .renderer
                .render_encoded(&decoder, &settings, &aovs, &watch)?;
            Ok((frame, rendered, color, decoder.decoded_ns()))
        });
        let why = watch.why();
        drop(watch);
        match taken {
            Ok((frame, rendered, color, decoded_ns)) => {
                self.wanting_planes = false;
                let stamps = Stamps {
                    received_ns: incoming.received_ns,
                    decode_start_ns,
                    decoded_ns,
                    render_start_ns: decoded_ns,
                    render_end_ns: clock::now_ns(),
                    ..Stamps::default()
                };
                self.last = Some(Decoded {
                    frame: Arc::new(frame),
                    camera_jpeg: jpeg.then(|| incoming.message.slice(color)),
                    stamps,
                });
                match rendered {
                    Err(Unrendered::Cancelled) if why == Some(Why::TooSlow) => {
                        self.refuse_frame(incoming, self.too_slow());
                    }
                    rendered => self.publish(rendered, why, stamps, true),
                }
                true
            }
            Err(error) => {
                self.refuse_frame(incoming, error);
                false
            }
        }
    }

    /// Time between two frames of the source, nanoseconds, if it has a rate.
    fn source_period_ns(&self) -> Option<i64> {
        match &self.player {
            Some(player) => player.period_ns(),
            None => self.session.producer_period_ns(),
        }
    }

    /// The settings, with the time budget of a frame: as requested, otherwise derived from the source's rate.
    fn settings_in_force(&self) -> RenderSettings {
        let mut settings = self.settings;
        let of_source = || {
            let period_ns = self.source_period_ns()?;
            Some(BUDGET_SHARE * period_ns as f32 * 1e-6)
        };
        settings.budget_ms = settings.budget_ms.or_else(of_source);
        settings
    }

    /// Reads the recording's frame that is due, if any.
    fn play(&mut self) -> bool {
        let Some(due) = self.player.as_mut().and_then(Player::take_due) else {
            return false;
        };
        self.session.count_received(due.skipped + 1);
        self.session.count_dropped(due.skipped);
        let decode_start_ns = clock::now_ns();
        let read = self.player.as_mut().map(|player| player.read(&due));
        match read {
            Some(Ok(frame)) => {
                let stamps = Stamps {
                    received_ns: due.time_ns,
                    decode_start_ns,
                    decoded_ns: clock::now_ns(),
                    ..Stamps::default()
                };
                self.last = Some(Decoded {
                    frame: Arc::new(frame),
                    camera_jpeg: None,
                    stamps,
                });
                true
            }
            Some(Err(error)) => {
                // Clients see the count of refused frames; the log says why.
                self.session.count_refused(error.code);
                tracing::warn!(session = self.session.id, %error, "recording");
                false
            }
            None => false,
        }
    }

    /// Renders the last good frame and publishes the composite. A frame that is rendered again after a change
    /// keeps its original stamps of arrival and decoding.
    fn render(&mut self, fresh: bool) {
        self.load_waiting();
        if self.is_held() {
            self.unfinished = self.last.is_some().then_some(fresh);
            return;
        }
        self.wanting_planes = false;
        let aovs = self.aovs();
        let Some(last) = &self.last else { return };
        let mut stamps = last.stamps;
        stamps.render_start_ns = clock::now_ns();
        let settings = self.settings_in_force();
        let watch = FrameWatch::begin(&self.session, &self.gate, self.deadline, self.given_up);
        let rendered = self.renderer.render(&last.frame, &settings, &aovs, &watch);
        let why = watch.why();
        drop(watch);
        stamps.render_end_ns = clock::now_ns();
        self.publish(rendered, why, stamps, fresh);
    }

    /// Planes that at least one client wants. Every render produces all of them.
    fn aovs(&self) -> Vec<Aov> {
        let counters = &self.session.counters;
        let wanted = [
            (Aov::Mask, &counters.want_mask),
            (Aov::Depth, &counters.want_depth),
        ];
        let wanted = wanted.into_iter();
        let wanted = wanted.filter(|(_, wanted)| wanted.load(Ordering::Relaxed) > 0);
        wanted.map(|(aov, _)| aov).collect()
    }

    /// Carries out a request and answers it; false if it was refused and nothing has changed.
    ///
    /// A request for a scene is answered when the scene is shown. Until then, requests refer to the scene that is
    /// shown; those about an object that it does not have wait for the scene being loaded.
    fn carry_out(&mut self, command: Command) -> bool {
        let object = match &command.request {
            Request::Place(place) => Some(&place.object),
            Request::Turn(turn) => Some(&turn.object),
            _ => None,
        };
        if let Some(object) = object
            && self.loads.is_busy()
            && !(self.has_scene && self.renderer.objects().iter().any(|o| o.name == *object))
        {
            self.wait_for_scene(command);
            return false;
        }
        if self.waiting.is_some() && !self.has_scene && object.is_some() {
            self.note_for_scene(command);
            return false;
        }
        let answer = |kind| {
            Some(Answer {
                id: command.id,
                kind,
                reply: command.reply.clone(),
            })
        };
        let kind = command.request.kind();
        let result = match &command.request {
            Request::Scene(set) => match self.set_scene(&set.scene, answer(kind), None) {
                Ok(Answered::Later) => return false,
                other => other.map(|_| None),
            },
            Request::Settings(set) => parse_settings(&set.settings).map(|parsed| {
                self.settings = parsed.settings;
                self.own_settings = parsed.settings;
                (!parsed.notes.is_empty()).then(|| parsed.notes.join("; "))
            }),
            Request::Play(play) => {
                let (recording, scene) = (play.recording.as_deref(), play.scene.as_deref());
                match self.change_play(recording, scene, answer(kind)) {
                    Ok(Answered::Later) => return false,
                    other => other.map(|_| None),
                }
            }
            Request::Place(place) => self.place(place),
            Request::Turn(turn) => self.renderer.turn(&turn.object, turn.angle).map(|()| None),
            // The connection answers these itself.
            other => Err(WireError::new(
                Code::Internal,
                "request",
                "one for the session",
                other.kind(),
            )),
        };
        match result {
            Ok(note) => {
                self.owner_warned = false;
                if matches!(command.request, Request::Scene(_) | Request::Play(_)) {
                    self.scene_from = Some((command.id, command.reply.clone()));
                }
                let done = Done {
                    id: command.id,
                    request: command.request.kind().to_owned(),
                    note,
                };
                let _ = command.reply.try_send(Reply::Done(done));
                self.publish_state();
                true
            }
            Err(error) => {
                self.session.metrics().error(error.code);
                command.refuse(error);
                false
            }
        }
    }

    /// Moves an object. Returns a note for the user if it was put elsewhere than requested.
    fn place(&mut self, place: &Place) -> Result<Option<String>, WireError> {
        match (&place.stands, place.pixel, &self.last) {
            (Some(stands), ..) => self.renderer.put_back(&place.object, stands).map(|()| None),
            (None, Some(pixel), Some(last)) => {
                self.renderer
                    .place(&place.object, pixel, &last.frame, &self.settings)
            }
            // Messages that lack both pixel and pose are refused when they are parsed.
            (None, ..) => Err(no_frame()),
        }
    }

    fn publish_state(&self) {
        let source = match (&self.player, &self.session.live) {
            (Some(player), _) => Source::Recording(player.name().to_owned()),
            (None, live) => Source::Live(live.clone().unwrap_or_default()),
        };
        self.publisher.state.send_replace(Arc::new(State {
            session: self.session.id.clone(),
            source,
            scene: self.scene_name(),
            objects: match &self.coming {
                Some((_, objects)) => objects.clone(),
                None => self.renderer.objects(),
            },
            settings: serde_json::to_value(self.settings).unwrap_or_default(),
        }));
    }
}

/// Parses settings in wire format; unknown fields are errors that name the nearest known one.
fn parse_settings(
    settings: &serde_json::Map<String, serde_json::Value>,
) -> Result<Parsed, WireError> {
    let refuse = |error: &dyn std::fmt::Display| {
        WireError::new(Code::Settings, "settings", "render settings", error)
    };
    let text = serde_json::to_string(settings).map_err(|e| refuse(&e))?;
    settings::parse(&text, "settings").map_err(|error| match error {
        LoadSettingsError::Range { source: e, .. } => {
            let what = format!("settings, {}", e.field);
            WireError::new(Code::Settings, what, &e.expected, &e.got)
        }
        other => refuse(&other),
    })
}
