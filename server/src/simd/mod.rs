//! Shared parts of all vector kernels: choice of the instruction set, vector widths, sets of lanes, prefetching, and
//! memory in huge pages.
//!
//! Kernels are generic over `S: Simd` and compiled once per instruction set; the best one is chosen at run time.
//! Every function called by a kernel is `#[inline(always)]`: a function that is not inlined is compiled for the
//! baseline, and so are most closures.

mod lane_mask;
mod pages;
mod prefetch;
mod width;

pub(crate) use lane_mask::{LANES, LaneMask};
pub(crate) use pages::Pages;
pub(crate) use prefetch::prefetch;
pub(crate) use width::{Eight, Sixteen, Width};

/// Runs a kernel compiled for the level's instruction set, optionally with the best packet width for it:
/// `vectorize!(level, |simd| kernel)` or `vectorize!(level, |simd, Width| kernel)`.
///
/// `None`, without running the kernel, if only scalar code is available: processors older than SSE4.2 (2008) and the
/// fallback level, where emulated vectors would be slower than scalar code.
macro_rules! vectorize {
    ($level:expr, |$simd:ident| $kernel:expr) => {
        $crate::simd::vectorize!($level, |$simd, _Width| $kernel)
    };
    ($level:expr, |$simd:ident, $width:ident| $kernel:expr) => {
        match $level {
            #[cfg(target_arch = "x86_64")]
            fearless_simd::Level::Avx512($simd) => {
                type $width = $crate::simd::Sixteen;
                Some($simd.vectorize(
                    #[inline(always)]
                    || $kernel,
                ))
            }
            #[cfg(target_arch = "x86_64")]
            fearless_simd::Level::Avx2($simd) => {
                type $width = $crate::simd::Eight;
                Some($simd.vectorize(
                    #[inline(always)]
                    || $kernel,
                ))
            }
            #[cfg(target_arch = "x86_64")]
            fearless_simd::Level::Sse4_2($simd) => {
                type $width = $crate::simd::Eight;
                Some($simd.vectorize(
                    #[inline(always)]
                    || $kernel,
                ))
            }
            #[cfg(target_arch = "aarch64")]
            fearless_simd::Level::Neon($simd) => {
                type $width = $crate::simd::Eight;
                Some($simd.vectorize(
                    #[inline(always)]
                    || $kernel,
                ))
            }
            _ => None,
        }
    };
}
pub(crate) use vectorize;
