//! Texture statements of MTL, and the textures made from them.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::Vec2;

use super::UvTransform;
use super::files::Files;
use crate::scene::{LoadContext, Reading, Texture, Wrap, texture_file};
use crate::text;

/// Texels sampled to distinguish a normal map from a height map.
const SAMPLES: usize = 4096;

/// The texture channel that a value is read from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Channel {
    Red,
    Green,
    Blue,
    Alpha,
    /// The luminance of a colour picture.
    Luminance,
}

/// A `map_...` statement with its options.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct MapLine {
    /// Candidate file names, the most literal first.
    names: Vec<Vec<u8>>,
    scale: Vec2,
    offset: Vec2,
    /// `-bm`
    pub(super) bump: Option<f32>,
    channel: Option<Channel>,
    /// `-clamp on`
    clamped: bool,
}

impl MapLine {
    /// Options come before the file name, which may contain blanks; `None` without a name.
    pub(super) fn parse(value: &[u8]) -> Option<Self> {
        let mut line = Self {
            names: Vec::new(),
            scale: Vec2::ONE,
            offset: Vec2::ZERO,
            bump: None,
            channel: None,
            clamped: false,
        };
        let mut rest = value.trim_ascii();
        // A file may have the name of an option.
        line.names.push(rest.to_vec());
        while let Some(after) = line.option(rest) {
            rest = after;
        }
        if rest.is_empty() {
            return None;
        }
        if rest.len() < line.names[0].len() {
            // The options have been read, so the remaining text is the more likely name.
            line.names.insert(0, rest.to_vec());
        }
        // A comment, or options after the name.
        for marks in [&b" #"[..], b"\t#", b" -"] {
            if let Some(at) = rest.windows(2).position(|pair| pair == marks) {
                let head = rest[..at].trim_ascii_end();
                if marks == b" -" {
                    let mut late = line.clone();
                    let mut tail = rest[at..].trim_ascii();
                    while let Some(after) = late.option(tail) {
                        tail = after;
                    }
                    if tail.is_empty() {
                        line = late;
                    }
                }
                line.names.push(head.to_vec());
            }
        }
        Some(line)
    }

    /// Reads one option at the front; returns the rest of the line. The last word never belongs to an option if no
    /// name came before.
    fn option<'a>(&mut self, line: &'a [u8]) -> Option<&'a [u8]> {
        let (option, mut rest) = word(line)?;
        let option = std::str::from_utf8(option).ok()?.to_lowercase();
        let (least, most) = match option.as_str() {
            "-blendu" | "-blendv" | "-bm" | "-boost" | "-cc" | "-clamp" | "-imfchan"
            | "-texres" | "-type" | "-colorspace" => (1, 1),
            "-mm" => (2, 2),
            "-o" | "-s" | "-t" => (1, 3),
            _ => return None,
        };
        let mut numbers = Vec::new();
        for k in 0..most {
            let Some((value, after)) = word(rest) else {
                break;
            };
            let number = std::str::from_utf8(value)
                .ok()
                .and_then(|v| v.parse::<f32>().ok());
            // Up to three numbers; reading stops at the name, which is not a number.
            if k >= least && number.is_none() {
                break;
            }
            numbers.push(number);
            if option == "-clamp" {
                self.clamped = value.eq_ignore_ascii_case(b"on");
            }
            if option == "-imfchan" {
                self.channel = match value.to_ascii_lowercase().as_slice() {
                    b"r" => Some(Channel::Red),
                    b"g" => Some(Channel::Green),
                    b"b" => Some(Channel::Blue),
                    b"m" => Some(Channel::Alpha),
                    _ => Some(Channel::Luminance),
                };
            }
            rest = after;
        }
        let pair = |default: f32| {
            let number = |k: usize| {
                let number = numbers.get(k).copied().flatten();
                number.filter(|x| x.is_finite()).unwrap_or(default)
            };
            Vec2::new(number(0), number(1))
        };
        match option.as_str() {
            "-s" => self.scale = pair(1.0),
            "-o" => self.offset = pair(0.0),
            "-bm" => self.bump = Some(pair(1.0).x.clamp(-1e3, 1e3)),
            _ => {}
        }
        Some(rest)
    }

    pub(super) fn uvs(&self) -> UvTransform {
        UvTransform {
            scale: self.scale,
            offset: self.offset,
        }
    }

    fn shown(&self) -> String {
        let name = self.names.first().map(Vec::as_slice).unwrap_or_default();
        format!("{:?}", text::decode(name).text)
    }
}

