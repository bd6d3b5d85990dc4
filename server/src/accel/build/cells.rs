//! The first levels of a large BVH. They are built over the cells of a grid, some hundred triangles each, so that the
//! triangles are moved once and not at every level.

use glam::Vec4;
use rayon::prelude::*;

use super::bins::{BINS, Bins, Bounds, Boxed, Grid, Item, bounds_of, cut};
use super::chunks::SortedChunks;
use super::sah::{Builder, Place, Subtree, TASK};

/// Least number of triangles for which the grid pays off.
pub(super) const WORTHWHILE: usize = 1 << 15;

/// Least number of filled cells; with fewer, the cells are too coarse to choose splits.
const FEWEST: usize = 64;

/// Triangles sorted by the grid cell that contains their centre.
pub(super) struct Cells(SortedChunks<Item>);

/// The triangles of one cell.
#[derive(Clone, Copy)]
pub(super) struct Cluster {
    bounds: Bounds,
    cell: u32,
    triangles: u32,
}

impl Boxed for Cluster {
    #[inline(always)]
    fn bounds(&self) -> Bounds {
        self.bounds
    }

    #[inline(always)]
    fn triangles(&self) -> u32 {
        self.triangles
    }
}

impl Cells {
    /// Sorts triangles into cells; `centres` are the bounds of their centres, scaled by two.
    pub(super) fn new(items: &[Item], centres: Bounds) -> Self {
        // The cells are cubes, as many as fit.
        let sides = centres.high - centres.low;
        let longest = sides.x.max(sides.y).max(sides.z);
        let cubes = Bounds {
            high: centres.low + Vec4::splat(longest),
            ..centres
        };
        let grid = Grid::new(cubes, items.len());
        let cell = |i: usize| {
            let [x, y, z] = grid.place(&items[i]);
            ((z * BINS + y) * BINS + x) as u32
        };
        let cells = BINS.pow(3);
        Self(SortedChunks::new(items.len(), cells, cell, |i| items[i]))
    }

    /// The filled cells; `None` if there are only a few.
    pub(super) fn clusters(&self) -> Option<Vec<Cluster>> {
        let cluster = |cell: usize| {
            let mut cluster = Cluster {
                bounds: Bounds::EMPTY,
                cell: cell as u32,
                triangles: 0,
            };
            for items in self.0.of(cell) {
                cluster.bounds = cluster.bounds.union(bounds_of(items).0);
                cluster.triangles += items.len() as u32;
            }
            (cluster.triangles > 0).then_some(cluster)
        };
        let cells = (0..self.0.keys()).into_par_iter().with_min_len(BINS);
        let clusters: Vec<Cluster> = cells.filter_map(cluster).collect();
        (clusters.len() >= FEWEST).then_some(clusters)
    }
}

impl Builder {
    /// Builds a subtree over clusters; writes the triangle indices in leaf order.
    pub(super) fn over_cells(
        self,
        cells: &Cells,
        clusters: &mut [Cluster],
        order: &mut [u32],
        place: Place,
    ) -> Subtree {
        if order.len() > TASK && place.depth < self.deepest {
            let (bounds, centres) = bounds_of(clusters);
            if let Some(left) = cut(clusters, centres, &mut Bins::new()) {
                let (a, b) = clusters.split_at_mut(left);
                let triangles = a.iter().map(|cluster| cluster.triangles as usize).sum();
                let (order_a, order_b) = order.split_at_mut(triangles);
                let (place_a, place_b) = place.children(triangles);
                let children = rayon::join(
                    || self.over_cells(cells, a, order_a, place_a),
                    || self.over_cells(cells, b, order_b, place_b),
                );
                return Subtree::over(bounds, children);
            }
        }
        let mut items = Vec::with_capacity(order.len());
        for cluster in clusters {
            for part in cells.0.of(cluster.cell as usize) {
                items.extend_from_slice(part);
            }
        }
        self.subtree(&mut items, order, place)
    }
}
