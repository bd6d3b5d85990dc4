//! How much the lanes of a packet go the same way, which decides how they walk a tree together.

/// Which way lanes run along an axis.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Way {
    Ahead,
    Behind,
    Both,
}

impl Way {
    /// Of lanes in bit masks.
    #[inline(always)]
    pub(crate) fn of(negative: u64, active: u64) -> Self {
        if negative == 0 {
            Self::Ahead
        } else if negative == active {
            Self::Behind
        } else {
            Self::Both
        }
    }
}

/// All lanes run the same way along all axes.
pub(crate) const ALIKE: u8 = 0;
/// Along most axes.
pub(crate) const CLOSE: u8 = 1;
/// In all directions.
pub(crate) const LOOSE: u8 = 2;

/// Axes along which lanes that are [`CLOSE`] may run both ways.
pub(crate) const MOST_BOTH: usize = 1;

/// Lanes that are too few to walk on together, by kind: each goes on alone.
pub(crate) const FEW: [u32; 3] = [1, 1, 4];

/// Lanes that are tested against the triangles of a leaf at once: up to so many.
pub(crate) const TOGETHER: u32 = 4;
