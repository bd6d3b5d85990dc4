use super::*;
use crate::scene::test_data;
use crate::scene::{AlphaMode, Material, Wrap};
use glam::{Vec2, Vec3};
use proptest::prelude::*;

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    bytes
        .chunks(3)
        .flat_map(|chunk| {
            let bits = chunk.iter().fold(0u32, |bits, &b| bits << 8 | u32::from(b))
                << (8 * (3 - chunk.len()));
            (0..=chunk.len()).map(move |i| DIGITS[(bits >> (18 - 6 * i)) as usize & 63] as char)
        })
        .collect()
}

/// A square of four vertices: positions (48 bytes), texture coordinates (32), indices (12).
fn square_bytes() -> Vec<u8> {
    let positions = [
        [0.0f32, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ];
    let uvs = [[0.0f32, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    let mut bytes: Vec<u8> = Vec::new();
    bytes.extend(positions.iter().flatten().flat_map(|x| x.to_le_bytes()));
    bytes.extend(uvs.iter().flatten().flat_map(|x| x.to_le_bytes()));
    bytes.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|i| i.to_le_bytes()));
    bytes
}

/// A document around the square; `replace` edits its text.
fn square(replace: &[(&str, &str)]) -> String {
    let mut text = format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],
"nodes":[{{"mesh":0,"children":[1],"translation":[1,0,0]}},{{"mesh":0,"scale":[2,2,2]}}],
"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0}}]}}],
"materials":[{{"name":"m","pbrMetallicRoughness":{{"baseColorFactor":[1,0.5,0.25,1]}}}}],
"accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"}},
{{"bufferView":1,"componentType":5126,"count":4,"type":"VEC2"}},
{{"bufferView":2,"componentType":5123,"count":6,"type":"SCALAR"}}],
"bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":32}},{{"buffer":0,"byteOffset":80,"byteLength":12}}],
"buffers":[{{"byteLength":92,"uri":"data:application/octet-stream;base64,{}"}}]}}"#,
        base64(&square_bytes())
    );
    for (from, to) in replace {
        assert!(text.contains(from), "{from}");
        text = text.replacen(from, to, 1);
    }
    text
}

fn read(text: &str) -> Result<Model, MeshError> {
    load(text.as_bytes(), "m.gltf", Path::new(""))
}

fn material(replace: &str) -> (Material, Vec<String>) {
    let model = read(&square(&[("\"name\":\"m\"", replace)])).unwrap();
    (model.materials[0].clone(), model.notes)
}

#[test]
fn nodes_share_meshes_and_inherit_transforms() {
    let model = read(&square(&[])).unwrap();
    assert_eq!(
        (model.meshes.len(), model.parts.len(), model.n_drawn()),
        (1, 2, 4)
    );
    let corner = |part: usize| {
        model.parts[part]
            .model_from_mesh
            .transform_point3(DVec3::ONE)
    };
    assert_eq!(corner(0), DVec3::new(2.0, 1.0, 1.0));
    assert_eq!(corner(1), DVec3::new(3.0, 2.0, 2.0));
    assert_eq!(model.meshes[0].uvs[2], Vec2::new(1.0, 0.0));
    assert_eq!(model.materials[0].base_color, Vec3::new(1.0, 0.5, 0.25));
    assert!(model.meshes[0].normals.is_empty());
}

#[test]
fn every_mode_and_component_type_is_read() {
    // Strip and fan over the vertices in order.
    for (mode, triangles) in [(5, [[0, 1, 2], [2, 1, 3]]), (6, [[0, 1, 2], [0, 2, 3]])] {
        let text = square(&[("\"indices\":2", &format!("\"mode\":{mode}"))]);
        assert_eq!(read(&text).unwrap().meshes[0].triangles, triangles);
    }
    let points = read(&square(&[("\"indices\":2", "\"mode\":0")])).unwrap_err();
    assert!(
        points
            .to_string()
            .contains("expected triangles in its scene"),
        "{points}"
    );
    // Bytes, normalized (KHR_mesh_quantization).
    let quantized = square(&[
        (
            "\"componentType\":5126,\"count\":4,\"type\":\"VEC3\"",
            "\"componentType\":5120,\"normalized\":true,\"count\":3,\"type\":\"VEC3\"",
        ),
        (
            "\"asset\"",
            "\"extensionsRequired\":[\"KHR_mesh_quantization\"],\"asset\"",
        ),
        (
            "\"byteLength\":48",
            "\"byteOffset\":92,\"byteLength\":12,\"byteStride\":4",
        ),
        ("\"count\":6", "\"count\":3"),
        (",\"TEXCOORD_0\":1", ""),
        ("\"byteLength\":92", "\"byteLength\":104"),
        (
            &base64(&square_bytes()),
            &base64(
                &[
                    square_bytes(),
                    vec![0, 0, 0, 9, 127, 0, 0, 9, 127, 129, 128, 9],
                ]
                .concat(),
            ),
        ),
    ]);
    assert_eq!(
        read(&quantized).unwrap().meshes[0].positions,
        [Vec3::ZERO, Vec3::X, Vec3::new(1.0, -1.0, -1.0)]
    );
    // Sparse: the third vertex is replaced by the values of the first texture coordinates.
    let sparse = square(&[(
        "\"count\":4,\"type\":\"VEC3\"",
        "\"count\":4,\"type\":\"VEC3\",\"sparse\":{\"count\":1,\"indices\":{\"bufferView\":2,\"byteOffset\":4,\"componentType\":5123},\"values\":{\"bufferView\":1}}",
    )]);
    assert_eq!(
        read(&sparse).unwrap().meshes[0].positions[2],
        Vec3::new(0.0, 1.0, 1.0)
    );
}

