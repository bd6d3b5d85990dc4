//! The laboratory: what Ghostlight is measured against. The renderer does not see it.
//!
//! * [`oracle`]: the truth, in double precision.
//! * [`hard`]: hard cases, each with the bound that it must keep.
//! * [`compare`]: experiments, time against error.
//! * [`synth`]: a recording of a made room, whose depth, poses and lights are known.

pub mod compare;
pub mod hard;
pub mod oracle;
pub mod synth;
