//! The truth that faster code is tested against: double precision, no acceleration, simple enough
//! to be believed by reading.

pub mod ghost;
pub mod triangles;
