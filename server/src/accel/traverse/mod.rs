//! Ray traversal of the BVHs: `scalar` is the scalar reference, `single` traces one ray through the eight-wide BVH,
//! `packet` sixteen and more rays at once, `shaft` tests whole bundles of rays conservatively, and `query` is the
//! public interface. All of them agree; see [`super`].

mod candidates;
mod packet;
mod query;
mod scalar;
mod shaft;
mod single;
mod triangle;

pub use shaft::Shaft;
