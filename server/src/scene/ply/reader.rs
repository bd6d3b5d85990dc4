//! Reads the numbers of a PLY file's body.

use super::header::{Element, Format, Number};
use crate::scene::error::MeshError;

const SHORT: &str = "expected a number, got the end of the file";
const LENGTH: &str = "expected the length of a list that fits into the file, got something else";

/// Reads a body sequentially.
pub(super) struct Reader<'a> {
    pub(super) rest: &'a [u8],
    pub(super) format: Format,
    pub(super) file: &'a str,
    pub(super) n_bytes: usize,
}

impl Reader<'_> {
    pub(super) fn fail(&self, element: &Element, i: usize, problem: &str) -> MeshError {
        let offset = self.n_bytes - self.rest.len();
        MeshError::at(
            self.file,
            format!("{} {i} (byte {offset})", element.name),
            problem,
        )
    }

    /// Rejects counts that the rest of the file cannot hold, before anything is allocated.
    pub(super) fn check_count(&self, element: &Element) -> Result<(), MeshError> {
        let smallest: usize = element
            .properties
            .iter()
            .map(|property| match self.format {
                // A digit and a separator; the last number of the file may lack the separator.
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

    /// The next number; NaN for an unreadable word, `None` at the end of the file.
    fn next(&mut self, kind: Number) -> Option<f64> {
        if self.format == Format::Ascii {
            let text = self.rest.trim_ascii_start();
            let end = text
                .iter()
                .position(u8::is_ascii_whitespace)
                .unwrap_or(text.len());
            let (token, rest) = text.split_at(end);
            if token.is_empty() {
                return None;
            }
            self.rest = rest;
            let number = std::str::from_utf8(token).ok().and_then(|t| t.parse().ok());
            return Some(number.unwrap_or(f64::NAN));
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

    /// Reads item `i` of an element: scalar properties into `values` at their indices, and the lists whose property
    /// indices are in `keep` into the vectors there.
    pub(super) fn read(
        &mut self,
        element: &Element,
        i: usize,
        values: &mut [f64],
        keep: &mut [(usize, &mut Vec<f64>)],
    ) -> Result<(), MeshError> {
        for (k, property) in element.properties.iter().enumerate() {
            let Some(length) = property.list else {
                values[k] = self
                    .next(property.item)
                    .ok_or_else(|| self.fail(element, i, SHORT))?;
                continue;
            };
            // The loop is bounded by the remaining bytes, so a hostile length stops at the end of the file.
            let n = self
                .next(length)
                .filter(|&n| n >= 0.0 && n.fract() == 0.0 && n <= self.rest.len() as f64)
                .ok_or_else(|| self.fail(element, i, LENGTH))?;
            let mut kept = keep.iter_mut().find(|(wanted, _)| *wanted == k);
            if let Some((_, list)) = &mut kept {
                list.clear();
            }
            for _ in 0..n as usize {
                let value = self
                    .next(property.item)
                    .ok_or_else(|| self.fail(element, i, SHORT))?;
                if let Some((_, list)) = &mut kept {
                    list.push(value);
                }
            }
        }
        Ok(())
    }
}
