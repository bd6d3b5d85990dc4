//! Publishes the outcome of a frame: a composite, an error, or nothing.

use std::sync::Arc;
use std::sync::atomic::Ordering;

use ghostlight_proto::control::{ErrorReport, Reply};
use ghostlight_proto::{Code, Stamps, WireError};

use super::super::catalog::Unrendered;
use super::super::encode::Output;
use super::super::frame_watch::Why;
use super::super::session::count;
use super::super::session::{Incoming, Quality};
use super::RenderThread;
use crate::render::Rendered;

impl RenderThread {
    pub(super) fn refuse_frame(&mut self, incoming: &Incoming, error: WireError) {
        self.session.count_refused(error.code);
        let sequence = Some(incoming.header.sequence);
        let report = ErrorReport::new(error, None, sequence, false);
        let _ = incoming.reply.try_send(Reply::Error(report));
    }

    pub(super) fn too_slow(&self) -> WireError {
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

    /// Handles a cancelled frame: the last good picture stays.
    fn without_picture(&mut self, why: Option<Why>, fresh: bool) {
        match why {
            Some(Why::TooSlow) => {
                let error = self.too_slow();
                if fresh {
                    self.session.count_refused(error.code);
                } else {
                    self.session.metrics().error(error.code);
                }
                // Once per scene, not per frame.
                if !std::mem::replace(&mut self.owner_warned, true) {
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

    /// Publishes the composite of the last good frame; `why` is the reason if there is none.
    pub(super) fn publish(
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
        (self.given_up, self.owner_warned) = (0, false);
        self.session.set_quality(Quality {
            quality_reductions: rendered.lowered.iter().map(ToString::to_string).collect(),
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
}
