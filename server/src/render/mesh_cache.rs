//! Meshes that were built for rays, shared by all renderers of a process: two sessions of one scene build
//! each mesh once.
//!
//! A mesh is found by its content. Entries are weak: what no renderer holds is freed. A mesh that is being
//! built is waited for; if its builder gives up, one of those who wait builds it.

use std::collections::HashMap;
use std::collections::hash_map::{Entry as Slot, RandomState};
use std::hash::BuildHasher;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

use super::checkpoint::Checkpoint;
use super::error::RenderError;
use super::prepare::mesh_lods::MeshLods;
use crate::scene::Mesh;

/// How long somebody who waits for a mesh sleeps before looking whether it is still wanted.
const NAP: Duration = Duration::from_millis(5);

/// A mesh as rays see it, or what is wrong with it.
pub(super) type SharedLods = Result<Arc<MeshLods>, String>;

/// The same, just built; `None` if it was given up.
pub(super) type BuiltLods = Option<Result<MeshLods, String>>;

enum State {
    /// Somebody builds it.
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
    /// Random, so that nobody can prepare meshes that collide.
    hasher: RandomState,
    table: Mutex<Table>,
    /// A build ended, in whatever way.
    ended: Condvar,
}

/// Who may build a mesh; the others are let in when it is dropped.
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

/// What became of asking for a mesh.
enum Asked<'a> {
    Built(Arc<MeshLods>),
    /// It is to be built by who asked.
    Mine(Ticket<'a>),
    /// Somebody else builds it.
    Theirs,
    /// Another mesh of the same hash is there: to be built, and not shared.
    Collides,
}

impl MeshCache {
    fn table(&self) -> MutexGuard<'_, Table> {
        // Every critical section leaves its data whole.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Meshes built so far.
    pub(super) fn n_builds(&self) -> u64 {
        self.table().n_builds
    }

    fn key(&self, mesh: &Mesh) -> (u64, usize) {
        let hash = self.hasher.hash_one(bytes(mesh));
        (hash, mesh.triangles.len())
    }

    fn ask(&self, mesh: &Arc<Mesh>, key: (u64, usize)) -> Asked<'_> {
        let mut table = self.table();
        // What nobody holds any more goes, so that the table does not grow.
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

    /// Every mesh as rays see it, in order: found, built by `build` or waited for, while
    /// `checkpoint` lets it. `build` is handed those to be built and returns them in the same order.
    pub(super) fn lods(
        &self,
        meshes: &[Arc<Mesh>],
        checkpoint: &dyn Checkpoint,
        build: impl Fn(&[&Arc<Mesh>]) -> Result<Vec<BuiltLods>, RenderError>,
    ) -> Result<Vec<SharedLods>, RenderError> {
        let keys: Vec<_> = meshes.iter().map(|mesh| self.key(mesh)).collect();
        let mut found: Vec<Option<SharedLods>> = vec![None; meshes.len()];
        loop {
            // Who builds waits for nobody meanwhile, so two who need each other's meshes both get on.
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
            // What was finished after it was given up may lack coarser meshes.
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

/// The bytes of a mesh, list by list.
fn bytes(mesh: &Mesh) -> [&[u8]; 5] {
    [
        bytemuck::cast_slice(&mesh.positions),
        bytemuck::cast_slice(&mesh.normals),
        bytemuck::cast_slice(&mesh.uvs),
        bytemuck::cast_slice(&mesh.colors),
        bytemuck::cast_slice(&mesh.triangles),
    ]
}

/// To the bit.
fn is_same(a: &Arc<Mesh>, b: &Arc<Mesh>) -> bool {
    Arc::ptr_eq(a, b) || bytes(a) == bytes(b)
}

#[cfg(test)]
mod tests;