#[test]
fn materials_follow_the_extensions() {
    let (glass, _) = material(
        r#""extensions":{"KHR_materials_transmission":{"transmissionFactor":0.9},"KHR_materials_ior":{"ior":1.33},"KHR_materials_volume":{"thicknessFactor":1,"attenuationDistance":0.5,"attenuationColor":[1,0,0.5]}}"#,
    );
    assert_eq!(
        (glass.transmission, glass.ior, glass.thin),
        (0.9, 1.33, false)
    );
    assert_eq!(
        (glass.attenuation_distance_m, glass.attenuation_color),
        (0.5, Vec3::new(1.0, 0.0, 0.5))
    );
    let (pane, _) =
        material(r#""extensions":{"KHR_materials_transmission":{"transmissionFactor":1}}"#);
    assert!(pane.thin);
    let (pane, _) = material(
        r#""extensions":{"KHR_materials_transmission":{"transmissionFactor":1},"KHR_materials_volume":{}}"#,
    );
    assert!(pane.thin && pane.attenuation_distance_m.is_infinite());
    let (lamp, _) = material(
        r#""emissiveFactor":[1,0.5,0],"extensions":{"KHR_materials_emissive_strength":{"emissiveStrength":10}}"#,
    );
    assert_eq!(lamp.emissive, Vec3::new(10.0, 5.0, 0.0));
    let model = read(&square(&[
        ("\"name\":\"m\"", "\"alphaMode\":\"BLEND\""),
        ("0.25,1]", "0.25,0.2]"),
    ]))
    .unwrap();
    let veil = AlphaMode::Blend { opacity: 0.2 };
    assert_eq!((model.materials[0].alpha, model.notes.len()), (veil, 0));
    let (coated, _) = material(
        r#""extensions":{"KHR_materials_clearcoat":{"clearcoatFactor":0.7,"clearcoatRoughnessFactor":0.1}}"#,
    );
    assert_eq!((coated.clearcoat, coated.clearcoat_roughness), (0.7, 0.1));
    let gone = read(&square(&[
        ("\"name\":\"m\"", "\"alphaMode\":\"MASK\""),
        ("0.25,1]", "0.25,0.2]"),
    ]));
    assert!(gone.unwrap_err().to_string().contains("expected triangles"));
    // Numbers out of range are clamped.
    let (wild, _) = material(r#""emissiveFactor":[-1,1e300,0],"normalTexture":null"#);
    assert_eq!(wild.emissive, Vec3::Y);
}

#[test]
fn textures_are_decoded_and_share_one_mapping() {
    let mut png = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_pixel(2, 2, image::Rgba([9, 8, 7, 128]))
        .write_to(&mut png, image::ImageFormat::Png)
        .unwrap();
    let png = base64(png.get_ref());
    let textures = format!(
        "\"textures\":[{{\"source\":0,\"sampler\":0}},{{}}],\"samplers\":[{{\"wrapS\":33071,\"wrapT\":33648}}],\"images\":[{{\"uri\":\"data:image/png;base64,{png}\"}}],\"meshes\""
    );
    let text = square(&[
        ("\"meshes\"", &textures),
        (
            "\"name\":\"m\"",
            "\"alphaMode\":\"MASK\",\"alphaCutoff\":0.4,\"normalTexture\":{\"index\":0,\"scale\":0.5},\"occlusionTexture\":{\"index\":0,\"strength\":0.25},\"emissiveTexture\":{\"index\":0,\"texCoord\":1}",
        ),
        (
            "\"baseColorFactor\":[1,0.5,0.25,1]",
            "\"baseColorFactor\":[1,1,1,0.5],\"metallicRoughnessTexture\":{\"index\":1},\"baseColorTexture\":{\"index\":0}",
        ),
    ]);
    let model = read(&text).unwrap();
    let material = &model.materials[0];
    let base = material.base_color_texture.as_ref().unwrap();
    assert_eq!(
        (base.width, base.reading.srgb, base.rgba[3]),
        (2, true, [9, 8, 7, 128])
    );
    assert_eq!(base.reading.wrap, [Wrap::Clamp, Wrap::Mirror]);
    assert!(!material.normal_texture.as_ref().unwrap().reading.srgb);
    assert!(!material.occlusion_texture.as_ref().unwrap().reading.srgb);
    assert_eq!(material.occlusion_strength, 0.25);
    assert_eq!(
        (material.normal_scale, material.alpha),
        (0.5, AlphaMode::Mask { cutoff: 0.8 })
    );
    assert!(material.emissive_texture.is_none() && material.metallic_roughness_texture.is_none());
    assert_eq!(model.notes.len(), 2, "{:?}", model.notes);
    // A texture transform is baked into the mesh: a quarter turn, then a shift.
    let text = text.replacen(
        "\"baseColorTexture\":{\"index\":0}",
        "\"baseColorTexture\":{\"index\":0,\"extensions\":{\"KHR_texture_transform\":{\"rotation\":1.5707963267948966,\"offset\":[0,1],\"scale\":[2,1]}}}",
        1,
    );
    let uv = read(&text).unwrap().meshes[0].uvs[1];
    assert!((uv - Vec2::new(1.0, -1.0)).length() < 1e-6, "{uv}");
    let broken = text.replacen(&png[..40], &"A".repeat(40), 1);
    let model = read(&broken).unwrap();
    assert!(model.materials[0].base_color_texture.is_none());
    let note = "materials[0].baseColorTexture left out: images[0]: expected a PNG, JPEG or WebP";
    assert!(
        model.notes.iter().any(|n| n.starts_with(note)),
        "{:?}",
        model.notes
    );
}

#[test]
fn every_lie_is_one_error_that_says_where() {
    let cases: &[(&str, &str, &str)] = &[
        (
            "\"2.0\"",
            "\"1.0\"",
            "asset.version: expected 2.x, got \"1.0\"",
        ),
        (
            "\"POSITION\":0",
            "\"POSITION\":5",
            "meshes[0].primitives[0].attributes.POSITION: expected less than the 3 accessors, got 5",
        ),
        (
            "\"POSITION\":0",
            "\"POSITION\":1",
            "meshes[0].primitives[0].attributes.POSITION: accessors[1].type: expected VEC3, got \"VEC2\"",
        ),
        (
            "\"POSITION\":0",
            "\"POS\":0",
            "meshes[0].primitives[0]: attributes: expected POSITION, got none",
        ),
        (
            "\"indices\":2",
            "\"indices\":2,\"mode\":7",
            "meshes[0].primitives[0]: mode: expected 0 to 6, got 7",
        ),
        (
            "\"componentType\":5123",
            "\"componentType\":5126",
            "meshes[0].primitives[0].indices: accessors[2].componentType: expected 5121",
        ),
        (
            "\"componentType\":5123",
            "\"componentType\":9",
            "meshes[0].primitives[0].indices: accessors[2].componentType: expected",
        ),
        (
            "\"count\":6",
            "\"count\":7",
            "meshes[0].primitives[0].indices: 7 elements of 2 bytes",
        ),
        (
            "\"count\":6",
            "\"count\":18446744073709551615",
            "meshes[0].primitives[0].indices: accessors[2].count: expected at most",
        ),
        (
            "\"count\":6",
            "\"byteOffset\":18446744073709551615,\"count\":6",
            "meshes[0].primitives[0].indices: 6 elements",
        ),
        (
            "\"byteLength\":48",
            "\"byteStride\":99,\"byteLength\":48",
            "meshes[0].primitives[0].attributes.POSITION: 4 elements of 12 bytes",
        ),
        (
            "\"buffer\":0",
            "\"buffer\":4",
            "meshes[0].primitives[0].attributes.POSITION: bufferViews[0].buffer: expected less than 1, got 4",
        ),
        (
            "data:application",
            "../x:application",
            "buffers[0]: expected a file inside the mesh's folder",
        ),
        (
            ";base64",
            ";base65",
            "buffers[0]: uri: expected base64 data",
        ),
        (
            "\"count\":6",
            "\"count\":-1",
            "expected triangles in its scene, got none (accessors[2].count left out: invalid value",
        ),
        (
            "\"asset\"",
            "\"extensionsRequired\":[\"KHR_gaussian_splatting\"],\"asset\"",
            "extensionsRequired: KHR_gaussian_splatting is not supported, and says where surfaces are",
        ),
        (
            "\"asset\"",
            "\"extensionsRequired\":[\"ACME_mesh_compression\"],\"asset\"",
            "extensionsRequired: ACME_mesh_compression is not supported, and says where surfaces are: convert it",
        ),
    ];
    for (from, to, expected) in cases {
        let error = read(&square(&[(from, to)])).map(|m| m.notes);
        let text = match &error {
            Err(error) => error.to_string(),
            Ok(notes) => panic!("{to}: accepted, {notes:?}"),
        };
        assert!(!text.contains('\n'), "{text}");
        assert!(
            text.starts_with(&format!("m.gltf: {expected}")),
            "{text}\n   against {expected}"
        );
    }
    let mut bytes = square_bytes();
    bytes[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
    let nan = square(&[(&base64(&square_bytes()), &base64(&bytes))]);
    assert_eq!(
        read(&nan).unwrap_err().to_string(),
        "m.gltf: meshes[0].primitives[0]: vertex 0: expected finite coordinates under 1e6 in size, got NaN"
    );
}

#[test]
fn a_small_file_cannot_ask_for_much_memory() {
    // Each primitive refers to the same data under another key.
    let zeros = square(&[(
        "{\"bufferView\":0,\"componentType\":5126,\"count\":4",
        "{\"componentType\":5126,\"count\":40000000",
    )]);
    let error = read(&zeros).unwrap_err().to_string();
    assert!(
        error.contains("accessors[0].count: expected at most 1048576, got 40000000"),
        "{error}"
    );
}

fn glb(name: &str) -> Option<Vec<u8>> {
    Some(std::fs::read(test_data::folder()?.join("gltf").join(name)).unwrap())
}

#[test]
fn truncated_real_files_are_errors() {
    let Some(bytes) = glb("Box.glb") else { return };
    for n in 0..bytes.len() {
        assert!(load(&bytes[..n], "m.glb", Path::new("")).is_err(), "{n}");
    }
    let error = load(&bytes[..1000], "m.glb", Path::new(""))
        .unwrap_err()
        .to_string();
    assert!(error.contains("it is cut short"), "{error}");
}

#[test]
fn mutated_real_files_never_panic() {
    for name in ["Box.glb", "EmissiveStrengthTest.glb"] {
        let Some(bytes) = glb(name) else { return };
        for round in 0..3_000u32 {
            let mut bytes = bytes.clone();
            for change in 0..=round % 4 {
                let at = crate::numerics::hash(round, change, 0) as usize % bytes.len();
                // Half of the changes put digits and punctuation into the JSON, so that it remains readable.
                bytes[at] = match crate::numerics::hash(round, change, 1) {
                    h if h % 2 == 0 => b"0123456789-,:[]{}"[(h / 2) as usize % 17],
                    h => (h >> 8) as u8,
                };
            }
            if let Ok(model) = load(&bytes, "m.glb", Path::new("")) {
                for mesh in &model.meshes {
                    assert!(
                        mesh.triangles
                            .iter()
                            .flatten()
                            .all(|&i| (i as usize) < mesh.positions.len())
                    );
                    assert!(mesh.positions.iter().all(|p| p.is_finite()));
                }
            }
        }
    }
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(tail in prop::collection::vec(any::<u8>(), 0..200), magic: bool) {
        let mut bytes = if magic { b"glTF\x02\0\0\0".to_vec() } else { Vec::new() };
        bytes.extend(tail);
        let _ = load(&bytes, "m.glb", Path::new(""));
    }

    #[test]
    fn a_document_with_changed_numbers_never_panics(
        changes in prop::collection::vec((any::<prop::sample::Index>(), "[0-9]{1,20}"), 1..4),
    ) {
        let mut text = square(&[]);
        for (at, digits) in changes {
            let end = text.find("data:").unwrap();
            let places: Vec<usize> = text[..end].match_indices(|c: char| c.is_ascii_digit()).map(|(i, _)| i).collect();
            let at = *at.get(&places);
            text.replace_range(at..=at, &digits);
        }
        let _ = read(&text);
    }
}

mod compressed;
mod odd;
mod pose;
