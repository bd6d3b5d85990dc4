//! Wavefront MTL, limited to statements that can be rendered: `Kd`, `Ke`, `Ns`, `Ni`, `d`, `Tr`, the physically based
//! `Pr`, `Pm`, and textures for colour, opacity, emission, normals, roughness and metallic. Missing or damaged
//! libraries are notes, not errors: the mesh is still usable.

mod files;
mod maps;

use std::collections::HashMap;
use std::path::{Component, Path};

use glam::{Vec2, Vec3, Vec4};

use self::files::Files;
use self::maps::{MapLine, Textures};
use super::obj::line::{split_keyword, take_line};
use super::{AlphaMode, LoadContext, Material};
use crate::numerics::{linear_from_srgb, linear_from_srgb_part};
use crate::text;

pub(super) use self::maps::Textures as TextureFiles;

/// Largest library file, bytes.
const MAX_BYTES: u64 = 16 << 20;

/// Statements that are not rendered.
const NOT_RENDERED: [&str; 17] = [
    "map_ka", "map_ks", "map_ns", "map_tr", "map_refl", "refl", "disp", "decal", "map_disp", "pc",
    "pcr", "ps", "aniso", "anisor", "map_ps", "map_pc", "map_rma",
];

/// A material, and its changes to the meshes that use it.
pub(super) struct Entry {
    pub(super) material: Material,
    pub(super) uvs: UvTransform,
}

/// The change of texture coordinates by a material's `-s` and `-o` options.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct UvTransform {
    scale: Vec2,
    offset: Vec2,
}

impl UvTransform {
    const NONE: Self = Self {
        scale: Vec2::ONE,
        offset: Vec2::ZERO,
    };

    /// `uvs` count v from the top, MTL counts it from the bottom.
    pub(super) fn apply_to(&self, uvs: &mut [Vec2]) {
        if *self == Self::NONE {
            return;
        }
        for uv in uvs {
            let up = Vec2::new(uv.x, 1.0 - uv.y) * self.scale + self.offset;
            *uv = Vec2::new(up.x, 1.0 - up.y);
        }
    }
}

/// The materials of all libraries of a mesh, by name.
pub(super) struct Library<'a> {
    materials: HashMap<String, Raw>,
    textures: Textures<'a>,
    notes: Vec<String>,
}

/// Reads the libraries; `names` are the unparsed arguments of the `mtllib` lines. If a library is not found, one with
/// the mesh's own name is tried.
pub(super) fn load<'a>(
    context: &'a LoadContext,
    names: &[Vec<u8>],
    folder: &'a Path,
    mesh: &Path,
    notes: &mut Vec<String>,
) -> Library<'a> {
    let mut library = Library {
        materials: HashMap::new(),
        textures: Textures::new(context, folder),
        notes: Vec::new(),
    };
    let own = mesh.with_extension("mtl");
    let own = own.file_name().map(|name| name.as_encoded_bytes().to_vec());
    let mut read_own = false;
    for line in names {
        for name in library_names(line, library.textures.files()) {
            let shown = text::decode(&name).text.into_owned();
            let files = library.textures.files();
            let path = match files.find(&name) {
                Some(path) => path,
                None => {
                    let note = format!("material library {shown:?} left out: no such file");
                    let own = own.as_deref().filter(|_| !read_own);
                    let Some(path) = own.and_then(|own| files.find(own)) else {
                        notes.push(note);
                        continue;
                    };
                    read_own = true;
                    notes.push(format!("{note}; {} is read instead", path.display()));
                    path
                }
            };
            match context.read(&path, MAX_BYTES) {
                Ok(bytes) => library.parse(&bytes, &shown, notes),
                Err(reason) => {
                    notes.push(format!("material library {shown:?} left out: {reason}"));
                }
            }
        }
    }
    library
}

