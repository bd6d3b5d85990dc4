//! Netpbm's grey images: PGM (P5 and P2; 16 bits are big-endian) and PFM (float, rows from the bottom).

use super::depth_map::{DepthMap, DepthSamples, EXPECTED, check_depth_size};
use super::{CodecError, malformed};

/// Reads the words and bytes of a header.
struct Header<'a> {
    bytes: &'a [u8],
    at: usize,
    file: &'a str,
}

impl<'a> Header<'a> {
    /// The next word; comments run from `#` to the line's end.
    fn word(&mut self) -> Result<&'a str, CodecError> {
        loop {
            match self.bytes.get(self.at) {
                Some(b'#') => {
                    let rest = &self.bytes[self.at..];
                    let end = rest.iter().position(|b| matches!(b, b'\n' | b'\r'));
                    self.at += end.unwrap_or(rest.len());
                }
                Some(b) if b.is_ascii_whitespace() => self.at += 1,
                _ => break,
            }
        }
        let rest = &self.bytes[self.at..];
        let end = rest
            .iter()
            .position(|b| b.is_ascii_whitespace() || *b == b'#')
            .unwrap_or(rest.len());
        self.at += end;
        match std::str::from_utf8(&rest[..end]) {
            Ok(word) if !word.is_empty() && word.len() <= 32 => Ok(word),
            _ => Err(malformed(
                self.file,
                EXPECTED,
                "a Netpbm header cut short or damaged",
            )),
        }
    }

    fn number<T: std::str::FromStr>(&mut self, field: &str) -> Result<T, CodecError> {
        let file = self.file;
        let word = self.word()?;
        word.parse().map_err(|_| {
            let got = format!("a Netpbm {field} of {:?}", word.escape_debug().to_string());
            malformed(file, EXPECTED, got)
        })
    }

    /// The data after the single white-space byte that ends the header.
    fn body(&self) -> &'a [u8] {
        self.bytes.get(self.at + 1..).unwrap_or_default()
    }
}

/// Decodes P5 or P2.
pub(super) fn pgm(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    let plain = bytes.get(1) == Some(&b'2');
    let mut header = Header { bytes, at: 2, file };
    let (width, height) = (header.number("width")?, header.number("height")?);
    let (width, height) = check_depth_size(width, height, file)?;
    let most: u32 = header.number("largest value")?;
    if !(1..=65535).contains(&most) {
        let got = format!("a PGM with a largest value of {most}");
        return Err(malformed(file, EXPECTED, got));
    }
    let n = width as usize * height as usize;
    let units: Vec<u16> = if plain {
        // A number takes at least two bytes, which bounds the allocation.
        if header.body().len() < n.saturating_mul(2).saturating_sub(1) {
            return Err(cut_short(file, n, header.body().len() / 2));
        }
        let mut units = Vec::with_capacity(n);
        for _ in 0..n {
            units.push(header.number("value")?);
        }
        units
    } else if most < 256 {
        let body = header.body();
        let samples = body
            .get(..n)
            .ok_or_else(|| cut_short(file, n, body.len()))?;
        samples.iter().map(|&b| u16::from(b)).collect()
    } else {
        let body = header.body();
        let samples = body
            .get(..2 * n)
            .ok_or_else(|| cut_short(file, n, body.len() / 2))?;
        let pairs = samples.as_chunks::<2>().0.iter();
        pairs.map(|&pair| u16::from_be_bytes(pair)).collect()
    };
    Ok(DepthMap {
        width,
        height,
        samples: DepthSamples::Units(units),
    })
}

/// Decodes `Pf`: a negative scale means little-endian, rows are stored from the bottom.
pub(super) fn pfm(bytes: &[u8], file: &str) -> Result<DepthMap, CodecError> {
    let mut header = Header { bytes, at: 2, file };
    let (width, height) = (header.number("width")?, header.number("height")?);
    let (width, height) = check_depth_size(width, height, file)?;
    let scale: f64 = header.number("scale")?;
    let n = width as usize * height as usize;
    let body = header.body();
    let samples = body
        .get(..4 * n)
        .ok_or_else(|| cut_short(file, n, body.len() / 4))?;
    let quads = samples.as_chunks::<4>().0;
    let rows = quads.chunks_exact(width as usize).rev().flatten();
    let values = rows.map(|&quad| {
        if scale < 0.0 {
            f32::from_le_bytes(quad)
        } else {
            f32::from_be_bytes(quad)
        }
    });
    Ok(DepthMap::from_floats(width, height, values.collect()))
}

fn cut_short(file: &str, expected: usize, got: usize) -> CodecError {
    malformed(
        file,
        EXPECTED,
        format!("{got} of {expected} samples (cut short)"),
    )
}
