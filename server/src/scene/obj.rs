//! Wavefront OBJ: `v` (with colours), `vn`, `vt`, polygons with every index form, `usemtl`. Corners with the same
//! position, texture coordinate and normal become one vertex. Groups are ignored; everything left out is noted.

pub(super) mod line;

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;

use glam::{DVec3, Vec2, Vec3, Vec4};

use self::line::{numbers, show, split_keyword, take_line, tokens};
use super::LoadContext;
use super::error::MeshError;
use super::load::Scratch;
use super::model::{MAX_TRIANGLES, Model};
use super::mtl::{self, Library, UvTransform};
use super::odd::Odd;
use super::polygons::{BAD, NONE, Polygons};
use crate::text;

/// Most numbers read per line: position and colour.
const MAX_NUMBERS: usize = 8;

/// The statements of an OBJ file.
#[derive(Default)]
struct Listing {
    polygons: Polygons,
    /// sRGB-coded, 0..=1 or 0..=255, NaN for vertices without a colour; from the first coloured vertex on as long as
    /// the positions.
    colors: Vec<Vec3>,
    /// Colours of ZBrush, which are stored in comments.
    painted: Vec<[u8; 3]>,
    /// `(first face, name)` of each `usemtl`.
    materials: Vec<(u32, String)>,
    /// Unparsed: one name or several.
    libraries: Vec<Vec<u8>>,
    odd: Odd,
}

/// As [`load_with`], without limits.
#[cfg(test)]
fn load(bytes: &[u8], name: &str, folder: &Path) -> Result<Model, MeshError> {
    load_with(&LoadContext::default(), bytes, name, folder)
}

/// Reads an OBJ file from memory; material libraries are searched in `folder`.
pub(super) fn load_with(
    context: &LoadContext,
    bytes: &[u8],
    name: &str,
    folder: &Path,
) -> Result<Model, MeshError> {
    let mut scratch = context.scratch("triangles, while they are read");
    let Listing {
        mut polygons,
        colors,
        painted,
        materials,
        libraries,
        odd,
    } = parse(&text::clean(bytes), name, &mut scratch)?;
    let mut notes: Vec<String> = odd.into_notes().collect();
    polygons.colors = linear_colors(colors, &painted, polygons.positions.len());
    let built = polygons.build(name, &mut notes, &mut scratch)?;
    drop(scratch);
    let mut model = Model {
        notes,
        report: built.report,
        ..Model::default()
    };
    model.note_report();
    let mut library = mtl::load(
        context,
        &libraries,
        folder,
        Path::new(name),
        &mut model.notes,
    );
    let (of_triangle, uvs) =
        materials_of_triangles(&built.faces, &materials, &mut library, &mut model);
    model.notes.extend(library.into_notes());
    model.push_by_material(built.mesh, &of_triangle, &uvs);
    Ok(model)
}

fn parse(bytes: &[u8], name: &str, scratch: &mut Scratch<'_>) -> Result<Listing, MeshError> {
    let mut listing = Listing::default();
    let mut face: Vec<[u32; 3]> = Vec::new();
    let mut rest = bytes;
    let mut number = 0;
    while !rest.is_empty() {
        number += 1;
        let (line, extra_lines) = take_line(&mut rest);
        let line = match line {
            Cow::Borrowed(line) => line,
            Cow::Owned(ref line) => line,
        };
        listing.statement(line, number, &mut face);
        scratch.hold_for(name, listing.polygons.bytes())?;
        if listing.polygons.n_triangles() > MAX_TRIANGLES {
            return Err(MeshError::at(
                name,
                format!("line {number}"),
                format!("expected at most {MAX_TRIANGLES} triangles, got more"),
            ));
        }
        number += extra_lines;
    }
    Ok(listing)
}

