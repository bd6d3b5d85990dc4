//! The thread of a session: takes the newest frame, renders it, publishes the composite.
//!
//! It is a thread of the operating system and never one that serves sockets, so a long frame
//! delays nobody else.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use ghostlight_proto::control::{
    Done, ErrorReport, ObjectInfo, Place, Reply, Request, SceneChoice, Source, State, Turn,
};
use ghostlight_proto::{Code, Codec, Frame, Stamps, WireError};
use tokio::sync::mpsc;

use super::backend::{Backend, EncodedFrame, SceneLoad, SceneRenderer, Unrendered};
use super::clock;
use super::decode::Halves;
use super::encode::Output;
use super::fair::Gate;
use super::frame_watch::{FrameWatch, Why};
use super::metrics::count;
use super::player::Player;
use super::scene_load::{Answer, Ask, SceneLoads};
use super::session::{Command, Incoming, Publisher, Quality, Session, Work};
use crate::frame::RgbdFrame;
use crate::render::{Aov, RenderSettings, Rendered};

/// How often a frame is rendered once more for the planes that a client asks for: who only
/// watches must not be able to keep the renderer busy.
const PLANES_PERIOD: Duration = Duration::from_millis(100);

/// Share of the source's period that a frame may take where nothing else is asked for: the rest is
/// for reading, decoding and encoding.
const BUDGET_SHARE: f32 = 0.85;

/// Who sent a scene: the number of the request, and where errors about it go.
pub(super) type Asker = (Option<u64>, mpsc::Sender<Reply>);

/// What a session starts with.
pub(super) struct Start {
    /// Recording to play; none for a producer's frames.
    pub(super) recording: Option<String>,
    /// Scene of the server's.
    pub(super) scene: Option<String>,
    /// Who asked for it: it may turn out not to fit the first frame.
    pub(super) asker: Asker,
    /// Render settings.
    pub(super) settings: RenderSettings,
    /// Time that a scene may take to load.
    pub(super) load_limit: Duration,
    /// Time for one frame.
    pub(super) deadline: Duration,
    /// What its frames pass, as those of all sessions.
    pub(super) gate: Arc<Gate>,
}

/// Longest time that frames wait for the first scene: nearly every one is there by then, and who
/// waits for a large one sees at least the camera's picture.
const HOLD: Duration = Duration::from_secs(3);

/// How long a session that ends waits for the scene of its last frame.
const LAST_SCENE: Duration = Duration::from_secs(1);

/// Requests that may wait for a scene.
const MAX_AFTER: usize = 64;

/// When a request is answered.
enum Answered {
    /// Now, by whoever carries it out.
    Now,
    /// By what it started.
    Later,
}

/// A frame that was decoded, with what its composite says about it.
struct Decoded {
    frame: Arc<RgbdFrame>,
    camera_jpeg: Option<axum::body::Bytes>,
    stamps: Stamps,
}

/// Everything that only the thread touches.
pub(super) struct RenderThread {
    session: Arc<Session>,
    publisher: Publisher,
    backend: Arc<dyn Backend>,
    renderer: Box<dyn SceneRenderer>,
    player: Option<Player>,
    settings: RenderSettings,
    gate: Arc<Gate>,
    deadline: Duration,
    /// Frames given up in a row because something was changed.
    given_up: u32,
    /// The newest frame was given up for a change before it was shown; whether it was a fresh one.
    unfinished: Option<bool>,
    /// The owner knows that frames take too long with what is shown now.
    told_too_slow: bool,
    last: Option<Decoded>,
    serial: u64,
    /// Who sent the scene: a scene that comes before the first frame may turn out not to fit it.
    scene_from: Option<Asker>,
    /// The scene waits for a frame to be placed in.
    waiting: Option<Box<dyn SceneLoad>>,
    /// Scenes being loaded.
    loads: SceneLoads,
    /// A scene was put in place: before, there is nothing to be placed or turned.
    has_scene: bool,
    /// Name and objects of the scene that waits or is loaded while there is none.
    coming: Option<(Option<String>, Vec<ObjectInfo>)>,
    /// Nothing is shown before the first scene is there, but not for longer than until then.
    hold_until: Option<Instant>,
    /// Requests about objects of the scene being loaded.
    after: Vec<Command>,
    /// The newest frame is to be rendered again, with planes that were not wanted before.
    wanting_planes: bool,
    /// When that was done last.
    planes_at: Instant,
}

