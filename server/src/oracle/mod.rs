//! Double-precision brute force: the truth for tests and comparisons, independent of the fast code.

pub mod triangles;
