//! Typed reads of accessors: every offset, stride and index is checked against the buffer.

use std::borrow::Cow;
use std::sync::OnceLock;

use super::super::LoadContext;
use super::super::error::MeshError;
use super::super::model::MAX_TRIANGLES;
use super::compressed;
use super::format::{Accessor, Root};

/// The document and the bytes of its buffers.
pub(super) struct Data<'a> {
    pub(super) context: &'a LoadContext,
    pub(super) root: &'a Root,
    buffers: &'a [Cow<'a, [u8]>],
    /// File name, for messages.
    pub(super) file: &'a str,
    /// Compressed views, decoded when they are first used.
    decoded: Vec<OnceLock<Result<Vec<u8>, String>>>,
}

impl<'a> Data<'a> {
    pub(super) fn new(
        context: &'a LoadContext,
        root: &'a Root,
        buffers: &'a [Cow<'a, [u8]>],
        file: &'a str,
    ) -> Self {
        Self {
            context,
            root,
            buffers,
            file,
            decoded: root.buffer_views.iter().map(|_| OnceLock::new()).collect(),
        }
    }
}

/// Most elements of an accessor without a buffer (zeros except for sparse values); bounds the memory that a small
/// file can request.
const MAX_ZEROS: usize = 1 << 20;

fn component_size(kind: u32) -> Option<usize> {
    match kind {
        5120 | 5121 => Some(1),
        5122 | 5123 => Some(2),
        5125 | 5126 => Some(4),
        _ => None,
    }
}

/// One component as a float; normalized integers as glTF 2.0, 3.11 defines.
fn to_float(kind: u32, normalized: bool, bytes: &[u8]) -> f32 {
    let (value, max) = match (kind, bytes) {
        (5120, &[a]) => (f32::from(a as i8), 127.0),
        (5121, &[a]) => (f32::from(a), 255.0),
        (5122, &[a, b]) => (f32::from(i16::from_le_bytes([a, b])), 32767.0),
        (5123, &[a, b]) => (f32::from(u16::from_le_bytes([a, b])), 65535.0),
        (5125, &[a, b, c, d]) => (u32::from_le_bytes([a, b, c, d]) as f32, 4_294_967_295.0),
        (_, &[a, b, c, d]) => return f32::from_le_bytes([a, b, c, d]),
        _ => return f32::NAN,
    };
    if normalized {
        (value / max).max(-1.0)
    } else {
        value
    }
}

