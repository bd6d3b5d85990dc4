//! Where to split a set of AABBs: the surface area heuristic over bins of their centres.

use bytemuck::{Pod, Zeroable};
use glam::{Vec3A, Vec4};

use super::layout::{LEAF_SIZE, MOST_TRIANGLES};

/// Bins per axis. Nodes with few boxes use fewer.
pub(super) const BINS: usize = 32;

/// Added to a number below 2^22, rounds it to an integer that is held in the last mantissa bits.
const WHOLE: f32 = (1 << 23) as f32;

/// Low and high corner. The fourth component is not used.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(C)]
pub(super) struct Bounds {
    pub(super) low: Vec4,
    pub(super) high: Vec4,
}

impl Bounds {
    pub(super) const EMPTY: Self = Self {
        low: Vec4::INFINITY,
        high: Vec4::NEG_INFINITY,
    };

    #[inline(always)]
    pub(super) fn union(self, other: Self) -> Self {
        Self {
            low: self.low.min(other.low),
            high: self.high.max(other.high),
        }
    }

    /// Half the surface area of an AABB that is not empty.
    #[inline(always)]
    fn half_area(self) -> f32 {
        let d = self.high - self.low;
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}

/// Values that can be sorted into a BVH by their bounds.
pub(super) trait Boxed: Copy + Send + Sync {
    fn bounds(&self) -> Bounds;

    /// Number of triangles inside.
    fn triangles(&self) -> u32;

    /// Twice the centre.
    #[inline(always)]
    fn centre(&self) -> Vec4 {
        let Bounds { low, high } = self.bounds();
        low + high
    }
}

/// The AABB of one triangle, moved as a whole so that memory is read in order.
///
/// The fourth component of the low corner holds the triangle's index, stored as a float between 2 and 32: a denormal
/// number would slow every operation down.
#[derive(Clone, Copy, Pod, Zeroable)]
#[repr(transparent)]
pub(super) struct Item(Bounds);

impl Item {
    const TAG: u32 = 0x4000_0000;

    pub(super) fn new([a, b, c]: [Vec3A; 3], id: u32) -> Self {
        const { assert!(MOST_TRIANGLES <= 1 << 25) };
        Self(Bounds {
            low: a.min(b).min(c).extend(f32::from_bits(Self::TAG | id)),
            high: a.max(b).max(c).extend(0.0),
        })
    }

    pub(super) fn id(&self) -> u32 {
        self.0.low.w.to_bits() & !Self::TAG
    }
}

impl Boxed for Item {
    #[inline(always)]
    fn bounds(&self) -> Bounds {
        self.0
    }

    #[inline(always)]
    fn triangles(&self) -> u32 {
        1
    }
}

/// SAH cost of `count` triangles: the triangles themselves, plus the leaves that they fill or begin.
#[inline(always)]
fn work(count: u32) -> f32 {
    (count + count.next_multiple_of(LEAF_SIZE as u32)) as f32
}

/// A split plane: items whose bin on `axis` is below `bin` go left.
#[derive(Clone, Copy)]
pub(super) struct Plane {
    axis: usize,
    bin: usize,
}

/// Bin grid of a node: equal steps over its centres.
#[derive(Clone, Copy)]
pub(super) struct Grid {
    low: Vec4,
    steps: Vec4,
    bins: usize,
}

impl Grid {
    pub(super) fn new(centres: Bounds, count: usize) -> Self {
        let bins = (2 * count).min(BINS);
        Self {
            low: centres.low,
            // If all centres are equal, the step is infinite and all of them go to bin 0: 0 * inf is NaN, whose last
            // mantissa bits are 0.
            steps: Vec4::splat((bins - 1) as f32) / (centres.high - centres.low),
            bins,
        }
    }

    /// The item's bin on each axis, by rounding to the nearest bin: the outer two bins are half as wide.
    #[inline(always)]
    pub(super) fn place(&self, item: &impl Boxed) -> [usize; 3] {
        let at = (item.centre() - self.low) * self.steps + Vec4::splat(WHOLE);
        [at.x, at.y, at.z].map(|at| at.to_bits() as usize & (BINS - 1))
    }
}

/// Contents of the bins of one axis.
#[derive(Clone, Copy)]
struct Axis {
    bounds: [Bounds; BINS],
    counts: [u32; BINS],
}

/// Contents of the bins of a node.
pub(super) struct Bins([Axis; 3]);

impl Bins {
    pub(super) fn new() -> Self {
        let empty = Axis {
            bounds: [Bounds::EMPTY; BINS],
            counts: [0; BINS],
        };
        Self([empty; 3])
    }

