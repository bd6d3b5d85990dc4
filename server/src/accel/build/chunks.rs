//! Values sorted by a small key, in chunks that are sorted in parallel.

use bytemuck::Pod;
use rayon::prelude::*;

/// Values per chunk: enough to outweigh the chunk's table of keys, few enough for the cache.
const CHUNK: usize = 1 << 16;

/// Values sorted by key within each chunk; the sort is stable.
pub(super) struct SortedChunks<T> {
    keys: usize,
    /// Per chunk: its values, and the end of each key's range.
    chunks: Vec<(Vec<T>, Vec<u32>)>,
}

impl<T: Pod + Send + Sync> SortedChunks<T> {
    /// Sorts the values for 0 to `count - 1` by keys below `keys`.
    pub(super) fn new(
        count: usize,
        keys: usize,
        key: impl Fn(usize) -> u32 + Sync,
        value: impl Fn(usize) -> T + Sync,
    ) -> Self {
        let chunk = |n: usize| {
            let numbers = n * CHUNK..count.min((n + 1) * CHUNK);
            let keys_of: Vec<u32> = numbers.clone().map(&key).collect();
            let mut ends = vec![0_u32; keys];
            for &key in &keys_of {
                ends[key as usize] += 1;
            }
            let mut sum = 0;
            for end in &mut ends {
                sum += std::mem::replace(end, sum);
            }
            let mut values = bytemuck::zeroed_vec(numbers.len());
            for (key, i) in keys_of.into_iter().zip(numbers) {
                // Start of the key's values; it becomes their end while they are placed.
                let end = &mut ends[key as usize];
                values[*end as usize] = value(i);
                *end += 1;
            }
            (values, ends)
        };
        let chunks = (0..count.div_ceil(CHUNK)).into_par_iter().map(chunk);
        Self {
            keys,
            chunks: chunks.collect(),
        }
    }

    /// Number of keys, used or not.
    pub(super) fn keys(&self) -> usize {
        self.keys
    }

    /// The values of one key, chunk by chunk.
    pub(super) fn of(&self, key: usize) -> impl Iterator<Item = &[T]> {
        self.chunks.iter().map(move |(values, ends)| {
            let start = if key == 0 { 0 } else { ends[key - 1] };
            &values[start as usize..ends[key] as usize]
        })
    }
}
