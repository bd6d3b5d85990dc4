//! Draco and meshopt inside of glTF, specular-glossiness, and pictures in other formats.

use super::*;

#[test]
fn meshopt_views_are_decoded_and_fall_back() {
    let positions: Vec<[f32; 3]> = vec![
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ];
    let vertices = meshopt::encode_vertex_buffer(&positions).unwrap();
    let plain = square_bytes();
    let bytes = [plain.as_slice(), &vertices].concat();
    let with = |n: usize, bytes: &[u8]| {
        square(&[
            (&base64(&plain), &base64(bytes)),
            ("\"byteLength\":92", "\"byteLength\":900"),
            (
                "\"byteLength\":48",
                &format!(
                    "\"byteLength\":48,\"extensions\":{{\"EXT_meshopt_compression\":{{\"buffer\":0,\"byteOffset\":92,\"byteLength\":{n},\"byteStride\":12,\"count\":4,\"mode\":\"ATTRIBUTES\"}}}}"
                ),
            ),
            (
                "\"asset\"",
                "\"extensionsRequired\":[\"EXT_meshopt_compression\"],\"asset\"",
            ),
        ])
    };
    // The uncompressed bytes are zeros, so other values must have been decoded.
    let mut zeroed = bytes.clone();
    zeroed[..48].fill(0);
    let model = read(&with(vertices.len(), &zeroed)).unwrap();
    assert_eq!(model.meshes[0].positions[2], Vec3::new(1.0, 1.0, 0.0));
    // The buffer's declared length is too large.
    assert_eq!(model.notes.len(), 1, "{:?}", model.notes);
    // If the compressed bytes are cut, the uncompressed ones are used, with a note.
    let model = read(&with(vertices.len() - 9, &bytes)).unwrap();
    assert_eq!(model.meshes[0].positions[2], Vec3::new(1.0, 1.0, 0.0));
    let note = &model.notes[1];
    assert!(
        note.starts_with("bufferViews[0]: meshopt: ")
            && note.ends_with(": its uncompressed data are used"),
        "{note}"
    );
}

/// The Khronos sample box, compressed by Google's encoder.
const DRACO_BOX: &[u8] = include_bytes!("box.drc");

#[test]
fn draco_is_decoded_in_gltf_and_alone() {
    let model = crate::scene::draco::load(&LoadContext::default(), DRACO_BOX, "box.drc").unwrap();
    assert_eq!(model.n_drawn(), 12);
    let (lo, hi) = model.meshes[0].bounds().unwrap();
    assert!(
        (lo + 0.5).length() < 1e-3 && (hi - 0.5).length() < 1e-3,
        "{lo} {hi}"
    );
    let text = draco_document(DRACO_BOX);
    for required in [
        "",
        "\"extensionsRequired\":[\"KHR_draco_mesh_compression\"],",
    ] {
        let text = text.replacen("\"asset\"", &format!("{required}\"asset\""), 1);
        let model = read(&text).unwrap();
        assert_eq!(
            (model.n_drawn(), model.notes.len()),
            (12, 0),
            "{:?}",
            model.notes
        );
    }
    let error = read(&draco_document(&[0; 100])).unwrap_err().to_string();
    let expected = "m.gltf: meshes[0].primitives[0].KHR_draco_mesh_compression: Draco: expected data that begin with DRACO";
    assert!(error.starts_with(expected), "{error}");
}

