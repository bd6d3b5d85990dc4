//! Packets of rays: `query` traverses the TLAS, `walk` traverses one mesh with one vector of rays (`nearest` or
//! `any`), `group` one mesh with four vectors at once. The other modules are parts of these: `rays` in the space of a
//! mesh, `slabs` and `bundle` for boxes, `leaf` for triangles, `stack`, and `lanes` for lanes that leave the packet.

mod any;
mod bundle;
mod coherence;
mod group;
mod hits;
mod lanes;
mod leaf;
mod nearest;
pub(super) mod query;
mod rays;
mod slabs;
mod stack;
mod walk;
