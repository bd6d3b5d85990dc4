//! State shared by all renderers of a process: threads, built meshes, the clock.

use std::sync::{Arc, Mutex, PoisonError, Weak};

use rayon::prelude::*;

use super::backend::Backend;
use super::checkpoint::{Checkpoint, Uninterrupted};
use super::cpu::CpuRenderer;
use super::cpu::buffers::BufferPool;
use super::error::RenderError;
use super::mesh_cache::{BuiltLods, MeshCache};
use super::prepare::mesh_lods::MeshLods;
use super::renderer::Renderer;
use super::stage::Clock;
use super::threads::Threads;
use crate::scene::{Mesh, Scene};

/// Creates renderers. One per process; clones share it.
///
/// Renderers share its threads: frames are rendered by the threads that requested them and by helper threads, one
/// fewer than there are cores. They share working buffers: as many sets as there are concurrent frames. They also
/// share meshes: a mesh that two scenes contain is built once. Each renderer's [`memory`](Renderer::memory)
/// counts it in full, because either renderer may outlive the other.
#[derive(Clone)]
pub struct Engine(Arc<Shared>);

impl std::fmt::Debug for Engine {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Engine")
            .field("backend", &self.backend())
            .field("threads", &self.threads())
            .finish_non_exhaustive()
    }
}

struct Shared {
    backend: Backend,
    threads: Arc<Threads>,
    meshes: MeshCache,
    /// Freed with the last renderer.
    buffers: Mutex<Weak<BufferPool>>,
    clock: Clock,
    /// Threads that load scenes; they end when no scene is being loaded.
    loading: Mutex<Weak<rayon::ThreadPool>>,
}

impl Engine {
    /// An engine with `threads` threads in total (0: one per core). `clock` times stages.
    pub fn new(backend: Backend, threads: usize, clock: Clock) -> Result<Self, RenderError> {
        Ok(Self(Arc::new(Shared {
            backend: backend.resolve()?,
            threads: Arc::new(Threads::new(threads, clock).map_err(not_started)?),
            meshes: MeshCache::default(),
            buffers: Mutex::default(),
            clock,
            loading: Mutex::default(),
        })))
    }

    /// The backend that renders: never [`Backend::Auto`].
    pub fn backend(&self) -> Backend {
        self.0.backend
    }

    /// Threads that render one frame.
    pub fn threads(&self) -> usize {
        self.0.threads.count()
    }

    /// Number of meshes built so far; a mesh is not built again while any renderer holds it.
    pub fn mesh_builds(&self) -> u64 {
        self.0.meshes.n_builds()
    }

    /// A renderer of a scene.
    pub fn renderer(&self, scene: &Scene) -> Result<Renderer, RenderError> {
        self.renderer_while(scene, &Uninterrupted)
    }

    /// Like [`Self::renderer`]; returns [`RenderError::Cancelled`] if `checkpoint` cancels it.
    pub fn renderer_while(
        &self,
        scene: &Scene,
        checkpoint: &dyn Checkpoint,
    ) -> Result<Renderer, RenderError> {
        let lods = |mesh: &&Arc<Mesh>| {
            let wanted = checkpoint.go_on();
            wanted.then(|| MeshLods::new(mesh, checkpoint))
        };
        let build = |meshes: &[&Arc<Mesh>]| -> Result<Vec<BuiltLods>, RenderError> {
            self.load(|| meshes.par_iter().map(lods).collect())
        };
        let shared = &*self.0;
        let lods = shared.meshes.lods(&scene.meshes, checkpoint, build)?;
        let threads = Arc::clone(&shared.threads);
        let buffers = shared_or_new(&shared.buffers, || {
            Ok::<_, RenderError>(BufferPool::new(threads.count()))
        })?;
        let renderer = CpuRenderer::new(scene, lods, threads, buffers, shared.clock)?;
        Ok(Renderer::new(renderer, shared.clock))
    }

    /// Runs work whose parallel parts use rayon, such as loading a scene, on separate threads, so that it does
    /// not delay frames. All loads share these threads, which end with the last load.
    pub fn load<T: Send>(&self, work: impl FnOnce() -> T + Send) -> Result<T, RenderError> {
        let pool = shared_or_new(&self.0.loading, || {
            rayon::ThreadPoolBuilder::new()
                .num_threads(self.threads())
                .thread_name(|i| format!("load-{i}"))
                .build()
                .map_err(not_started)
        })?;
        Ok(pool.install(work))
    }
}

/// The value to which `slot` refers, if it still exists; otherwise a new one.
fn shared_or_new<T, E>(
    slot: &Mutex<Weak<T>>,
    new: impl FnOnce() -> Result<T, E>,
) -> Result<Arc<T>, E> {
    let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(shared) = slot.upgrade() {
        return Ok(shared);
    }
    let made = Arc::new(new()?);
    *slot = Arc::downgrade(&made);
    Ok(made)
}

fn not_started(error: rayon::ThreadPoolBuildError) -> RenderError {
    RenderError::Threads(error.to_string())
}

#[cfg(test)]
mod tests;
