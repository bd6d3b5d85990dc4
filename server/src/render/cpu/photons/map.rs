//! Stored photons, in layouts for fast look-up.
//!
//! There are two kinds of surfaces with a layout each; both are flat arrays filled by a counting sort whose order
//! depends only on the photons' numbers. Photons on the *ghost surface* are only read for pixels, so they are
//! sorted by the tiles of the picture that their kernel reaches: no search is needed (Lavignotte and Paulin 2003
//! splat photons in a similar way). Photons on *virtual surfaces* are read for arbitrary rays, so they are stored
//! in the hashed cells of a grid as wide as the kernel.
//!
//! Density is estimated with a fixed Epanechnikov kernel (Kan and Kaufmann 2012, section 3.2). Their kd-tree
//! takes 196 ms for 280,000 photons; sorting is one pass over each chunk.

use std::f32::consts::PI;

use glam::{IVec3, Vec3A};

use crate::render::checkpoint::Pulse;
use crate::render::prepare::pinhole::Pinhole;
use crate::render::prepare::tile_plan::TILE;

/// Most entries in a chunk's lists of photons by tile: 256 chunks take 256 MiB. A chunk whose kernels are so wide
/// that they need more entries is not sorted; each tile then reads all its photons.
pub(crate) const MAX_ENTRIES: usize = 1 << 18;

/// Photons sorted between two checkpoints.
const SORTED_AT_ONCE: usize = 1 << 12;

/// Least radius of the kernel in the picture, pixels, so that every photon reaches a pixel.
const LEAST_RADIUS_PX: f32 = 1.0;

/// A photon on a real surface.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GhostPhoton {
    /// Camera space, metres.
    pub(crate) position: Vec3A,
    /// Unit direction of travel.
    pub(crate) direction: Vec3A,
    /// Watts; negative if virtual objects remove it.
    pub(crate) flux: Vec3A,
    /// Radius of its kernel, metres.
    pub(crate) radius: f32,
}

/// A photon on a mesh.
#[derive(Debug, Clone, Copy)]
pub(crate) struct MeshPhoton {
    /// Camera space, metres.
    pub(crate) position: Vec3A,
    /// Unit direction of travel.
    pub(crate) direction: Vec3A,
    /// Watts.
    pub(crate) flux: Vec3A,
    pub(crate) instance: u32,
}

/// Pixels that a kernel may reach, as an unclipped range of columns and rows.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Footprint {
    pub(crate) x: [f32; 2],
    pub(crate) y: [f32; 2],
}

impl Footprint {
    /// The footprint of a photon in front of the camera.
    pub(crate) fn new(pinhole: Pinhole, photon: &GhostPhoton) -> Self {
        let p = photon.position;
        let (u, v) = pinhole.project(p);
        // Projection of a sphere around the photon; a sphere that reaches half way to the camera has no good
        // bound.
        let reach = photon.radius / (p.z - photon.radius).max(0.5 * p.z);
        let (du, dv) = (reach * pinhole.fx, reach * pinhole.fy);
        Self {
            x: [(u - du).ceil(), (u + du).floor()],
            y: [(v - dv).ceil(), (v + dv).floor()],
        }
    }

    /// Range first..end of tiles for each axis, in a grid of the given size; empty outside the picture.
    pub(crate) fn tiles(&self, columns: u32, rows: u32) -> [u32; 4] {
        // Casts saturate.
        let span = |[low, high]: [f32; 2], n: u32| {
            let first = low.max(0.0) as u32 / TILE;
            let end = if high < 0.0 {
                0
            } else {
                high as u32 / TILE + 1
            };
            [first, end.min(n)]
        };
        let ([x0, x1], [y0, y1]) = (span(self.x, columns), span(self.y, rows));
        [x0, x1, y0, y1]
    }
}

/// Photons that were traced together.
#[derive(Default)]
pub(crate) struct Chunk {
    pub(crate) ghost: Vec<GhostPhoton>,
    pub(crate) mesh: Vec<MeshPhoton>,
    /// Radius of the kernel, metres; in the picture at least [`LEAST_RADIUS_PX`].
    pub(crate) radius_m: f32,
    /// Indices into `ghost`, grouped by tile, and where each tile's indices start; no starts if they are not
    /// sorted.
    order: Vec<u32>,
    starts: Vec<u32>,
}

