//! Buffer views compressed by meshoptimizer (EXT_meshopt_compression, KHR_meshopt_compression; written by gltfpack).
//! The decoder is safe for any bytes; its preconditions on sizes are checked here, and its output is bounded before
//! it is allocated.

use std::borrow::Cow;

use super::super::LoadContext;
use super::super::model::MAX_TRIANGLES;
use super::format::Meshopt;

/// Most bytes of one decoded view.
const MAX_DECODED: usize = 2 << 30;

/// Largest compression ratio, output bytes per input byte: a block of 256 equal vertices takes a quarter byte per
/// byte of one vertex.
const MAX_RATIO: usize = 1024;

/// A vertex of `N` words.
#[derive(Clone, Copy)]
struct Words<const N: usize>([u32; N]);

impl<const N: usize> Default for Words<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

/// The bytes of a compressed view.
pub(super) fn decode(
    context: &LoadContext,
    view: &Meshopt,
    buffers: &[Cow<'_, [u8]>],
) -> Result<Vec<u8>, String> {
    let buffer = buffers.get(view.buffer).ok_or_else(|| {
        format!(
            "meshopt: buffer: expected less than {}, got {}",
            buffers.len(),
            view.buffer
        )
    })?;
    let encoded = view
        .byte_offset
        .checked_add(view.byte_length)
        .and_then(|end| buffer.get(view.byte_offset..end))
        .ok_or_else(|| {
            format!(
                "meshopt: {} bytes at {}: expected them within the buffer's {} bytes",
                view.byte_length,
                view.byte_offset,
                buffer.len()
            )
        })?;
    let (count, stride) = (view.count, view.byte_stride);
    let bytes = count.checked_mul(stride).filter(|&n| n <= MAX_DECODED);
    // A small output is always allowed, because short blocks are padded.
    let backed = encoded.len().saturating_mul(MAX_RATIO).max(1 << 16);
    if count > 3 * MAX_TRIANGLES || bytes.is_none_or(|n| n > backed) {
        return Err(format!(
            "meshopt: {count} elements of {stride} bytes: got only {} bytes for them",
            encoded.len()
        ));
    }
    // Memory of the words, then of the bytes.
    context.unpack(2 * bytes.unwrap_or(0) as u64)?;
    let damaged = || format!("meshopt: its {} bytes cannot be decoded", encoded.len());
    match view.mode.as_str() {
        "ATTRIBUTES" => {
            let mut words = vertices(encoded, count, stride)?.ok_or_else(damaged)?;
            filter(&mut words, stride, &view.filter)?;
            Ok(words)
        }
        "TRIANGLES" | "INDICES" if !matches!(stride, 2 | 4) => Err(format!(
            "meshopt: byteStride: expected 2 or 4 for indices, got {stride}"
        )),
        "TRIANGLES" if count % 3 != 0 => Err(format!(
            "meshopt: count: expected three indices per triangle, got {count}"
        )),
        mode @ ("TRIANGLES" | "INDICES") => {
            let indices: Vec<u32> = match mode {
                "TRIANGLES" => meshopt::decode_index_buffer(encoded, count),
                _ => meshopt::decode_index_sequence(encoded, count),
            }
            .map_err(|_| damaged())?;
            Ok(indices
                .iter()
                .flat_map(|i| i.to_le_bytes().into_iter().take(stride))
                .collect())
        }
        other => Err(format!(
            "meshopt: mode: expected ATTRIBUTES, TRIANGLES or INDICES, got {other:?}"
        )),
    }
}

/// Vertices of any permitted size as bytes; `Ok(None)` if the data is damaged.
fn vertices(encoded: &[u8], count: usize, stride: usize) -> Result<Option<Vec<u8>>, String> {
    macro_rules! by_size {
        ($($n:literal)*) => {
            match stride {
                $(n if n == 4 * $n => words::<$n>(encoded, count),)*
                _ => return Err(format!(
                    "meshopt: byteStride: expected a multiple of 4 up to 256, got {stride}"
                )),
            }
        };
    }
    Ok(by_size!(
        1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32
        33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62
        63 64
    ))
}

fn words<const N: usize>(encoded: &[u8], count: usize) -> Option<Vec<u8>> {
    let vertices: Vec<Words<N>> = meshopt::decode_vertex_buffer(encoded, count).ok()?;
    // The words were written in memory order, so their bytes are the decoded data.
    Some(
        vertices
            .iter()
            .flat_map(|v| v.0)
            .flat_map(u32::to_ne_bytes)
            .collect(),
    )
}

/// Undoes the filter that was applied before compression.
fn filter(bytes: &mut [u8], stride: usize, name: &str) -> Result<(), String> {
    let i8s = |four: &[u8; 4]| four.map(|b| b as i8);
    let i16s = |eight: &[u8; 8]| -> [i16; 4] {
        std::array::from_fn(|k| i16::from_le_bytes([eight[2 * k], eight[2 * k + 1]]))
    };
    macro_rules! in_fours {
        (i8, $decode:path) => {
            for four in bytes.as_chunks_mut::<4>().0 {
                let mut one = [i8s(four)];
                $decode(&mut one);
                *four = one[0].map(|x| x as u8);
            }
        };
        (i16, $decode:path) => {
            for eight in bytes.as_chunks_mut::<8>().0 {
                let mut one = [i16s(eight)];
                $decode(&mut one);
                for (pair, x) in eight.as_chunks_mut::<2>().0.iter_mut().zip(one[0]) {
                    *pair = x.to_le_bytes();
                }
            }
        };
    }
    match (name, stride) {
        ("" | "NONE", _) => {}
        ("OCTAHEDRAL", 4) => in_fours!(i8, meshopt::decode_filter_oct),
        ("OCTAHEDRAL", 8) => in_fours!(i16, meshopt::decode_filter_oct),
        ("COLOR", 4) => in_fours!(i8, meshopt::decode_filter_color),
        ("COLOR", 8) => in_fours!(i16, meshopt::decode_filter_color),
        ("QUATERNION", 8) => in_fours!(i16, meshopt::decode_filter_quat),
        ("EXPONENTIAL", _) => {
            // Any multiple of 4: each word is decoded on its own.
            for word in bytes.as_chunks_mut::<4>().0 {
                let mut one = [[u32::from_le_bytes(*word)]];
                meshopt::decode_filter_exp(&mut one);
                *word = one[0][0].to_le_bytes();
            }
        }
        ("OCTAHEDRAL" | "COLOR" | "QUATERNION", _) => {
            return Err(format!(
                "meshopt: filter {name}: expected a byteStride of 4 or 8, got {stride}"
            ));
        }
        _ => {
            return Err(format!(
                "meshopt: filter: expected a known one, got {name:?}"
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn view(bytes: &[u8], count: usize, stride: usize, mode: &str, filter: &str) -> Meshopt {
        Meshopt {
            byte_length: bytes.len(),
            byte_stride: stride,
            count,
            mode: mode.to_owned(),
            filter: filter.to_owned(),
            ..Meshopt::default()
        }
    }

    fn read(view: &Meshopt, bytes: &[u8]) -> Result<Vec<u8>, String> {
        decode(&LoadContext::default(), view, &[Cow::Borrowed(bytes)])
    }

    #[test]
    fn vertices_and_indices_come_back() {
        let vertices: Vec<[f32; 3]> = (0..300).map(|i| [i as f32, 0.5, -1.0]).collect();
        let bytes = meshopt::encode_vertex_buffer(&vertices).unwrap();
        let out = read(&view(&bytes, 300, 12, "ATTRIBUTES", "NONE"), &bytes).unwrap();
        let expected: Vec<u8> = vertices
            .iter()
            .flatten()
            .flat_map(|x| x.to_le_bytes())
            .collect();
        assert_eq!(out, expected);
        let indices = [0u32, 1, 2, 2, 1, 3];
        let bytes = meshopt::encode_index_buffer(&indices, 4).unwrap();
        let out = read(&view(&bytes, 6, 2, "TRIANGLES", ""), &bytes).unwrap();
        assert_eq!(out, [0, 0, 1, 0, 2, 0, 2, 0, 1, 0, 3, 0]);
        let bytes = meshopt::encode_index_sequence(&indices, 4).unwrap();
        let out = read(&view(&bytes, 6, 4, "INDICES", ""), &bytes).unwrap();
        assert_eq!((out.len(), out[20]), (24, 3));
    }

    #[test]
    fn filters_are_undone() {
        // Each word encodes 2^E M: here exponent 1, mantissa 3.
        let mut word = (1u32 << 24 | 3).to_le_bytes();
        filter(&mut word, 4, "EXPONENTIAL").unwrap();
        assert_eq!(f32::from_le_bytes(word), 6.0);
        // x = 1 on the octahedron with one = 127.
        let mut normal = [127, 0, 127, 0];
        filter(&mut normal, 4, "OCTAHEDRAL").unwrap();
        assert_eq!(normal, [127, 0, 0, 0]);
        let mut wide = [32767i16, 0, 32767, 0].map(i16::to_le_bytes).concat();
        filter(&mut wide, 8, "OCTAHEDRAL").unwrap();
        assert_eq!(wide, [32767i16, 0, 0, 0].map(i16::to_le_bytes).concat());
    }

    #[test]
    fn sizes_that_the_decoder_does_not_take_are_errors() {
        let bytes = meshopt::encode_vertex_buffer(&[[0u32; 2]; 4]).unwrap();
        for (count, stride, mode, filter) in [
            (4, 0, "ATTRIBUTES", ""),
            (4, 6, "ATTRIBUTES", ""),
            (4, 260, "ATTRIBUTES", ""),
            (4, 8, "ATTRIBUTES", "FOURIER"),
            (4, 12, "ATTRIBUTES", "QUATERNION"),
            (4, 2, "TRIANGLES", ""),
            (6, 3, "TRIANGLES", ""),
            (6, 4, "POINTS", ""),
            (usize::MAX, 8, "ATTRIBUTES", ""),
            (40_000_000, 8, "ATTRIBUTES", ""),
        ] {
            let error = read(&view(&bytes, count, stride, mode, filter), &bytes);
            assert!(error.is_err(), "{count} {stride} {mode} {filter}");
        }
        let mut outside = view(&bytes, 4, 8, "ATTRIBUTES", "");
        outside.byte_offset = usize::MAX;
        assert!(read(&outside, &bytes).is_err());
    }

    proptest! {
        #[test]
        fn damaged_bytes_never_panic(
            tail in prop::collection::vec(any::<u8>(), 0..300),
            changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6),
            count in 0usize..600,
            stride in 0usize..72,
            mode in prop::sample::select(vec!["ATTRIBUTES", "TRIANGLES", "INDICES"]),
            filter in prop::sample::select(vec!["", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"]),
            real: bool,
        ) {
            let mut bytes = if real {
                let vertices: Vec<[u16; 4]> = (0..100).map(|i| [i, 2 * i, 7, 0]).collect();
                meshopt::encode_vertex_buffer(&vertices).unwrap()
            } else {
                [&[0xA0 | (count as u8 & 0x51)][..], &tail].concat()
            };
            for (at, byte) in changes {
                let at = at.index(bytes.len());
                bytes[at] = byte;
            }
            if let Ok(out) = read(&view(&bytes, count, stride, mode, filter), &bytes) {
                prop_assert_eq!(out.len(), count * stride);
            }
        }
    }
}
