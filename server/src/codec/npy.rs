//! NumPy's `.npy` (format versions 1 to 3): one array of numbers, with two dimensions apart from dimensions of 1.

use super::depth_map::{DepthMap, EXPECTED, check_depth_size};
use super::{CodecError, malformed};

/// Longest header, bytes; NumPy writes 128.
const MAX_HEADER: usize = 1 << 16;

/// Kinds of numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    Unsigned,
    Signed,
    Float,
}

/// Content of the header.
struct Array {
    kind: Kind,
    /// Bytes per number.
    size: usize,
    big_endian: bool,
    fortran: bool,
    width: u32,
    height: u32,
}

pub(super) fn decode(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    let bad = |got: String| malformed(file, EXPECTED, got);
    let cut = || bad("an NPY header cut short".to_owned());
    let (length, start) = match bytes.get(6) {
        Some(1) => {
            let field = bytes.get(8..10).ok_or_else(cut)?;
            (usize::from(field[0]) | usize::from(field[1]) << 8, 10)
        }
        Some(2 | 3) => {
            let field = bytes.get(8..12).and_then(|b| b.first_chunk::<4>());
            (u32::from_le_bytes(*field.ok_or_else(cut)?) as usize, 12)
        }
        _ => return Err(bad("an NPY file of an unknown version".to_owned())),
    };
    if length > MAX_HEADER {
        return Err(bad(format!("an NPY header of {length} bytes")));
    }
    let header = bytes.get(start..start + length).ok_or_else(cut)?;
    let header = String::from_utf8_lossy(header);
    let array = parse_header(&header, file)?;
    let n = array.width as usize * array.height as usize;
    let data = &bytes[start + length..];
    let Some(data) = data.get(..n * array.size) else {
        let got = data.len() / array.size;
        return Err(bad(format!("{got} of {n} samples (cut short)")));
    };
    let (width, height) = (array.width as usize, array.height as usize);
    // In Fortran order the columns are stored one after the other.
    let number = move |i: usize| {
        let at = if array.fortran {
            i % width * height + i / width
        } else {
            i
        };
        let raw = &data[at * array.size..(at + 1) * array.size];
        raw.iter().enumerate().fold(0u64, |value, (k, &byte)| {
            let place = if array.big_endian {
                array.size - 1 - k
            } else {
                k
            };
            value | u64::from(byte) << (8 * place)
        })
    };
    Ok(match (array.kind, array.size) {
        (Kind::Float, size) => {
            let value = |i| match size {
                2 => f32_from_f16(number(i) as u16),
                4 => f32::from_bits(number(i) as u32),
                _ => f64::from_bits(number(i)) as f32,
            };
            DepthMap::from_floats(array.width, array.height, (0..n).map(value).collect())
        }
        (Kind::Unsigned, _) => {
            let values = (0..n).map(|i| i64::try_from(number(i)).unwrap_or(i64::MAX));
            DepthMap::from_integers(array.width, array.height, values)
        }
        (Kind::Signed, size) => {
            let unused = 64 - 8 * size as u32;
            let values = (0..n).map(|i| ((number(i) << unused) as i64) >> unused);
            DepthMap::from_integers(array.width, array.height, values)
        }
    })
}

/// The header is a Python dictionary: `{'descr': '<f4', 'fortran_order': False, 'shape': (72, 96), }`.
fn parse_header(header: &str, file: &str) -> Result<Array, CodecError> {
    let bad = |got: String| malformed(file, EXPECTED, got);
    let field = |name: &str| {
        let at = header.find(&format!("'{name}'"))? + name.len() + 2;
        Some(header[at..].trim_start().strip_prefix(':')?.trim_start())
    };
    let missing = |name: &str| bad(format!("an NPY header without {name}"));
    let descr = field("descr")
        .and_then(|rest| rest.strip_prefix('\'')?.split('\'').next())
        .ok_or_else(|| missing("a plain number type"))?;
    let (order, code) = match descr.split_at_checked(1) {
        Some((order @ ("<" | ">" | "|" | "="), code)) => (order, code),
        _ => ("=", descr),
    };
    let (kind, size) = match code {
        "b1" | "u1" => (Kind::Unsigned, 1),
        "u2" => (Kind::Unsigned, 2),
        "u4" => (Kind::Unsigned, 4),
        "u8" => (Kind::Unsigned, 8),
        "i1" => (Kind::Signed, 1),
        "i2" => (Kind::Signed, 2),
        "i4" => (Kind::Signed, 4),
        "i8" => (Kind::Signed, 8),
        "f2" => (Kind::Float, 2),
        "f4" => (Kind::Float, 4),
        "f8" => (Kind::Float, 8),
        _ => {
            let code: String = descr.chars().take(16).collect();
            return Err(bad(format!("an NPY array of {:?}", code)));
        }
    };
    let fortran = field("fortran_order").ok_or_else(|| missing("fortran_order"))?;
    let shape = field("shape")
        .and_then(|rest| rest.strip_prefix('(')?.split(')').next())
        .ok_or_else(|| missing("a shape"))?;
    let mut sides: Vec<u64> = Vec::new();
    for word in shape.split(',').map(str::trim).filter(|w| !w.is_empty()) {
        // Python 2 wrote long integers with an L.
        let side = word.trim_end_matches('L').parse();
        sides.push(side.map_err(|_| missing("a shape of numbers"))?);
        if sides.len() > 8 {
            return Err(bad("an NPY array of many dimensions".to_owned()));
        }
    }
    // Batch and channel dimensions of size one.
    while sides.len() > 2 {
        match sides.as_slice() {
            [1, ..] => drop(sides.remove(0)),
            [.., 1] => drop(sides.pop()),
            _ => return Err(bad(format!("an NPY array of shape {sides:?}"))),
        }
    }
    let &[height, width] = sides.as_slice() else {
        return Err(bad(format!("an NPY array of shape {sides:?}")));
    };
    let (width, height) = check_depth_size(width, height, file)?;
    Ok(Array {
        kind,
        size,
        big_endian: order == ">",
        fortran: fortran.starts_with("True"),
        width,
        height,
    })
}

/// IEEE 754 binary16.
fn f32_from_f16(bits: u16) -> f32 {
    let sign = if bits >> 15 == 1 { -1.0 } else { 1.0 };
    let (exponent, fraction) = (i32::from(bits >> 10 & 31), f32::from(bits & 1023));
    sign * match exponent {
        0 => fraction * 2f32.powi(-24),
        31 if fraction == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1024.0 + fraction) * 2f32.powi(exponent - 25),
    }
}
