//! Rays through the trees: `scalar` is the plain reference, `single` takes one ray through the
//! eight-wide tree, `packet` sixteen and more at once, `shaft` rules out whole bundles, and `query` is
//! what the rest of the program calls. All of them return the same hits; see [`super`].

mod candidates;
mod packet;
mod query;
mod scalar;
mod shaft;
mod single;
mod triangle;

pub use shaft::Shaft;
