//! Stanford PLY, ascii and binary of both byte orders: vertices `x y z`, optionally with normals, texture coordinates
//! and colours; polygons, with texture coordinates per corner as written by MeshLab, or with face colours; and
//! triangle strips. Everything left out is noted.

mod header;
mod reader;

use std::collections::HashMap;
use std::path::Path;

use glam::{DVec3, Vec2, Vec3, Vec4};

use self::header::{Element, Header, Number};
use self::reader::Reader;
use super::error::MeshError;
use super::load::Scratch;
use super::model::{MAX_TRIANGLES, Model};
use super::mtl::{self, TextureFiles};
use super::odd::Odd;
use super::polygons::{BAD, NONE, Polygons};
use super::{LoadContext, Material};
use crate::text;

/// Names of the faces' vertex list.
const CORNERS: [&str; 4] = [
    "vertex_indices",
    "vertex_index",
    "vertex_indexes",
    "vertices",
];

/// Content of the elements.
#[derive(Default)]
struct Listing {
    polygons: Polygons,
    /// Texture index of each face; empty if the file has none.
    textures: Vec<u32>,
    has_normals: bool,
    has_uvs: bool,
    odd: Odd,
    left_out: Vec<String>,
}

/// As [`load_with`], without limits.
#[cfg(test)]
fn load(bytes: &[u8], name: &str, folder: &Path) -> Result<Model, MeshError> {
    load_with(&LoadContext::default(), bytes, name, folder)
}

/// Reads a PLY file from memory; textures are searched in `folder`.
pub(super) fn load_with(
    context: &LoadContext,
    bytes: &[u8],
    name: &str,
    folder: &Path,
) -> Result<Model, MeshError> {
    let mut scratch = context.scratch("triangles, while they are read");
    if bytes.starts_with(b"\xFF\xFE") || bytes.starts_with(b"\xFE\xFF") {
        // Twice the file size, for text in UTF-16.
        scratch.hold_for(name, 2 * bytes.len())?;
        return load_with(context, &text::clean(bytes), name, folder);
    }
    let (header, body) = header::read(bytes, name)?;
    let mut reader = Reader {
        rest: body,
        format: header.format,
        file: name,
        n_bytes: bytes.len(),
    };
    let listing = read_elements(&mut reader, &header, &mut scratch)?;
    let mut notes: Vec<String> = listing.odd.into_notes().collect();
    let built = listing.polygons.build(name, &mut notes, &mut scratch)?;
    drop(scratch);
    if !listing.left_out.is_empty() {
        notes.push(format!("left out: {}", listing.left_out.join(", ")));
    }
    let mut model = Model {
        notes,
        report: built.report,
        ..Model::default()
    };
    model.note_report();
    let of_texture = if built.mesh.uvs.is_empty() && !header.textures.is_empty() {
        let note = "textures left out: there are no texture coordinates";
        model.notes.push(note.to_owned());
        Vec::new()
    } else {
        textured_materials(context, &header, folder, &mut model)
    };
    let of_triangle: Vec<Option<usize>> = built
        .faces
        .iter()
        .map(|&face| {
            let texture = listing.textures.get(face as usize).copied().unwrap_or(0);
            of_texture.get(texture as usize).copied().flatten()
        })
        .collect();
    model.push_by_material(built.mesh, &of_triangle, &[]);
    Ok(model)
}

fn read_elements(
    reader: &mut Reader<'_>,
    header: &Header,
    scratch: &mut Scratch<'_>,
) -> Result<Listing, MeshError> {
    let mut listing = Listing::default();
    let find = |name: &str| header.elements.iter().find(|e| e.name == name);
    let faces = find("face").or(find("tristrips"));
    if faces.is_none_or(|faces| faces.count == 0) {
        let n = find("vertex").map_or(0, |vertices| vertices.count);
        return Err(MeshError::new(
            reader.file,
            format!("expected a mesh, got a point cloud: {n} vertices and no faces"),
        ));
    }
    if let Some(vertices) = find("vertex") {
        // Set here, because faces may come before the vertices.
        listing.has_normals = normal_of(vertices).is_some();
        listing.has_uvs = uv_of(vertices).is_some();
    }
    let mut meshes = 0;
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => listing.vertices(reader, element, scratch)?,
            "face" => listing.faces(reader, element, scratch)?,
            "tristrips" => listing.strips(reader, element, scratch)?,
            other => {
                if element.count > 0 && !element.properties.is_empty() {
                    listing.left_out.push(format!("{} {other}", element.count));
                }
                // All required elements may have been read already.
                match skip(reader, element) {
                    Err(_) if meshes > 1 => break,
                    skipped => skipped?,
                }
                continue;
            }
        }
        meshes += 1;
    }
    if listing.polygons.colors.is_empty() {
        let colors = std::mem::take(&mut listing.polygons.face_colors);
        listing.polygons.face_colors = mtl::linear_from_coded(colors.iter().copied());
    } else if !listing.polygons.face_colors.is_empty() {
        listing.polygons.face_colors.clear();
        listing.left_out.push("colours of faces".to_owned());
    }
    Ok(listing)
}