impl Chunk {
    pub(crate) fn sort_by_tile(&mut self, pinhole: Pinhole, columns: u32, rows: u32, most: usize) {
        let tiles_of = |photon: &GhostPhoton| {
            let [x0, x1, y0, y1] = Footprint::new(pinhole, photon).tiles(columns, rows);
            (y0..y1).flat_map(move |y| (x0..x1).map(move |x| (y * columns + x) as usize))
        };
        self.starts.clear();
        self.order.clear();
        let n_tiles = |photon: &GhostPhoton| {
            let [x0, x1, y0, y1] = Footprint::new(pinhole, photon).tiles(columns, rows);
            x1.saturating_sub(x0) as usize * y1.saturating_sub(y0) as usize
        };
        if self.ghost.iter().map(n_tiles).sum::<usize>() > most {
            return;
        }
        self.starts.resize((columns * rows) as usize + 1, 0);
        for tile in self.ghost.iter().flat_map(tiles_of) {
            self.starts[tile] += 1;
        }
        let mut n = 0;
        for start in &mut self.starts {
            n += *start;
            *start = n;
        }
        self.order.resize(n as usize, 0);
        // Backwards, so that indices increase within a tile and ends become starts.
        for (i, photon) in self.ghost.iter().enumerate().rev() {
            for tile in tiles_of(photon) {
                self.starts[tile] -= 1;
                self.order[self.starts[tile] as usize] = i as u32;
            }
        }
    }

    /// Photons whose kernel may reach a tile, in the order of their indices; others may be included.
    pub(crate) fn of_tile(&self, tile: usize) -> impl Iterator<Item = &GhostPhoton> {
        let (sorted, all) = match (self.starts.get(tile), self.starts.get(tile + 1)) {
            (Some(&start), Some(&end)) => {
                (&self.order[start as usize..end as usize], &self.ghost[..0])
            }
            _ => (&self.order[..0], self.ghost.as_slice()),
        };
        sorted.iter().map(|&i| &self.ghost[i as usize]).chain(all)
    }
}

/// Photons on meshes, in hashed cells.
#[derive(Default)]
pub(crate) struct MeshGrid {
    photons: Vec<MeshPhoton>,
    /// Start of each bucket; a power of two of them, plus one.
    starts: Vec<u32>,
    radius: f32,
}

impl MeshGrid {
    /// Sorts photons into cells two radii wide: a kernel reaches at most two cells along each axis.
    pub(crate) fn rebuild(&mut self, chunks: &[Chunk], radius: f32, pulse: &Pulse<'_>) {
        self.radius = radius;
        let all = || chunks.iter().flat_map(|chunk| &chunk.mesh);
        let n: usize = chunks.iter().map(|chunk| chunk.mesh.len()).sum();
        self.photons.clear();
        self.starts.clear();
        let Some(&any) = all().next() else {
            return;
        };
        self.starts.resize(n.next_power_of_two() + 1, 0);
        self.photons.resize(n, any);
        for (i, photon) in all().enumerate() {
            if i.is_multiple_of(SORTED_AT_ONCE) && !pulse.go_on() {
                return;
            }
            let bucket = self.bucket(self.cell(photon.position));
            self.starts[bucket] += 1;
        }
        let mut sum = 0;
        for start in &mut self.starts {
            sum += *start;
            *start = sum;
        }
        let backwards = chunks
            .iter()
            .rev()
            .flat_map(|chunk| chunk.mesh.iter().rev());
        for (i, photon) in backwards.enumerate() {
            if i.is_multiple_of(SORTED_AT_ONCE) && !pulse.go_on() {
                return;
            }
            let bucket = self.bucket(self.cell(photon.position));
            self.starts[bucket] -= 1;
            self.photons[self.starts[bucket] as usize] = *photon;
        }
    }

    fn cell(&self, p: Vec3A) -> IVec3 {
        (p / (2.0 * self.radius)).floor().as_ivec3()
    }

