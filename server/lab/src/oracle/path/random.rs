//! Random numbers of the path tracer: one stream per pixel and sample, so that pictures of two worlds have the same
//! noise where the worlds are equal.

/// SplitMix64 (Steele, Lea, Flood 2014).
#[derive(Debug, Clone)]
pub(super) struct Random(u64);

const GOLDEN: u64 = 0x9e37_79b9_7f4a_7c15;

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Random {
    /// The stream for a seed, a place and a sample.
    pub(super) fn new(seed: u64, place: u64, sample: u64) -> Self {
        let step = |state: u64, word: u64| mix(state.wrapping_add(GOLDEN) ^ mix(word));
        Self(step(step(step(0, seed), place), sample))
    }

    /// A number in [0, 1), 53 bits.
    pub(super) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(GOLDEN);
        (mix(self.0) >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }
}
