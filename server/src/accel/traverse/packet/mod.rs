//! Packets of rays: `query` walks the tree over the instances, `walk` one mesh with one vector of
//! rays (`nearest` or `any`), `group` one mesh with four vectors at once. The others are their parts:
//! `rays` in the space of a mesh, `slabs` and `bundle` for boxes, `leaf` for triangles, `stack`, and
//! `alone` for lanes that part from the rest.

mod alone;
mod any;
mod bundle;
mod coherence;
mod group;
mod hits;
mod leaf;
mod nearest;
pub(super) mod query;
mod rays;
mod slabs;
mod stack;
mod walk;
