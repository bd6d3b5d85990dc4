//! Frames in, composites out. Knows nothing of networks, files or clocks: the clock that
//! times its stages is handed in.

mod budget;
mod checkpoint;
pub mod cpu;
mod settings;

pub use budget::Lowered;
pub use checkpoint::{Cancel, Cancelled, Checkpoint, Uninterrupted};
pub use settings::*;

pub use crate::ghost::{GhostSettings, HolePolicy, Traversal};

use glam::DAffine3;

use crate::frame::{ColorImage, FrameGeometry, RgbdFrame};
use crate::scene::Scene;

/// A step of a frame, in the order they run. Benches, timings, reports and client graphs
/// derive from [`Stage::ALL`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// Depth to ghost surface: connectivity, pyramid.
    Ghost,
    /// Caustics: photons emitted, followed and sorted.
    Photons,
    /// Instances placed relative to the camera; which tiles anything virtual can reach.
    Plan,
    /// What each pixel in reach sees.
    Primary,
    /// Ambient light that virtual objects take from real surfaces and send to them.
    Ambient,
    /// Light visibility.
    Shadow,
    /// Mean filter over penumbra.
    ShadowFilter,
    /// Shading, secondary rays and compositing.
    Shade,
    /// Bloom and glare.
    Post,
    /// Linear light to 8-bit RGBA.
    Encode,
}

impl Stage {
    /// Every stage, in order.
    pub const ALL: [Self; 10] = [
        Self::Ghost,
        Self::Photons,
        Self::Plan,
        Self::Primary,
        Self::Ambient,
        Self::Shadow,
        Self::ShadowFilter,
        Self::Shade,
        Self::Post,
        Self::Encode,
    ];

    /// As written in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ghost => "ghost",
            Self::Photons => "photons",
            Self::Plan => "plan",
            Self::Primary => "primary",
            Self::Ambient => "ambient",
            Self::Shadow => "shadow",
            Self::ShadowFilter => "shadow_filter",
            Self::Shade => "shade",
            Self::Post => "post",
            Self::Encode => "encode",
        }
    }
}

/// Nanoseconds since any fixed moment.
pub type Clock = fn() -> u64;

/// Images beside the composite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Aov {
    /// Share of the pixel that is virtual, M; 8-bit.
    Mask,
    /// Depth of the composite, 16-bit millimetres, 0 where unknown; through a lens too that at the
    /// pixel's centre, as the pinhole sees it.
    Depth,
    /// Camera-space normal of what is seen there, RGB = (n + 1) / 2; black where unknown.
    Normal,
    /// Im / Ir in luminance, 8-bit: 255 where nothing virtual changes the light, or adds to it.
    Shadow,
    /// The same if lamps were not shadowed: what ambient light alone does. 8-bit, 255 where nothing
    /// changes or light is added.
    Ambient,
    /// Radiance with only real things, Ir; sRGB.
    Real,
    /// Radiance with everything, Im; sRGB.
    Mixed,
}

impl Aov {
    /// Every one.
    pub const ALL: [Self; 7] = [
        Self::Mask,
        Self::Depth,
        Self::Normal,
        Self::Shadow,
        Self::Ambient,
        Self::Real,
        Self::Mixed,
    ];

    /// As written on the command line and in paths.
    pub fn name(self) -> &'static str {
        match self {
            Self::Mask => "mask",
            Self::Depth => "depth",
            Self::Normal => "normal",
            Self::Shadow => "shadow",
            Self::Ambient => "ambient",
            Self::Real => "real",
            Self::Mixed => "mixed",
        }
    }
}

/// Pixels of an [`Aov`], the frame's size, rows from the top.
#[derive(Debug, Clone, PartialEq)]
pub enum AovImage {
    /// Mask, shadow, ambient.
    Gray8(Vec<u8>),
    /// Depth.
    Gray16(Vec<u16>),
    /// Normal, real, mixed.
    Rgb8(Vec<[u8; 3]>),
}

/// What was counted while a frame was made.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct FrameStats {
    /// Pixels of the frame.
    pub pixels: u64,
    /// Pixels that went through ray tracing; the others were copied.
    pub traced_pixels: u64,
    /// Pixels that show something virtual.
    pub virtual_pixels: u64,
    /// Pixels that show something virtual where depth, filled or not, says nothing of what is real:
    /// whether something real is in front is unknown there. See [`HolePolicy`].
    pub unmeasured_pixels: u64,
    /// Pixels whose light something virtual changes.
    pub relit_pixels: u64,
    /// Rays cast for ambient light.
    pub ambient_rays: u64,
    /// Shadow rays cast.
    pub shadow_rays: u64,
    /// Pairs of a shaded point and a light that rays were cast for: what is proven lit, or faces
    /// away from the light, is not among them.
    pub shadow_points: u64,
    /// Those of them whose first samples disagreed, or those of a neighbour: they took all.
    pub penumbra_points: u64,
    /// Shadow rays cast for those.
    pub penumbra_rays: u64,
    /// Photons emitted for caustics.
    pub photons: u64,
    /// Photons that came to rest where they count.
    pub photons_stored: u64,
    /// Triangles of all objects, in the versions that the frame shows of large meshes; see
    /// [`RenderSettings::detail_px`].
    pub triangles: u64,
    /// Secondary rays (reflection, refraction) cast.
    pub secondary_rays: u64,
    /// Secondary rays that ended on something virtual or on a modelled ghost.
    pub secondary_mesh: u64,
    /// Secondary rays that ended on the ghost surface.
    pub secondary_ghost: u64,
    /// Secondary rays that left what the camera sees and took the environment's radiance.
    pub secondary_environment: u64,
    /// Secondary rays that went where nothing is known: behind the sheet or into a hole.
    pub secondary_unknown: u64,
}