/// Positions of three properties that belong together.
fn vector(element: &Element, names: [&str; 3]) -> Option<[usize; 3]> {
    match names.map(|name| element.scalar(&[name])) {
        [Some(x), Some(y), Some(z)] => Some([x, y, z]),
        _ => None,
    }
}

/// Positions of a vertex's normal.
fn normal_of(element: &Element) -> Option<[usize; 3]> {
    let named = |names| vector(element, names);
    named(["nx", "ny", "nz"]).or_else(|| named(["normal_x", "normal_y", "normal_z"]))
}

/// Positions of a vertex's texture coordinates.
fn uv_of(element: &Element) -> Option<[usize; 2]> {
    [
        ["s", "t"],
        ["u", "v"],
        ["texture_u", "texture_v"],
        ["texture_s", "texture_t"],
        ["tx", "ty"],
    ]
    .into_iter()
    .find_map(|[u, v]| Some([element.scalar(&[u])?, element.scalar(&[v])?]))
}

/// Position of a face's vertex list.
fn corners_of(reader: &Reader<'_>, element: &Element) -> Result<usize, MeshError> {
    element.list(&CORNERS).ok_or_else(|| {
        MeshError::at(
            reader.file,
            format!("element {}", element.name),
            "expected a list property vertex_indices",
        )
    })
}

/// Positions of red, green and blue, and the factor for their values. Alpha is ignored: a mesh without a material is
/// opaque.
struct Color {
    at: [usize; 3],
    scale: f64,
}

impl Color {
    fn find(element: &Element) -> Option<Self> {
        let find = |[r, g, b]: [&str; 3]| {
            Some([
                element.scalar(&[r])?,
                element.scalar(&[g])?,
                element.scalar(&[b])?,
            ])
        };
        let at = find(["red", "green", "blue"])
            .or_else(|| find(["diffuse_red", "diffuse_green", "diffuse_blue"]))
            .or_else(|| find(["r", "g", "b"]))?;
        Some(Self {
            at,
            scale: match element.properties[at[0]].item {
                Number::U8 => 1.0 / 255.0,
                Number::U16 => 1.0 / 65_535.0,
                _ => 1.0,
            },
        })
    }

    /// The colour, sRGB-coded.
    fn of(&self, values: &[f64]) -> Vec4 {
        let [r, g, b] = self.at.map(|k| (values[k] * self.scale) as f32);
        Vec4::new(r, g, b, 1.0)
    }
}

impl Listing {
    fn vertices(
        &mut self,
        reader: &mut Reader<'_>,
        element: &Element,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), MeshError> {
        reader.check_count(element)?;
        let Some(position) = vector(element, ["x", "y", "z"]) else {
            return Err(MeshError::at(
                reader.file,
                "element vertex",
                "expected properties x, y and z",
            ));
        };
        let normal = normal_of(element);
        // Ignored if faces came first and have texture coordinates per corner.
        let uv = uv_of(element).filter(|_| self.has_uvs);
        let color = Color::find(element);
        let mut values = vec![0.0; element.properties.len()];
        let mut colors = Vec::new();
        let polygons = &mut self.polygons;
        scratch.hold_for(
            reader.file,
            element.count.saturating_mul(size_of::<DVec3>()),
        )?;
        polygons.positions.reserve(element.count);
        for i in 0..element.count {
            reader.read(element, i, &mut values, &mut [])?;
            polygons
                .positions
                .push(DVec3::from(position.map(|k| values[k])));
            if let Some(n) = normal {
                polygons
                    .normals
                    .push(DVec3::from(n.map(|k| values[k])).as_vec3());
            }
            if let Some([u, v]) = uv {
                // v is counted from the bottom; textures here start at the top.
                polygons
                    .uvs
                    .push(Vec2::new(values[u] as f32, 1.0 - values[v] as f32));
            }
            colors.extend(color.as_ref().map(|color| color.of(&values)));
            scratch.hold_for(reader.file, polygons.bytes() + 16 * colors.len())?;
        }
        polygons.colors = mtl::linear_from_coded(colors.iter().copied());
        Ok(())
    }

