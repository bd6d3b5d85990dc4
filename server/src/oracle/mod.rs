//! (see README)

pub mod ghost;
