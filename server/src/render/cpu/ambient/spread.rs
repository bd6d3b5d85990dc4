//! Interpolates the records of cells at pixels.

use glam::Vec3A;

use crate::render::cpu::tile::Tile;
use crate::render::prepare::sensed::NormalMemo;
use crate::render::prepare::tile_plan::{TILE, TILE_PIXELS, TileGrid};
use crate::simd::LANES;

use super::around::{SPAN, around, taps};
use super::cell::{Cell, FAINT, Mean, noise_at};
use super::change::{AmbientChange, AmbientTile, Kept, NODE_STEP, NODES, Node, Own, mix, share_of};
use super::gather::{GatherScratch, gather};
use super::input::{AmbientInput, Place, TILE_CELLS};

/// Least sum of weights of records for their mean to be used.
const LEAST_WEIGHT: f32 = 0.1;

/// Weights of the filter over pixels that were gathered individually, every second one of every second row: four
/// pixels to each side, the outer ones with half weight, cover one whole 4 x 4 pattern. Less leaves dots.
const FILTER_WEIGHTS: [f32; 9] = [0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5];

/// Pixels to each side.
const FILTER_REACH: u32 = FILTER_WEIGHTS.len() as u32 / 2;

/// Finds the changes at the pixels of a tile, from the records of all cells or from rays of its own.
pub(crate) fn spread_tile(
    input: AmbientInput<'_>,
    cells: &[[Cell; TILE_CELLS]],
    tile: &Tile,
    out: &mut AmbientTile,
    scratch: &mut GatherScratch,
) {
    out.kept = Kept::Nowhere;
    if !tile.has_ambient || !input.frame.go_on() {
        return;
    }
    let Some(around) = Around::new(input.grid, cells, tile) else {
        return;
    };
    if spread_nodes(input, &around, tile, &mut out.nodes) {
        let seen = |node: &Node| share_of(node.share) != Vec3A::ONE;
        if out.nodes.iter().any(seen) {
            out.kept = Kept::AtNodes;
        }
        return;
    }
    out.kept = Kept::AtPixels;
    out.raw.clear();
    out.raw.resize(TILE_PIXELS, AmbientChange::default());
    scratch.places.clear();
    for (bx, by) in tile.blocks() {
        if spread_block(input, &around, tile, bx, by, &mut out.raw) {
            continue;
        }
        let mut memo = NormalMemo::default();
        for (dx, dy) in (0..16).map(|i| (bx + i % 4, by + i / 4)) {
            let (x, y) = (tile.x0 + dx, tile.y0 + dy);
            let Some(point) = point_at(input, tile, dx, dy) else {
                continue;
            };
            match around.at(dx, dy, point) {
                Some(change) => out.raw[Tile::index(dx, dy)] = change,
                None => {
                    let normal = input.frame.sensed.block_normal(x, y, &mut memo);
                    out.raw[Tile::index(dx, dy)] = AmbientChange {
                        normal,
                        own: Own::Missing,
                        ..AmbientChange::default()
                    };
                    // Every second pixel of every second row is gathered: the filter is wider than that.
                    if x.is_multiple_of(2) && y.is_multiple_of(2) {
                        scratch.places.push(Place {
                            point,
                            normal,
                            x,
                            y,
                            lattice: (x / 2, y / 2),
                        });
                    }
                    out.kept = Kept::Filtered;
                }
            }
        }
    }
    // The filter averages at least four of them.
    let samples = (input.frame.settings.ambient.samples as usize / 4).clamp(4, LANES);
    gather(input, samples, scratch);
    for (place, gathered) in scratch.places.iter().zip(&scratch.gathered) {
        out.raw[Tile::index(place.x - tile.x0, place.y - tile.y0)] = AmbientChange {
            delta: gathered.delta,
            real: gathered.real,
            normal: place.normal,
            own: Own::Gathered,
        };
    }
}

/// Finds the changes at the nodes of a tile that is part of one surface; false if it is not, or if a node has no
/// valid record.
fn spread_nodes(
    input: AmbientInput<'_>,
    around: &Around<'_>,
    tile: &Tile,
    nodes: &mut [Node; NODES * NODES],
) -> bool {
    let faint = around.strengths.iter().all(|&strength| strength <= FAINT);
    if !faint && (tile.width < TILE || tile.height < TILE || !is_one_surface(input, tile)) {
        return false;
    }
    for (i, node) in nodes.iter_mut().enumerate() {
        let (dx, dy) = (
            (i % NODES) as u32 * NODE_STEP,
            (i / NODES) as u32 * NODE_STEP,
        );
        let change = if faint {
            around.anywhere_at(dx, dy)
        } else {
            point_at(input, tile, dx, dy).and_then(|point| around.at(dx, dy, point))
        };
        match change {
            Some(change) => *node = Node::new(change),
            None => return false,
        }
    }
    true
}