impl FrameStats {
    /// Adds the counts of a part of the frame; its pixels and photons are known as a whole.
    fn add(&mut self, other: &Self) {
        self.traced_pixels += other.traced_pixels;
        self.virtual_pixels += other.virtual_pixels;
        self.unmeasured_pixels += other.unmeasured_pixels;
        self.relit_pixels += other.relit_pixels;
        self.ambient_rays += other.ambient_rays;
        self.shadow_rays += other.shadow_rays;
        self.shadow_points += other.shadow_points;
        self.penumbra_points += other.penumbra_points;
        self.penumbra_rays += other.penumbra_rays;
        self.secondary_rays += other.secondary_rays;
        self.secondary_mesh += other.secondary_mesh;
        self.secondary_ghost += other.secondary_ghost;
        self.secondary_environment += other.secondary_environment;
        self.secondary_unknown += other.secondary_unknown;
    }
}

/// A finished frame.
#[derive(Debug, Clone)]
pub struct Rendered {
    /// The composite.
    pub color: ColorImage,
    /// The images asked for.
    pub aovs: Vec<(Aov, AovImage)>,
    /// Nanoseconds per stage, in the order of [`Stage::ALL`].
    pub stage_ns: [u64; Stage::ALL.len()],
    /// Nanoseconds from decoded frame to finished RGBA, the ghost surface counted in full even where
    /// it was built during decoding.
    pub total_ns: u64,
    /// Counts.
    pub stats: FrameStats,
    /// What was made with less than asked for, to keep [`RenderSettings::budget_ms`].
    pub lowered: Vec<Lowered>,
}

/// Why a scene or frame cannot be rendered.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// Threads could not be started.
    #[error("render threads: {0}")]
    Threads(String),
    /// A mesh that no acceleration structure could be built for.
    #[error("object {object:?}: {reason}")]
    Mesh {
        /// Object of the scene document.
        object: String,
        /// What is wrong.
        reason: String,
    },
    /// The frame's [`Checkpoint`] gave it up.
    #[error("rendering was cancelled")]
    Cancelled,
}

/// Renders frames of one scene on some backend, a whole frame per call, so that a device can keep
/// its data.
pub struct Renderer {
    backend: Backend,
    budget: budget::Budget,
    clock: Clock,
}

enum Backend {
    /// The processor.
    Cpu(Box<cpu::CpuRenderer>),
}

impl Renderer {
    /// A CPU renderer with `threads` threads of its own (0: one per core) for one scene.
    pub fn cpu(scene: &Scene, threads: usize, clock: Clock) -> Result<Self, RenderError> {
        Self::cpu_while(scene, threads, clock, &Uninterrupted)
    }

    /// As [`Self::cpu`], while `checkpoint` lets it, else [`RenderError::Cancelled`].
    pub fn cpu_while(
        scene: &Scene,
        threads: usize,
        clock: Clock,
        checkpoint: &dyn Checkpoint,
    ) -> Result<Self, RenderError> {
        let renderer = cpu::CpuRenderer::new_while(scene, threads, clock, checkpoint)?;
        Ok(Self {
            backend: Backend::Cpu(Box::new(renderer)),
            budget: budget::Budget::default(),
            clock,
        })
    }

    /// What was odd about the scene, one sentence each.
    pub fn notes(&self) -> &[String] {
        match &self.backend {
            Backend::Cpu(renderer) => &renderer.notes,
        }
    }

    /// Memory held for the scene beside its own meshes, bytes: trees, coarser meshes.
    pub fn memory(&self) -> u64 {
        match &self.backend {
            Backend::Cpu(renderer) => renderer.memory,
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
            Backend::Cpu(renderer) => renderer.set_transform(instance, world_from_object),
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
            Backend::Cpu(renderer) => renderer.render(frame, &affordable, aovs, checkpoint),
        };
        self.account(settings, &affordable, start, rendered)
    }

    /// Decodes a frame and renders it as [`Self::render_while`] does: the ghost surface is built from
    /// its depth while its picture is decoded. Both closures run on render threads; if both fail, the
    /// picture's error is returned. A frame that is given up is decoded nevertheless.
    pub fn render_decoding<E: Send>(
        &mut self,
        geometry: impl FnOnce() -> Result<FrameGeometry, E> + Send,
        color: impl FnOnce() -> Result<ColorImage, E> + Send,
        settings: &RenderSettings,
        aovs: &[Aov],
        checkpoint: &dyn Checkpoint,
    ) -> Result<(RgbdFrame, Result<Rendered, RenderError>), E> {
        let start = (self.clock)();
        let affordable = self.budget.apply(settings);
        let (frame, rendered) = match &mut self.backend {
            Backend::Cpu(renderer) => {
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
