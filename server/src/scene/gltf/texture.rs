//! A file's textures, each decoded once. A texture that cannot be read is left out with a note.

use std::collections::{HashMap, HashSet};
use std::path::Path;
use std::sync::Arc;

use super::super::{Reading, Texture, Wrap, texture_file};
use super::accessor::Data;
use super::format::{Image, TextureEntry};
use super::uri;

/// The extension whose images can be decoded; it is preferred to the fallback.
const WEBP: &str = "EXT_texture_webp";

/// The textures of a file's materials.
pub(super) struct Textures<'a, 'n> {
    data: &'a Data<'a>,
    folder: &'a Path,
    /// By image and reading mode; the error for textures that cannot be read.
    decoded: HashMap<(usize, Reading), Result<Arc<Texture>, String>>,
    n_texels: u64,
    /// Samplers with unknown wrapping that was noted already.
    noted: HashSet<usize>,
    pub(super) notes: &'n mut Vec<String>,
}

impl<'a, 'n> Textures<'a, 'n> {
    pub(super) fn new(data: &'a Data<'a>, folder: &'a Path, notes: &'n mut Vec<String>) -> Self {
        Self {
            data,
            folder,
            decoded: HashMap::new(),
            n_texels: 0,
            noted: HashSet::new(),
            notes,
        }
    }

    /// A texture; `None`, with a note, if it cannot be read.
    pub(super) fn get(&mut self, index: usize, srgb: bool, at: &str) -> Option<Arc<Texture>> {
        let data = self.data;
        let Some(entry) = data.root.textures.get(index) else {
            self.notes.push(format!(
                "{at} left out: index: expected less than the {} textures, got {index}",
                data.root.textures.len()
            ));
            return None;
        };
        let reading = Reading {
            srgb,
            wrap: self.wrap(entry.sampler, at),
        };
        let mut problem = "it names no image".to_owned();
        for source in sources(entry) {
            match self.image(source, reading) {
                Ok(texture) => return Some(texture),
                Err(reason) => problem = format!("images[{source}]: {reason}"),
            }
        }
        self.notes.push(format!("{at} left out: {problem}"));
        None
    }

    fn image(&mut self, index: usize, reading: Reading) -> Result<Arc<Texture>, String> {
        if let Some(known) = self.decoded.get(&(index, reading)) {
            return known.clone();
        }
        let images = &self.data.root.images;
        let texture = match images.get(index) {
            Some(image) => self.decode(image, reading),
            None => Err(format!("expected less than the {} images", images.len())),
        };
        self.decoded.insert((index, reading), texture.clone());
        texture
    }

    fn decode(&mut self, image: &Image, reading: Reading) -> Result<Arc<Texture>, String> {
        let context = self.data.context;
        let texture = match (&image.uri, image.buffer_view) {
            (_, Some(view)) => {
                let bytes = self.data.view(view, "").map_err(|error| error.problem)?;
                context.texture(bytes, reading)?
            }
            (Some(text), None) => {
                let bytes = uri::resolve(context, text, self.folder, texture_file::MAX_BYTES)?;
                context.texture(&bytes, reading)?
            }
            (None, None) => return Err("expected a uri or a bufferView, got neither".to_owned()),
        };
        self.count(u64::from(texture.width) * u64::from(texture.height))?;
        Ok(texture)
    }

    /// Adds texels to be stored to the total; an error if there are too many.
    pub(super) fn count(&mut self, n_texels: u64) -> Result<(), String> {
        if self.n_texels + n_texels > texture_file::MAX_TEXELS_IN_ALL {
            return Err(format!(
                "expected at most {} texels in all, got more",
                texture_file::MAX_TEXELS_IN_ALL
            ));
        }
        self.n_texels += n_texels;
        Ok(())
    }

    /// Stores a texture made by this loader, within the budget.
    pub(super) fn keep(&mut self, texture: Texture) -> Result<Arc<Texture>, String> {
        self.count(u64::from(texture.width) * u64::from(texture.height))?;
        let context = self.data.context;
        context
            .keep(texture.bytes(), "pictures")
            .map_err(|error| error.to_string())?;
        Ok(Arc::new(texture))
    }

    /// Wrap modes along u and v.
    fn wrap(&mut self, sampler: Option<usize>, at: &str) -> [Wrap; 2] {
        let Some(index) = sampler else {
            return [Wrap::Repeat; 2];
        };
        let Some(sampler) = self.data.root.samplers.get(index) else {
            return [Wrap::Repeat; 2];
        };
        // OpenGL constants (glTF 2.0, 5.26).
        [sampler.wrap_s, sampler.wrap_t].map(|code| match code {
            None | Some(10_497) => Wrap::Repeat,
            Some(33_071) => Wrap::Clamp,
            Some(33_648) => Wrap::Mirror,
            Some(other) => {
                if self.noted.insert(index) {
                    self.notes.push(format!(
                        "{at}: the texture repeats: samplers[{index}]: expected 10497, 33071 or 33648 as wrapping, got {other}"
                    ));
                }
                Wrap::Repeat
            }
        })
    }
}

/// Candidate images of a texture, the best first.
fn sources(entry: &TextureEntry) -> Vec<usize> {
    let webp = entry.extensions.get(WEBP).and_then(|e| e.source);
    let mut others: Vec<_> = entry
        .extensions
        .iter()
        .filter(|(name, _)| *name != WEBP)
        .collect();
    others.sort_by_key(|(name, _)| *name);
    // An unsupported format comes last, so that its error is reported if no image can be read.
    let others = others.into_iter().filter_map(|(_, e)| e.source);
    webp.into_iter().chain(entry.source).chain(others).collect()
}
