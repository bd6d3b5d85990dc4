//! Renders frames of one scene.

use glam::DAffine3;

use crate::frame::{ColorImage, FrameGeometry, RgbdFrame};
use crate::scene::Scene;

use super::aov::Aov;
use super::budget::{self, Lowered};
use super::checkpoint::{Cancelled, Checkpoint, Uninterrupted};
use super::cpu;
use super::error::RenderError;
use super::rendered::Rendered;
use super::settings::RenderSettings;
use super::stage::Clock;

/// Renders frames of one scene on some backend, a whole frame per call, so that a device can keep
/// its data.
pub struct Renderer {
    backend: BackendRenderer,
    budget: budget::Budget,
    clock: Clock,
}

enum BackendRenderer {
    /// The processor.
    Cpu(Box<cpu::CpuRenderer>),
}

impl Renderer {
    /// Around the renderer of a backend.
    pub(super) fn new(renderer: cpu::CpuRenderer, clock: Clock) -> Self {
        Self {
            backend: BackendRenderer::Cpu(Box::new(renderer)),
            budget: budget::Budget::default(),
            clock,
        }
    }

    /// What was odd about the scene, one sentence each.
    pub fn notes(&self) -> &[String] {
        match &self.backend {
            BackendRenderer::Cpu(renderer) => &renderer.notes,
        }
    }

    /// Memory held for the scene beside its own meshes, bytes: trees, coarser meshes.
    pub fn memory(&self) -> u64 {
        match &self.backend {
            BackendRenderer::Cpu(renderer) => renderer.memory,
        }
    }

    /// About what building a renderer of a scene takes at most, bytes, beside its own meshes: trees
    /// while they are built, and meshes while they are simplified.
    pub fn building_bytes(scene: &Scene) -> u64 {
        let of_mesh = |mesh: &std::sync::Arc<crate::scene::Mesh>| {
            250 * mesh.triangles.len() as u64 + 100 * mesh.positions.len() as u64
        };
        scene.meshes.iter().map(of_mesh).sum()
    }

    /// Moves an instance of the scene, by its index there; nothing is built anew.
    pub fn set_transform(&mut self, instance: usize, world_from_object: DAffine3) {
        match &mut self.backend {
            BackendRenderer::Cpu(renderer) => renderer.set_transform(instance, world_from_object),
        }
    }

    /// Renders one frame to its end. The same frame and settings give the same bytes, unless a
    /// budget is set: then quality follows how long the frames before took.
    pub fn render(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
    ) -> Result<Rendered, RenderError> {
        self.render_while(frame, settings, aovs, &Uninterrupted)
    }

    /// Renders one frame as [`Self::render`] does while `checkpoint` lets it, else
    /// [`RenderError::Cancelled`]. A frame that was given up leaves nothing behind: the next one is as
    /// if it had not been begun.
    pub fn render_while(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<Rendered, RenderError> {
        let start = (self.clock)();
        let affordable = self.budget.apply(settings);
        let rendered = match &mut self.backend {
            BackendRenderer::Cpu(renderer) => renderer.render(frame, &affordable, aovs, checkpoint),
        };
        self.account(settings, &affordable, start, rendered)
    }

    /// Decodes a frame and renders it as [`Self::render_while`] does: the ghost surface is built from
    /// its depth while its picture is decoded, on two threads if there are; if both fail, the picture's
    /// error is returned. A frame that is given up is decoded nevertheless.
    pub fn render_decoding<E: Send>(
        &mut self,
        geometry: impl FnOnce() -> Result<FrameGeometry, E>,
        color: impl FnOnce() -> Result<ColorImage, E> + Send,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<(RgbdFrame, Result<Rendered, RenderError>), E> {
        let start = (self.clock)();
        let affordable = self.budget.apply(settings);
        let (frame, rendered) = match &mut self.backend {
            BackendRenderer::Cpu(renderer) => {
                renderer.render_decoding(geometry, color, &affordable, aovs, checkpoint)?
            }
        };
        let rendered = self.account(settings, &affordable, start, rendered);
        Ok((frame, rendered))
    }

    /// Says what was lowered, and learns from how long it took. A frame that was given up took at
    /// least as long as it ran.
    fn account(
        &mut self,
        settings: &RenderSettings,
        affordable: &RenderSettings,
        start: u64,
        rendered: Result<Rendered, Cancelled>,
    ) -> Result<Rendered, RenderError> {
        let took_ns = match &rendered {
            Ok(rendered) => rendered.total_ns,
            Err(Cancelled) => (self.clock)().saturating_sub(start),
        };
        let took_ms = took_ns as f32 * 1e-6;
        if rendered.is_ok() || settings.limit_ms().is_some_and(|limit| took_ms > limit) {
            self.budget.learn(settings, took_ms);
        }
        let mut rendered = rendered?;
        rendered.lowered = budget::lowered_settings(settings, affordable);
        if rendered.stats.photons == 0 {
            // Nothing was lost where none would have been cast.
            let of_photons = |lowered: &Lowered| lowered.setting == "caustics.photons";
            rendered.lowered.retain(|lowered| !of_photons(lowered));
        }
        Ok(rendered)
    }
}
