//! Stanford PLY, ascii and binary of both byte orders: vertices `x y z`, optionally
//! `nx ny nz` and texture coordinates, and polygonal faces. Other elements and properties are
//! passed over.

use glam::{Vec2, Vec3};

use super::error::MeshError;
use super::model::{MAX_TRIANGLES, Model};
use super::normals;
use super::sanitise::sanitise;
use super::{LoadContext, Mesh};

/// Largest header, bytes: real ones have a few hundred.
const MAX_HEADER_BYTES: usize = 1 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Number {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Number {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

#[derive(Debug)]
struct Property {
    name: String,
    /// Type of the length, for lists.
    list: Option<Number>,
    item: Number,
}

#[derive(Debug)]
struct Element {
    name: String,
    count: usize,
    properties: Vec<Property>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// As [`load_with`], without limits.
#[cfg(test)]
pub(super) fn load(bytes: &[u8], name: &str) -> Result<Model, MeshError> {
    load_with(&LoadContext::default(), bytes, name)
}

/// Reads a PLY file from memory.
pub(super) fn load_with(
    context: &LoadContext,
    bytes: &[u8],
    name: &str,
) -> Result<Model, MeshError> {
    let mut scratch = context.scratch("triangles, while they are read");
    scratch.hold_for(name, 2 * bytes.len())?;
    let (format, elements, body) = header(bytes, name)?;
    let mut reader = Reader {
        rest: body,
        format,
        file: name,
        n_bytes: bytes.len(),
    };
    let mut mesh = Mesh::default();
    let mut notes = Vec::new();
    for element in &elements {
        match element.name.as_str() {
            "vertex" => vertices(&mut reader, element, &mut mesh, &mut notes)?,
            "face" => faces(&mut reader, element, &mut mesh)?,
            "tristrips" => {
                return Err(MeshError::new(
                    name,
                    "expected faces, got triangle strips, which are not supported",
                ));
            }
            _ => skip(&mut reader, element)?,
        }
    }
    let had_normals = !mesh.normals.is_empty();
    let (mut mesh, report) = sanitise(mesh, name)?;
    if !had_normals {
        mesh = normals::smooth(mesh);
    }
    let mut model = Model {
        notes,
        report,
        ..Model::default()
    };
    model.note_report();
    model.push_part(mesh, None);
    Ok(model)
}

fn header<'a>(bytes: &'a [u8], name: &str) -> Result<(Format, Vec<Element>, &'a [u8]), MeshError> {
    let mut rest = bytes;
    let mut number = 0;
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        number += 1;
        let fail = |problem: String| MeshError::at(name, format!("line {number}"), problem);
        let searched = &rest[..rest.len().min(MAX_HEADER_BYTES)];
        let Some(end) = searched.iter().position(|&b| b == b'\n') else {
            return Err(fail(
                "expected a PLY header up to \"end_header\", got its end".into(),
            ));
        };
        let line = std::str::from_utf8(&rest[..end])
            .map_err(|_| fail("header: expected text, got other bytes".into()))?
            .trim();
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 1 => {}
            _ if number == 1 => {
                return Err(fail("expected \"ply\", got something else".into()));
            }
            ["format", kind, _] => {
                format = Some(match *kind {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::LittleEndian,
                    "binary_big_endian" => Format::BigEndian,
                    _ => {
                        return Err(fail(format!(
                            "format: expected ascii or binary_little_endian or binary_big_endian, got {kind:?}"
                        )));
                    }
                });
            }
            ["element", element, count] => elements.push(Element {
                name: (*element).to_owned(),
                count: count.parse().map_err(|_| {
                    fail(format!(
                        "element {element}: expected a count, got {count:?}"
                    ))
                })?,
                properties: Vec::new(),
            }),
            ["property", types @ .., property] if !types.is_empty() => {
                let unknown = || {
                    fail(format!(
                        "property {property}: expected a type as in \"float\" or \"list uchar int\", got {:?}",
                        types.join(" ")
                    ))
                };
                let (list, item) = match types {
                    [item] => (None, item),
                    ["list", length, item] => (
                        Some(
                            Number::parse(length)
                                .filter(|n| !matches!(n, Number::F32 | Number::F64))
                                .ok_or_else(unknown)?,
                        ),
                        item,
                    ),
                    _ => return Err(unknown()),
                };
                let item = Number::parse(item).ok_or_else(unknown)?;
                elements
                    .last_mut()
                    .ok_or_else(|| fail("expected an element before its properties".into()))?
                    .properties
                    .push(Property {
                        name: (*property).to_owned(),
                        list,
                        item,
                    });
            }
            ["end_header"] => break,
            [] | ["comment" | "obj_info", ..] => {}
            [word, ..] => return Err(fail(format!("header: unknown statement {word:?}"))),
        }
    }
    let format =
        format.ok_or_else(|| MeshError::new(name, "header: expected a \"format\", got none"))?;
    Ok((format, elements, rest))
}

