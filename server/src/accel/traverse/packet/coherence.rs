//! How similar the directions of a packet's lanes are, which decides how they traverse a BVH together.

/// Sign of the active lanes' directions along one axis.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum DirectionSign {
    /// All lanes have positive directions.
    Positive,
    /// All lanes have negative directions.
    Negative,
    /// Some lanes have positive and some negative directions.
    Both,
}

impl DirectionSign {
    /// From bit masks of the lanes with a negative direction and of all active lanes.
    #[inline(always)]
    pub(crate) fn of(negative: u64, active: u64) -> Self {
        if negative == 0 {
            Self::Positive
        } else if negative == active {
            Self::Negative
        } else {
            Self::Both
        }
    }
}

/// The lanes agree in sign along all axes.
pub(crate) const COHERENT: u8 = 0;
/// The lanes disagree along at most [`MOST_MIXED_AXES`] axes.
pub(crate) const MIXED: u8 = 1;
/// The lanes disagree along more axes.
pub(crate) const INCOHERENT: u8 = 2;

/// Axes along which the lanes of a [`MIXED`] packet may disagree in sign.
pub(crate) const MOST_MIXED_AXES: usize = 1;

/// Per packet kind: at most this many lanes leave the packet and are traced one by one.
pub(crate) const TOO_FEW: [u32; 3] = [1, 1, 4];

/// At most this many lanes are tested ray by ray against all triangles of a leaf; more lanes are tested triangle by
/// triangle, all lanes at once.
pub(crate) const LEAF_BY_RAY: u32 = 4;
