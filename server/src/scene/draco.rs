//! Draco-compressed meshes (.drc files, KHR_draco_mesh_compression). The decoder is safe Rust
//! that validates its input; the size of its output is bounded here.

use std::panic::{AssertUnwindSafe, catch_unwind};

use draco_core::{
    DataType, DecodeLimits, DecoderBuffer, GeometryAttributeType, MeshDecoder, PointAttribute,
};
use glam::{Vec2, Vec3, Vec4};

use super::error::MeshError;
use super::model::{MAX_TRIANGLES, Model, Part};
use super::sanitise::sanitise;
use super::{LoadContext, Mesh, normals};
use crate::numerics::linear_from_srgb;

/// Most bytes of decoded attributes of one mesh.
const MAX_DECODED: u64 = 1 << 30;

/// Memory per triangle while decoding, bytes: corners, opposite corners, marks.
const FACE_BYTES: u64 = 96;

/// Advice that errors end with.
pub(super) const CONVERT: &str =
    "convert it (gltf-transform copy in.glb out.glb, or export without Draco)";

/// A decoded mesh.
pub(super) struct Decoded(draco_core::Mesh);

/// Decodes a mesh from untrusted bytes.
pub(super) fn decode(context: &LoadContext, bytes: &[u8]) -> Result<Decoded, String> {
    if !bytes.starts_with(b"DRACO") {
        return Err(format!(
            "Draco: expected data that begin with DRACO, got others: {CONVERT}"
        ));
    }
    context.check().map_err(|error| error.to_string())?;
    let left = context.left();
    let mut limits = DecodeLimits::default();
    limits.max_faces = (context.max_triangles() as u64).min(left / FACE_BYTES);
    limits.max_points = (2 * MAX_TRIANGLES as u64).min(left / FACE_BYTES);
    limits.max_decoded_bytes = MAX_DECODED.min(left / 2);
    // A panic of the decoder must not stop the server.
    let decoded = catch_unwind(AssertUnwindSafe(|| {
        let mut buffer = DecoderBuffer::new(bytes).with_limits(limits);
        let mut mesh = draco_core::Mesh::new();
        MeshDecoder::new()
            .decode(&mut buffer, &mut mesh)
            .map(|()| mesh)
    }));
    match decoded {
        Ok(Ok(mesh)) => Ok(Decoded(mesh)),
        Ok(Err(error)) => {
            let problem = error.to_string().replace(['\n', '\r'], " ");
            Err(format!("Draco: cannot be decoded: {problem}: {CONVERT}"))
        }
        Err(_) => Err(format!("Draco: cannot be decoded: {CONVERT}")),
    }
}

impl Decoded {
    /// Corners of the triangles.
    pub(super) fn triangles(&self) -> Vec<[u32; 3]> {
        self.0
            .faces()
            .iter()
            .map(|face| face.map(|point| point.0))
            .collect()
    }

    /// `N` numbers per point, of the attribute with the Draco id `id`; normalized integers become fractions. `None`
    /// if there is no such attribute.
    pub(super) fn attribute<const N: usize>(
        &self,
        id: u32,
        is_normalized: bool,
    ) -> Option<Vec<[f32; N]>> {
        let attribute = self.0.attribute_by_unique_id(id)?;
        Some(self.read(attribute, is_normalized))
    }

    /// Numbers per point of an attribute.
    pub(super) fn width(&self, id: u32) -> Option<usize> {
        let attribute = self.0.attribute_by_unique_id(id)?;
        Some(usize::from(attribute.num_components()))
    }

    fn read<const N: usize>(
        &self,
        attribute: &PointAttribute,
        is_normalized: bool,
    ) -> Vec<[f32; N]> {
        let mut values = attribute.read_f32s(self.0.num_points(), N);
        let max = match attribute.data_type() {
            DataType::Int8 => 127.0,
            DataType::Uint8 => 255.0,
            DataType::Int16 => 32_767.0,
            DataType::Uint16 => 65_535.0,
            _ => 1.0,
        };
        if (is_normalized || attribute.normalized()) && max > 1.0 {
            for value in &mut values {
                *value = (*value / max).max(-1.0);
            }
        }
        values.as_chunks::<N>().0.to_vec()
    }

    fn named<const N: usize>(&self, kind: GeometryAttributeType) -> Option<Vec<[f32; N]>> {
        let attribute = self.0.named_attribute(kind)?;
        // Integer colours are always fractions.
        let is_normalized = kind == GeometryAttributeType::Color;
        Some(self.read(attribute, is_normalized))
    }
}

/// Reads a .drc file from memory.
pub(super) fn load(context: &LoadContext, bytes: &[u8], name: &str) -> Result<Model, MeshError> {
    let fail = |problem: String| MeshError::new(name, problem);
    let decoded = decode(context, bytes).map_err(fail)?;
    let triangles = decoded.triangles();
    if triangles.is_empty() {
        return Err(fail(format!(
            "expected triangles, got a cloud of {} points",
            decoded.0.num_points()
        )));
    }
    let positions = decoded
        .named::<3>(GeometryAttributeType::Position)
        .ok_or_else(|| fail("expected positions, got none".to_owned()))?;
    let vectors = |kind| decoded.named::<3>(kind).unwrap_or_default();
    let width = decoded
        .0
        .named_attribute(GeometryAttributeType::Color)
        .map_or(0, PointAttribute::num_components);
    // Colours are sRGB-coded, as in other scans.
    let color = |[r, g, b, a]: [f32; 4]| {
        let linear = |c: f32| linear_from_srgb((255.0 * c).round() as u8);
        let alpha = if width == 4 { a } else { 1.0 };
        Vec4::new(linear(r), linear(g), linear(b), alpha)
    };
    let mesh = Mesh {
        positions: positions.into_iter().map(Vec3::from).collect(),
        normals: vectors(GeometryAttributeType::Normal)
            .into_iter()
            .map(Vec3::from)
            .collect(),
        uvs: decoded
            .named::<2>(GeometryAttributeType::TexCoord)
            .unwrap_or_default()
            .into_iter()
            // Image rows run downwards.
            .map(|[u, v]| Vec2::new(u, 1.0 - v))
            .collect(),
        colors: decoded
            .named::<4>(GeometryAttributeType::Color)
            .unwrap_or_default()
            .into_iter()
            .map(color)
            .collect(),
        triangles,
    };
    let had_normals = !mesh.normals.is_empty();
    let (mut mesh, report) = sanitise(mesh, name)?;
    if !had_normals {
        mesh = normals::smooth(mesh);
    }
    let mut model = Model {
        meshes: vec![std::sync::Arc::new(mesh)],
        parts: vec![Part {
            mesh: 0,
            material: None,
            model_from_mesh: glam::DAffine3::IDENTITY,
        }],
        report,
        ..Model::default()
    };
    model.note_report();
    Ok(model)
}
