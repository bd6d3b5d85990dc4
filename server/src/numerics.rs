//! Rounding bounds, sRGB conversion and deterministic random numbers.
//!
//! Three kinds of tolerance exist in this project and are never mixed:
//! *rounding* (derived from [`gamma`]), *sensor* ([`crate::frame::depth_sigma_m`])
//! and *heuristic* (a documented field of [`crate::render::RenderSettings`]).

use std::sync::LazyLock;

use glam::Vec3A;

/// Half a unit in the last place of 1.0: the relative error of one f32 operation.
pub const UNIT_ROUNDOFF: f32 = f32::EPSILON * 0.5;

/// Bound on the relative error after `n` f32 roundings, `n u / (1 - n u)`
/// (Higham 2002, section 3.1).
pub const fn gamma(n: u32) -> f32 {
    let nu = n as f32 * UNIT_ROUNDOFF;
    nu / (1.0 - nu)
}

/// Luminance of linear Rec. 709 light.
pub fn luminance(c: Vec3A) -> f32 {
    c.dot(Vec3A::new(0.2126, 0.7152, 0.0722))
}

/// The least value of a sorted list that a share of its values, 0..=1, do not exceed (nearest rank); `None` for an
/// empty list.
pub fn percentile<T: Copy>(sorted: &[T], share: f64) -> Option<T> {
    let rank = (share * sorted.len() as f64).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

/// Linear light in 0..=1 of each 8-bit sRGB code (IEC 61966-2-1).
static LINEAR_FROM_SRGB: LazyLock<[f32; 256]> = LazyLock::new(|| {
    std::array::from_fn(|code| {
        let c = code as f64 / 255.0;
        let linear = if c <= 0.04045 {
            c / 12.92
        } else {
            ((c + 0.055) / 1.055).powf(2.4)
        };
        linear as f32
    })
});

/// Size of the linear-to-code table: so large that a step spans less than one code everywhere (the steepest slope of
/// the transfer function is 12.92 x 255 codes per unit of linear light, so with 4096 steps it is at most 0.81 codes).
const SRGB_STEPS: usize = 4096;

/// For each step of linear light, the code to which its lower edge is rounded.
static SRGB_FROM_STEP: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let table = &*CODE_EDGES;
    (0..=SRGB_STEPS)
        .map(|step| {
            let linear = step as f32 / SRGB_STEPS as f32;
            table.partition_point(|&edge| edge <= linear) as u8
        })
        .collect()
});

/// `CODE_EDGES[c]` is the linear value at which code `c + 1` begins.
static CODE_EDGES: LazyLock<[f32; 255]> = LazyLock::new(|| {
    std::array::from_fn(|code| {
        let c = (code as f64 + 0.5) / 255.0;
        let linear = if c <= 0.04045 {
            c / 12.92
        } else {
            ((c + 0.055) / 1.055).powf(2.4)
        };
        linear as f32
    })
});

/// Linear light (0..=1) of an 8-bit sRGB code.
#[inline]
pub fn linear_from_srgb(code: u8) -> f32 {
    LINEAR_FROM_SRGB[usize::from(code)]
}

/// Linear light of an sRGB-coded value in 0..=1; other values are clamped.
pub fn linear_from_srgb_part(coded: f32) -> f32 {
    let c = f64::from(coded.clamp(0.0, 1.0));
    let linear = if c <= 0.04045 {
        c / 12.92
    } else {
        ((c + 0.055) / 1.055).powf(2.4)
    };
    linear as f32
}

/// The 8-bit sRGB code nearest to linear light; below 0 and NaN give 0, above 1 gives 255.
#[inline]
pub fn srgb_from_linear(linear: f32) -> u8 {
    if linear.is_nan() || linear <= 0.0 {
        return 0;
    }
    if linear >= 1.0 {
        return 255;
    }
    let code = SRGB_FROM_STEP[(linear * SRGB_STEPS as f32) as usize];
    // A step spans less than one code, so at most one edge lies inside it.
    match CODE_EDGES.get(usize::from(code)) {
        Some(&edge) if edge <= linear => code + 1,
        _ => code,
    }
}

/// A hash of (pixel, frame, dimension): the only source of randomness in rendering, so samples do not depend on the
/// number of threads or the backend. PCG's output permutation over three rounds (Jarzynski and Olano 2020, `pcg3d`).
#[inline]
pub fn hash(pixel: u32, frame: u32, dimension: u32) -> u32 {
    let mut x = pixel.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    let mut y = frame.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
    let mut z = dimension
        .wrapping_mul(1_664_525)
        .wrapping_add(1_013_904_223);
    x = x.wrapping_add(y.wrapping_mul(z));
    y = y.wrapping_add(z.wrapping_mul(x));
    z = z.wrapping_add(x.wrapping_mul(y));
    x ^= x >> 16;
    y ^= y >> 16;
    z ^= z >> 16;
    x = x.wrapping_add(y.wrapping_mul(z));
    y = y.wrapping_add(z.wrapping_mul(x));
    z.wrapping_add(x.wrapping_mul(y))
}

