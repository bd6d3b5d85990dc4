//! Memory budget and cancellation of a scene being loaded.
//!
//! Loaders ask a [`LoadContext`] for memory before they allocate, and regularly check whether to continue. The
//! context remembers a refusal: even if a loader recovers from the error (for example by leaving out a texture), the
//! scene as a whole is rejected.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use super::error::{LoadError, MeshError};
use super::model::{MAX_TRIANGLES, Model};
use super::picture_cache::{Picture, PictureCache};
use super::{Reading, Texture, file, texture_file};
use crate::memory::{Budget, Held, OverBudget};

/// Smallest increment of working memory, bytes: keeps calls to the budget rare.
const STEP: u64 = 1 << 20;

/// Budget, cancellation and shared pictures of one scene being loaded. It holds the memory that the scene takes from
/// the budget, and the mesh files read: keep it as long as the scene.
#[derive(Debug)]
pub struct LoadContext {
    budget: Budget,
    stop: Arc<AtomicBool>,
    max_triangles: usize,
    pictures: Arc<PictureCache>,
    refused: OnceLock<OverBudget>,
    pub(super) models: Mutex<HashMap<PathBuf, Arc<Model>>>,
    held: Mutex<Holdings>,
}

/// Memory held by a scene.
#[derive(Debug)]
struct Holdings {
    own: Held,
    /// Bytes of the files of the model being read.
    files: Held,
    /// Pictures; other scenes may hold the same ones.
    pictures: Vec<(Arc<Held>, Held)>,
    /// Addresses of the pictures that were counted.
    counted: HashSet<usize>,
}

impl Default for LoadContext {
    /// Uses the machine's memory as its budget and is never cancelled; pictures are shared with all other scenes of
    /// the process.
    fn default() -> Self {
        Self::new(Budget::of_the_machine(), Arc::default())
    }
}

