//! Builds a ghost surface from a depth map: connectivity, inverse depth, pyramid.

use fearless_simd::{Select, Simd, SimdBase, SimdMask, dispatch, f32x16, u32x16};

use super::connection::Connection;
use super::node::Node;
use super::settings::GhostSettings;
use super::surface::{GhostSurface, LANES};
use super::traverse::segment::Frustum;
use crate::camera::Intrinsics;
use crate::frame::{DepthImage, is_valid_depth};
use crate::numerics::UNIT_ROUNDOFF;

impl GhostSurface {
    /// Rebuilds the surface from a depth map. `intrinsics` are those of the depth image and must have its size.
    ///
    /// # Panics
    /// If depth and intrinsics differ in size.
    pub fn rebuild(
        &mut self,
        depth: &DepthImage,
        intrinsics: &Intrinsics,
        settings: &GhostSettings,
    ) {
        assert_eq!(
            (depth.width, depth.height),
            (intrinsics.width, intrinsics.height),
            "ghost surface: size of depth against intrinsics"
        );
        self.intrinsics = *intrinsics;
        self.frustum = Frustum::new(intrinsics);
        self.connection = Connection::new(settings);
        self.resize(depth.width as usize, depth.height as usize);
        dispatch!(self.level, simd => self.fill(simd, depth));
    }

    /// Fills the buffers from a depth map of the size given to [`Self::resize`].
    #[inline(always)]
    pub(crate) fn fill<S: Simd>(&mut self, simd: S, depth: &DepthImage) {
        let width = depth.width as usize;
        if width == 0 {
            return;
        }
        for (y, row) in depth.z_m.chunks_exact(width).enumerate() {
            self.load_row(simd, y, row);
            if y > 0 && self.cells_x > 0 {
                self.fill_cells(simd, y - 1);
            }
        }
        if let Some(&first) = self.levels.first() {
            // Rows of cells below the last row of the image.
            for y in self.cells_y..first.rows * 4 {
                let nodes = &mut self.nodes[(y / 4) * first.stride..][..first.stride];
                let lanes = (y % 4) * 4..(y % 4) * 4 + 4;
                for node in nodes {
                    node.0[lanes.clone()].fill(Node::OUTSIDE_TILE);
                }
            }
        }
        self.fill_levels(simd);
    }

    /// Copies a row of depths and computes their inverses.
    #[inline(always)]
    fn load_row<S: Simd>(&mut self, simd: S, y: usize, row: &[f32]) {
        let z = &mut self.z[y * self.stride..][..self.stride];
        let w = &mut self.w[y * self.stride..][..self.stride];
        for (z, &from) in z.iter_mut().zip(row) {
            // The field of the depth image is public, so the invariant is established here, where it is cheap.
            *z = if is_valid_depth(from) {
                from
            } else {
                DepthImage::INVALID
            };
        }
        z[row.len()..].fill(DepthImage::INVALID);
        let one = f32x16::splat(simd, 1.0);
        for (z, w) in z.chunks_exact(LANES).zip(w.chunks_exact_mut(LANES)) {
            (one / f32x16::from_slice(simd, z)).store_slice(w);
        }
    }

    /// Finds the triangles of one row of cells and their intervals of w.
    #[inline(always)]
    fn fill_cells<S: Simd>(&mut self, simd: S, y: usize) {
        let stride = self.stride;
        let (z_above, z_below) = self.z[y * stride..][..2 * stride].split_at(stride);
        let (w_above, w_below) = self.w[y * stride..][..2 * stride].split_at(stride);
        let exists = &mut self.exists[y * self.blocks..][..self.blocks];
        let node_stride = self.levels[0].stride;
        let nodes = &mut self.nodes[(y / 4) * node_stride..][..node_stride];
        let lane = (y % 4) * 4;
        let connection = self.connection;
        let infinite = f32x16::splat(simd, f32::INFINITY);
        let column = u32x16::from_fn(simd, |lane| lane as u32);
        let cells_x = self.cells_x;
        for (block, (exists, nodes)) in exists.iter_mut().zip(nodes.chunks_exact_mut(4)).enumerate()
        {
            let x = block * LANES;
            let load = |row: &[f32], x: usize| f32x16::from_slice(simd, &row[x..x + LANES]);
            let (a, b) = (load(z_above, x), load(z_above, x + 1));
            let (c, d) = (load(z_below, x), load(z_below, x + 1));
            let diagonal = connection.joins_simd(a, d);
            let upper = diagonal & connection.joins_simd(a, b) & connection.joins_simd(b, d);
            let lower = diagonal & connection.joins_simd(a, c) & connection.joins_simd(c, d);
            *exists = [upper.to_bitmask() as u16, lower.to_bitmask() as u16];
            let (a, b) = (load(w_above, x), load(w_above, x + 1));
            let (c, d) = (load(w_below, x), load(w_below, x + 1));
            let (ad_low, ad_high) = (a.min(d), a.max(d));
            let low = upper
                .select(ad_low.min(b), infinite)
                .min(lower.select(ad_low.min(c), infinite));
            let high = upper
                .select(ad_high.max(b), -infinite)
                .max(lower.select(ad_high.max(c), -infinite));
            // Each w has one rounding; scaling adds another.
            let tiles = Node::encode(
                simd,
                low * (1.0 - 4.0 * UNIT_ROUNDOFF),
                high * (1.0 + 4.0 * UNIT_ROUNDOFF),
                upper & lower,
            );
            let left = u32x16::splat(simd, (cells_x - x) as u32);
            let empty = column.simd_lt(left).select(
                u32x16::splat(simd, Node::EMPTY_TILE),
                u32x16::splat(simd, Node::OUTSIDE_TILE),
            );
            let tiles = (upper | lower).select(tiles, empty).to_array();
            for (k, node) in nodes.iter_mut().enumerate() {
                node.0[lane..lane + 4].copy_from_slice(&tiles[k * 4..k * 4 + 4]);
            }
        }
    }

    /// Computes every level from the level below it.
    #[inline(always)]
    fn fill_levels<S: Simd>(&mut self, simd: S) {
        for pair in self.levels.windows(2) {
            let (from, to) = (pair[0], pair[1]);
            let (below, above) = self.nodes.split_at_mut(to.offset);
            for y in 0..to.rows {
                for x in 0..to.columns {
                    let mut node = Node::OUTSIDE;
                    for child in 0..16 {
                        let (i, j) = (x * 4 + child % 4, y * 4 + child / 4);
                        if i < from.columns && j < from.rows {
                            node.0[child] = below[from.offset + j * from.stride + i].union(simd);
                        }
                    }
                    above[y * to.stride + x] = node;
                }
            }
        }
    }
}
