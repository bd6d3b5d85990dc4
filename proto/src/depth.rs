//! The two depth codecs defined by the format itself (README, section 6): RVL, and differences in byte planes
//! compressed with zstd. Both are lossless for 16-bit samples in row order.
//!
//! RVL: Wilson 2017, "Fast Lossless Depth Image Compression", ISS.

use crate::{Code, WireError};

fn corrupt(
    codec: &str,
    expected: impl std::fmt::Display,
    got: impl std::fmt::Display,
) -> WireError {
    WireError::new(
        Code::Decode,
        format_args!("depth payload ({codec})"),
        expected,
        got,
    )
}

/// Packs nibbles into 32-bit words, from the most significant end.
struct NibbleWriter {
    out: Vec<u8>,
    word: u32,
    n: u32,
}

impl NibbleWriter {
    fn put(&mut self, mut value: u32) {
        loop {
            let more = value > 7;
            self.word = self.word << 4 | value & 7 | u32::from(more) << 3;
            self.n += 1;
            if self.n == 8 {
                self.out.extend_from_slice(&self.word.to_le_bytes());
                (self.word, self.n) = (0, 0);
            }
            value >>= 3;
            if !more {
                return;
            }
        }
    }

    fn finish(mut self) -> Vec<u8> {
        if self.n > 0 {
            self.word <<= 4 * (8 - self.n);
            self.out.extend_from_slice(&self.word.to_le_bytes());
        }
        self.out
    }
}

struct NibbleReader<'a> {
    bytes: &'a [u8],
    word: u32,
    n: u32,
}

impl NibbleReader<'_> {
    fn get(&mut self) -> Result<u32, WireError> {
        let mut value = 0;
        let mut shift = 0;
        loop {
            if self.n == 0 {
                let Some((word, rest)) = self.bytes.split_first_chunk::<4>() else {
                    return Err(corrupt("rvl", "more 32-bit words", "the end"));
                };
                self.word = u32::from_le_bytes(*word);
                self.bytes = rest;
                self.n = 8;
            }
            let nibble = self.word >> 28;
            self.word <<= 4;
            self.n -= 1;
            // A 17-bit zigzag difference needs 6 nibbles, a run in 8192 x 8192 pixels needs 9.
            if shift > 24 {
                return Err(corrupt(
                    "rvl",
                    "numbers of at most 9 nibbles",
                    "a longer one",
                ));
            }
            value |= (nibble & 7) << shift;
            shift += 3;
            if nibble & 8 == 0 {
                return Ok(value);
            }
        }
    }
}

/// Encodes samples in row order as RVL.
pub fn encode_rvl(pixels: &[u16]) -> Vec<u8> {
    let mut nibbles = NibbleWriter {
        out: Vec::with_capacity(pixels.len() / 2 + 8),
        word: 0,
        n: 0,
    };
    let mut rest = pixels;
    let mut last = 0i32;
    while !rest.is_empty() {
        let zeros = rest.iter().take_while(|&&p| p == 0).count();
        rest = &rest[zeros..];
        let run = rest.iter().take_while(|&&p| p != 0).count();
        let (values, after) = rest.split_at(run);
        rest = after;
        nibbles.put(zeros as u32);
        nibbles.put(run as u32);
        for &value in values {
            let d = i32::from(value) - last;
            last = i32::from(value);
            nibbles.put(((d << 1) ^ (d >> 31)) as u32);
        }
    }
    nibbles.finish()
}

/// Decodes `n_pixels` samples from RVL; allocates exactly these.
pub fn decode_rvl(bytes: &[u8], n_pixels: usize) -> Result<Vec<u16>, WireError> {
    let mut nibbles = NibbleReader {
        bytes,
        word: 0,
        n: 0,
    };
    let mut pixels = Vec::new();
    pixels
        .try_reserve_exact(n_pixels)
        .map_err(|e| corrupt("rvl", "room for the image", e))?;
    let mut last = 0i64;
    while pixels.len() < n_pixels {
        let zeros = nibbles.get()? as usize;
        let run = nibbles.get()? as usize;
        let room = n_pixels - pixels.len();
        if zeros + run == 0 || zeros + run > room {
            return Err(corrupt(
                "rvl",
                format_args!("runs of 1 to {room} pixels (what is left)"),
                format_args!("{zeros} zeros and {run} others"),
            ));
        }
        pixels.resize(pixels.len() + zeros, 0);
        for _ in 0..run {
            let z = nibbles.get()?;
            last += i64::from((z >> 1) as i32 ^ -((z & 1) as i32));
            match u16::try_from(last) {
                Ok(value) if value != 0 => pixels.push(value),
                _ => return Err(corrupt("rvl", "non-zero samples of 1 to 65535", last)),
            }
        }
    }
    if nibbles.bytes.is_empty() && nibbles.word == 0 {
        return Ok(pixels);
    }
    Err(corrupt(
        "rvl",
        format_args!("the end after {n_pixels} pixels"),
        format_args!("{} bytes more", nibbles.bytes.len()),
    ))
}

/// Encodes differences in byte planes, compressed with zstd at level 1.
pub fn encode_delta_zstd(pixels: &[u16]) -> Result<Vec<u8>, WireError> {
    let n = pixels.len();
    let mut planes = vec![0; 2 * n];
    let (low, high) = planes.split_at_mut(n);
    let mut last = 0u16;
    for ((&p, l), h) in pixels.iter().zip(low).zip(high) {
        [*l, *h] = p.wrapping_sub(last).to_le_bytes();
        last = p;
    }
    zstd::bulk::compress(&planes, 1).map_err(|e| {
        WireError::new(
            Code::Internal,
            "depth payload (delta_zstd)",
            "zstd to compress it",
            e,
        )
    })
}

/// Decodes `n_pixels` samples from differences in byte planes; never allocates more than four bytes per pixel (and
/// zstd's fixed tables), independent of the sizes that the frame declares.
pub fn decode_delta_zstd(bytes: &[u8], n_pixels: usize) -> Result<Vec<u16>, WireError> {
    let mut planes = Vec::new();
    planes
        .try_reserve_exact(2 * n_pixels)
        .map_err(|e| corrupt("delta_zstd", "room for the image", e))?;
    // A second frame or trailing bytes must not be accepted as part of the first one.
    let frame = zstd::zstd_safe::find_frame_compressed_size(bytes).map_err(|e| {
        corrupt(
            "delta_zstd",
            "a zstd frame",
            zstd::zstd_safe::get_error_name(e),
        )
    })?;
    if frame != bytes.len() {
        return Err(corrupt(
            "delta_zstd",
            format_args!("one zstd frame of {frame} bytes"),
            format_args!("{} bytes", bytes.len()),
        ));
    }
    // The destination bounds the output: a decompression bomb ends as "destination buffer is too small".
    zstd::bulk::Decompressor::new()
        .and_then(|mut zstd| zstd.decompress_to_buffer(bytes, &mut planes))
        .map_err(|e| {
            corrupt(
                "delta_zstd",
                format_args!("a zstd frame of {} bytes of content", 2 * n_pixels),
                e,
            )
        })?;
    if planes.len() != 2 * n_pixels {
        return Err(corrupt(
            "delta_zstd",
            format_args!("{} bytes of content", 2 * n_pixels),
            format_args!("{} bytes", planes.len()),
        ));
    }
    let (low, high) = planes.split_at(n_pixels);
    let mut last = 0u16;
    Ok(low
        .iter()
        .zip(high)
        .map(|(&l, &h)| {
            last = last.wrapping_add(u16::from_le_bytes([l, h]));
            last
        })
        .collect())
}
