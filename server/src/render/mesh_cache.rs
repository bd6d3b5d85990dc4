//! Built meshes, shared by all renderers of a process: two sessions of one scene build each mesh once.
//!
//! A mesh is looked up by its content. Entries are weak: a mesh that no renderer holds is freed. If a mesh is
//! being built, others wait for it; if its builder is cancelled, one of those that wait builds it.

use std::collections::HashMap;
use std::collections::hash_map::{Entry as Slot, RandomState};
use std::hash::BuildHasher;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use super::checkpoint::Checkpoint;
use super::error::RenderError;
use super::prepare::mesh_lods::MeshLods;
use crate::scene::Mesh;

/// How long a thread that waits for a mesh sleeps before it checks whether it was cancelled.
const NAP: Duration = Duration::from_millis(5);

/// The levels of detail of a built mesh, or what is wrong with the mesh.
pub(super) type SharedLods = Result<Arc<MeshLods>, String>;

/// The same, just built; `None` if the build was cancelled.
pub(super) type BuiltLods = Option<Result<MeshLods, String>>;

enum State {
    /// The mesh is being built.
    Building,
    Built(Weak<MeshLods>),
}

#[derive(Default)]
struct Table {
    /// By hash and number of triangles.
    states: HashMap<(u64, usize), State>,
    n_builds: u64,
}

/// The meshes of a process.
#[derive(Default)]
pub(super) struct MeshCache {
    /// Randomly seeded, so that nobody can prepare meshes whose hashes collide.
    hasher: RandomState,
    table: Mutex<Table>,
    /// Signalled when a build ends, with or without success.
    ended: Condvar,
}

/// Permission to build a mesh; when it is dropped, a thread that waits may build it.
struct Ticket<'a> {
    cache: &'a MeshCache,
    key: (u64, usize),
}

impl Ticket<'_> {
    fn publish(&self, lods: &Arc<MeshLods>) {
        let mut table = self.cache.table();
        let built = State::Built(Arc::downgrade(lods));
        table.states.insert(self.key, built);
        table.n_builds += 1;
    }
}

impl Drop for Ticket<'_> {
    fn drop(&mut self) {
        let mut table = self.cache.table();
        if matches!(table.states.get(&self.key), Some(State::Building)) {
            table.states.remove(&self.key);
        }
        drop(table);
        self.cache.ended.notify_all();
    }
}

/// The result of requesting a mesh.
enum Asked<'a> {
    Built(Arc<MeshLods>),
    /// The caller must build it.
    Mine(Ticket<'a>),
    /// Another thread is building it.
    Theirs,
    /// Another mesh has the same hash: the caller must build it and does not share it.
    Collides,
}

impl MeshCache {
    fn table(&self) -> MutexGuard<'_, Table> {
        // Every critical section leaves its data consistent.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Number of meshes built so far.
    pub(super) fn n_builds(&self) -> u64 {
        self.table().n_builds
    }

    fn key(&self, mesh: &Mesh) -> (u64, usize) {
        let hash = self.hasher.hash_one(bytes(mesh));
        (hash, mesh.triangles.len())
    }

    fn ask(&self, mesh: &Arc<Mesh>, key: (u64, usize)) -> Asked<'_> {
        let mut table = self.table();
        // Entries that nobody holds are removed, so that the table does not grow.
        let kept = |state: &State| match state {
            State::Building => true,
            State::Built(lods) => lods.strong_count() > 0,
        };
        table.states.retain(|_, state| kept(state));
        match table.states.entry(key) {
            Slot::Occupied(mut slot) => match slot.get() {
                State::Building => Asked::Theirs,
                State::Built(lods) => match lods.upgrade() {
                    Some(lods) if is_same(lods.mesh(), mesh) => Asked::Built(lods),
                    Some(_) => Asked::Collides,
                    None => {
                        slot.insert(State::Building);
                        Asked::Mine(Ticket { cache: self, key })
                    }
                },
            },
            Slot::Vacant(slot) => {
                slot.insert(State::Building);
                Asked::Mine(Ticket { cache: self, key })
            }
        }
    }

    /// The levels of detail of every mesh, in order: found, built by `build` or waited for, unless `checkpoint`
    /// cancels it. `build` gets the meshes to build and returns the results in the same order.
    pub(super) fn lods(
        &self,
        meshes: &[Arc<Mesh>],
        checkpoint: &dyn Checkpoint,
        build: impl Fn(&[&Arc<Mesh>]) -> Result<Vec<BuiltLods>, RenderError>,
    ) -> Result<Vec<SharedLods>, RenderError> {
        let keys: Vec<_> = meshes.iter().map(|mesh| self.key(mesh)).collect();
        let mut found: Vec<Option<SharedLods>> = vec![None; meshes.len()];
        loop {
            // A thread that builds does not wait meanwhile, so two that need each other's meshes cannot deadlock.
            let mut mine = Vec::new();
            let mut waits = false;
            for (i, mesh) in meshes.iter().enumerate() {
                if found[i].is_some() {
                    continue;
                }
                match self.ask(mesh, keys[i]) {
                    Asked::Built(lods) => found[i] = Some(Ok(lods)),
                    Asked::Mine(ticket) => mine.push((i, Some(ticket))),
                    Asked::Collides => mine.push((i, None)),
                    Asked::Theirs => waits = true,
                }
            }
            let to_build: Vec<_> = mine.iter().map(|(i, _)| &meshes[*i]).collect();
            let built = match to_build.is_empty() {
                true => Vec::new(),
                false => build(&to_build)?,
            };
            // A mesh that was finished after cancellation may lack coarser levels.
            if !checkpoint.go_on() {
                return Err(RenderError::Cancelled);
            }
            for ((i, ticket), built) in mine.into_iter().zip(built) {
                let built = built.ok_or(RenderError::Cancelled)?.map(Arc::new);
                if let (Ok(lods), Some(ticket)) = (&built, &ticket) {
                    ticket.publish(lods);
                }
                found[i] = Some(built);
            }
            if !waits {
                return Ok(found.into_iter().flatten().collect());
            }
            if to_build.is_empty() {
                self.wait();
            }
        }
    }

    fn wait(&self) {
        let table = self.table();
        let waited = self.ended.wait_timeout(table, NAP);
        drop(waited.unwrap_or_else(PoisonError::into_inner));
    }
}

/// The bytes of a mesh, for each of its lists.
fn bytes(mesh: &Mesh) -> [&[u8]; 5] {
    [
        bytemuck::cast_slice(&mesh.positions),
        bytemuck::cast_slice(&mesh.normals),
        bytemuck::cast_slice(&mesh.uvs),
        bytemuck::cast_slice(&mesh.colors),
        bytemuck::cast_slice(&mesh.triangles),
    ]
}

/// Whether two meshes are equal to the bit.
fn is_same(a: &Arc<Mesh>, b: &Arc<Mesh>) -> bool {
    Arc::ptr_eq(a, b) || bytes(a) == bytes(b)
}

#[cfg(test)]
mod tests;
