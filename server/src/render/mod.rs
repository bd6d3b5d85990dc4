//! Renders frames: RGB-D frames in, composites out. Uses no network, files or clocks: the clock that times its
//! stages is passed in.

mod aov;
mod backend;
mod budget;
mod checkpoint;
pub mod cpu;
mod engine;
mod error;
mod helper;
mod mesh_cache;
mod prepare;
mod rendered;
mod renderer;
mod settings;
mod stage;
mod stats;
mod threads;

pub use aov::{Aov, AovImage};
pub use backend::Backend;
pub use budget::Lowered;
pub use checkpoint::{Cancel, Cancelled, Checkpoint, Uninterrupted};
pub use engine::Engine;
pub use error::RenderError;
pub use rendered::Rendered;
pub use renderer::Renderer;
pub use settings::*;
pub use stage::{Clock, Stage};
pub use stats::FrameStats;
pub use threads::Threads;

pub use crate::ghost::{GhostSettings, HolePolicy, Traversal};
