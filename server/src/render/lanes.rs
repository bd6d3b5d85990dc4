//! Lanes of a ray packet as bits of a mask.

/// Lanes of a packet.
pub(crate) const LANES: usize = 16;

/// Set bits of a mask, lowest first.
pub(crate) fn lanes(mut mask: u16) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = mask.trailing_zeros() as usize;
        (mask != 0).then(|| {
            mask &= mask - 1;
            lane
        })
    })
}
