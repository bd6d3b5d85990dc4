//! The reference for tests of faster code: double precision, simple enough to be verified by reading.
//!
//! * [`ghost`], [`triangles`]: brute force over every triangle.
//! * [`closed`]: closed forms, against which the path tracer itself is tested.
//! * [`path`]: whole frames by unbiased path tracing.

pub mod closed;
pub mod ghost;
pub mod path;
pub mod triangles;
