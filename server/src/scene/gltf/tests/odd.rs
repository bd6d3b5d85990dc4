//! Documents with errors, of which the valid rest is read.

use super::*;

#[test]
fn one_bad_item_is_left_out_with_a_note() {
    let short = base64(&[&square_bytes()[..90], &[9, 0]].concat());
    let cases: &[(&str, &str, &str, usize)] = &[
        (
            "\"scene\":0",
            "\"scene\":3",
            "scene: expected less than the 1 scenes, got 3",
            4,
        ),
        (
            "\"nodes\":[0]",
            "\"nodes\":[7]",
            "nodes[7] left out: there are 2 nodes",
            4,
        ),
        (
            "\"children\":[1]",
            "\"children\":[0]",
            "nodes[0] is used only once",
            2,
        ),
        (
            "\"children\":[1]",
            "\"children\":[1,1]",
            "nodes[1] is used only once",
            4,
        ),
        (
            "\"mesh\":0",
            "\"mesh\":1",
            "nodes[0].mesh left out: expected less than",
            2,
        ),
        (
            "\"translation\":[1,0,0]",
            "\"rotation\":[0,0,0,2]",
            "nodes[0]: rotation of length 2.000 brought to 1",
            4,
        ),
        (
            "\"translation\":[1,0,0]",
            "\"rotation\":[0,0,0,0]",
            "nodes[0]: rotation of length 0 taken as none",
            4,
        ),
        (
            "\"translation\":[1,0,0]",
            "\"translation\":[1,0]",
            "nodes[0].translation left out: invalid length 2",
            4,
        ),
        (
            "\"scale\":[2,2,2]",
            "\"matrix\":[1,0,0,1,0,1,0,0,0,0,1,0,0,0,0,1]",
            "nodes[1] left out: matrix: expected an affine transform",
            2,
        ),
        (
            "\"material\":0",
            "\"material\":9",
            "meshes[0].primitives[0].material left out: expected less than the 1",
            4,
        ),
        (
            "\"TEXCOORD_0\":1",
            "\"TEXCOORD_0\":9",
            "meshes[0].primitives[0].attributes.TEXCOORD_0 left out: expected less than the 3",
            4,
        ),
        (
            "\"byteLength\":92",
            "\"byteLength\":99",
            "buffers[0]: expected 99 bytes, got 92",
            4,
        ),
        (
            "\"name\":\"m\"",
            "\"normalTexture\":{\"index\":4}",
            "materials[0].normalTexture left out: index: expected less than the 0 textures",
            4,
        ),
        (
            "\"name\":\"m\"",
            "\"alphaMode\":\"GLOW\"",
            "materials[0].alphaMode left out: unknown variant \"GLOW\"",
            4,
        ),
        (
            "\"primitives\":[",
            "\"primitives\":[{\"attributes\":{}},",
            "meshes[0].primitives[0] left out: attributes: expected POSITION",
            4,
        ),
        (
            &base64(&square_bytes()),
            &short,
            "meshes[0].primitives[0]: 1 triangles left out: their vertices are not there",
            2,
        ),
        (
            "\"count\":6",
            "\"count\":5",
            "meshes[0].primitives[0]: the last 2 of its 5 indices",
            2,
        ),
        (
            "\"version\":\"2.0\"",
            "\"x\":0",
            "asset.version is missing",
            4,
        ),
        (
            "\"asset\"",
            "\"extensionsRequired\":[\"ACME_metadata\"],\"asset\"",
            "extensions left out: ACME_metadata",
            4,
        ),
        (
            "\"translation\":[1,0,0]",
            "\"translation\":[NaN,0,0]",
            "numbers that are no JSON",
            4,
        ),
    ];
    for (from, to, expected, n_drawn) in cases {
        let model = read(&square(&[(from, to)])).unwrap_or_else(|error| panic!("{to}: {error}"));
        assert_eq!(model.n_drawn(), *n_drawn, "{to}: {:?}", model.notes);
        let is_noted = model.notes.iter().any(|note| note.starts_with(expected));
        assert!(is_noted, "{to}: {:?}", model.notes);
    }
}

#[test]
fn documents_as_exporters_write_them_are_read_without_a_word() {
    let plain = square(&[]);
    let cases = [
        format!("\u{feff}{plain}"),
        format!("{plain}\0\0\0"),
        format!("  {plain}\r\n"),
        square(&[
            ("\"count\":4", "\"count\":4.0"),
            ("\"scene\":0", "\"scene\":0.0"),
        ]),
        square(&[
            (
                "\"mesh\":0",
                "\"mesh\":0,\"skin\":null,\"rotation\":null,\"extensions\":null",
            ),
            (
                "\"asset\"",
                "\"animations\":null,\"skins\":null,\"extensionsUsed\":null,\"asset\"",
            ),
            (
                "\"indices\":2",
                "\"indices\":2,\"mode\":null,\"targets\":null",
            ),
        ]),
        square(&[("\"version\":\"2.0\"", "\"version\":2.0")]),
        // A view that ends beyond the buffer, although all used bytes are present.
        square(&[("\"byteLength\":12", "\"byteLength\":14")]),
        square(&[("data:application/octet-stream;base64,", "data:;base64,")]),
    ];
    for text in cases {
        let model = read(&text).unwrap_or_else(|error| panic!("{text}: {error}"));
        assert_eq!(
            (model.n_drawn(), model.notes.len()),
            (4, 0),
            "{text}: {:?}",
            model.notes
        );
    }
    // The same in a binary container, padded with zeros, and with a wrong length.
    let mut json = plain.into_bytes();
    json.resize(json.len().next_multiple_of(4) + 4, 0);
    for length_off in [0, 8] {
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        glb.extend((20 + json.len() as u32 + 8 - length_off).to_le_bytes());
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(&json);
        glb.extend(b"\0\0\0\0BIN\0");
        let model = load(&glb, "m.glb", Path::new("")).unwrap();
        assert_eq!(
            (model.n_drawn(), model.notes.len()),
            (4, 0),
            "{:?}",
            model.notes
        );
    }
}
