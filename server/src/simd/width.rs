//! Vector types of one width, for kernels that are generic over it.

use fearless_simd::{Simd, f32x4, f32x8, f32x16, mask32x8, mask32x16, prelude::*, u32x8, u32x16};

/// The vector types of one packet width.
pub(crate) trait Width<S: Simd>: Copy {
    /// Lanes of floats.
    type F: SimdFloat<S, Element = f32, Mask = Self::M, Block = f32x4<S>>;
    /// Lanes of numbers.
    type U: SimdInt<S, Element = u32, Mask = Self::M>;
    /// One truth value per lane.
    type M: SimdMask<S> + Select<Self::F> + Select<Self::U>;
}

/// Sixteen lanes: one AVX-512 register.
#[derive(Clone, Copy)]
pub(crate) struct Sixteen;
/// Eight lanes: one AVX2 register.
#[derive(Clone, Copy)]
pub(crate) struct Eight;

impl<S: Simd> Width<S> for Sixteen {
    type F = f32x16<S>;
    type U = u32x16<S>;
    type M = mask32x16<S>;
}

impl<S: Simd> Width<S> for Eight {
    type F = f32x8<S>;
    type U = u32x8<S>;
    type M = mask32x8<S>;
}