fn draco_document(bytes: &[u8]) -> String {
    format!(
        r#"{{"asset":{{"version":"2.0"}},"nodes":[{{"mesh":0}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0}},"indices":1,"extensions":{{"KHR_draco_mesh_compression":{{"bufferView":0,"attributes":{{"POSITION":0}}}}}}}}]}}],
        "accessors":[{{"componentType":5126,"count":24,"type":"VEC3"}},{{"componentType":5123,"count":36,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteLength":{0}}}],"buffers":[{{"byteLength":{0},"uri":"data:;base64,{1}"}}]}}"#,
        bytes.len(),
        base64(bytes)
    )
}

#[test]
fn specular_glossiness_becomes_metallic_roughness() {
    let of = |fields: &str| {
        material(&format!(
            "\"extensions\":{{\"KHR_materials_pbrSpecularGlossiness\":{{{fields}}}}}"
        ))
        .0
    };
    let red = of(r#""diffuseFactor":[1,0,0,1],"glossinessFactor":0.1"#);
    assert_eq!((red.base_color, red.metallic), (Vec3::X, 0.0));
    assert!((red.roughness - 0.9).abs() < 1e-6);
    let gold = of(r#""diffuseFactor":[0,0,0,1],"specularFactor":[1,0.77,0.34]"#);
    assert!(gold.metallic > 0.99 && gold.base_color.x > 0.9 && gold.base_color.z < 0.4);
    assert_eq!(gold.roughness, 0.0);
}

fn textured(image: &str, texture: &str, material: &str) -> Model {
    read(&square(&[
        (
            "\"meshes\"",
            &format!("\"textures\":[{texture}],\"images\":[{image}],\"meshes\""),
        ),
        ("\"name\":\"m\"", material),
    ]))
    .unwrap()
}

fn picture(format: image::ImageFormat, color: [u8; 4]) -> String {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_pixel(2, 2, image::Rgba(color))
        .write_to(&mut bytes, format)
        .unwrap();
    format!("{{\"uri\":\"data:;base64,{}\"}}", base64(bytes.get_ref()))
}

#[test]
fn specular_textures_are_converted_texel_by_texel() {
    let image = picture(image::ImageFormat::Png, [255, 255, 255, 51]);
    let model = textured(
        &image,
        "{\"source\":0}",
        "\"extensions\":{\"KHR_materials_pbrSpecularGlossiness\":{\"diffuseFactor\":[0,0,0,1],\"specularGlossinessTexture\":{\"index\":0}}}",
    );
    let material = &model.materials[0];
    let surface = material.metallic_roughness_texture.as_ref().unwrap();
    // Roughness 1 - 0.2, fully metallic, white.
    assert_eq!(
        (surface.rgba[0], surface.reading.srgb),
        ([255, 204, 255, 255], false)
    );
    let base = material.base_color_texture.as_ref().unwrap();
    assert_eq!(
        (base.rgba[0], base.reading.srgb),
        ([255, 255, 255, 255], true)
    );
}

#[test]
fn pictures_in_other_formats_are_decoded_or_noted() {
    let base = "\"emissiveTexture\":{\"index\":0}";
    let webp = picture(image::ImageFormat::WebP, [9, 8, 7, 255]);
    let texture = "{\"extensions\":{\"EXT_texture_webp\":{\"source\":0}}}";
    let model = textured(&webp, texture, base);
    let emissive = model.materials[0].emissive_texture.as_ref().unwrap();
    assert_eq!(emissive.rgba[0], [9, 8, 7, 255]);
    // KTX2: the fallback is used if there is one, else there is a note.
    let ktx = format!(
        "{{\"uri\":\"data:;base64,{}\"}}",
        base64(b"\xABKTX 20\xBB\r\n\x1A\n")
    );
    let images = format!("{ktx},{}", picture(image::ImageFormat::Png, [1, 2, 3, 255]));
    let with = "{\"source\":1,\"extensions\":{\"KHR_texture_basisu\":{\"source\":0}}}";
    let model = textured(&images, with, base);
    assert_eq!(
        model.materials[0].emissive_texture.as_ref().unwrap().rgba[0],
        [1, 2, 3, 255]
    );
    let without = "{\"extensions\":{\"KHR_texture_basisu\":{\"source\":0}}}";
    let model = textured(&images, without, base);
    assert!(model.materials[0].emissive_texture.is_none());
    assert!(model.notes[0].contains("got KTX2"), "{:?}", model.notes);
    // Missing files, and textures without an image.
    for (image, texture) in [("{\"uri\":\"none.png\"}", "{\"source\":0}"), ("{}", "{}")] {
        let model = textured(image, texture, base);
        assert!(model.materials[0].emissive_texture.is_none());
        assert!(
            model.notes[0].contains("emissiveTexture left out"),
            "{:?}",
            model.notes
        );
    }
}

proptest! {
    #[test]
    fn damaged_draco_never_panics(
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let mut bytes = DRACO_BOX.to_vec();
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        let _ = crate::scene::draco::load(&LoadContext::default(), &bytes, "m.drc");
    }
}