/// [`hash`] as a float in [0, 1).
#[inline]
pub fn uniform(pixel: u32, frame: u32, dimension: u32) -> f32 {
    unit_float(hash(pixel, frame, dimension))
}

/// The upper 24 bits as a float in [0, 1).
#[inline]
pub fn unit_float(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// The random numbers of one path: a hash of (pixel, frame, sample), of all bounces and choices of rays before it,
/// and of the requested dimension. It does not depend on tiles, threads or positions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RandomKey(u32);

impl RandomKey {
    /// The key of sample `sample` of a pixel, given by its index in the picture. Pictures that are not averaged over
    /// time use the same `frame` for all, so that the noise does not change while the camera is at rest.
    #[inline]
    pub fn new(pixel: u32, frame: u32, sample: u32) -> Self {
        Self(hash(pixel, frame, sample))
    }

    /// The key of the path that continues as ray `ray` of bounce `bounce`.
    #[inline]
    pub fn child(self, bounce: u32, ray: u32) -> Self {
        Self(hash(self.0, bounce, ray))
    }

    /// A number in [0, 1) for one dimension of a bounce.
    #[inline]
    pub fn uniform(self, bounce: u32, dimension: u32) -> f32 {
        // Rays of `child` are numbered upwards from 0, dimensions downwards from the largest value.
        uniform(self.0, bounce, !dimension)
    }
}

/// Van der Corput sequence: the bits of `i` mirrored at the binary point.
#[inline]
pub fn radical_inverse(i: u32) -> f32 {
    unit_float(i.reverse_bits())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_codes_survive_the_round_trip() {
        for code in 0..=255u8 {
            assert_eq!(srgb_from_linear(linear_from_srgb(code)), code);
        }
    }

    #[test]
    fn srgb_encoding_is_the_nearest_code() {
        for i in 0..=1_000_000u32 {
            let linear = i as f32 / 1_000_000.0;
            let exact = f64::from(linear);
            let s = if exact <= 0.003_130_8 {
                exact * 12.92
            } else {
                1.055 * exact.powf(1.0 / 2.4) - 0.055
            };
            let code = f64::from(srgb_from_linear(linear));
            // Half a code, plus the rounding of the f32 table edge.
            assert!(
                (code - s * 255.0).abs() <= 0.5 + 1e-4,
                "{linear}: {code} against {}",
                s * 255.0
            );
        }
        assert_eq!(srgb_from_linear(f32::NAN), 0);
        assert_eq!(srgb_from_linear(f32::INFINITY), 255);
        assert_eq!(srgb_from_linear(-1.0), 0);
    }

    #[test]
    fn uniform_fills_its_interval_evenly() {
        let mut bins = [0u32; 16];
        for pixel in 0..65_536 {
            let x = uniform(pixel, 7, 3);
            assert!((0.0..1.0).contains(&x));
            bins[(x * 16.0) as usize] += 1;
        }
        // 4096 expected, standard deviation 62: the limit is six standard deviations.
        assert!(bins.iter().all(|&n| n.abs_diff(4096) < 372), "{bins:?}");
    }

    #[test]
    fn paths_of_a_pixel_draw_unrelated_numbers() {
        let pairs = |other: fn(RandomKey) -> RandomKey| {
            let products = (0..65_536).map(|pixel| {
                let key = RandomKey::new(pixel, 0, 0);
                let [a, b] = [key.uniform(0, 0), other(key).uniform(0, 0)];
                f64::from(a - 0.5) * f64::from(b - 0.5)
            });
            12.0 * products.sum::<f64>() / 65_536.0
        };
        // The standard deviation of the correlation is 1 / 256: the limit is six standard deviations.
        for correlation in [
            pairs(|key| key.child(0, 1)),
            pairs(|key| key.child(0, 1).child(1, 1)),
            pairs(|key| RandomKey::new(key.0, 1, 0)),
            pairs(|key| RandomKey::new(key.0, 0, 1)),
        ] {
            assert!(correlation.abs() < 6.0 / 256.0, "{correlation}");
        }
        let key = RandomKey::new(5, 0, 3);
        assert_ne!(key.uniform(0, 0), key.uniform(0, 1));
        assert_ne!(key.uniform(0, 0), key.uniform(1, 0));
        assert_eq!(key.child(0, 1), key.child(0, 1));
        assert_ne!(key.child(0, 1), key.child(0, 2));
    }
}