/// Whether a whole tile has no hole and no depth edge between neighbouring pixels.
fn is_one_surface(input: AmbientInput<'_>, tile: &Tile) -> bool {
    let width = input.frame.sensed.color.width as usize;
    let row = |dy: u32| {
        let first = (tile.y0 + dy) as usize * width + tile.x0 as usize;
        &input.frame.sensed.depth[first..first + TILE as usize]
    };
    // False beside a hole, which is NaN.
    let edge = input.frame.settings.ghost.edge_relative;
    let small = |a: f32, b: f32| (a - b).abs() <= edge * a.min(b);
    (0..TILE).all(|dy| {
        let here = row(dy);
        let across = here.iter().zip(&here[1..]).all(|(&a, &b)| small(a, b));
        let below = row((dy + 1).min(TILE - 1));
        across && here.iter().zip(below).all(|(&a, &b)| small(a, b))
    })
}

/// The ghost surface at a pixel of a tile; `None` in a hole and outside the picture.
fn point_at(input: AmbientInput<'_>, tile: &Tile, dx: u32, dy: u32) -> Option<Vec3A> {
    if dx >= tile.width || dy >= tile.height {
        return None;
    }
    let (x, y) = (tile.x0 + dx, tile.y0 + dy);
    let point = input.frame.sensed.point_at(x, y);
    (!point.z.is_nan()).then_some(point)
}

/// Heuristic: a pixel is on another surface if it is farther from the plane of the filtered pixel than this share
/// of their distance, or if the cosine between their normals is smaller than `SAME_NORMAL`.
const SAME_SLOPE: f32 = 0.25;
const SAME_NORMAL: f32 = 0.7;

/// Fills a 4x4 block that is part of one surface from the records at its corners; false if it is not, or if a
/// corner has no valid record.
fn spread_block(
    input: AmbientInput<'_>,
    around: &Around<'_>,
    tile: &Tile,
    bx: u32,
    by: u32,
    out: &mut [AmbientChange],
) -> bool {
    if bx + 4 > tile.width || by + 4 > tile.height {
        return false;
    }
    let (mut near, mut far) = (f32::INFINITY, 0.0_f32);
    for (dx, dy) in (0..16).map(|i| (bx + i % 4, by + i / 4)) {
        let z = input.frame.sensed.depth_at(tile.x0 + dx, tile.y0 + dy);
        if z.is_nan() {
            return false;
        }
        (near, far) = (near.min(z), far.max(z));
    }
    // The same test as for shadows of a block: over three steps, depth may differ no more than between three
    // neighbours.
    if far - near > 3.0 * input.frame.settings.ghost.edge_relative * near {
        return false;
    }
    let corner = |dx, dy| around.at(dx, dy, point_at(input, tile, dx, dy)?);
    let (Some(a), Some(b)) = (corner(bx, by), corner(bx + 3, by)) else {
        return false;
    };
    let (Some(c), Some(d)) = (corner(bx, by + 3), corner(bx + 3, by + 3)) else {
        return false;
    };
    for i in 0..16 {
        let (s, t) = ((i % 4) as f32 / 3.0, (i / 4) as f32 / 3.0);
        out[Tile::index(bx + i % 4, by + i / 4)] = mix([&a, &b, &c, &d], s, t);
    }
    true
}

struct Around<'c> {
    all: [&'c Cell; SPAN * SPAN],
    strengths: [f32; SPAN * SPAN],
}

impl<'c> Around<'c> {
    /// `None` if nothing changes.
    fn new(grid: &TileGrid, cells: &'c [[Cell; TILE_CELLS]], tile: &Tile) -> Option<Self> {
        let all = around(grid, cells, tile, &Cell::NONE);
        let changes = all.iter().any(|cell| cell.delta != Vec3A::ZERO);
        changes.then(|| Self {
            strengths: std::array::from_fn(|i| all[i].strength()),
            all,
        })
    }

