//! Nodes of the min/max pyramid over the cells: sixteen tiles each, with bounds of w as 16-bit codes.

use bytemuck::{Pod, Zeroable};
use fearless_simd::prelude::*;
use fearless_simd::{Simd, f32x16, mask32x16, u32x16};

/// Sixteen tiles, 4x4, row by row. A node is one cache line, because for incoherent rays its cost is the memory
/// latency.
///
/// Each tile's bounds of w are two codes of 16 bits, the low bound in the lower half. A code is the bits of the
/// f32 minus those of [`W_FIRST`], without the last [`W_SHIFT`] bits. Eleven bits of mantissa remain; bounds are
/// rounded outward to them. The high code is rounded up to an even number, and its last bit says that the tile is
/// [full](Self::FULL). Read as part of the bound, this bit only moves the bound outward.
#[derive(Debug, Clone, Copy, Zeroable, Pod)]
#[repr(C, align(64))]
pub(crate) struct Node(pub(crate) [u32; 16]);

/// Smallest w that has a code, below that of [`DepthImage::MAX_M`](crate::frame::DepthImage).
/// The largest code stands for 2^18, above that of the nearest depth.
pub(crate) const W_FIRST: f32 = 1.0 / 16384.0;

/// Bits of an f32's mantissa that a code leaves out.
pub(crate) const W_SHIFT: u32 = 12;

/// Limit on the ratio of a full cell's bounds, in powers of two. With it, the cell's contact tolerance, at most
/// 2^-36 of its largest w, is far below the 2 u of its smallest w by which the low bound is moved.
const FULL_OCTAVES: u32 = 8;

impl Node {
    /// A tile without triangles: low and high bound are swapped, so that it is neutral in unions.
    pub(crate) const EMPTY_TILE: u32 = 0x0000_ffff;

    /// Set if every cell of a tile that is inside the image has both its triangles.
    pub(crate) const FULL: u32 = 0x0001_0000;

    /// A tile outside the image; neutral in unions.
    pub(crate) const OUTSIDE_TILE: u32 = Self::EMPTY_TILE | Self::FULL;

    /// A node outside the image.
    pub(crate) const OUTSIDE: Self = Self([Self::OUTSIDE_TILE; 16]);

    /// Encodes the tiles' bounds, which are inverses of measured depths, rounded outward.
    #[inline(always)]
    pub(crate) fn encode<S: Simd>(
        simd: S,
        low: f32x16<S>,
        high: f32x16<S>,
        full: mask32x16<S>,
    ) -> u32x16<S> {
        let splat = |x: u32| u32x16::splat(simd, x);
        let first = W_FIRST.to_bits();
        let last_bits = (1 << (W_SHIFT + 1)) - 1;
        let low = (low.bitcast::<u32x16<S>>() - first) >> W_SHIFT;
        let high = ((high.bitcast::<u32x16<S>>() - first + last_bits) >> W_SHIFT) & !1;
        let octaves = splat(FULL_OCTAVES << (f32::MANTISSA_DIGITS - 1 - W_SHIFT));
        let full = full & (high - low).simd_lt(octaves);
        low | (high << 16) | full.select(splat(Self::FULL), splat(0))
    }

    /// The tiles' low and high bounds of w.
    #[inline(always)]
    pub(crate) fn bounds<S: Simd>(tiles: u32x16<S>) -> (f32x16<S>, f32x16<S>) {
        let first = W_FIRST.to_bits();
        let low = ((tiles & 0xffff) << W_SHIFT) + first;
        let high = ((tiles >> 16) << W_SHIFT) + first;
        (low.bitcast(), high.bitcast())
    }

    /// The tile that covers all tiles of a node.
    #[inline(always)]
    pub(crate) fn union<S: Simd>(&self, simd: S) -> u32 {
        let tiles = u32x16::load_array_ref(simd, &self.0);
        let low = (tiles & 0xffff)
            .to_array()
            .into_iter()
            .fold(0xffff, u32::min);
        let high = (tiles & !Self::OUTSIDE_TILE)
            .to_array()
            .into_iter()
            .fold(0, u32::max);
        let full = self.0.into_iter().fold(Self::FULL, |all, tile| all & tile);
        low | high | full
    }
}

/// The nodes of one level.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct LevelShape {
    /// Index of its first node in the array of all levels.
    pub(crate) offset: usize,
    /// Nodes per row in memory.
    pub(crate) stride: usize,
    /// Rows of nodes.
    pub(crate) rows: usize,
    /// Nodes per row that hold cells.
    pub(crate) columns: usize,
}

/// Levels above the cells: 4^7 = 16384 cells per side, twice what an image may have.
pub(crate) const MAX_LEVELS: usize = 7;
