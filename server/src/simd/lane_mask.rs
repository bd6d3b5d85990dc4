//! A set of lanes.

/// Lanes of a packet of rays.
pub(crate) const LANES: usize = 16;

/// A set of up to sixteen lanes, one bit each. Iterating gives their indices, lowest first.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct LaneMask(pub(crate) u16);

/// The lanes of a [`LaneMask`].
pub(crate) struct Lanes(u16);

impl IntoIterator for LaneMask {
    type Item = usize;
    type IntoIter = Lanes;

    #[inline(always)]
    fn into_iter(self) -> Lanes {
        Lanes(self.0)
    }
}

impl Iterator for Lanes {
    type Item = usize;

    #[inline(always)]
    fn next(&mut self) -> Option<usize> {
        if self.0 == 0 {
            return None;
        }
        // The mask tells the compiler that the result is a valid lane index.
        let lane = self.0.trailing_zeros() as usize & 15;
        self.0 &= self.0 - 1;
        Some(lane)
    }
}

#[cfg(test)]
mod tests {
    use super::LaneMask;

    #[test]
    fn iterates_over_exactly_the_set_bits() {
        for bits in 0..=u16::MAX {
            let lanes: Vec<usize> = LaneMask(bits).into_iter().collect();
            let expected: Vec<usize> = (0..16).filter(|lane| bits >> lane & 1 != 0).collect();
            assert_eq!(lanes, expected);
        }
    }
}