impl Listing {
    /// Reads one line; `face` is a reusable buffer.
    fn statement(&mut self, line: &[u8], number: usize, face: &mut Vec<[u32; 3]>) {
        let (keyword, values) = split_keyword(line);
        match keyword {
            b"v" => self.vertex(values, number),
            b"vn" => {
                let [x, y, z] = numbers::<3>(values).values;
                self.polygons.normals.push(DVec3::new(x, y, z).as_vec3());
            }
            b"vt" => {
                let read = numbers::<2>(values);
                // v defaults to 0 and is counted from the bottom; textures here start at the top.
                let [u, v] = match read.n {
                    1 => [read.values[0], 0.0],
                    _ => read.values,
                };
                self.polygons.uvs.push(Vec2::new(u as f32, 1.0 - v as f32));
            }
            b"f" | b"fo" => {
                face.clear();
                let mut bad = None;
                for token in tokens(values) {
                    match self.corner(token) {
                        Some(corner) => face.push(corner),
                        None => bad = bad.or(Some(token)),
                    }
                }
                match bad {
                    Some(token) => self.odd.add("faces left out: unreadable corners", || {
                        let got = show(token);
                        format!("line {number}: expected v/vt/vn as whole numbers, got {got}")
                    }),
                    None if face.len() < 3 => {
                        let n = face.len();
                        self.odd.add("faces left out: too few corners", || {
                            format!("line {number}: expected at least 3, got {n}")
                        });
                    }
                    None => self.polygons.push(face),
                }
            }
            b"usemtl" => {
                let name = text::decode(values).text.trim().to_owned();
                self.materials.push((self.polygons.n_faces() as u32, name));
            }
            b"mtllib" => self.libraries.push(values.trim_ascii().to_vec()),
            b"#MRGB" => self.paint(values),
            b"l" | b"p" => self
                .odd
                .add("lines and points left out", || format!("line {number}")),
            b"curv" | b"curv2" | b"surf" => {
                self.odd.add("free-form curves and surfaces left out", || {
                    format!("line {number}")
                })
            }
            b"" | b"g" | b"o" | b"s" | b"mg" | b"vp" | b"bevel" | b"c_interp" | b"d_interp"
            | b"lod" | b"shadow_obj" | b"trace_obj" | b"usemap" | b"maplib" | b"cstype"
            | b"deg" | b"bmat" | b"step" | b"parm" | b"trim" | b"hole" | b"scrv" | b"sp"
            | b"end" | b"con" | b"ctech" | b"stech" | b"call" | b"csh" => {}
            comment if comment.starts_with(b"#") => {}
            word => self.odd.add("lines left out: unknown first words", || {
                format!("line {number}: {}", show(word))
            }),
        }
    }

    /// `x y z`, then nothing, a weight (ignored), or a colour, perhaps with alpha.
    fn vertex(&mut self, values: &[u8], number: usize) {
        let read = numbers::<MAX_NUMBERS>(values);
        let [x, y, z, a, b, c, ..] = read.values;
        if let Some(token) = read.unreadable {
            self.odd.add("vertices with unreadable numbers", || {
                format!("line {number}: expected a number, got {}", show(token))
            });
        } else if read.n < 3 {
            self.odd.add("vertices with too few numbers", || {
                format!("line {number}: expected 3 numbers, got {}", read.n)
            });
        }
        if read.commas {
            self.odd
                .add("vertices whose decimal commas are read as points", || {
                    format!("line {number}")
                });
        }
        let n = self.polygons.positions.len();
        self.polygons.positions.push(DVec3::new(x, y, z));
        if read.n >= 6 {
            self.colors.resize(n, Vec3::NAN);
            self.colors.push(DVec3::new(a, b, c).as_vec3());
        } else if !self.colors.is_empty() {
            self.colors.push(Vec3::NAN);
        }
    }

