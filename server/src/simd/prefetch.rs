//! Prefetch instructions. The token of the instruction set proves that the instruction exists, so this is safe code;
//! on other architectures nothing is prefetched.

use fearless_simd::{Level, Simd};

macro_rules! prefetchers {
    ($($name:ident: $token:ident),*) => {$(
        fearless_simd::kernel!(
            #[inline(always)]
            fn $name(token: $token, line: *const i8) {
                let _ = token;
                #[cfg(target_arch = "x86_64")]
                std::arch::x86_64::_mm_prefetch::<{ std::arch::x86_64::_MM_HINT_T0 }>(line);
            }
        );
    )*};
}

prefetchers!(sse4_2: Sse4_2, avx2: Avx2, avx512: Avx512);

/// Prefetches the cache line that holds the start of `value`.
#[inline(always)]
pub(crate) fn prefetch<S: Simd, T>(simd: S, value: &T) {
    let line = std::ptr::from_ref(value).cast::<i8>();
    match simd.level() {
        #[cfg(target_arch = "x86_64")]
        Level::Sse4_2(token) => sse4_2(token, line),
        #[cfg(target_arch = "x86_64")]
        Level::Avx2(token) => avx2(token, line),
        #[cfg(target_arch = "x86_64")]
        Level::Avx512(token) => avx512(token, line),
        _ => {
            let _ = line;
        }
    }
}