    #[inline(always)]
    fn clear(&mut self, bins: usize) {
        for axis in &mut self.0 {
            axis.bounds[..bins].fill(Bounds::EMPTY);
            axis.counts[..bins].fill(0);
        }
    }

    #[inline(always)]
    fn add(&mut self, items: &[impl Boxed], grid: &Grid) {
        for item in items {
            let place = grid.place(item);
            for (axis, bin) in self.0.iter_mut().zip(place) {
                axis.bounds[bin] = axis.bounds[bin].union(item.bounds());
                axis.counts[bin] += item.triangles();
            }
        }
    }

    /// The split with the least SAH cost: area times work, summed over both sides. `None` if no split has boxes on
    /// both sides. A split before an empty bin costs the same as the next one, so only splits before filled bins are
    /// evaluated.
    #[inline(always)]
    fn cheapest(&self, bins: usize) -> Option<Plane> {
        let mut best = (f32::INFINITY, None);
        for (number, axis) in self.0.iter().enumerate() {
            let mut filled = 0_u32;
            for bin in 0..bins {
                filled |= u32::from(axis.counts[bin] != 0) << bin;
            }
            // Accumulated cost of the bins before each filled bin.
            let mut left = [0.0_f32; BINS];
            let (mut bounds, mut count) = (Bounds::EMPTY, 0);
            let mut todo = filled;
            while todo != 0 {
                let bin = todo.trailing_zeros() as usize & (BINS - 1);
                todo &= todo - 1;
                left[bin] = if count == 0 {
                    f32::INFINITY
                } else {
                    bounds.half_area() * work(count)
                };
                bounds = bounds.union(axis.bounds[bin]);
                count += axis.counts[bin];
            }
            (bounds, count) = (Bounds::EMPTY, 0);
            let mut todo = filled & !1;
            while todo != 0 {
                let bin = (31 - todo.leading_zeros()) as usize & (BINS - 1);
                todo &= !(1 << bin);
                bounds = bounds.union(axis.bounds[bin]);
                count += axis.counts[bin];
                let cost = left[bin] + bounds.half_area() * work(count);
                if cost < best.0 {
                    best = (cost, Some(Plane { axis: number, bin }));
                }
            }
        }
        best.1
    }
}

/// Moves the items left of the plane to the front; returns their number. Branch-free, because the side of an item
/// cannot be predicted.
#[inline(always)]
fn partition(items: &mut [impl Boxed], grid: &Grid, plane: Plane) -> usize {
    let (low, step) = (grid.low[plane.axis], grid.steps[plane.axis]);
    let mut left = 0;
    for i in 0..items.len() {
        let item = items[i];
        let at = (item.centre()[plane.axis] - low) * step + WHOLE;
        let goes_left = (at.to_bits() as usize & (BINS - 1)) < plane.bin;
        items[i] = items[left];
        items[left] = item;
        left += usize::from(goes_left);
    }
    left
}

/// Moves the boxes left of the cheapest split to the front; returns their number. `None` if no split has boxes on
/// both sides.
pub(super) fn cut(items: &mut [impl Boxed], centres: Bounds, bins: &mut Bins) -> Option<usize> {
    let grid = Grid::new(centres, items.len());
    bins.clear(grid.bins);
    bins.add(items, &grid);
    let plane = bins.cheapest(grid.bins)?;
    Some(partition(items, &grid, plane))
}

/// Bounds of the boxes, and bounds of their centres (scaled by two).
pub(super) fn bounds_of(items: &[impl Boxed]) -> (Bounds, Bounds) {
    let (mut bounds, mut centres) = (Bounds::EMPTY, Bounds::EMPTY);
    for item in items {
        let centre = item.centre();
        bounds = bounds.union(item.bounds());
        centres = centres.union(Bounds {
            low: centre,
            high: centre,
        });
    }
    (bounds, centres)
}
