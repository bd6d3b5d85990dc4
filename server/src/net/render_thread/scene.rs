//! Changes the scene of a session: a new scene waits for a frame to be placed in, is loaded in the background,
//! and replaces the one shown.

use std::sync::Arc;
use std::time::{Duration, Instant};

use ghostlight_proto::control::{Done, ErrorReport, Place, Reply, Request, SceneChoice, Turn};
use ghostlight_proto::{Code, Codec, Frame, Stamps, WireError};
use tokio::sync::mpsc;

use super::super::catalog::EncodedFrame;
use super::super::decode::FrameDecoder;
use super::super::player::Player;
use super::super::scene_load::{Answer, SceneRequest};
use super::super::session::{Command, Incoming};
use super::{Decoded, RenderThread};
use crate::clock;
use crate::frame::RgbdFrame;
use crate::render::RenderSettings;

/// Longest time that frames wait for the first scene. Nearly every scene is loaded within it; while a larger one
/// loads, viewers see the camera's picture.
const HOLD: Duration = Duration::from_secs(3);

/// How long an ending session waits for the scene of its last frame.
const LAST_SCENE: Duration = Duration::from_secs(1);

/// Most requests that may wait for a scene.
const MAX_AFTER: usize = 64;

/// When a request is answered.
pub(super) enum Answered {
    /// Now, by the caller.
    Now,
    /// When the load that the request started is done.
    Later,
}

impl RenderThread {
    /// Before the session ends, renders a last frame that waits for its scene, if the scene is loaded within
    /// [`LAST_SCENE`].
    pub(super) fn last_words(&mut self, waits: bool) {
        let until = Instant::now() + LAST_SCENE;
        while waits && self.is_held() && Instant::now() < until && !self.session.is_over() {
            std::thread::sleep(Duration::from_millis(5));
            if self.take_scene() {
                self.render(true);
            }
        }
    }

    /// Decodes a producer's frame, to be rendered once the scene is loaded.
    pub(super) fn take_unshown(&mut self, incoming: &Incoming) -> bool {
        let decode_start_ns = clock::now_ns();
        let jpeg = incoming.header.color_codec == Codec::Jpeg;
        let taken = Frame::decode(&incoming.message).and_then(|frame| {
            let start = incoming.message.len() - frame.color.len() - frame.depth.len();
            let color = start..start + frame.color.len();
            Ok((FrameDecoder::new(&frame).whole()?, color))
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
    pub(super) fn is_held(&self) -> bool {
        self.hold_until.is_some() && self.loads.is_busy()
    }

    /// Loads the scene that waited for a first frame.
    pub(super) fn load_waiting(&mut self) {
        let Some(last) = &self.last else { return };
        if let Some(load) = self.waiting.take() {
            let ask = SceneRequest {
                // The request was answered when its document was checked.
                answer: None,
                player: None,
            };
            let frame = Arc::clone(&last.frame);
            let settings = self.settings_of(load.settings());
            let superseded = self.loads.start(load, frame, settings, ask);
            self.hold_until = Some(Instant::now() + HOLD);
            self.tell_superseded(superseded);
        }
    }

    pub(super) fn tell_superseded(&self, ask: Option<SceneRequest>) {
        if let Some(answer) = ask.and_then(|ask| ask.answer) {
            let expected = "the newest request";
            let got = "one replaced by a newer one";
            let error = WireError::new(Code::Scene, "scene", expected, got);
            self.session.metrics().error(error.code);
            let report = ErrorReport::new(error, answer.id, None, false);
            let _ = answer.reply.try_send(Reply::Error(report));
        }
    }

    /// Takes over the result of a load, or reports its error; false if there was no result.
    pub(super) fn take_scene(&mut self) -> bool {
        let Some((ask, loaded)) = self.loads.poll() else {
            return false;
        };
        self.hold_until = None;
        self.coming = None;
        match loaded {
            Ok(renderer) => {
                let stays = self.stays(ask.player.is_some(), renderer.scene_name());
                self.renderer = renderer;
                self.has_scene = true;
                if !stays {
                    self.settings = self.settings_of(self.renderer.scene_settings());
                }
                self.owner_warned = false;
                if let Some(mut player) = ask.player {
                    player.restart();
                    self.player = Some(player);
                    self.last = None;
                    self.unfinished = None;
                }
                if let Some(Answer { id, kind, reply }) = ask.answer {
                    let request = kind.to_owned();
                    let note = None;
                    let _ = reply.try_send(Reply::Done(Done { id, request, note }));
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

    /// Whether a scene of this name is the one that is shown, now with another recording: it is placed again, and
    /// the settings of the session stay.
    fn stays(&self, other_recording: bool, name: Option<String>) -> bool {
        other_recording && self.has_scene && name.is_some() && name == self.renderer.scene_name()
    }

    /// Settings for a newly chosen scene: its document's, otherwise those for scenes without their own.
    fn settings_of(&self, scene: Option<RenderSettings>) -> RenderSettings {
        match scene {
            _ if self.fixed_settings => self.settings,
            Some(settings) => settings,
            None => self.own_settings,
        }
    }

    /// Queues a request until the scene being loaded is shown.
    pub(super) fn wait_for_scene(&mut self, command: Command) {
        if self.after.len() < MAX_AFTER {
            self.after.push(command);
            return;
        }
        let expected = format_args!("at most {MAX_AFTER} that wait for a scene");
        let error = WireError::new(Code::Limit, "requests", expected, "one more");
        self.session.metrics().error(error.code);
        command.refuse(error);
    }

    /// Answers a request about an object of a scene that waits for its first frame; the request is carried out
    /// once the scene is loaded.
    pub(super) fn note_for_scene(&mut self, command: Command) {
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
            note: None,
        };
        let _ = command.reply.try_send(Reply::Done(done));
        // The request has been answered, so its later outcome is not reported.
        let (reply, _) = mpsc::channel(1);
        self.wait_for_scene(Command {
            id: None,
            reply,
            ..command
        });
    }

    /// Starts to load a scene, with an optional recording to play. Without a frame to place it in, the scene
    /// waits for the first one, and the request is answered at once.
    pub(super) fn set_scene(
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
        let settings = match self.stays(player.is_some(), load.name()) {
            true => self.settings,
            false => self.settings_of(load.settings()),
        };
        let ask = SceneRequest { answer, player };
        let superseded = self.loads.start(load, frame, settings, ask);
        self.tell_superseded(superseded);
        Ok(Answered::Later)
    }

    /// Changes recording, scene or both. If the scene cannot be loaded, the old recording keeps playing.
    pub(super) fn change_play(
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
        // Placements refer to the first frame of the recording to be played.
        let opened = match recording {
            Some(name) => {
                let mut player = Player::new(name, self.catalog.open(name)?);
                let first = player.read(&player.first())?;
                Some((player, Arc::new(first)))
            }
            None => None,
        };
        let choice = match (scene, recording) {
            (Some(name), _) => Some(name.to_owned()),
            // The same scene must be placed again, because the recording shows another room.
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

    /// Name of the scene that is shown, or of the one being loaded while there is none.
    pub(super) fn scene_name(&self) -> Option<String> {
        match &self.coming {
            Some((name, _)) => name.clone(),
            None => self.renderer.scene_name(),
        }
    }
}

/// The error for a placement by pixel before the first frame.
pub(super) fn no_frame() -> WireError {
    WireError::new(Code::Object, "place", "a frame to place it in", "none yet")
}
