//! What all renderers of a process share: threads, meshes built for rays, the clock.

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

/// One per process; clones share it. Makes renderers.
///
/// Renderers share its threads: the frames under way are worked on by the threads that asked for them and
/// by helpers, one fewer than there are cores. They share the buffers that frames are worked out in: as many
/// sets as frames are under way at a time. They also share meshes: a mesh that two scenes contain is built
/// once. Each renderer's [`memory`](Renderer::memory) counts it in full, since either of them may
/// outlive the other.
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
    /// Gone with the last renderer.
    buffers: Mutex<Weak<BufferPool>>,
    clock: Clock,
    /// Threads that load scenes; gone when no scene is being loaded.
    loading: Mutex<Weak<rayon::ThreadPool>>,
}

impl Engine {
    /// An engine with `threads` threads in all (0: one per core). `clock` times stages.
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

    /// What renders: never [`Backend::Auto`].
    pub fn backend(&self) -> Backend {
        self.0.backend
    }

    /// Threads that work on one frame at a time.
    pub fn threads(&self) -> usize {
        self.0.threads.count()
    }

    /// Meshes built for rays so far, each once while any renderer holds it.
    pub fn mesh_builds(&self) -> u64 {
        self.0.meshes.n_builds()
    }

    /// A renderer of a scene.
    pub fn renderer(&self, scene: &Scene) -> Result<Renderer, RenderError> {
        self.renderer_while(scene, &Uninterrupted)
    }

    /// As [`Self::renderer`], while `checkpoint` lets it, else [`RenderError::Cancelled`].
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

    /// Runs work whose parts rayon hands out on threads of its own, as loading a scene has: frames under
    /// way are not in its way. All loads share the threads, which end with the last of them.
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

/// What `slot` refers to while anybody holds it, else a new one.
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