/// A line is one name with blanks if such a file exists, else several names.
fn library_names(line: &[u8], files: &mut Files<'_>) -> Vec<Vec<u8>> {
    if line.is_empty() {
        return Vec::new();
    }
    let blank = |line: &[u8]| !line.iter().any(u8::is_ascii_whitespace);
    if blank(line) || files.find(line).is_some() {
        return vec![line.to_vec()];
    }
    let mut names = Vec::new();
    let mut name: Vec<u8> = Vec::new();
    for word in line.split(u8::is_ascii_whitespace) {
        if word.starts_with(b"#") {
            break;
        }
        if !name.is_empty() {
            name.push(b' ');
        }
        name.extend_from_slice(word);
        let ends = name.len() >= 4 && name[name.len() - 4..].eq_ignore_ascii_case(b".mtl");
        if ends || files.find(&name).is_some() {
            names.push(std::mem::take(&mut name));
        }
    }
    if !name.trim_ascii().is_empty() {
        names.push(name.trim_ascii().to_vec());
    }
    names
}

/// Checks that a path is relative and stays inside its base folder.
pub(super) fn inside(path: &str) -> Result<&Path, String> {
    let path = Path::new(path);
    let stays = path
        .components()
        .all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if stays && path.file_name().is_some() {
        Ok(path)
    } else {
        Err(format!(
            "expected a file inside the mesh's folder, got {:?}",
            path.display().to_string()
        ))
    }
}

/// The statements of a material.
#[derive(Debug, Clone, Default)]
struct Raw {
    name: String,
    kd: Option<Vec3>,
    ke: Option<Vec3>,
    ns: Option<f32>,
    pr: Option<f32>,
    pm: Option<f32>,
    ni: Option<f32>,
    d: Option<f32>,
    tr: Option<f32>,
    map_kd: Option<MapLine>,
    map_ke: Option<MapLine>,
    map_d: Option<MapLine>,
    map_pr: Option<MapLine>,
    map_pm: Option<MapLine>,
    /// The map, and whether it is surely a normal map.
    map_normal: Option<(MapLine, bool)>,
}

