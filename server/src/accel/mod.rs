//! Ray tracing of virtual objects: triangle meshes ([`Blas`], built once) placed by instances ([`Tlas`], rebuilt
//! every frame). Three traversals return the same hits, and a fourth proves the absence of hits.
//!
//! * [`Tlas::intersect_packet`], [`Tlas::occluded_packet`]: 16 rays at once, fastest for coherent rays.
//! * [`Tlas::intersect`], [`Tlas::occluded`]: one ray.
//! * [`Tlas::may_intersect`]: conservative test of a whole bundle of rays.
//! * [`Tlas::intersect_scalar`], [`Tlas::occluded_scalar`]: scalar code, the reference for the others.
//!
//! Rays are in camera space, and `t` is always in units of the ray's direction. A ray is transformed to an instance's
//! object space without renormalising it, so `t` needs no conversion.
//!
//! # Why meshes are watertight and all kernels agree
//!
//! 1. The triangle test (`traverse::triangle`; Woop, Benthin, Wald 2013, "Watertight Ray/Triangle
//!    Intersection") moves each *vertex* into a space where the ray is the z axis, by operations
//!    that depend on the vertex and the ray alone. Triangles that share a vertex therefore see
//!    the same rounded vertex, and the signs that decide a hit are exact for it. A closed mesh
//!    stays closed.
//! 2. Boxes are widened per ray by a bound on that rounding (`space::PAD`), so that
//!    no box that holds an accepted triangle is missed, from any distance.
//! 3. All kernels share leaves, box arithmetic and triangle arithmetic (multiplications,
//!    additions and divisions in one order, never fused), and a hit is never nearer than the entry into its
//!    leaf. The nearest hit, ties going to the lowest (instance, triangle), is then a property of
//!    the ray, not of the order in which a tree is walked: results are equal bit for bit on every
//!    instruction set.

mod blas;
mod build;
mod instance;
mod ray;
mod space;
mod tlas;
mod traverse;

pub use blas::Blas;
pub use build::{BuildError, BuildLimits};
pub use instance::TlasInstance;
pub use ray::{
    Hit, HitFilter, HitPacket, MASK_GHOST, MASK_VIRTUAL, NO_HIT, PacketFilter, Ray, RayPacket,
};
pub use space::PAD as BOX_PAD;
pub use tlas::Tlas;
pub use traverse::Shaft;