impl LoadContext {
    /// Uses the given budget; loading ends soon after `stop` is set.
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
            models: Mutex::default(),
        }
    }

    /// Sets the limit on stored triangles.
    #[must_use]
    pub fn with_max_triangles(mut self, max_triangles: usize) -> Self {
        self.max_triangles = max_triangles.min(MAX_TRIANGLES);
        self
    }

    /// Most triangles that may be stored.
    pub fn max_triangles(&self) -> usize {
        self.max_triangles
    }

    /// Whether loading was cancelled.
    pub fn is_cancelled(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// Checks that loading was neither cancelled nor refused.
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
        // Every critical section leaves its data consistent.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn remember(&self, over: OverBudget) -> LoadError {
        LoadError::Memory(self.refused.get_or_init(|| over).clone())
    }

    /// Takes memory that the scene will keep, before it is allocated.
    pub fn keep(&self, bytes: u64, what: &str) -> Result<(), LoadError> {
        self.check()?;
        let grown = self.holdings().own.grow(bytes, what);
        grown.map_err(|over| self.remember(over))
    }

    /// Working memory, returned to the budget on drop.
    pub fn scratch(&self, what: &'static str) -> Scratch<'_> {
        Scratch {
            context: self,
            held: self.budget.nothing(),
            what,
        }
    }

    /// Reads a file; its bytes count until [`Self::close_files`]. The error says why it cannot be read.
    pub(super) fn read(&self, path: &Path, max_bytes: u64) -> Result<Vec<u8>, String> {
        file::read_within(path, max_bytes, |size| {
            self.check().map_err(|error| error.to_string())?;
            let grown = self.holdings().files.grow(size, "bytes of files");
            grown.map_err(|over| self.remember(over).to_string())
        })
    }

    /// Takes memory for data decoded from a file, which counts until [`Self::close_files`].
    pub(super) fn unpack(&self, bytes: u64) -> Result<(), String> {
        self.check().map_err(|error| error.to_string())?;
        let grown = self
            .holdings()
            .files
            .grow(bytes, "bytes of files, unpacked");
        grown.map_err(|over| self.remember(over).to_string())
    }

    /// Bytes that the budget has left.
    pub(super) fn left(&self) -> u64 {
        let left = |budget: &Budget| budget.limit().saturating_sub(budget.held());
        let own = left(&self.budget);
        self.budget
            .parent()
            .map_or(own, |parent| own.min(left(parent)))
    }

    /// Releases the memory of all files read so far.
    pub(super) fn close_files(&self) {
        self.holdings().files.shrink_to(0);
    }

    /// Decodes a picture, unless this process already holds a picture of the same bytes.
    pub(super) fn texture(&self, bytes: &[u8], reading: Reading) -> Result<Arc<Texture>, String> {
        self.check().map_err(|error| error.to_string())?;
        let picture = self.pictures.get_or_decode(bytes, reading, || {
            let mut scratch = self.scratch("pictures, while they are decoded");
            let texture = texture_file::decode_within(bytes, reading, |peak| {
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

    /// Counts a shared picture once for this scene.
    fn count(&self, picture: &Picture) -> Result<(), LoadError> {
        let address = Arc::as_ptr(&picture.texture) as usize;
        let mut holdings = self.holdings();
        if holdings.counted.contains(&address) {
            return Ok(());
        }
        // The process is charged once per decoded picture, the session once per scene that uses it.
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
    /// Ensures that at least `bytes` are reserved in total and that loading is not cancelled. Cheap enough to call
    /// before each push to a growing list.
    pub fn hold(&mut self, bytes: u64) -> Result<(), LoadError> {
        if bytes <= self.held.bytes() {
            return Ok(());
        }
        self.context.check()?;
        // A growing list doubles its capacity, and its old content exists twice while it is copied.
        let needed = bytes - self.held.bytes();
        let generous = needed.max(STEP).max(self.held.bytes() / 4);
        let grown = match self.held.grow(generous, self.what) {
            Ok(()) => Ok(()),
            Err(_) => self.held.grow(needed, self.what),
        };
        grown.map_err(|over| self.context.remember(over))
    }

    /// As [`Self::hold`], with the error of a mesh file.
    pub(super) fn hold_for(&mut self, file: &str, bytes: usize) -> Result<(), MeshError> {
        self.hold(bytes as u64)
            .map_err(|error| MeshError::new(file, error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;
    use crate::scene::Material;

    const SIDE: u32 = 256;
    const PICTURE_BYTES: u64 = 4 * (SIDE as u64) * (SIDE as u64);

    /// Writes files of one triangle each that all use one picture, with colours from `seed`: the process-wide cache
    /// must not contain pictures of another test.
    fn write_files(folder: &Path, n: usize, seed: u8) -> Vec<PathBuf> {
        let picture =
            image::RgbImage::from_fn(SIDE, SIDE, |x, y| image::Rgb([x as u8, y as u8, seed]));
        let mut png = Cursor::new(Vec::new());
        picture.write_to(&mut png, image::ImageFormat::Png).unwrap();
        std::fs::write(folder.join("p.png"), png.into_inner()).unwrap();
        let text = r#"{"asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "material": 0}]}],
            "materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
            "textures": [{"source": 0}], "images": [{"uri": "p.png"}],
            "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}]}"#;
        let name = |i: usize| folder.join(format!("{i}.gltf"));
        for i in 0..n {
            std::fs::write(name(i), text).unwrap();
        }
        (0..n).map(name).collect()
    }

    fn picture_of(model: &Model) -> Option<Arc<Texture>> {
        let materials: &[Material] = &model.materials;
        materials[0].base_color_texture.clone()
    }

    #[test]
    fn a_picture_that_many_files_and_scenes_show_is_decoded_and_held_once() {
        let folder = tempfile::tempdir().unwrap();
        let files = write_files(folder.path(), 8, 1);
        let process = Budget::new("all sessions", 64 << 20);
        let scene = || LoadContext::new(process.part("the session", 32 << 20), Arc::default());
        let (one, other) = (scene(), scene());
        let mut pictures = Vec::new();
        for file in &files {
            for context in [&one, &other] {
                let model = context.model(file).unwrap();
                // A file is read only once, too.
                assert!(Arc::ptr_eq(&model, &context.model(file).unwrap()));
                pictures.push(picture_of(&model).unwrap());
            }
        }
        assert!(pictures.iter().all(|p| Arc::ptr_eq(p, &pictures[0])));
        // Each session is charged for the pictures it uses, the process for the pictures it holds.
        let picture_bytes = pictures[0].bytes();
        assert!((PICTURE_BYTES..PICTURE_BYTES * 3 / 2).contains(&picture_bytes));
        let triangles = 8 * one.model(&files[0]).unwrap().meshes[0].bytes();
        for context in [&one, &other] {
            assert_eq!(context.budget.held(), picture_bytes + triangles);
        }
        assert_eq!(process.held(), picture_bytes + 2 * triangles);
        drop((one, pictures));
        assert_eq!(process.held(), picture_bytes + triangles);
        drop(other);
        assert_eq!(process.held(), 0);
    }

    #[test]
    fn a_scene_over_its_budget_is_refused_whatever_is_made_of_the_picture() {
        let folder = tempfile::tempdir().unwrap();
        let files = write_files(folder.path(), 8, 2);
        let budget = Budget::new("the session", PICTURE_BYTES / 2);
        let context = LoadContext::new(budget.clone(), Arc::default());
        for file in &files {
            // Either with a note that the picture is left out, or not at all.
            if let Ok(model) = context.model(file) {
                assert!(picture_of(&model).is_none());
            }
        }
        let error = context.check().unwrap_err().to_string();
        assert!(
            error.contains("left of the") && error.contains("for the session"),
            "{error}"
        );
        // Nothing was decoded.
        assert!(budget.held() < PICTURE_BYTES / 2);
        drop(context);
        assert_eq!(budget.held(), 0);
    }

    #[test]
    fn loading_ends_when_it_is_cancelled() {
        let folder = tempfile::tempdir().unwrap();
        let files = write_files(folder.path(), 1, 3);
        let stop = Arc::new(AtomicBool::new(true));
        let context = LoadContext::new(Budget::unlimited(), stop);
        assert!(context.model(&files[0]).is_err());
        assert_eq!(context.check(), Err(LoadError::Cancelled));
    }
}
