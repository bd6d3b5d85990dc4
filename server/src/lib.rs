//! Ghostlight: ray traces virtual objects into RGB-D frames, with the sensed depth map as a
//! *ghost surface* that occludes, is mirrored, and casts and receives shadows, but is never drawn.
//!
//! Modules in the order of the data flow.

pub mod accel;
pub mod camera;
pub mod clock;
pub mod codec;
pub mod frame;
pub mod ghost;
pub mod json;
pub mod memory;
pub mod net;
pub mod numerics;
pub mod output;
pub mod recording;
pub mod render;
pub mod replay;
pub mod scene;
pub mod schema;
pub mod settings;
pub mod shapes;
mod simd;
pub mod text;
