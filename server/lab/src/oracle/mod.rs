//! The truth that faster code is tested against: double precision, simple enough to be believed
//! by reading.
//!
//! * [`ghost`], [`triangles`]: brute force over every triangle.
//! * [`closed`]: closed forms, against which the path tracer itself is tested.
//! * [`path`]: whole frames by unbiased path tracing.

pub mod closed;
pub mod ghost;
pub mod path;
pub mod triangles;
