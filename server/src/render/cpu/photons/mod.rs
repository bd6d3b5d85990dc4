//! The photon stage: caustics by photon mapping (Kan and Kaufmann 2012, section 3.2). Photons are emitted from
//! lights towards caustic generators, traced, and sorted by their final position.

pub(crate) mod beam;
pub(crate) mod light;
pub(crate) mod map;
mod trace;

pub(crate) use map::PhotonMap;

use crate::render::prepare::frame::PreparedFrame;
use crate::render::prepare::tile_plan::TILE;
use crate::render::threads::Workers;

use super::scratch::ScratchPool;
use beam::{Beam, plan_beams};
use map::{Chunk, MAX_ENTRIES};
use trace::{PhotonScratch, trace_photons};

/// Fewest photons that a thread takes at a time, and most chunks into which all photons are split. Neither
/// affects the picture.
const CHUNK: u32 = 4096;
const MAX_CHUNKS: u32 = 256;

/// If caustics were not explicitly enabled, the kernel's radius is at least this many times the mean spacing of
/// photons on their generators: the caustic of a large glass object is blurred rather than noisy.
const AUTOMATIC_SPACINGS: f32 = 2.0;

/// Buffers of the stage.
pub(crate) struct PhotonStage {
    beams: Vec<Beam>,
    map: PhotonMap,
    scratch: ScratchPool<PhotonScratch>,
}

impl PhotonStage {
    /// For `threads` threads.
    pub(crate) fn new(threads: usize) -> Self {
        Self {
            beams: Vec::new(),
            map: PhotonMap::default(),
            scratch: ScratchPool::new(threads),
        }
    }

    /// The photons of the last frame.
    #[cfg(test)]
    pub(crate) fn map(&self) -> &PhotonMap {
        &self.map
    }
}

/// Emits, traces and sorts the photons of a frame; `None` if there are none to emit.
pub(crate) fn trace<'m>(
    frame: &PreparedFrame<'_>,
    stage: &'m mut PhotonStage,
    workers: Workers<'_>,
) -> Option<&'m PhotonMap> {
    let PhotonStage {
        beams,
        map,
        scratch,
    } = stage;
    let caustics = &frame.settings.caustics;
    map.n_emitted = plan_beams(frame, caustics.photons, beams);
    if map.n_emitted == 0 {
        return None;
    }
    let n = map.n_emitted;
    let per_chunk = n.div_ceil(MAX_CHUNKS).max(CHUNK);
    map.n_chunks = n.div_ceil(per_chunk) as usize;
    if map.chunks.len() < map.n_chunks {
        map.chunks.resize_with(map.n_chunks, Chunk::default);
    }
    let [width, height] = frame.sensed.size();
    map.columns = width.div_ceil(TILE);
    let (columns, rows) = (map.columns, height.div_ceil(TILE));
    let beams = &*beams;
    let mut radius_m = caustics.radius_m;
    if caustics.enabled.is_none() {
        let area: f32 = beams.iter().map(Beam::cross_section).sum();
        radius_m = radius_m.max(AUTOMATIC_SPACINGS * (area / n as f32).sqrt());
    }
    let chunks = &mut map.chunks[..map.n_chunks];
    workers.for_each(chunks.iter_mut().enumerate(), |(k, chunk)| {
        let first = k as u32 * per_chunk;
        let numbers = first..(first + per_chunk).min(n);
        chunk.radius_m = radius_m;
        scratch.with(|scratch| trace_photons(frame, beams, numbers, scratch, chunk));
        if frame.go_on() {
            chunk.sort_by_tile(frame.sensed.pinhole, columns, rows, MAX_ENTRIES);
        }
    });
    map.grid.rebuild(chunks, radius_m, frame.pulse);
    Some(map)
}
