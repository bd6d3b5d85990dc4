//! The header of a PLY file: its format and its elements.

use crate::scene::error::MeshError;
use crate::text;

/// Largest header, bytes: real ones have a few hundred.
const MAX_HEADER_BYTES: usize = 1 << 20;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
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
        Some(match name.to_ascii_lowercase().as_str() {
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

    pub(super) fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

#[derive(Debug)]
pub(super) struct Property {
    pub(super) name: String,
    /// Type of the list's length, for lists.
    pub(super) list: Option<Number>,
    pub(super) item: Number,
}

#[derive(Debug)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) count: usize,
    pub(super) properties: Vec<Property>,
}

impl Element {
    /// Position of the first property with one of these names that is not a list.
    pub(super) fn scalar(&self, names: &[&str]) -> Option<usize> {
        self.find(names, false)
    }

    /// Position of the first list with one of these names.
    pub(super) fn list(&self, names: &[&str]) -> Option<usize> {
        self.find(names, true)
    }

    fn find(&self, names: &[&str], list: bool) -> Option<usize> {
        let is = |name: &&str| {
            let matches = |p: &Property| p.list.is_some() == list && p.name == **name;
            self.properties.iter().position(matches)
        };
        names.iter().find_map(is)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Format {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// Content of the header.
#[derive(Debug)]
pub(super) struct Header {
    pub(super) format: Format,
    pub(super) elements: Vec<Element>,
    /// Textures named by `comment TextureFile`, as bytes.
    pub(super) textures: Vec<Vec<u8>>,
}

/// Splits a file into its header and body.
pub(super) fn read<'a>(bytes: &'a [u8], name: &str) -> Result<(Header, &'a [u8]), MeshError> {
    let mut rest = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    // The first line determines the line end: the first byte after the header may have any value.
    let end_of_line = match rest {
        [b'p', b'l', b'y', b'\r', after, ..] if *after != b'\n' => b'\r',
        _ => b'\n',
    };
    let mut number = 0;
    let mut format = None;
    let mut elements: Vec<Element> = Vec::new();
    let mut textures = Vec::new();
    loop {
        number += 1;
        let fail = |problem: String| MeshError::at(name, format!("line {number}"), problem);
        let searched = &rest[..rest.len().min(MAX_HEADER_BYTES)];
        let Some(end) = searched.iter().position(|&b| b == end_of_line) else {
            return Err(fail(
                "expected a PLY header up to \"end_header\", got its end".into(),
            ));
        };
        let raw = rest[..end].trim_ascii();
        // Comments and names may be in any encoding.
        let line = text::decode(raw).text;
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_whitespace().collect();
        match words.as_slice() {
            ["ply"] if number == 1 => {}
            _ if number == 1 => {
                return Err(fail(format!("expected \"ply\", got {:?}", head(&line))));
            }
            ["format", kind, ..] => {
                format = Some(match *kind {
                    "ascii" => Format::Ascii,
                    "binary_little_endian" => Format::LittleEndian,
                    "binary_big_endian" => Format::BigEndian,
                    _ => {
                        return Err(fail(format!(
                            "format: expected ascii or binary_{{little,big}}_endian, got {kind:?}"
                        )));
                    }
                });
            }
            ["element", element, count] => {
                let count = count.parse().map_err(|_| {
                    fail(format!(
                        "element {element}: expected a count, got {count:?}"
                    ))
                })?;
                elements.push(Element {
                    name: (*element).to_owned(),
                    count,
                    properties: Vec::new(),
                });
            }
            ["property", types @ .., property] => {
                let property = parse_property(types, property).map_err(fail)?;
                elements
                    .last_mut()
                    .ok_or_else(|| fail("expected an element before its properties".into()))?
                    .properties
                    .push(property);
            }
            ["end_header"] => break,
            ["comment" | "obj_info", word, ..] if word.eq_ignore_ascii_case("texturefile") => {
                let at = raw.to_ascii_lowercase();
                let at = at.windows(11).position(|word| word == b"texturefile");
                textures.extend(at.map(|at| raw[at + 11..].trim_ascii().to_vec()));
            }
            [] | ["comment" | "obj_info", ..] => {}
            [word, ..] => return Err(fail(format!("header: unknown statement {word:?}"))),
        }
    }
    let format =
        format.ok_or_else(|| MeshError::new(name, "header: expected a \"format\", got none"))?;
    let header = Header {
        format,
        elements,
        textures,
    };
    Ok((header, rest))
}

fn head(line: &str) -> String {
    line.chars().take(40).collect()
}

fn parse_property(types: &[&str], name: &str) -> Result<Property, String> {
    let unknown = || {
        format!(
            "property {name}: expected a type as in \"float\" or \"list uchar int\", got {:?}",
            types.join(" ")
        )
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
    Ok(Property {
        name: name.to_ascii_lowercase(),
        list,
        item: Number::parse(item).ok_or_else(unknown)?,
    })
}