    /// Colours in ZBrush's form: eight hexadecimal digits per vertex, for mask, red, green, blue.
    fn paint(&mut self, values: &[u8]) {
        let digit = |b: u8| char::from(b).to_digit(16).map(|d| d as u8);
        for [_, _, digits @ ..] in values.trim_ascii().as_chunks::<8>().0 {
            let byte = |i: usize| Some(digit(digits[i])? << 4 | digit(digits[i + 1])?);
            if let (Some(r), Some(g), Some(b)) = (byte(0), byte(2), byte(4)) {
                self.painted.push([r, g, b]);
            }
        }
    }

    /// `v`, `v/t`, `v//n` or `v/t/n`. Indices count from 1, or backwards from the last element so far if negative;
    /// whether the elements exist is known only at the end of the file. 0 is not an index.
    fn corner(&self, token: &[u8]) -> Option<[u32; 3]> {
        let lists = [
            self.polygons.positions.len(),
            self.polygons.uvs.len(),
            self.polygons.normals.len(),
        ];
        let mut out = [NONE; 3];
        let mut fields = token.split(|&b| b == b'/');
        for (k, (slot, n)) in out.iter_mut().zip(lists).enumerate() {
            match fields.next() {
                None => break,
                Some(b"") if k > 0 => {}
                Some(field) => {
                    *slot = match index(field, n)? {
                        // Some exporters always write three indices, with 0 or these for "none".
                        BAD if k > 0 && field.iter().all(|&b| b == b'0') => NONE,
                        index => index,
                    }
                }
            }
        }
        Some(out)
    }
}

/// A zero-based index; [`BAD`] for 0 and for indices before the first element; `None` if the field is not an integer.
fn index(field: &[u8], n: usize) -> Option<u32> {
    let (negative, digits) = match field {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] => (false, digits),
        digits => (false, digits),
    };
    // 18 digits fit into u64, so no digit needs an overflow check.
    if digits.is_empty() || digits.len() > 18 {
        return None;
    }
    let mut value = 0u64;
    for &digit in digits {
        if !digit.is_ascii_digit() {
            return None;
        }
        value = value * 10 + u64::from(digit - b'0');
    }
    let from_0 = if negative {
        (n as u64).checked_sub(value).filter(|_| value > 0)
    } else {
        value.checked_sub(1)
    };
    let usable = from_0.and_then(|index| u32::try_from(index).ok());
    Some(usable.filter(|&index| index < BAD).unwrap_or(BAD))
}

/// One linear colour per position; empty if the file has none. White for vertices without a colour.
fn linear_colors(mut coded: Vec<Vec3>, painted: &[[u8; 3]], n: usize) -> Vec<Vec4> {
    if coded.is_empty() && painted.len() == n {
        coded = painted
            .iter()
            .map(|rgb| Vec3::from(rgb.map(f32::from)))
            .collect();
    }
    mtl::linear_from_coded(coded.iter().map(|c| c.extend(1.0)))
}

/// The material of each triangle, by the `usemtl` before its face; the materials are added to the model. Also returns
/// each material's change of texture coordinates.
fn materials_of_triangles(
    faces: &[u32],
    used: &[(u32, String)],
    library: &mut Library<'_>,
    model: &mut Model,
) -> (Vec<Option<usize>>, Vec<UvTransform>) {
    let mut uvs = Vec::new();
    let mut add = |entry: Option<mtl::Entry>| {
        let entry = entry?;
        uvs.push(entry.uvs);
        model.materials.push(entry.material);
        Some(model.materials.len() - 1)
    };
    let mut slots: HashMap<&str, Option<usize>> = HashMap::new();
    for (_, name) in used {
        if !slots.contains_key(name.as_str()) {
            slots.insert(name, add(library.get(name)));
        }
    }
    let mut current = match used {
        [] => add(library.only()),
        _ => None,
    };
    let mut next = used.iter().peekable();
    let of_face = faces.iter().map(|&face| {
        while let Some((_, name)) = next.next_if(|(first, _)| *first <= face) {
            current = slots[name.as_str()];
        }
        current
    });
    (of_face.collect(), uvs)
}

#[cfg(test)]
mod tests;