fn to_index(bytes: &[u8]) -> u32 {
    match *bytes {
        [a] => u32::from(a),
        [a, b] => u32::from(u16::from_le_bytes([a, b])),
        [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
        _ => u32::MAX,
    }
}

impl Data<'_> {
    /// The bytes of a buffer view; fewer than declared if its buffer is short.
    pub(super) fn view(&self, index: usize, at: &str) -> Result<&[u8], MeshError> {
        let fail = |problem: String| MeshError::at(self.file, at, problem);
        let view = self.root.buffer_views.get(index).ok_or_else(|| {
            fail(format!(
                "bufferView: expected less than {}, got {index}",
                self.root.buffer_views.len()
            ))
        })?;
        let Some(meshopt) = view.meshopt() else {
            return self.plain(index).map_err(fail);
        };
        let decoded = self.decoded[index]
            .get_or_init(|| compressed::decode(self.context, meshopt, self.buffers));
        match decoded {
            Ok(bytes) => Ok(bytes),
            Err(problem) => self
                .fallback(index)
                .ok_or_else(|| fail(format!("bufferViews[{index}]: {problem}"))),
        }
    }

    /// The bytes at a view's offset, as many as the buffer has.
    fn plain(&self, index: usize) -> Result<&[u8], String> {
        let view = &self.root.buffer_views[index];
        let buffer = self.buffers.get(view.buffer).ok_or_else(|| {
            format!(
                "bufferViews[{index}].buffer: expected less than {}, got {}",
                self.buffers.len(),
                view.buffer
            )
        })?;
        let end = view.byte_offset.saturating_add(view.byte_length);
        buffer
            .get(view.byte_offset..end.min(buffer.len()))
            .filter(|bytes| !bytes.is_empty())
            .ok_or_else(|| {
                format!(
                    "bufferViews[{index}]: {} bytes at {}: expected them within the buffer's {} bytes",
                    view.byte_length,
                    view.byte_offset,
                    buffer.len()
                )
            })
    }

    /// The uncompressed copy of a compressed view, if the file has one.
    fn fallback(&self, index: usize) -> Option<&[u8]> {
        let whole = self.root.buffer_views[index].byte_length;
        self.plain(index).ok().filter(|bytes| bytes.len() >= whole)
    }

    /// Notes on damaged views whose uncompressed copy was used instead.
    pub(super) fn fallback_notes(&self) -> impl Iterator<Item = String> {
        let views = self.decoded.iter().enumerate();
        views.filter_map(|(index, decoded)| match decoded.get() {
            Some(Err(problem)) if self.fallback(index).is_some() => Some(format!(
                "bufferViews[{index}]: {problem}: its uncompressed data are used"
            )),
            _ => None,
        })
    }

    /// `count` elements of `size` bytes, `offset` into a view.
    fn elements<'s>(
        &'s self,
        view: usize,
        offset: usize,
        count: usize,
        size: usize,
        at: &str,
    ) -> Result<impl Iterator<Item = &'s [u8]> + use<'s>, MeshError> {
        let bytes = self.view(view, at)?;
        // The view was looked up just above, so the index is valid.
        let entry = &self.root.buffer_views[view];
        // Compressed indices are decoded tightly packed.
        let stride = match (entry.byte_stride, entry.meshopt()) {
            (None, Some(meshopt)) if meshopt.mode == "ATTRIBUTES" => meshopt.byte_stride,
            (stride, _) => stride.unwrap_or(size),
        }
        .max(size);
        let needed = count
            .checked_sub(1)
            .map_or(Some(0), |last| last.checked_mul(stride)?.checked_add(size));
        let data = needed
            .and_then(|n| offset.checked_add(n))
            .and_then(|end| bytes.get(offset..end))
            .ok_or_else(|| {
                MeshError::at(
                    self.file,
                    at,
                    format!(
                        "{count} elements of {size} bytes: expected them within the {} bytes of bufferViews[{view}]",
                        bytes.len()
                    ),
                )
            })?;
        Ok((0..count).map(move |i| &data[i * stride..i * stride + size]))
    }

    fn accessor(
        &self,
        index: usize,
        at: &str,
        kind: &str,
    ) -> Result<(&Accessor, usize), MeshError> {
        let fail = |problem: String| MeshError::at(self.file, at, problem);
        let accessor = self.root.accessors.get(index).ok_or_else(|| {
            fail(format!(
                "expected less than the {} accessors, got {index}",
                self.root.accessors.len()
            ))
        })?;
        if accessor.kind != kind {
            return Err(fail(format!(
                "accessors[{index}].type: expected {kind}, got {:?}",
                accessor.kind
            )));
        }
        let size = component_size(accessor.component_type).ok_or_else(|| {
            fail(format!(
                "accessors[{index}].componentType: expected 5120 to 5123, 5125 or 5126, got {}",
                accessor.component_type
            ))
        })?;
        // A usable accessor has at most three indices per triangle.
        let max = match accessor.buffer_view {
            Some(_) => 3 * MAX_TRIANGLES,
            None => MAX_ZEROS,
        };
        if accessor.count > max {
            return Err(fail(format!(
                "accessors[{index}].count: expected at most {max}, got {}",
                accessor.count
            )));
        }
        Ok((accessor, size))
    }

    /// An accessor of `N`-vectors (16: column-major matrices) as floats.
    pub(super) fn vectors<const N: usize>(
        &self,
        index: usize,
        at: &str,
    ) -> Result<Vec<[f32; N]>, MeshError> {
        let (accessor, size) = match N {
            16 => self.accessor(index, at, "MAT4")?,
            _ => self.accessor(index, at, &format!("VEC{N}"))?,
        };
        let read = |bytes: &[u8]| -> [f32; N] {
            std::array::from_fn(|k| {
                to_float(
                    accessor.component_type,
                    accessor.normalized,
                    &bytes[k * size..(k + 1) * size],
                )
            })
        };
        let mut out: Vec<[f32; N]> = match accessor.buffer_view {
            Some(view) => self
                .elements(view, accessor.byte_offset, accessor.count, N * size, at)?
                .map(read)
                .collect(),
            None => vec![[0.0; N]; accessor.count],
        };
        self.each_sparse(accessor, N * size, at, |i, bytes| out[i] = read(bytes))?;
        Ok(out)
    }

    /// An accessor of colours, linear; alpha is 1 if the file has none. Integers are always treated as normalized, as
    /// the specification requires for colours.
    pub(super) fn colors(&self, index: usize, at: &str) -> Result<Vec<[f32; 4]>, MeshError> {
        let entry = self.root.accessors.get(index);
        let mut colors: Vec<[f32; 4]> = match entry.map(|a| a.kind.as_str()) {
            Some("VEC3") => self
                .vectors::<3>(index, at)?
                .into_iter()
                .map(|[r, g, b]| [r, g, b, 1.0])
                .collect(),
            _ => self.vectors::<4>(index, at)?,
        };
        let has_alpha = entry.is_some_and(|a| a.kind == "VEC4");
        let max = match entry.filter(|a| !a.normalized).map(|a| a.component_type) {
            Some(5121) => 255.0,
            Some(5123) => 65535.0,
            _ => return Ok(colors),
        };
        for color in &mut colors {
            for channel in &mut color[..if has_alpha { 4 } else { 3 }] {
                *channel /= max;
            }
        }
        Ok(colors)
    }

    /// The index that restarts a strip (forbidden by glTF, but supported by engines): the largest of its type.
    pub(super) fn restart_index(&self, accessor: usize) -> u32 {
        match self.root.accessors.get(accessor).map(|a| a.component_type) {
            Some(5121) => 0xFF,
            Some(5123) => 0xFFFF,
            _ => u32::MAX,
        }
    }

    /// An accessor of vertex indices.
    pub(super) fn indices(&self, index: usize, at: &str) -> Result<Vec<u32>, MeshError> {
        let (accessor, size) = self.accessor(index, at, "SCALAR")?;
        if !matches!(accessor.component_type, 5121 | 5123 | 5125) {
            return Err(MeshError::at(
                self.file,
                at,
                format!(
                    "accessors[{index}].componentType: expected 5121, 5123 or 5125, got {}",
                    accessor.component_type
                ),
            ));
        }
        let mut out: Vec<u32> = match accessor.buffer_view {
            Some(view) => self
                .elements(view, accessor.byte_offset, accessor.count, size, at)?
                .map(to_index)
                .collect(),
            None => vec![0; accessor.count],
        };
        self.each_sparse(accessor, size, at, |i, bytes| out[i] = to_index(bytes))?;
        Ok(out)
    }

    /// Calls `set` with each value that a sparse accessor replaces.
    fn each_sparse(
        &self,
        accessor: &Accessor,
        size: usize,
        at: &str,
        mut set: impl FnMut(usize, &[u8]),
    ) -> Result<(), MeshError> {
        let Some(sparse) = &accessor.sparse else {
            return Ok(());
        };
        let fail = |problem: String| MeshError::at(self.file, at, problem);
        let kind = sparse.indices.component_type;
        let index_size = component_size(kind)
            .filter(|_| matches!(kind, 5121 | 5123 | 5125))
            .ok_or_else(|| {
                fail(format!(
                    "sparse.indices.componentType: expected 5121, 5123 or 5125, got {kind}"
                ))
            })?;
        let indices = self.elements(
            sparse.indices.buffer_view,
            sparse.indices.byte_offset,
            sparse.count,
            index_size,
            at,
        )?;
        let values = self.elements(
            sparse.values.buffer_view,
            sparse.values.byte_offset,
            sparse.count,
            size,
            at,
        )?;
        for (index, value) in indices.zip(values) {
            let index = to_index(index) as usize;
            if index >= accessor.count {
                return Err(fail(format!(
                    "sparse.indices: expected less than {}, got {index}",
                    accessor.count
                )));
            }
            set(index, value);
        }
        Ok(())
    }
}