    fn bucket(&self, cell: IVec3) -> usize {
        let [x, y, z] = cell.to_array().map(|i| i as u32);
        crate::numerics::hash(x, y, z) as usize & (self.starts.len() - 2)
    }

    /// Photons in the cells that a kernel at `p` reaches, each once; others may be included.
    fn near(&self, p: Vec3A) -> impl Iterator<Item = &MeshPhoton> {
        let low = self.cell(p - Vec3A::splat(self.radius));
        let mut buckets = [usize::MAX; 8];
        for corner in 0..8 {
            let step = IVec3::new(corner & 1, corner >> 1 & 1, corner >> 2);
            let bucket = self.bucket(low.wrapping_add(step));
            // Two cells may share a bucket.
            if !buckets.contains(&bucket) {
                buckets[corner as usize] = bucket;
            }
        }
        let found = buckets.into_iter().filter(|&bucket| bucket != usize::MAX);
        found.flat_map(|bucket| {
            let range = self.starts[bucket] as usize..self.starts[bucket + 1] as usize;
            &self.photons[range]
        })
    }
}

/// All photons of a frame. Buffers are kept between frames.
#[derive(Default)]
pub(crate) struct PhotonMap {
    /// The first `n_chunks` belong to this frame.
    pub(crate) chunks: Vec<Chunk>,
    pub(crate) n_chunks: usize,
    /// Tiles in a row of the picture.
    pub(crate) columns: u32,
    pub(crate) grid: MeshGrid,
    /// Number of photons emitted.
    pub(crate) n_emitted: u32,
}

impl PhotonMap {
    fn chunks(&self) -> &[Chunk] {
        &self.chunks[..self.n_chunks]
    }

    /// Number of photons stored, including those that virtual objects remove.
    pub(crate) fn n_stored(&self) -> u64 {
        let stored = self.chunks().iter().map(|c| c.ghost.len() + c.mesh.len());
        stored.sum::<usize>() as u64
    }

    /// Whether any kernel reaches a tile.
    pub(crate) fn reaches(&self, column: u32, row: u32) -> bool {
        self.of_tile(column, row).next().is_some()
    }

    /// Photons on real surfaces whose kernel may reach a tile, in the order of their indices.
    pub(crate) fn of_tile(&self, column: u32, row: u32) -> impl Iterator<Item = &GhostPhoton> {
        let tile = (row * self.columns + column) as usize;
        self.chunks()
            .iter()
            .flat_map(move |chunk| chunk.of_tile(tile))
    }

    /// Photons on meshes around a point; farther ones may be included.
    pub(crate) fn near(&self, p: Vec3A) -> impl Iterator<Item = &MeshPhoton> {
        let grid = (!self.grid.photons.is_empty()).then_some(&self.grid);
        grid.into_iter().flat_map(move |grid| grid.near(p))
    }

    /// Radius of the kernel on meshes, metres.
    pub(crate) fn mesh_radius(&self) -> f32 {
        self.grid.radius
    }

    /// All photons on real surfaces.
    #[cfg(test)]
    pub(crate) fn ghost_photons(&self) -> impl Iterator<Item = &GhostPhoton> {
        self.chunks().iter().flat_map(|chunk| &chunk.ghost)
    }

    /// All photons on meshes.
    #[cfg(test)]
    pub(crate) fn mesh_photons(&self) -> &[MeshPhoton] {
        &self.grid.photons
    }
}

/// Radius of a photon's kernel on the ghost surface at depth `z`, metres, if the radius is `radius_m` elsewhere.
pub(crate) fn kernel_radius(pinhole: &Pinhole, radius_m: f32, z: f32) -> f32 {
    let least = LEAST_RADIUS_PX * z / pinhole.fx.min(pinhole.fy);
    radius_m.max(least)
}

/// Epanechnikov kernel over a disc, 1/m2: its integral is one. Zero from `radius` on.
#[inline]
pub(crate) fn kernel(distance_squared: f32, radius: f32) -> f32 {
    let radius_squared = radius * radius;
    2.0 / (PI * radius_squared) * (1.0 - distance_squared / radius_squared).max(0.0)
}
