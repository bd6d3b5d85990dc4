//! The boxes of a node's children against the lanes of a packet, one box at a time.

use fearless_simd::{Simd, prelude::*};

use super::coherence::{COHERENT, DirectionSign};
use super::rays::SpaceRays;
use crate::accel::build::layout::WideNode;
use crate::simd::Width;

/// The lanes of a packet prepared for slab tests.
#[derive(Clone, Copy)]
pub(crate) struct PacketSlabs<S: Simd, W: Width<S>, const KIND: u8> {
    inv: [W::F; 3],
    /// Origins for the near and the far plane, if the lanes agree in sign.
    origins: [[W::F; 2]; 3],
    side: [usize; 3],
}

impl<S: Simd, W: Width<S>, const KIND: u8> PacketSlabs<S, W, KIND> {
    #[inline(always)]
    pub(crate) fn new(rays: &SpaceRays<S, W>, signs: [DirectionSign; 3]) -> Self {
        macro_rules! origins {
            ($axis:literal) => {{
                let (low, high) = (rays.low_origin[$axis], rays.high_origin[$axis]);
                if KIND == COHERENT && signs[$axis] == DirectionSign::Negative {
                    [high, low]
                } else {
                    [low, high]
                }
            }};
        }
        macro_rules! side {
            ($axis:literal) => {
                usize::from(KIND == COHERENT && signs[$axis] == DirectionSign::Negative)
            };
        }
        Self {
            inv: rays.inv,
            origins: [origins!(0), origins!(1), origins!(2)],
            side: [side!(0), side!(1), side!(2)],
        }
    }

    /// Entry into and exit from a child's box, per lane; see [`crate::accel::space::Slabs::cross`].
    #[inline(always)]
    pub(crate) fn cross(&self, simd: S, node: &WideNode, slot: usize) -> (W::F, W::F) {
        macro_rules! plane {
            ($axis:literal, $far:literal) => {
                (W::F::splat(simd, node.planes[$axis][self.side[$axis] ^ $far][slot])
                    - self.origins[$axis][$far])
                    * self.inv[$axis]
            };
        }
        let (x, xx) = (plane!(0, 0), plane!(0, 1));
        let (y, yy) = (plane!(1, 0), plane!(1, 1));
        let (z, zz) = (plane!(2, 0), plane!(2, 1));
        if KIND == COHERENT {
            (x.max(y).max(z), xx.min(yy).min(zz))
        } else {
            (
                x.min(xx).max(y.min(yy)).max(z.min(zz)),
                x.max(xx).min(y.max(yy)).min(z.max(zz)),
            )
        }
    }
}