struct Reader<'a> {
    rest: &'a [u8],
    format: Format,
    file: &'a str,
    n_bytes: usize,
}

impl Reader<'_> {
    fn fail(&self, element: &Element, i: usize, problem: &str) -> MeshError {
        let offset = self.n_bytes - self.rest.len();
        MeshError::at(
            self.file,
            format!("{} {i} (byte {offset})", element.name),
            problem,
        )
    }

    /// Refuses counts that the rest of the file cannot hold, before anything is allocated.
    fn check_count(&self, element: &Element) -> Result<(), MeshError> {
        let smallest: usize = element
            .properties
            .iter()
            .map(|property| match self.format {
                // A digit and a separator; the last of the file may lack the latter.
                Format::Ascii => 2,
                _ => property.list.unwrap_or(property.item).size(),
            })
            .sum();
        let fits = match smallest {
            0 => element.count == 0,
            n => element.count <= (self.rest.len() + 1) / n,
        };
        if fits {
            return Ok(());
        }
        Err(MeshError::at(
            self.file,
            format!("element {}", element.name),
            format!(
                "expected {} of them, got only {} bytes",
                element.count,
                self.rest.len()
            ),
        ))
    }

    /// The next number; `None` where the file ends or holds something else.
    fn next(&mut self, kind: Number) -> Option<f64> {
        if self.format == Format::Ascii {
            let text = self.rest.trim_ascii_start();
            let end = text
                .iter()
                .position(u8::is_ascii_whitespace)
                .unwrap_or(text.len());
            let (token, rest) = text.split_at(end);
            self.rest = rest;
            return std::str::from_utf8(token).ok()?.parse().ok();
        }
        let (head, rest) = self.rest.split_at_checked(kind.size())?;
        self.rest = rest;
        let mut bytes = [0u8; 8];
        let bytes = &mut bytes[..head.len()];
        bytes.copy_from_slice(head);
        if self.format == Format::BigEndian {
            bytes.reverse();
        }
        Some(match (kind, &*bytes) {
            (Number::I8, &[a]) => f64::from(a as i8),
            (Number::U8, &[a]) => f64::from(a),
            (Number::I16, &[a, b]) => f64::from(i16::from_le_bytes([a, b])),
            (Number::U16, &[a, b]) => f64::from(u16::from_le_bytes([a, b])),
            (Number::I32, &[a, b, c, d]) => f64::from(i32::from_le_bytes([a, b, c, d])),
            (Number::U32, &[a, b, c, d]) => f64::from(u32::from_le_bytes([a, b, c, d])),
            (Number::F32, &[a, b, c, d]) => f64::from(f32::from_le_bytes([a, b, c, d])),
            (Number::F64, &[a, b, c, d, e, f, g, h]) => {
                f64::from_le_bytes([a, b, c, d, e, f, g, h])
            }
            _ => return None,
        })
    }

    /// The length of a list.
    fn length(&mut self, kind: Number) -> Option<usize> {
        let n = self.next(kind)?;
        // Bounded by what follows, so a hostile length ends at the end of the file.
        (n >= 0.0 && n.fract() == 0.0 && n <= self.rest.len() as f64).then_some(n as usize)
    }
}

const SHORT: &str = "expected a number, got something else or the end of the file";
const LENGTH: &str = "expected the length of a list that fits into the file, got something else";