    /// The mean of the records around a pixel of the tile, weighted by their validity there; `None` if the
    /// weights sum to less than `least`.
    fn mean(
        &self,
        dx: u32,
        dy: u32,
        least: f32,
        holds: impl Fn(&Cell) -> f32,
    ) -> Option<AmbientChange> {
        let (mut mean, mut normal) = (Mean::default(), Vec3A::ZERO);
        for (i, tent) in taps(dx, dy) {
            let cell = self.all[i];
            if !cell.is_none() {
                let weight = tent * holds(cell);
                mean.add(cell.delta, cell.real, weight);
                normal += cell.normal * weight;
            }
        }
        (mean.weight >= least).then(|| {
            let (delta, real) = mean.delta_and_real();
            AmbientChange {
                delta,
                real,
                normal: normal.normalize_or(-Vec3A::Z),
                own: Own::No,
            }
        })
    }

    /// The change from the records around a pixel of the tile, whichever surfaces they are on.
    fn anywhere_at(&self, dx: u32, dy: u32) -> Option<AmbientChange> {
        self.mean(dx, dy, f32::MIN_POSITIVE, |_| 1.0)
    }

    /// The change from the records around a pixel of the tile; `None` if the pixel must be gathered individually.
    fn at(&self, dx: u32, dy: u32, point: Vec3A) -> Option<AmbientChange> {
        let noise = noise_at(point);
        let holding = self.mean(dx, dy, LEAST_WEIGHT, |cell| cell.holds_at(point, noise));
        if holding.is_some() {
            return holding;
        }
        let there = || taps(dx, dy).filter(|&(i, _)| !self.all[i].is_none());
        if there().any(|(i, _)| self.strengths[i] > FAINT) {
            return None;
        }
        let distance = |cell: &&Cell| (cell.point - point).length_squared();
        let cells = there().map(|(i, _)| self.all[i]);
        let nearest = cells.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        Some(AmbientChange {
            delta: nearest.delta,
            real: nearest.real,
            normal: nearest.normal,
            own: Own::No,
        })
    }
}

/// Filters the pixels of a tile that were gathered individually; copies the others.
pub(crate) fn filter_tile(
    input: AmbientInput<'_>,
    raw: &[AmbientTile],
    tile: &Tile,
    slot: usize,
    out: &mut Vec<AmbientChange>,
) {
    if raw[slot].kept != Kept::Filtered || !input.frame.go_on() {
        return;
    }
    out.clone_from(&raw[slot].raw);
    let (right, bottom) = input.frame.sensed.last();
    for (place, own) in out
        .iter_mut()
        .enumerate()
        .filter(|(_, change)| change.own != Own::No)
    {
        let (x, y) = (tile.x0 + place as u32 % TILE, tile.y0 + place as u32 / TILE);
        let here = input.frame.sensed.direction_at(x, y) * input.frame.sensed.depth_at(x, y);
        let noise = noise_at(here);
        // The first sum is over the pixel's own surface, the second over all neighbours.
        let mut sums = [Mean::default(); 2];
        for (j, wy) in (0..).zip(FILTER_WEIGHTS) {
            for (i, wx) in (0..).zip(FILTER_WEIGHTS) {
                let before = |at: u32| at.checked_sub(FILTER_REACH);
                let (Some(nx), Some(ny)) = (before(x + i), before(y + j)) else {
                    continue;
                };
                if nx > right || ny > bottom {
                    continue;
                }
                let there = input.grid.locate(nx, ny);
                let Some(there) = there.and_then(|(slot, place)| raw[slot].raw_at(place)) else {
                    continue;
                };
                if there.own == Own::Missing || there.normal == Vec3A::ZERO {
                    continue;
                }
                let z = input.frame.sensed.depth_at(nx, ny);
                let away = input.frame.sensed.direction_at(nx, ny) * z - here;
                let across = away.dot(own.normal).abs() - noise;
                // False in a hole.
                let on_it = across <= SAME_SLOPE * away.length()
                    && there.normal.dot(own.normal) >= SAME_NORMAL;
                for sum in &mut sums[usize::from(!on_it)..] {
                    sum.add(there.delta, there.real, wx * wy);
                }
            }
        }
        // A single pixel that was not gathered takes the mean of all its neighbours; without it, it would be a
        // visible speck.
        let lone = usize::from(own.own == Own::Missing && sums[0].weight == 0.0);
        if sums[lone].weight > 0.0 {
            (own.delta, own.real) = sums[lone].delta_and_real();
        }
    }
}
