//! The hits of a packet so far, and the target of its traversal.

use fearless_simd::Simd;

use crate::accel::ray::PacketFilter;
use crate::simd::Width;

/// The nearest hits so far.
#[derive(Clone, Copy)]
pub(crate) struct PacketHits<S: Simd, W: Width<S>> {
    /// `t` of the nearest hit, or the end of the ray; -inf once a lane is done.
    pub(crate) t: W::F,
    pub(crate) u: W::F,
    pub(crate) v: W::F,
    pub(crate) instance: W::U,
    pub(crate) triangle: W::U,
}

/// The instance being traversed, and the filter that may reject its hits.
#[derive(Clone, Copy)]
pub(crate) struct PacketTarget<'a> {
    pub(crate) instance: u32,
    /// Index of lane 0 in the caller's packet.
    pub(crate) first_lane: usize,
    pub(crate) filter: Option<PacketFilter<'a>>,
    /// Any hit is sufficient.
    pub(crate) any: bool,
}
