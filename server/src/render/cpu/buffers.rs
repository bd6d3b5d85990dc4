//! Working buffers of frames: lent to a frame while it is rendered, and shared by all renderers of an engine.
//! Sessions whose frames take turns need only one set.

use std::ops::{Deref, DerefMut};
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::ghost::{FilledDepth, GhostSurface};
use crate::render::prepare::camera_levels::CameraLevels;
use crate::render::prepare::environment::CameraEnvironment;
use crate::render::prepare::tile_plan::{TILE_PIXELS, TileGrid, TilePlan};

use super::ambient::{ObjectAmbient, RealAmbient};
use super::photons::PhotonStage;
use super::post;
use super::post::composite::{CompositeBuffers, PostPass};
use super::scratch::ScratchPool;
use super::shade::rough::RoughTile;
use super::shade::secondary::Scratch;
use super::shade::shaded::Shaded;
use super::shadow::group::ShadowScratch;
use super::tile::{LightTile, PixelLight, PrimaryTile, Tile};

/// Unused sets are freed after this many frames: four seconds at 30 Hz.
const FRAMES_KEPT: u32 = 128;

/// A set is freed if its pictures were this many times larger than the recent ones.
const LARGEST_SPARE: usize = 2;

/// Results of every stage of one frame. A frame reads only values that it has written.
pub(crate) struct FrameBuffers {
    pub(crate) ghost: GhostSurface,
    pub(crate) filled: FilledDepth,
    pub(crate) ambient: RealAmbient,
    pub(crate) object_ambient: ObjectAmbient,
    pub(crate) plans: Vec<TilePlan>,
    pub(crate) camera_environment: CameraEnvironment,
    pub(crate) camera_levels: CameraLevels,
    pub(crate) photons: PhotonStage,
    pub(crate) grid: TileGrid,
    pub(crate) tiles: Vec<Tile>,
    pub(crate) primary: Vec<PrimaryTile>,
    pub(crate) lit: Vec<LightTile>,
    pub(crate) filtered: Vec<Box<[PixelLight; TILE_PIXELS]>>,
    pub(crate) rough: Vec<RoughTile>,
    pub(crate) shaded: Vec<Shaded>,
    pub(crate) composite: CompositeBuffers,
    pub(crate) passes: Vec<Box<dyn PostPass>>,
    pub(crate) shadow_scratch: ScratchPool<ShadowScratch>,
    pub(crate) shade_scratch: ScratchPool<Scratch>,
    /// Pixels of the largest picture so far.
    n_pixels: usize,
}

impl FrameBuffers {
    /// An empty set, for `n_threads` threads.
    fn new(n_threads: usize) -> Self {
        Self {
            ghost: GhostSurface::new(),
            filled: FilledDepth::default(),
            ambient: RealAmbient::new(n_threads),
            object_ambient: ObjectAmbient::new(n_threads),
            plans: Vec::new(),
            camera_environment: CameraEnvironment::default(),
            camera_levels: CameraLevels::default(),
            photons: PhotonStage::new(n_threads),
            grid: TileGrid::default(),
            tiles: Vec::new(),
            primary: Vec::new(),
            lit: Vec::new(),
            filtered: Vec::new(),
            rough: Vec::new(),
            shaded: Vec::new(),
            composite: CompositeBuffers::default(),
            passes: post::passes(),
            shadow_scratch: ScratchPool::new(n_threads),
            shade_scratch: ScratchPool::new(n_threads),
            n_pixels: 0,
        }
    }
}

/// Largest number of sets in use at the same time, and the largest picture.
#[derive(Debug, Clone, Copy, Default)]
struct Demand {
    n_sets: usize,
    n_pixels: usize,
}

#[derive(Default)]
struct Sets {
    free: Vec<FrameBuffers>,
    n_lent: usize,
    /// For the frames counted by `n_frames`, and for the [`FRAMES_KEPT`] frames before them.
    demand: [Demand; 2],
    n_frames: u32,
}

impl Sets {
    fn demand(&self) -> Demand {
        let [now, before] = self.demand;
        Demand {
            n_sets: now.n_sets.max(before.n_sets),
            n_pixels: now.n_pixels.max(before.n_pixels),
        }
    }
}

/// The sets of an engine: as many as the largest recent number of concurrent frames.
pub(crate) struct BufferPool {
    n_threads: usize,
    sets: Mutex<Sets>,
}