impl Library<'_> {
    /// Finds a material by name, exactly or ignoring case; adds a note if there is none.
    pub(super) fn get(&mut self, name: &str) -> Option<Entry> {
        let uncommented = name.split(" #").next().unwrap_or(name).trim_end();
        let folded = uncommented.to_lowercase();
        let found = self
            .materials
            .get(name)
            .or_else(|| self.materials.get(uncommented))
            .or_else(|| {
                let same = |raw: &&Raw| raw.name.to_lowercase() == folded;
                let named = |raw: &&Raw| raw.name.clone();
                self.materials.values().filter(same).min_by_key(named)
            });
        match found.cloned() {
            Some(raw) => Some(self.finish(&raw)),
            None => {
                // Names that exporters use for "no material".
                if !["", "none", "(null)", "null"].contains(&folded.as_str()) {
                    self.notes
                        .push(format!("material {name:?} left out: it is in no library"));
                }
                None
            }
        }
    }

    /// The only material of the libraries, for a mesh that names none; `None` if there are several.
    pub(super) fn only(&mut self) -> Option<Entry> {
        let n = self.materials.len();
        let only = self.materials.values().next()?.clone();
        if n > 1 {
            self.notes.push(format!(
                "{n} materials left out: the mesh does not say which one it uses"
            ));
            return None;
        }
        Some(self.finish(&only))
    }

    /// Notes on the requested materials.
    pub(super) fn into_notes(self) -> Vec<String> {
        self.notes
    }

    fn parse(&mut self, bytes: &[u8], library: &str, notes: &mut Vec<String>) {
        let mut own: HashMap<String, Raw> = HashMap::new();
        let mut current: Option<Raw> = None;
        let mut odd_lines = 0usize;
        let mut not_rendered: Vec<&str> = Vec::new();
        let mut repeated: Option<String> = None;
        let mut keep = |done: Option<Raw>| {
            if let Some(done) = done
                && let Some(before) = own.insert(done.name.clone(), done)
            {
                repeated.get_or_insert(before.name);
            }
        };
        let bytes = text::clean(bytes);
        let mut rest = &*bytes;
        while !rest.is_empty() {
            let (line, _) = take_line(&mut rest);
            let (keyword, value) = split_keyword(&line);
            let keyword = String::from_utf8_lossy(keyword).to_lowercase();
            let value = value.trim_ascii();
            if keyword == "newmtl" {
                keep(current.take());
                current = Some(Raw {
                    name: text::decode(value).text.into_owned(),
                    ..Raw::default()
                });
                continue;
            }
            if let Some(&word) = NOT_RENDERED.iter().find(|word| **word == keyword)
                && !not_rendered.contains(&word)
            {
                not_rendered.push(word);
            }
            if let Some(material) = current.as_mut() {
                odd_lines += usize::from(!material.statement(&keyword, value));
            }
        }
        keep(current);
        // The library that is named first takes precedence.
        for (name, raw) in own {
            self.materials.entry(name).or_insert(raw);
        }
        if odd_lines > 0 {
            notes.push(format!(
                "material library {library:?}: {odd_lines} unusable lines left out"
            ));
        }
        if let Some(name) = repeated {
            notes.push(format!(
                "material library {library:?}: {name:?} is defined more than once, the last definition is used"
            ));
        }
        if !not_rendered.is_empty() {
            notes.push(format!(
                "material library {library:?}: not rendered: {}",
                not_rendered.join(", ")
            ));
        }
    }

    fn finish(&mut self, raw: &Raw) -> Entry {
        let textures = &mut self.textures;
        let notes = &mut self.notes;
        let map_kd = raw.map_kd.as_ref();
        let mut material = Material {
            name: raw.name.clone(),
            // With a texture and no colour, the texture is shown unchanged.
            base_color: raw.kd.unwrap_or(match map_kd {
                Some(_) => Vec3::ONE,
                None => Material::default().base_color,
            }),
            emissive: raw.ke.unwrap_or(Vec3::ZERO),
            // Blinn's exponent converted to a GGX width: alpha^2 = 2 / (Ns + 2), roughness^2 = alpha.
            roughness: raw
                .pr
                .or(raw.ns.map(|ns| (2.0 / (ns + 2.0)).powf(0.25)))
                .unwrap_or(1.0),
            metallic: raw.pm.unwrap_or(0.0),
            ior: raw.ni.unwrap_or(Material::default().ior),
            // `d` is specified. `Tr` is 1 - `d` for most exporters, and equal to `d` for some.
            transmission: raw.d.map(|d| 1.0 - d).or(raw.tr).unwrap_or(0.0),
            ..Material::default()
        };
        material.base_color_texture = map_kd.and_then(|map| textures.color(map, notes));
        if material.base_color_texture.is_some() && material.base_color == Vec3::ZERO {
            notes.push(format!(
                "material {:?}: black with a texture is read as the texture alone",
                raw.name
            ));
            material.base_color = Vec3::ONE;
        }
        if let Some(map) = &raw.map_d
            && let Some(texture) =
                textures.with_opacity(map, material.base_color_texture.as_ref(), notes)
        {
            material.base_color_texture = Some(texture);
            material.alpha = AlphaMode::Mask { cutoff: 0.5 };
        }
        if let Some(map) = &raw.map_ke {
            material.emissive_texture = textures.color(map, notes);
            if material.emissive_texture.is_some() && material.emissive == Vec3::ZERO {
                material.emissive = Vec3::ONE;
            }
        }
        if let Some((map, only_normals)) = &raw.map_normal {
            material.normal_texture = textures.normals(map, *only_normals, notes);
            material.normal_scale = map.bump.unwrap_or(1.0);
        }
        let roughness = raw.map_pr.as_ref();
        let metal = raw.map_pm.as_ref();
        if let Some(texture) = textures.roughness_and_metal(roughness, metal, notes) {
            material.metallic_roughness_texture = Some(texture);
            if roughness.is_some() {
                material.roughness = 1.0;
            }
            if metal.is_some() {
                material.metallic = 1.0;
            }
        }
        Entry {
            uvs: self.uvs_of(raw),
            material,
        }
    }

    /// The textures of a material share their coordinates: the scale and offset of the first one are used.
    fn uvs_of(&mut self, raw: &Raw) -> UvTransform {
        let normal = raw.map_normal.as_ref().map(|(map, _)| map);
        let maps = [
            &raw.map_kd,
            &raw.map_d,
            &raw.map_ke,
            &raw.map_pr,
            &raw.map_pm,
        ];
        let mut all = maps.into_iter().flatten().chain(normal).map(MapLine::uvs);
        let first = all.next().unwrap_or(UvTransform::NONE);
        if all.any(|other| other != first) {
            self.notes.push(format!(
                "material {:?}: its textures have scales and offsets of their own; the first counts",
                raw.name
            ));
        }
        first
    }
}

