//! Sample directions for ambient light.

use crate::numerics::{radical_inverse, unit_float};

/// Points of a part: as many as a ray packet has lanes.
pub(crate) const PART_LEN: usize = 16;

/// Parts of the pattern; each is well distributed by itself.
pub(crate) const PARTS: usize = 16;

/// A (0, 2)-sequence of 256 points in the unit square (Sobol 1967): each run of sixteen is a stratified set, and
/// all together are a stratified set of 256.
#[derive(Debug, Clone)]
pub(crate) struct AmbientSamples {
    parts: [[[f32; 2]; PART_LEN]; PARTS],
}

/// Bayer order: neighbouring positions get parts that are far apart.
const ORDER: [u8; PARTS] = [0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5];

impl Default for AmbientSamples {
    fn default() -> Self {
        let point = |i: u32| {
            let (mut rest, mut v, mut second) = (i, 1_u32 << 31, 0);
            while rest != 0 {
                second ^= if rest & 1 == 1 { v } else { 0 };
                (rest, v) = (rest >> 1, v ^ (v >> 1));
            }
            // Offset by half a cell of the finest grid, so that no sample is on the horizon or the axis.
            let half = 0.5 / (PARTS * PART_LEN) as f32;
            [radical_inverse(i) + half, unit_float(second) + half]
        };
        let part = |p: usize| std::array::from_fn(|i| point((p * PART_LEN + i) as u32));
        Self {
            parts: std::array::from_fn(part),
        }
    }
}

impl AmbientSamples {
    /// The `k`-th part for a position in the 4 x 4 lattice, counted from that position's first part.
    pub(crate) fn part(&self, x: u32, y: u32, k: usize) -> &[[f32; 2]; PART_LEN] {
        let first = usize::from(ORDER[((y & 3) * 4 + (x & 3)) as usize]);
        &self.parts[(first + k) % PARTS]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Whether each cell of a grid of columns x rows contains equally many points.
    fn even(points: &[[f32; 2]], columns: usize, rows: usize) -> bool {
        let mut counts = vec![0; columns * rows];
        for [x, y] in points {
            counts[(x * columns as f32) as usize + (y * rows as f32) as usize * columns] += 1;
        }
        counts.iter().all(|&n| n == points.len() / counts.len())
    }

    #[test]
    fn every_part_and_the_whole_are_stratified_both_ways() {
        let pattern = AmbientSamples::default();
        for part in &pattern.parts {
            for columns in [1, 2, 4, 8, 16] {
                assert!(even(part, columns, 16 / columns), "{columns}: {part:?}");
            }
        }
        let whole = pattern.parts.as_flattened();
        for columns in [1, 2, 4, 16, 64, 256] {
            assert!(even(whole, columns, 256 / columns), "{columns}");
        }
    }

    #[test]
    fn the_places_of_a_lattice_have_every_part_once() {
        let pattern = AmbientSamples::default();
        let mut firsts: Vec<[f32; 2]> = (0..16).map(|i| pattern.part(i % 4, i / 4, 0)[0]).collect();
        firsts.sort_by(|a, b| a[0].total_cmp(&b[0]));
        firsts.dedup();
        assert_eq!(firsts.len(), PARTS);
    }
}