/// A set that is lent to a frame.
pub(crate) struct Lent<'a> {
    pool: &'a BufferPool,
    /// `None` only while it is dropped.
    set: Option<FrameBuffers>,
}

impl BufferPool {
    /// An empty pool, for renderers with `n_threads` threads.
    pub(crate) fn new(n_threads: usize) -> Self {
        Self {
            n_threads,
            sets: Mutex::default(),
        }
    }

    fn sets(&self) -> MutexGuard<'_, Sets> {
        // Every critical section leaves its data consistent.
        self.sets.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lends a set for a picture of `n_pixels` pixels; a new set if none is free. Does not block.
    pub(crate) fn lend(&self, n_pixels: usize) -> Lent<'_> {
        let mut sets = self.sets();
        sets.n_lent += 1;
        sets.n_frames += 1;
        if sets.n_frames > FRAMES_KEPT {
            sets.n_frames = 1;
            sets.demand = [Demand::default(), sets.demand[0]];
        }
        let n_lent = sets.n_lent;
        let now = &mut sets.demand[0];
        now.n_sets = now.n_sets.max(n_lent);
        now.n_pixels = now.n_pixels.max(n_pixels);
        // The smallest set that is large enough, otherwise the largest.
        let fit = |set: &FrameBuffers| (set.n_pixels < n_pixels, set.n_pixels.abs_diff(n_pixels));
        let best = (0..sets.free.len()).min_by_key(|&i| fit(&sets.free[i]));
        let free = best.map(|i| sets.free.swap_remove(i));
        drop(sets);
        let mut set = free.unwrap_or_else(|| FrameBuffers::new(self.n_threads));
        set.n_pixels = set.n_pixels.max(n_pixels);
        Lent {
            pool: self,
            set: Some(set),
        }
    }

    fn take_back(&self, set: FrameBuffers) {
        let mut sets = self.sets();
        sets.n_lent -= 1;
        let demand = sets.demand();
        let fits = set.n_pixels <= demand.n_pixels.saturating_mul(LARGEST_SPARE);
        if fits && sets.free.len() + sets.n_lent < demand.n_sets {
            sets.free.push(set);
        }
    }

    /// The set of the last frame, if frames are rendered one after the other.
    #[cfg(test)]
    pub(crate) fn last(&self) -> Lent<'_> {
        let largest = self.sets().free.iter().map(|set| set.n_pixels).max();
        self.lend(largest.unwrap_or(0))
    }

    #[cfg(test)]
    pub(crate) fn n_free(&self) -> usize {
        self.sets().free.len()
    }
}

impl Deref for Lent<'_> {
    type Target = FrameBuffers;

    fn deref(&self) -> &FrameBuffers {
        // Only `drop` takes it.
        self.set.as_ref().unwrap_or_else(|| unreachable!())
    }
}

impl DerefMut for Lent<'_> {
    fn deref_mut(&mut self) -> &mut FrameBuffers {
        self.set.as_mut().unwrap_or_else(|| unreachable!())
    }
}

impl Drop for Lent<'_> {
    fn drop(&mut self) {
        if let Some(set) = self.set.take() {
            self.pool.take_back(set);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_in_turns_share_one_set_and_frames_at_once_have_their_own() {
        let pool = BufferPool::new(1);
        for _ in 0..10 {
            drop(pool.lend(100));
        }
        assert_eq!(pool.n_free(), 1);
        let (a, b) = (pool.lend(100), pool.lend(100));
        drop((a, b));
        assert_eq!(pool.n_free(), 2);
        // The second set is kept for a while, then freed.
        for _ in 0..FRAMES_KEPT / 2 {
            drop(pool.lend(100));
        }
        assert_eq!(pool.n_free(), 2);
        for _ in 0..2 * FRAMES_KEPT {
            drop(pool.lend(100));
        }
        assert_eq!(pool.n_free(), 1);
    }

    #[test]
    fn the_set_that_fits_is_lent_and_one_that_is_far_too_large_is_freed() {
        let pool = BufferPool::new(1);
        let (large, small) = (pool.lend(1000), pool.lend(10));
        drop((large, small));
        assert_eq!(pool.lend(10).n_pixels, 10);
        assert_eq!(pool.lend(11).n_pixels, 1000);
        assert_eq!(pool.lend(2000).n_pixels, 2000);
        for _ in 0..3 * FRAMES_KEPT {
            drop(pool.lend(10));
        }
        assert_eq!(pool.lend(10).n_pixels, 10);
    }
}