/// The next word, and the rest.
fn word(line: &[u8]) -> Option<(&[u8], &[u8])> {
    let line = line.trim_ascii_start();
    let end = line
        .iter()
        .position(u8::is_ascii_whitespace)
        .unwrap_or(line.len());
    let (word, rest) = line.split_at(end);
    (!word.is_empty()).then(|| (word, rest.trim_ascii_start()))
}

/// Textures beside the mesh, each decoded only once.
pub(in crate::scene) struct Textures<'a> {
    context: &'a LoadContext,
    files: Files<'a>,
    decoded: HashMap<(PathBuf, Reading), Arc<Texture>>,
    n_texels: u64,
}

impl<'a> Textures<'a> {
    pub(in crate::scene) fn new(context: &'a LoadContext, folder: &'a Path) -> Self {
        Self {
            context,
            files: Files::new(folder),
            decoded: HashMap::new(),
            n_texels: 0,
        }
    }

    pub(super) fn files(&mut self) -> &mut Files<'a> {
        &mut self.files
    }

    /// A texture, by its name alone.
    pub(in crate::scene) fn named(
        &mut self,
        name: &[u8],
        notes: &mut Vec<String>,
    ) -> Option<Arc<Texture>> {
        let line = MapLine {
            names: vec![name.to_vec()],
            scale: Vec2::ONE,
            offset: Vec2::ZERO,
            bump: None,
            channel: None,
            clamped: false,
        };
        self.color(&line, notes)
    }

    /// A colour texture.
    pub(super) fn color(&mut self, map: &MapLine, notes: &mut Vec<String>) -> Option<Arc<Texture>> {
        self.get(map, true, notes)
    }

    fn get(&mut self, map: &MapLine, srgb: bool, notes: &mut Vec<String>) -> Option<Arc<Texture>> {
        let found = map.names.iter().find_map(|name| self.files.find(name));
        let wrap = if map.clamped {
            Wrap::Clamp
        } else {
            Wrap::Repeat
        };
        let reading = Reading {
            srgb,
            wrap: [wrap; 2],
        };
        let texture = match found {
            Some(path) => self.read(path, reading),
            None => Err("no such file beside the mesh".to_owned()),
        };
        texture
            .map_err(|reason| notes.push(format!("texture {} left out: {reason}", map.shown())))
            .ok()
    }

    fn read(&mut self, path: PathBuf, reading: Reading) -> Result<Arc<Texture>, String> {
        let key = (path, reading);
        if let Some(known) = self.decoded.get(&key) {
            return Ok(Arc::clone(known));
        }
        let bytes = self.context.read(&key.0, texture_file::MAX_BYTES)?;
        let texture = self.context.texture(&bytes, reading)?;
        self.count(texture.rgba.len())?;
        self.decoded.insert(key, Arc::clone(&texture));
        Ok(texture)
    }

    fn count(&mut self, n_texels: usize) -> Result<(), String> {
        self.n_texels += n_texels as u64;
        if self.n_texels <= texture_file::MAX_TEXELS_IN_ALL {
            return Ok(());
        }
        Err(format!(
            "expected at most {} texels in all, got more",
            texture_file::MAX_TEXELS_IN_ALL
        ))
    }

    /// A normal map. If it may be a height map, its colours decide: normal maps are mostly blue.
    pub(super) fn normals(
        &mut self,
        map: &MapLine,
        only_normals: bool,
        notes: &mut Vec<String>,
    ) -> Option<Arc<Texture>> {
        let texture = self.get(map, false, notes)?;
        if only_normals || holds_normals(&texture) {
            return Some(texture);
        }
        notes.push(format!(
            "texture {} left out: heights, which are not rendered (normals are)",
            map.shown()
        ));
        None
    }

    /// The colours of a texture (white without one), with the opacity map as alpha.
    pub(super) fn with_opacity(
        &mut self,
        map: &MapLine,
        color: Option<&Arc<Texture>>,
        notes: &mut Vec<String>,
    ) -> Option<Arc<Texture>> {
        let opacity = self.get(map, false, notes)?;
        let has_alpha = opacity.rgba.iter().any(|texel| texel[3] < 255);
        let channel = map.channel.unwrap_or(match has_alpha {
            true => Channel::Alpha,
            false => Channel::Luminance,
        });
        self.combined(color.unwrap_or(&opacity), true, map, notes, |texel, uv| {
            let alpha = value(&opacity, uv, channel);
            match color {
                Some(_) => [texel[0], texel[1], texel[2], alpha],
                None => [255, 255, 255, alpha],
            }
        })
    }

    /// A combined texture of roughness and metallic, as in glTF; `None` without either.
    pub(super) fn roughness_and_metal(
        &mut self,
        roughness: Option<&MapLine>,
        metal: Option<&MapLine>,
        notes: &mut Vec<String>,
    ) -> Option<Arc<Texture>> {
        let mut read = |map: Option<&MapLine>| {
            let map = map?;
            let channel = map.channel.unwrap_or(Channel::Luminance);
            Some((self.get(map, false, notes)?, channel))
        };
        let (rough, metallic) = (read(roughness), read(metal));
        let like = rough.as_ref().or(metallic.as_ref())?.0.clone();
        let of = |map: &Option<(Arc<Texture>, Channel)>, uv: Vec2| match map {
            Some((texture, channel)) => value(texture, uv, *channel),
            None => 255,
        };
        let map = roughness.or(metal)?;
        self.combined(&like, false, map, notes, |_, uv| {
            [255, of(&rough, uv), of(&metallic, uv), 255]
        })
    }

    /// A new texture of the size of another one, computed from each texel and its position.
    fn combined(
        &mut self,
        like: &Texture,
        srgb: bool,
        map: &MapLine,
        notes: &mut Vec<String>,
        texel: impl Fn([u8; 4], Vec2) -> [u8; 4],
    ) -> Option<Arc<Texture>> {
        let size = Texture::bytes_of(like.rgba.len() as u64);
        let kept = self
            .context
            .keep(size, "pictures")
            .map_err(|e| e.to_string());
        if let Err(reason) = kept.and_then(|()| self.count(like.rgba.len())) {
            notes.push(format!("texture {} left out: {reason}", map.shown()));
            return None;
        }
        let (width, height) = (like.width, like.height);
        let at = |i: usize| {
            let (x, y) = (i as u32 % width, i as u32 / width);
            Vec2::new(
                (x as f32 + 0.5) / width as f32,
                (y as f32 + 0.5) / height as f32,
            )
        };
        let rgba = like.rgba.iter().enumerate();
        let rgba = rgba.map(|(i, &old)| texel(old, at(i))).collect();
        let wrap = like.reading.wrap;
        let texture = Texture::read_as(width, height, rgba, Reading { srgb, wrap });
        Some(Arc::new(texture))
    }
}

/// The value of a linear texture at a position, 0..=255.
fn value(texture: &Texture, uv: Vec2, channel: Channel) -> u8 {
    let [r, g, b, a] = texture.sample(uv);
    let value = match channel {
        Channel::Red => r,
        Channel::Green => g,
        Channel::Blue => b,
        Channel::Alpha => a,
        Channel::Luminance => 0.2126 * r + 0.7152 * g + 0.0722 * b,
    };
    (255.0 * value).round() as u8
}

/// Whether a texture looks like a normal map: its mean direction is straight up.
fn holds_normals(texture: &Texture) -> bool {
    let stride = texture.rgba.len().div_ceil(SAMPLES).max(1);
    let (mut sums, mut n) = ([0u64; 3], 0u64);
    for texel in texture.rgba.iter().step_by(stride) {
        for (sum, &channel) in sums.iter_mut().zip(texel) {
            *sum += u64::from(channel);
        }
        n += 1;
    }
    let [r, g, b] = sums.map(|sum| sum / n.max(1));
    (98..158).contains(&r) && (98..158).contains(&g) && b > 180
}
