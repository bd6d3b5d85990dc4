//! What loading a scene may use, and whether it is still wanted.
//!
//! Loaders ask a [`LoadContext`] before they allocate, and now and then whether to go on. A refusal
//! is remembered: whatever a loader makes of the error (a texture that cannot be had is left out),
//! the scene as a whole is then refused.

use std::collections::HashSet;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use super::error::{LoadError, MeshError};
use super::model::MAX_TRIANGLES;
use super::picture_cache::{Picture, PictureCache};
use super::{Texture, file, texture};
use crate::memory::{Budget, Held, OverBudget};

/// Bytes by which working memory grows at least: budgets are asked seldom.
const STEP: u64 = 1 << 20;

/// Budget, cancellation and shared pictures of one scene being loaded. It holds what the scene
/// takes of the budget: keep it as long as the scene.
#[derive(Debug)]
pub struct LoadContext {
    budget: Budget,
    stop: Arc<AtomicBool>,
    max_triangles: usize,
    pictures: Arc<PictureCache>,
    refused: OnceLock<OverBudget>,
    held: Mutex<Holdings>,
}

/// What a scene holds.
#[derive(Debug)]
struct Holdings {
    own: Held,
    /// Bytes of the files of the model being read.
    files: Held,
    /// Pictures, which other scenes may hold as well.
    pictures: Vec<(Arc<Held>, Held)>,
    /// Which of them are counted, by address.
    counted: HashSet<usize>,
}

impl Default for LoadContext {
    /// Without a limit, never cancelled; pictures are shared with whatever the process loads.
    fn default() -> Self {
        Self::new(Budget::unlimited(), Arc::default())
    }
}

impl LoadContext {
    /// With a budget; loading ends soon after `stop` is set.
    pub fn new(budget: Budget, stop: Arc<AtomicBool>) -> Self {
        Self {
            held: Mutex::new(Holdings {
                own: budget.nothing(),
                files: budget.nothing(),
                pictures: Vec::new(),
                counted: HashSet::new(),
            }),
            budget,
            stop,
            max_triangles: MAX_TRIANGLES,
            pictures: PictureCache::of_the_process(),
            refused: OnceLock::new(),
        }
    }

    /// Stores at most so many triangles.
    #[must_use]
    pub fn with_max_triangles(mut self, max_triangles: usize) -> Self {
        self.max_triangles = max_triangles.min(MAX_TRIANGLES);
        self
    }

    /// Most triangles to store.
    pub fn max_triangles(&self) -> usize {
        self.max_triangles
    }

    /// Whether loading was given up.
    pub fn is_cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Whether to go on: neither cancelled nor refused.
    pub fn check(&self) -> Result<(), LoadError> {
        if self.is_cancelled() {
            return Err(LoadError::Cancelled);
        }
        match self.refused.get() {
            Some(over) => Err(LoadError::Memory(over.clone())),
            None => Ok(()),
        }
    }

    fn holdings(&self) -> MutexGuard<'_, Holdings> {
        // Every critical section leaves its data whole.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn remember(&self, over: OverBudget) -> LoadError {
        LoadError::Memory(self.refused.get_or_init(|| over).clone())
    }

    /// Takes memory that the scene keeps, before it is allocated.
    pub fn keep(&self, bytes: u64, what: &str) -> Result<(), LoadError> {
        self.check()?;
        let grown = self.holdings().own.grow(bytes, what);
        grown.map_err(|over| self.remember(over))
    }

    /// Working memory, given back when it is dropped.
    pub fn scratch(&self, what: &'static str) -> Scratch<'_> {
        Scratch {
            context: self,
            held: self.budget.nothing(),
            what,
        }
    }

    /// A file's bytes, which count until [`Self::close_files`]; else why they cannot be had.
    pub(super) fn read(&self, path: &Path, max_bytes: u64) -> Result<Vec<u8>, String> {
        file::read_within(path, max_bytes, |size| {
            self.check().map_err(|error| error.to_string())?;
            let grown = self.holdings().files.grow(size, "bytes of files");
            grown.map_err(|over| self.remember(over).to_string())
        })
    }

    /// The bytes of all files read so far are gone.
    pub(super) fn close_files(&self) {
        self.holdings().files.shrink_to(0);
    }

    /// Decodes a picture, unless this process holds it already: of the same bytes there is one.
    pub(super) fn texture(&self, bytes: &[u8], srgb: bool) -> Result<Arc<Texture>, String> {
        self.check().map_err(|error| error.to_string())?;
        let picture = self.pictures.get_or_decode(bytes, srgb, || {
            let mut scratch = self.scratch("pictures, while they are decoded");
            let texture = texture::decode_within(bytes, srgb, |peak| {
                scratch.hold(peak).map_err(|error| error.to_string())
            })?;
            drop(scratch);
            let process = self.budget.parent().unwrap_or(&self.budget);
            let size = texture.bytes();
            let held = process.take_here(size, "pictures");
            Ok((
                texture,
                held.map_err(|over| self.remember(over).to_string())?,
            ))
        })?;
        self.count(&picture).map_err(|error| error.to_string())?;
        Ok(picture.texture)
    }

    /// Counts a picture that this scene shares, once.
    fn count(&self, picture: &Picture) -> Result<(), LoadError> {
        let address = Arc::as_ptr(&picture.texture) as usize;
        let mut holdings = self.holdings();
        if holdings.counted.contains(&address) {
            return Ok(());
        }
        // The process was charged when it was decoded, the session for each scene that shows it.
        let share = match self.budget.parent() {
            Some(_) => self.budget.take_here(picture.texture.bytes(), "pictures"),
            None => Ok(self.budget.nothing()),
        };
        let share = share.map_err(|over| self.remember(over))?;
        holdings.counted.insert(address);
        holdings.pictures.push((Arc::clone(&picture.held), share));
        Ok(())
    }
}

/// Working memory of a loader.
#[derive(Debug)]
pub struct Scratch<'a> {
    context: &'a LoadContext,
    held: Held,
    what: &'static str,
}

impl Scratch<'_> {
    /// Makes sure that at least `bytes` are taken in all, and that loading goes on. Cheap enough to
    /// be asked before each push to a growing list.
    pub fn hold(&mut self, bytes: u64) -> Result<(), LoadError> {
        if bytes <= self.held.bytes() {
            return Ok(());
        }
        self.context.check()?;
        // Lists double when they grow, and what is copied is there twice for a moment.
        let needed = bytes - self.held.bytes();
        let generous = needed.max(STEP).max(self.held.bytes() / 4);
        let grown = match self.held.grow(generous, self.what) {
            Ok(()) => Ok(()),
            Err(_) => self.held.grow(needed, self.what),
        };
        grown.map_err(|over| self.context.remember(over))
    }

    /// As [`Self::hold`], as an error of a mesh file.
    pub(super) fn hold_for(&mut self, file: &str, bytes: usize) -> Result<(), MeshError> {
        self.hold(bytes as u64)
            .map_err(|error| MeshError::new(file, error.to_string()))
    }
}
