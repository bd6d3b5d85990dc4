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

/// Renders frames of one scene on a backend, a whole frame per call, so that a device can keep its data.
pub struct Renderer {
    backend: BackendRenderer,
    budget: budget::Budget,
    clock: Clock,
}

enum BackendRenderer {
    /// The CPU.
    Cpu(Box<cpu::CpuRenderer>),
}

impl Renderer {
    /// Wraps the renderer of a backend.
    pub(super) fn new(renderer: cpu::CpuRenderer, clock: Clock) -> Self {
        Self {
            backend: BackendRenderer::Cpu(Box::new(renderer)),
            budget: budget::Budget::default(),
            clock,
        }
    }

    /// Notes about unusual properties of the scene, one sentence each.
    pub fn notes(&self) -> &[String] {
        match &self.backend {
            BackendRenderer::Cpu(renderer) => &renderer.notes,
        }
    }

    /// Memory held for the scene in addition to its own meshes, bytes: BVHs and coarser levels of detail.
    pub fn memory(&self) -> u64 {
        match &self.backend {
            BackendRenderer::Cpu(renderer) => renderer.memory,
        }
    }

    /// Approximate peak memory for building a renderer of a scene, bytes, in addition to its own meshes: BVHs
    /// during the build, and meshes during simplification.
    pub fn building_bytes(scene: &Scene) -> u64 {
        let of_mesh = |mesh: &std::sync::Arc<crate::scene::Mesh>| {
            250 * mesh.triangles.len() as u64 + 100 * mesh.positions.len() as u64
        };
        scene.meshes.iter().map(of_mesh).sum()
    }

    /// Moves an instance of the scene, given by its index; nothing is rebuilt.
    pub fn set_transform(&mut self, instance: usize, world_from_object: DAffine3) {
        match &mut self.backend {
            BackendRenderer::Cpu(renderer) => renderer.set_transform(instance, world_from_object),
        }
    }

    /// Renders one frame without cancellation. The same frame and settings give the same bytes, unless a budget
    /// is set: then quality depends on how long previous frames took.
    pub fn render(
        &mut self,
        frame: &RgbdFrame,
        settings: &RenderSettings,
        aovs: &[Aov],
    ) -> Result<Rendered, RenderError> {
        self.render_while(frame, settings, aovs, &Uninterrupted)
    }

    /// Renders one frame like [`Self::render`]; returns [`RenderError::Cancelled`] if `checkpoint` cancels it. A
    /// cancelled frame has no effect on later ones.
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

    /// Decodes a frame and renders it like [`Self::render_while`]: the ghost surface is built from its depth
    /// while its picture is decoded, on two threads if possible. If both fail, the picture's error is returned. A
    /// cancelled frame is still decoded.
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

    /// Records the reduced settings, and updates the budget from the time that the frame took. A cancelled frame
    /// would have taken at least the time for which it ran, so it counts if that is over the budget.
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
            // Reducing the number of photons does not count if none would have been emitted.
            let of_photons = |lowered: &Lowered| lowered.setting == "caustics.photons";
            rendered.lowered.retain(|lowered| !of_photons(lowered));
        }
        Ok(rendered)
    }
}