impl Raw {
    /// Reads one line; false if it cannot be used.
    fn statement(&mut self, keyword: &str, value: &[u8]) -> bool {
        let text = String::from_utf8_lossy(value);
        let text = text.split('#').next().unwrap_or_default().trim();
        match keyword {
            // No surface reflects more than 1.
            "kd" => set(&mut self.kd, rgb(text, 1e6).map(|kd| kd.min(Vec3::ONE))),
            "ke" => set(&mut self.ke, rgb(text, 1e6)),
            "ns" => set(&mut self.ns, number(text, 0.0, 1e9)),
            "pr" => set(&mut self.pr, number(text, 0.0, 1.0)),
            "pm" => set(&mut self.pm, number(text, 0.0, 1.0)),
            "ni" => set(&mut self.ni, number(text, 1.0, 5.0)),
            "d" => {
                let text = text.strip_prefix("-halo").unwrap_or(text).trim();
                set(&mut self.d, number(text, 0.0, 1.0))
            }
            "tr" => set(&mut self.tr, number(text, 0.0, 1.0)),
            "map_kd" => set(&mut self.map_kd, MapLine::parse(value)),
            "map_ke" => set(&mut self.map_ke, MapLine::parse(value)),
            "map_d" => set(&mut self.map_d, MapLine::parse(value)),
            "map_pr" => set(&mut self.map_pr, MapLine::parse(value)),
            "map_pm" => set(&mut self.map_pm, MapLine::parse(value)),
            "norm" | "map_kn" | "map_norm" => {
                let map = MapLine::parse(value).map(|map| (map, true));
                set(&mut self.map_normal, map)
            }
            // Heights by the specification, normals in most exporters; `norm` is unambiguous.
            "bump" | "map_bump" => match (&self.map_normal, MapLine::parse(value)) {
                (Some((_, true)), _) => true,
                (_, map) => set(&mut self.map_normal, map.map(|map| (map, false))),
            },
            _ => true,
        }
    }
}

fn set<T>(slot: &mut Option<T>, value: Option<T>) -> bool {
    let usable = value.is_some();
    if usable {
        *slot = value;
    }
    usable
}

fn number(text: &str, lo: f32, hi: f32) -> Option<f32> {
    let text = text.split_whitespace().next()?;
    text.parse().ok().filter(|x| (lo..=hi).contains(x))
}

fn rgb(text: &str, hi: f32) -> Option<Vec3> {
    let mut channels = text.split_whitespace().map(|c| number(c, 0.0, hi));
    let r = channels.next()??;
    // A single number is used for all three channels.
    match (channels.next(), channels.next()) {
        (None, _) => Some(Vec3::splat(r)),
        (Some(g), Some(b)) => Some(Vec3::new(r, g?, b?)),
        _ => None,
    }
}

/// Converts sRGB-coded colours to linear: 0 to 1 or, if any value is over 1.5, 0 to 255, as MeshLab, Open3D and
/// Blender write them. Colours that are not finite become white. Alpha is linear already.
pub(super) fn linear_from_coded(coded: impl Iterator<Item = Vec4> + Clone) -> Vec<Vec4> {
    let bytes = coded.clone().any(|c| c.truncate().max_element() > 1.5);
    let linear = |c: f32| {
        if !bytes {
            linear_from_srgb_part(c)
        } else if c.fract() == 0.0 {
            // The cast saturates.
            linear_from_srgb(c as u8)
        } else {
            linear_from_srgb_part(c / 255.0)
        }
    };
    let of = |c: Vec4| {
        if !c.is_finite() {
            return Vec4::ONE;
        }
        let alpha = if bytes && c.w > 1.5 { c.w / 255.0 } else { c.w };
        Vec4::new(linear(c.x), linear(c.y), linear(c.z), alpha.clamp(0.0, 1.0))
    };
    coded.map(of).collect()
}

#[cfg(test)]
mod tests;