fn vertices(
    reader: &mut Reader<'_>,
    element: &Element,
    mesh: &mut Mesh,
    notes: &mut Vec<String>,
) -> Result<(), MeshError> {
    reader.check_count(element)?;
    let find = |names: &[&str]| {
        element
            .properties
            .iter()
            .position(|p| p.list.is_none() && names.contains(&p.name.as_str()))
    };
    let (Some(x), Some(y), Some(z)) = (find(&["x"]), find(&["y"]), find(&["z"])) else {
        return Err(MeshError::at(
            reader.file,
            "element vertex",
            "expected properties x, y and z",
        ));
    };
    let normal = match (find(&["nx"]), find(&["ny"]), find(&["nz"])) {
        (Some(x), Some(y), Some(z)) => Some([x, y, z]),
        _ => None,
    };
    let uv = match (
        find(&["s", "u", "texture_u"]),
        find(&["t", "v", "texture_v"]),
    ) {
        (Some(u), Some(v)) => Some([u, v]),
        _ => None,
    };
    if find(&["red", "diffuse_red"]).is_some() {
        notes.push("vertex colours are left out".to_owned());
    }
    let mut values = vec![0.0f32; element.properties.len()];
    mesh.positions.reserve(element.count);
    for i in 0..element.count {
        for (slot, property) in values.iter_mut().zip(&element.properties) {
            match property.list {
                None => {
                    *slot = reader
                        .next(property.item)
                        .ok_or_else(|| reader.fail(element, i, SHORT))?
                        as f32;
                }
                Some(length) => skip_list(reader, element, i, length, property.item)?,
            }
        }
        mesh.positions
            .push(Vec3::new(values[x], values[y], values[z]));
        if let Some(n) = normal {
            mesh.normals.push(Vec3::from(n.map(|k| values[k])));
        }
        if let Some([u, v]) = uv {
            // v counts up from the bottom; textures here start at the top.
            mesh.uvs.push(Vec2::new(values[u], 1.0 - values[v]));
        }
    }
    Ok(())
}

fn faces(reader: &mut Reader<'_>, element: &Element, mesh: &mut Mesh) -> Result<(), MeshError> {
    reader.check_count(element)?;
    let Some(corners) = element.properties.iter().position(|p| {
        p.list.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index")
    }) else {
        return Err(MeshError::at(
            reader.file,
            "element face",
            "expected a list property vertex_indices",
        ));
    };
    let mut polygon: Vec<u32> = Vec::new();
    for i in 0..element.count {
        for (k, property) in element.properties.iter().enumerate() {
            match property.list {
                None => {
                    reader
                        .next(property.item)
                        .ok_or_else(|| reader.fail(element, i, SHORT))?;
                }
                Some(length) if k != corners => {
                    skip_list(reader, element, i, length, property.item)?;
                }
                Some(length) => {
                    let n = reader
                        .length(length)
                        .ok_or_else(|| reader.fail(element, i, LENGTH))?;
                    polygon.clear();
                    for _ in 0..n {
                        let index = reader
                            .next(property.item)
                            .ok_or_else(|| reader.fail(element, i, SHORT))?;
                        if !(index >= 0.0 && index <= f64::from(u32::MAX) && index.fract() == 0.0) {
                            let problem = format!("expected a vertex index, got {index}");
                            return Err(reader.fail(element, i, &problem));
                        }
                        polygon.push(index as u32);
                    }
                }
            }
        }
        if let [first, others @ ..] = polygon.as_slice() {
            for pair in others.windows(2) {
                mesh.triangles.push([*first, pair[0], pair[1]]);
            }
        }
        if mesh.triangles.len() > MAX_TRIANGLES {
            let problem = format!("expected at most {MAX_TRIANGLES} triangles, got more");
            return Err(reader.fail(element, i, &problem));
        }
    }
    Ok(())
}

fn skip(reader: &mut Reader<'_>, element: &Element) -> Result<(), MeshError> {
    if element.properties.is_empty() {
        return Ok(());
    }
    reader.check_count(element)?;
    for i in 0..element.count {
        for property in &element.properties {
            match property.list {
                None => {
                    reader
                        .next(property.item)
                        .ok_or_else(|| reader.fail(element, i, SHORT))?;
                }
                Some(length) => skip_list(reader, element, i, length, property.item)?,
            }
        }
    }
    Ok(())
}

fn skip_list(
    reader: &mut Reader<'_>,
    element: &Element,
    i: usize,
    length: Number,
    item: Number,
) -> Result<(), MeshError> {
    let n = reader
        .length(length)
        .ok_or_else(|| reader.fail(element, i, LENGTH))?;
    for _ in 0..n {
        reader
            .next(item)
            .ok_or_else(|| reader.fail(element, i, SHORT))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
