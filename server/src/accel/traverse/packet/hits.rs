//! What lanes have hit so far, and what they look for.

use fearless_simd::Simd;

use crate::accel::ray::PacketFilter;
use crate::simd::Width;

/// The nearest hits so far.
#[derive(Clone, Copy)]
pub(crate) struct Found<S: Simd, W: Width<S>> {
    /// Nearest `t`, or where the ray ends; -inf once a lane is done.
    pub(crate) t: W::F,
    pub(crate) u: W::F,
    pub(crate) v: W::F,
    pub(crate) instance: W::U,
    pub(crate) triangle: W::U,
}

/// The instance being walked, and who may refuse its hits.
#[derive(Clone, Copy)]
pub(crate) struct PacketTarget<'a> {
    pub(crate) instance: u32,
    /// Number of lane 0 within the caller's packet.
    pub(crate) first_lane: usize,
    pub(crate) filter: Option<PacketFilter<'a>>,
    /// Any hit will do.
    pub(crate) any: bool,
}