    fn faces(
        &mut self,
        reader: &mut Reader<'_>,
        element: &Element,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), MeshError> {
        reader.check_count(element)?;
        let corners = corners_of(reader, element)?;
        let wedges = element.list(&["texcoord", "texcoords", "texture_coordinates", "uv"]);
        let number = element.scalar(&["texnumber", "texture_number", "tex_index"]);
        let color = Color::find(element);
        let mut values = vec![0.0; element.properties.len()];
        let (mut indices, mut coordinates) = (Vec::new(), Vec::new());
        let mut face: Vec<[u32; 3]> = Vec::new();
        // Texture coordinates of corners by their bits, because neighbouring corners mostly agree.
        let mut known: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
        if wedges.is_some() {
            // Texture coordinates of corners replace those of the vertices.
            self.polygons.uvs.clear();
            self.has_uvs = false;
        }
        for i in 0..element.count {
            coordinates.clear();
            let mut lists = [
                (corners, &mut indices),
                (wedges.unwrap_or(usize::MAX), &mut coordinates),
            ];
            reader.read(element, i, &mut values, &mut lists)?;
            if indices.len() < 3 {
                self.odd.add("faces left out: too few corners", || {
                    format!("face {}: expected at least 3, got {}", i + 1, indices.len())
                });
                continue;
            }
            face.clear();
            face.extend(indices.iter().map(|&index| self.corner(index)));
            if coordinates.len() >= 2 * face.len() {
                let pairs = coordinates.as_chunks::<2>().0;
                for (corner, &[u, v]) in face.iter_mut().zip(pairs) {
                    let uv = Vec2::new(u as f32, 1.0 - v as f32);
                    let key = (corner[0], uv.to_array().map(f32::to_bits));
                    corner[1] = *known.entry(key).or_insert_with(|| {
                        self.polygons.uvs.push(uv);
                        (self.polygons.uvs.len() - 1) as u32
                    });
                }
            } else if wedges.is_some() && !coordinates.is_empty() {
                self.odd.add(
                    "texture coordinates left out: two a corner expected",
                    || {
                        format!(
                            "face {}: {} of {}",
                            i + 1,
                            coordinates.len(),
                            2 * face.len()
                        )
                    },
                );
            }
            self.push(reader, element, i, &face, scratch)?;
            if let Some(number) = number {
                // A negative number means no texture.
                let texture = Some(values[number]).filter(|&x| x >= 0.0);
                self.textures.push(texture.map_or(NONE, |x| x as u32));
            }
            let face_color = color.as_ref().map(|color| color.of(&values));
            self.polygons.face_colors.extend(face_color);
        }
        Ok(())
    }

    /// Triangle strips separated by -1 (scans of Georgia Tech and Stanford).
    fn strips(
        &mut self,
        reader: &mut Reader<'_>,
        element: &Element,
        scratch: &mut Scratch<'_>,
    ) -> Result<(), MeshError> {
        reader.check_count(element)?;
        let list = corners_of(reader, element)?;
        // As an unsigned number, -1 is the largest value.
        let between = |index: f64| index < 0.0 || index >= f64::from(u32::MAX);
        let mut values = vec![0.0; element.properties.len()];
        let mut indices = Vec::new();
        for i in 0..element.count {
            reader.read(element, i, &mut values, &mut [(list, &mut indices)])?;
            for strip in indices.split(|&index| between(index)) {
                for (k, window) in strip.windows(3).enumerate() {
                    let [a, b, c] = [0, 1, 2].map(|j| self.corner(window[j]));
                    // Strips change direction by repeating a corner.
                    if a == b || b == c || c == a {
                        continue;
                    }
                    // Every other triangle of a strip has the opposite orientation.
                    let triangle = if k % 2 == 0 { [a, b, c] } else { [b, a, c] };
                    self.push(reader, element, i, &triangle, scratch)?;
                }
            }
        }
        Ok(())
    }

    fn push(
        &mut self,
        reader: &Reader<'_>,
        element: &Element,
        i: usize,
        face: &[[u32; 3]],
        scratch: &mut Scratch<'_>,
    ) -> Result<(), MeshError> {
        self.polygons.push(face);
        if self.polygons.n_triangles() > MAX_TRIANGLES {
            let problem = format!("expected at most {MAX_TRIANGLES} triangles, got more");
            return Err(reader.fail(element, i, &problem));
        }
        scratch.hold_for(reader.file, self.polygons.bytes())
    }

    /// A corner with the attributes of its vertex.
    fn corner(&self, index: f64) -> [u32; 3] {
        let whole = index >= 0.0 && index < f64::from(BAD) && index.fract() == 0.0;
        let index = if whole { index as u32 } else { BAD };
        let with = |has: bool| if has { index } else { NONE };
        [index, with(self.has_uvs), with(self.has_normals)]
    }
}

/// Adds a material to the model for each of the file's readable textures.
fn textured_materials(
    context: &LoadContext,
    header: &Header,
    folder: &Path,
    model: &mut Model,
) -> Vec<Option<usize>> {
    let mut files = TextureFiles::new(context, folder);
    let mut material = |name: &Vec<u8>| {
        let texture = files.named(name, &mut model.notes)?;
        model.materials.push(Material {
            name: text::decode(name).text.into_owned(),
            base_color: Vec3::ONE,
            base_color_texture: Some(texture),
            ..Material::default()
        });
        Some(model.materials.len() - 1)
    };
    header.textures.iter().map(&mut material).collect()
}

/// Skips an element.
fn skip(reader: &mut Reader<'_>, element: &Element) -> Result<(), MeshError> {
    if element.properties.is_empty() {
        return Ok(());
    }
    reader.check_count(element)?;
    let mut values = vec![0.0; element.properties.len()];
    for i in 0..element.count {
        reader.read(element, i, &mut values, &mut [])?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