impl RenderThread {
    /// Opens recording and scene.
    pub(super) fn new(
        session: Arc<Session>,
        publisher: Publisher,
        backend: Arc<dyn Backend>,
        start: Start,
    ) -> Result<Self, WireError> {
        let player = match &start.recording {
            Some(name) => Some(Player::new(name, backend.open(name)?)),
            None => None,
        };
        let mut thread = Self {
            publisher,
            renderer: backend.renderer(&session.memory)?,
            loads: SceneLoads::new(Arc::clone(&session), start.load_limit),
            session,
            backend,
            player,
            settings: start.settings,
            gate: start.gate,
            deadline: start.deadline,
            given_up: 0,
            unfinished: None,
            told_too_slow: false,
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

    /// The session ends after the frame in flight: one that only waits for its scene is shown, if that
    /// does not take long.
    fn last_words(&mut self, waits: bool) {
        let until = Instant::now() + LAST_SCENE;
        while waits && self.is_held() && Instant::now() < until && !self.session.is_over() {
            std::thread::sleep(Duration::from_millis(5));
            if self.take_scene() {
                self.render(true);
            }
        }
    }

    /// Decodes and renders a producer's frame; an error is answered, and the last good frame stays.
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
            let halves = Halves::new(&frame);
            let (frame, rendered) = self
                .renderer
                .render_encoded(&halves, &settings, &aovs, &watch)?;
            Ok((frame, rendered, color, halves.decoded_ns()))
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

    /// Decodes a producer's frame, to be shown once the scene is there.
    fn take_unshown(&mut self, incoming: &Incoming) -> bool {
        let decode_start_ns = clock::now_ns();
        let jpeg = incoming.header.color_codec == Codec::Jpeg;
        let taken = Frame::decode(&incoming.message).and_then(|frame| {
            let start = incoming.message.len() - frame.color.len() - frame.depth.len();
            let color = start..start + frame.color.len();
            Ok((Halves::new(&frame).whole()?, color))
        });
        match taken {
            Ok((frame, color)) => {
                self.last = Some(Decoded {
                    frame: Arc::new(frame),
                    camera_jpeg: jpeg.then(|| incoming.message.slice(color)),
                    stamps: Stamps {
                        received_ns: incoming.received_ns,
                        decode_start_ns,
                        decoded_ns: clock::now_ns(),
                        ..Stamps::default()
                    },
                });
                self.load_waiting();
                self.unfinished = Some(true);
                true
            }
            Err(error) => {
                self.refuse_frame(incoming, error);
                false
            }
        }
    }

    /// Whether nothing is shown yet, because the first scene is still being loaded.
    fn is_held(&self) -> bool {
        self.hold_until.is_some() && self.loads.is_busy()
    }

    /// Loads the scene that waited for a frame, now that there is one.
    fn load_waiting(&mut self) {
        let Some(last) = &self.last else { return };
        if let Some(load) = self.waiting.take() {
            let ask = Ask {
                // It was answered when it was found to be a scene.
                answer: None,
                player: None,
            };
            let frame = Arc::clone(&last.frame);
            let superseded = self.loads.start(load, frame, ask);
            self.hold_until = Some(Instant::now() + HOLD);
            self.tell_superseded(superseded);
        }
    }

    fn tell_superseded(&self, ask: Option<Ask>) {
        if let Some(answer) = ask.and_then(|ask| ask.answer) {
            let expected = "the newest one asked for";
            let got = "one that a newer one took the place of";
            let error = WireError::new(Code::Scene, "scene", expected, got);
            self.session.metrics().error(error.code);
            let report = ErrorReport::new(error, answer.id, None, false);
            let _ = answer.reply.try_send(Reply::Error(report));
        }
    }

    /// Shows the scene that was loaded, or says why there is none; false if there is no news.
    fn take_scene(&mut self) -> bool {
        let Some((ask, loaded)) = self.loads.poll() else {
            return false;
        };
        self.hold_until = None;
        self.coming = None;
        match loaded {
            Ok(renderer) => {
                self.renderer = renderer;
                self.has_scene = true;
                self.told_too_slow = false;
                if let Some(mut player) = ask.player {
                    player.restart();
                    self.player = Some(player);
                    self.last = None;
                    self.unfinished = None;
                }
                if let Some(Answer { id, kind, reply }) = ask.answer {
                    let request = kind.to_owned();
                    let _ = reply.try_send(Reply::Done(Done { id, request }));
                }
            }
            Err(error) => {
                tracing::warn!(session = self.session.id, %error, "scene");
                self.session.metrics().error(error.code);
                let asked = ask.answer.map(|answer| (answer.id, answer.reply));
                match asked.or_else(|| self.scene_from.take()) {
                    Some((id, reply)) => {
                        let report = ErrorReport::new(error, id, None, false);
                        let _ = reply.try_send(Reply::Error(report));
                    }
                    None => {
                        let report = ErrorReport::new(error, None, None, false);
                        self.session.tell_owner(Reply::Error(report));
                    }
                }
            }
        }
        self.publish_state();
        for command in std::mem::take(&mut self.after) {
            self.carry_out(command);
        }
        true
    }

    fn refuse_frame(&mut self, incoming: &Incoming, error: WireError) {
        self.session.count_refused(error.code);
        let sequence = Some(incoming.header.sequence);
        let report = ErrorReport::new(error, None, sequence, false);
        let _ = incoming.reply.try_send(Reply::Error(report));
    }

    fn too_slow(&self) -> WireError {
        WireError::new(
            Code::TooSlow,
            "frame",
            format_args!(
                "at most {} s to render (the server's frame deadline)",
                self.deadline.as_secs_f64()
            ),
            "more, so it was given up: ask for less (settings, scene)",
        )
    }

    /// Between two frames of the source, nanoseconds, if it has a rate.
    fn source_period_ns(&self) -> Option<i64> {
        match &self.player {
            Some(player) => player.period_ns(),
            None => self.session.producer_period_ns(),
        }
    }

    /// The settings with the time that a frame may take: as asked for, else what keeps the source's
    /// rate.
    fn settings_in_force(&self) -> RenderSettings {
        let mut settings = self.settings;
        let of_source = || {
            let period_ns = self.source_period_ns()?;
            Some(BUDGET_SHARE * period_ns as f32 * 1e-6)
        };
        settings.budget_ms = settings.budget_ms.or_else(of_source);
        settings
    }

    /// Reads the recording's frame that is due, if one is.
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
                // A recording that reads badly is the server's affair: its clients see the
                // count, the log says why.
                self.session.count_refused(error.code);
                tracing::warn!(session = self.session.id, %error, "recording");
                false
            }
            None => false,
        }
    }

    /// Renders the last good frame and publishes the composite. A frame that is rendered again,
    /// after a change, keeps its own stamps of arrival and decoding.
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

    /// Planes that some client wants. Every render has all of them.
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

    /// A frame was given up, and why: the last good picture stays.
    fn without_picture(&mut self, why: Option<Why>, fresh: bool) {
        match why {
            Some(Why::TooSlow) => {
                let error = self.too_slow();
                if fresh {
                    self.session.count_refused(error.code);
                } else {
                    self.session.metrics().error(error.code);
                }
                // Once, however many frames a recording has.
                if !std::mem::replace(&mut self.told_too_slow, true) {
                    tracing::warn!(session = self.session.id, %error, "frame");
                    let report = ErrorReport::new(error, None, None, false);
                    self.session.tell_owner(Reply::Error(report));
                }
                self.given_up = 0;
            }
            Some(Why::Changed) => {
                self.given_up = self.given_up.saturating_add(1);
                self.unfinished = Some(fresh);
            }
            Some(Why::Stopped) | None => {}
        }
    }

    /// Publishes the composite of the last good frame; `why` says why there is none.
    fn publish(
        &mut self,
        rendered: Result<Rendered, Unrendered>,
        why: Option<Why>,
        stamps: Stamps,
        fresh: bool,
    ) {
        if matches!(rendered, Err(Unrendered::Cancelled)) {
            return self.without_picture(why, fresh);
        }
        let Some(last) = &self.last else { return };
        let counters = &self.session.counters;
        let rendered = match rendered {
            Ok(rendered) => rendered,
            Err(Unrendered::Cancelled) => return,
            Err(Unrendered::Scene(error)) => {
                tracing::warn!(session = self.session.id, %error, "scene");
                self.session.metrics().error(error.code);
                if let Some((id, reply)) = self.scene_from.take() {
                    let report = ErrorReport::new(error, id, None, false);
                    let _ = reply.try_send(Reply::Error(report));
                }
                self.publish_state();
                return;
            }
        };
        if fresh {
            count(&counters.rendered);
            self.session.metrics().rendered(&stamps, &rendered.stage_ns);
        }
        (self.given_up, self.told_too_slow) = (0, false);
        self.session.set_quality(Quality {
            lowered: rendered.lowered.iter().map(ToString::to_string).collect(),
            period_ns: self.source_period_ns(),
        });
        self.serial += 1;
        let output = Output::new(
            self.serial,
            Arc::clone(&last.frame),
            last.camera_jpeg.clone(),
            rendered,
            stamps,
            counters.dropped.load(Ordering::Relaxed),
        );
        self.publisher.output.send_replace(Some(Arc::new(output)));
    }

    /// Answers a request; false if it was refused and nothing has changed.
    ///
    /// A scene is answered when it is in place. Until then requests are about the scene that is
    /// shown; those about an object that it does not have wait for the one being loaded.
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
                other => other.map(|_| ()),
            },
            Request::Settings(set) => parse_settings(&set.settings).map(|s| self.settings = s),
            Request::Play(play) => {
                let (recording, scene) = (play.recording.as_deref(), play.scene.as_deref());
                match self.change_play(recording, scene, answer(kind)) {
                    Ok(Answered::Later) => return false,
                    other => other.map(|_| ()),
                }
            }
            Request::Place(place) => self.place(place),
            Request::Turn(turn) => self.renderer.turn(&turn.object, turn.angle),
            // The connection answers these itself and hands none in.
            other => Err(WireError::new(
                Code::Internal,
                "request",
                "one for the session",
                other.kind(),
            )),
        };
        match result {
            Ok(()) => {
                self.told_too_slow = false;
                if matches!(command.request, Request::Scene(_) | Request::Play(_)) {
                    self.scene_from = Some((command.id, command.reply.clone()));
                }
                let done = Done {
                    id: command.id,
                    request: command.request.kind().to_owned(),
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

    /// Keeps a request until the scene being loaded is in place.
    fn wait_for_scene(&mut self, command: Command) {
        if self.after.len() < MAX_AFTER {
            self.after.push(command);
            return;
        }
        let expected = format_args!("at most {MAX_AFTER} that wait for a scene");
        let error = WireError::new(Code::Limit, "requests", expected, "one more");
        self.session.metrics().error(error.code);
        command.refuse(error);
    }

    /// Answers a request about an object of the scene that waits for its first frame; it is carried out
    /// once the scene is there.
    fn note_for_scene(&mut self, command: Command) {
        let names: Vec<&String> = match &self.coming {
            Some((_, objects)) => objects.iter().map(|object| &object.name).collect(),
            None => Vec::new(),
        };
        let error = match &command.request {
            Request::Place(place) if place.stands.is_none() => Some(no_frame()),
            Request::Place(Place { object, .. }) | Request::Turn(Turn { object, .. })
                if !names.contains(&object) =>
            {
                let expected = format!("one of {names:?}");
                let got = format!("{object:?}");
                Some(WireError::new(Code::Object, "object", expected, got))
            }
            _ => None,
        };
        if let Some(error) = error {
            self.session.metrics().error(error.code);
            command.refuse(error);
            return;
        }
        let done = Done {
            id: command.id,
            request: command.request.kind().to_owned(),
        };
        let _ = command.reply.try_send(Reply::Done(done));
        // What is said of it later goes nowhere.
        let (reply, _) = mpsc::channel(1);
        self.wait_for_scene(Command {
            id: None,
            reply,
            ..command
        });
    }

    fn place(&mut self, place: &Place) -> Result<(), WireError> {
        match (&place.stands, place.pixel, &self.last) {
            (Some(stands), ..) => self.renderer.put_back(&place.object, stands),
            (None, Some(pixel), Some(last)) => {
                self.renderer.place(&place.object, pixel, &last.frame)
            }
            // Without a pixel there are no messages: parsing refuses them.
            (None, ..) => Err(no_frame()),
        }
    }

    /// Begins to load a scene, and with it what is to be played. Without a frame to place it in it
    /// waits for the first one: then nothing more is to be said now.
    fn set_scene(
        &mut self,
        scene: &SceneChoice,
        answer: Option<Answer>,
        play: Option<(Player, Arc<RgbdFrame>)>,
    ) -> Result<Answered, WireError> {
        let load = self.renderer.begin_scene(scene, &self.session.assets())?;
        if !self.has_scene {
            self.coming = Some((load.name(), load.objects()));
        }
        let (player, first) = play.unzip();
        let current = self.last.as_ref().map(|last| Arc::clone(&last.frame));
        let Some(frame) = first.or(current) else {
            self.waiting = Some(load);
            return Ok(Answered::Now);
        };
        self.waiting = None;
        let superseded = self.loads.start(load, frame, Ask { answer, player });
        self.tell_superseded(superseded);
        Ok(Answered::Later)
    }

    /// Both or neither: a scene that cannot be loaded leaves the old recording playing.
    fn change_play(
        &mut self,
        recording: Option<&str>,
        scene: Option<&str>,
        answer: Option<Answer>,
    ) -> Result<Answered, WireError> {
        if self.player.is_none() {
            return Err(WireError::new(
                Code::Forbidden,
                "play",
                "a session that plays a recording",
                "a live one",
            ));
        }
        // Placements refer to the first frame of what will be played.
        let opened = match recording {
            Some(name) => {
                let mut player = Player::new(name, self.backend.open(name)?);
                let first = player.read(&player.first())?;
                Some((player, Arc::new(first)))
            }
            None => None,
        };
        let choice = match (scene, recording) {
            (Some(name), _) => Some(name.to_owned()),
            // The scene that stays is placed anew: it was placed in another room.
            (None, Some(_)) => self.scene_name(),
            (None, None) => None,
        };
        if let Some(name) = choice {
            return self.set_scene(&SceneChoice::Name(name), answer, opened);
        }
        if let Some((player, _)) = opened {
            self.player = Some(player);
            self.last = None;
            self.unfinished = None;
        }
        Ok(Answered::Now)
    }

    /// Name of the scene that is shown, or will be while nothing else is.
    fn scene_name(&self) -> Option<String> {
        match &self.coming {
            Some((name, _)) => name.clone(),
            None => self.renderer.scene_name(),
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

fn no_frame() -> WireError {
    WireError::new(Code::Object, "place", "a frame to place it in", "none yet")
}

/// Settings as the wire has them; unknown fields are errors that name the nearest known one.
fn parse_settings(
    settings: &serde_json::Map<String, serde_json::Value>,
) -> Result<RenderSettings, WireError> {
    let refuse = |error: &dyn std::fmt::Display| {
        WireError::new(Code::Settings, "settings", "render settings", error)
    };
    let text = serde_json::to_string(settings).map_err(|e| refuse(&e))?;
    let settings: RenderSettings =
        crate::json::from_str(&text, "settings").map_err(|e| refuse(&e))?;
    settings.validate().map_err(|e| {
        let what = format!("settings, {}", e.field);
        WireError::new(Code::Settings, what, &e.expected, &e.got)
    })?;
    Ok(settings)
}
