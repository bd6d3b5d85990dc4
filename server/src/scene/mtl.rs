//! Wavefront MTL as far as it means something here: `Kd`, `Ke`, `Ns`, `Ni`, `d`, `Tr`,
//! `map_Kd`, and the physically based `Pr`, `Pm`. Missing or odd libraries are noted, not
//! errors: the mesh is still good.

use std::collections::HashMap;
use std::path::{Component, Path};
use std::sync::Arc;

use glam::Vec3;

use super::{LoadContext, Material, Texture, texture};

/// Largest library, bytes.
const MAX_BYTES: u64 = 16 << 20;

/// The materials of the libraries, by name.
pub(super) fn load(
    context: &LoadContext,
    libraries: &[&str],
    folder: &Path,
    notes: &mut Vec<String>,
) -> HashMap<String, Material> {
    let mut materials = HashMap::new();
    let mut textures = Textures {
        context,
        folder,
        decoded: HashMap::new(),
        n_texels: 0,
    };
    for library in libraries {
        match inside(library).and_then(|path| context.read(&folder.join(path), MAX_BYTES)) {
            Ok(bytes) => parse(&bytes, library, &mut textures, &mut materials, notes),
            Err(reason) => notes.push(format!("material library {library:?} left out: {reason}")),
        }
    }
    materials
}

/// Textures beside the libraries, each decoded once.
struct Textures<'a> {
    context: &'a LoadContext,
    folder: &'a Path,
    decoded: HashMap<String, Arc<Texture>>,
    n_texels: u64,
}

impl Textures<'_> {
    fn get(&mut self, name: &str) -> Result<Arc<Texture>, String> {
        if let Some(known) = self.decoded.get(name) {
            return Ok(Arc::clone(known));
        }
        let path = self.folder.join(inside(name)?);
        let bytes = self.context.read(&path, texture::MAX_BYTES)?;
        let texture = self.context.texture(&bytes, true)?;
        self.n_texels += texture.rgba.len() as u64;
        if self.n_texels > texture::MAX_TEXELS_IN_ALL {
            return Err(format!(
                "expected at most {} texels in all, got more",
                texture::MAX_TEXELS_IN_ALL
            ));
        }
        self.decoded.insert(name.to_owned(), Arc::clone(&texture));
        Ok(texture)
    }
}

/// A relative path that stays inside the folder it starts from.
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

fn parse(
    bytes: &[u8],
    library: &str,
    textures: &mut Textures<'_>,
    materials: &mut HashMap<String, Material>,
    notes: &mut Vec<String>,
) {
    let text = String::from_utf8_lossy(bytes);
    let mut current: Option<Material> = None;
    let mut odd_lines = 0usize;
    for line in text.lines() {
        let line = line.trim();
        let (keyword, value) = line.split_once(char::is_whitespace).unwrap_or((line, ""));
        let value = value.trim();
        if keyword == "newmtl" {
            if let Some(done) = current.take() {
                materials.insert(done.name.clone(), done);
            }
            current = Some(Material {
                name: value.to_owned(),
                roughness: 1.0,
                ..Material::default()
            });
            continue;
        }
        let Some(material) = current.as_mut() else {
            continue;
        };
        let ok = match keyword {
            "Kd" => set(&mut material.base_color, rgb(value, 1.0)),
            "Ke" => set(&mut material.emissive, rgb(value, 1e6)),
            // Blinn's exponent as a GGX width: alpha^2 = 2 / (Ns + 2), roughness^2 = alpha.
            "Ns" => set(
                &mut material.roughness,
                number(value, 0.0, 1e9).map(|ns| (2.0 / (ns + 2.0)).powf(0.25)),
            ),
            "Pr" => set(&mut material.roughness, number(value, 0.0, 1.0)),
            "Pm" => set(&mut material.metallic, number(value, 0.0, 1.0)),
            "Ni" => set(&mut material.ior, number(value, 1.0, 5.0)),
            "d" => set(
                &mut material.transmission,
                number(value, 0.0, 1.0).map(|d| 1.0 - d),
            ),
            "Tr" => set(&mut material.transmission, number(value, 0.0, 1.0)),
            "map_Kd" => {
                match textures.get(value) {
                    Ok(texture) => material.base_color_texture = Some(texture),
                    Err(reason) => notes.push(format!("texture {value:?} left out: {reason}")),
                }
                true
            }
            _ => true,
        };
        odd_lines += usize::from(!ok);
    }
    if let Some(done) = current {
        materials.insert(done.name.clone(), done);
    }
    if odd_lines > 0 {
        notes.push(format!(
            "material library {library:?}: {odd_lines} unusable lines left out"
        ));
    }
}

fn set<T>(slot: &mut T, value: Option<T>) -> bool {
    match value {
        Some(value) => {
            *slot = value;
            true
        }
        None => false,
    }
}

fn number(text: &str, lo: f32, hi: f32) -> Option<f32> {
    text.parse().ok().filter(|x| (lo..=hi).contains(x))
}

fn rgb(text: &str, hi: f32) -> Option<Vec3> {
    let mut channels = text.split_whitespace().map(|c| number(c, 0.0, hi));
    let r = channels.next()??;
    // One number stands for all three.
    match (channels.next(), channels.next()) {
        (None, _) => Some(Vec3::splat(r)),
        (Some(g), Some(b)) => Some(Vec3::new(r, g?, b?)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_stay_in_the_folder() {
        for bad in ["../x.mtl", "/etc/passwd", "a/../../b", "", ".", ".."] {
            assert!(inside(bad).is_err(), "{bad}");
        }
        assert!(inside("a/b.mtl").is_ok() && inside("./b.mtl").is_ok());
    }

    #[test]
    fn values_are_read_and_odd_ones_counted() {
        let mut materials = HashMap::new();
        let mut notes = Vec::new();
        let text = b"Kd 1 1 1\nnewmtl a\nKd 0.5\nNs 30\nd 0.25\nNi 1.33\nPm 2\nKe 1 nan 1\nmap_Kd ../x.png\n";
        let context = LoadContext::default();
        let mut textures = Textures {
            context: &context,
            folder: Path::new(""),
            decoded: HashMap::new(),
            n_texels: 0,
        };
        parse(text, "l.mtl", &mut textures, &mut materials, &mut notes);
        let a = &materials["a"];
        assert_eq!(
            (a.base_color, a.transmission, a.ior, a.metallic),
            (Vec3::splat(0.5), 0.75, 1.33, 0.0)
        );
        assert!((a.roughness - 0.5).abs() < 1e-6);
        assert_eq!(notes.len(), 2, "{notes:?}");
        assert!(notes[1].contains("2 unusable lines"), "{notes:?}");
    }
}
