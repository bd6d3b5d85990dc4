use super::*;
use proptest::prelude::*;

fn read(text: &str) -> Result<Model, MeshError> {
    load(text.as_bytes(), "m.obj", Path::new(""))
}

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";

#[test]
fn every_index_form_is_read() {
    for face in [
        "f 1 2 3 4",
        "f -4 -3 -2 -1",
        "f 1/1 2/1 3/1 4/1",
        "f 1//1 2//1 3//1 4//1",
        "f 1/1/1 2/1/1 3/1/1 4/1/1 # end",
        "f 1 2 \\\r\n 3 4",
        "f 1 2 \\ \t\n 3 \\\n4\n",
        "fo +1 2 3 4",
    ] {
        let model = read(&format!("{SQUARE}vt 0.25 0.25\nvn 0 0 2\n{face}")).unwrap();
        assert_eq!(model.meshes[0].triangles.len(), 2, "{face}");
        assert_eq!(model.meshes[0].positions.len(), 4, "{face}");
        assert_eq!(model.meshes[0].normals, vec![Vec3::Z; 4], "{face}");
        if let Some(uv) = model.meshes[0].uvs.first() {
            assert_eq!(*uv, Vec2::new(0.25, 0.75));
        }
        assert!(model.notes.is_empty(), "{face}: {:?}", model.notes);
    }
}

#[test]
fn corners_are_split_only_where_attributes_differ() {
    let text = format!("{SQUARE}vt 0 0\nvt 1 1\nf 1/1 2/1 3/1\nf 1/1 3/2 4/1\n");
    assert_eq!(read(&text).unwrap().meshes[0].positions.len(), 5);
}

/// The same square for any line ends, any order of vertices and any encoding.
#[test]
fn encodings_line_ends_and_order_do_not_matter() {
    let plain = format!("{SQUARE}f 1 2 3 4\n");
    let utf16: Vec<u8> = std::iter::once(0xFEFF)
        .chain(plain.encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    let mut latin1 = format!("{SQUARE}usemtl gr").into_bytes();
    latin1.extend(b"\xFCn\nmtllib \xB2\xC4\xD6\xCA.mtl\n# \xFC\nf 1 2 3 4\n");
    for (bytes, n_notes) in [
        (plain.clone().into_bytes(), 0),
        (plain.replace('\n', "\r\n").into_bytes(), 0),
        (plain.replace('\n', "\r").into_bytes(), 0),
        (plain.replace('\n', "\n\n").into_bytes(), 0),
        (format!("\u{FEFF}{plain}").into_bytes(), 0),
        (format!("# C:\\dir\\\n{plain}").into_bytes(), 0),
        (format!("f 1 2 3 4\n{SQUARE}").into_bytes(), 0),
        (format!("o a\ng b\ns off\n{plain}").into_bytes(), 0),
        (plain.replace(" 0\n", " 0 1.0\n").into_bytes(), 0),
        (plain.replace("1 0 0", "1e0  +.0\t0.").into_bytes(), 0),
        (format!("{plain}l 1 2\np 1\n").into_bytes(), 1),
        (
            format!("{plain}{}f 1\n", " ".repeat(1 << 20)).into_bytes(),
            1,
        ),
        (plain.replace("1 1 0", "1,0 1,0 0").into_bytes(), 1),
        (utf16, 0),
        (latin1, 2),
    ] {
        let model = load(&bytes, "m.obj", Path::new("")).unwrap();
        let mesh = &model.meshes[0];
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
        assert_eq!(model.notes.len(), n_notes, "{:?}", model.notes);
    }
}

#[test]
fn bad_items_are_left_out_counted_and_named() {
    for (bad, expected) in [
        ("f 1 2\n", "1 faces left out: too few corners (line 5:"),
        (
            "f\n",
            "1 faces left out: too few corners (line 5: expected at least 3, got 0)",
        ),
        (
            "f 1 2 x\n",
            "1 faces left out: unreadable corners (line 5: expected v/vt/vn as whole numbers, got \"x\")",
        ),
        (
            "f 1 2 0\n",
            "1 faces left out: corners that are no vertices (face 1: expected a vertex of 4, got another one)",
        ),
        (
            "f 1 2 5\nf 1 2 99\n",
            "2 faces left out: corners that are no vertices (the first: face 1: expected a vertex of 4, got 5)",
        ),
        (
            "f 1 2 -5\n",
            "1 faces left out: corners that are no vertices",
        ),
        (
            "v 0 zero 0\nf 1 2 5\n",
            "1 vertices with unreadable numbers (line 5: expected a number, got \"zero\")",
        ),
        (
            "v 0 0\nf 1 2 5\n",
            "1 vertices with too few numbers (line 5: expected 3 numbers, got 2)",
        ),
        (
            "v nan 0 0\nf 1 2 5\n",
            "1 faces left out: corners that are nowhere (face 1: vertex 5 at (NaN, 0, 0))",
        ),
        (
            "v 0 0 1e39\nf 1 2 5\n",
            "1 faces left out: corners that are too far away (face 1: expected finite coordinates under 1e6 in size, got",
        ),
        (
            "surf 0 1 0 1 1\n",
            "1 free-form curves and surfaces left out (line 5)",
        ),
        (
            "hello\n",
            "1 lines left out: unknown first words (line 5: \"hello\")",
        ),
        (
            "vt -1.#IND00 0\nf 1/1 3/1 2/1\n",
            "texture coordinates that are not finite set to 0",
        ),
        ("vn 1.#QNAN 0 0\nf 1//1 3//1 2//1\n", ""),
        (
            "f 1/7 3/7 2/7\n",
            "3 texture coordinates left out that are not there (the first: face 1: expected one of 0)",
        ),
        (
            "vn 0 0 -1\nf 1//1 3//1 2//9\n",
            "1 normals left out that are not there (face 1: expected one of 1)",
        ),
    ] {
        let model = read(&format!("{SQUARE}{bad}f 1 2 3 4\n")).unwrap();
        let triangles = model.n_drawn();
        assert!(triangles == 2 || bad.contains("3/"), "{bad}: {triangles}");
        assert!(triangles >= 2, "{bad}");
        let all = model.notes.join("; ");
        assert!(all.contains(expected), "{bad}: {all}");
        for mesh in &model.meshes {
            assert!(mesh.positions.iter().all(|p| p.is_finite()));
            assert!(mesh.normals.iter().all(|n| (n.length() - 1.0).abs() < 1e-5));
        }
    }
    // Unused values and "none" written as 0 cause no note.
    for fine in [
        "v nan 0 0\n",
        "v inf 0 0\n",
        "vt nan\n",
        "vn x 0 0\n",
        "f 1/0/0 3/0/0 2/0/0\n",
    ] {
        let model = read(&format!("{SQUARE}{fine}f 1 2 3 4\n")).unwrap();
        assert!(model.notes.is_empty(), "{fine}: {:?}", model.notes);
    }
}

#[test]
fn what_leaves_nothing_is_an_error_that_says_why() {
    for (text, expected) in [
        ("", "m.obj: expected triangles, got none"),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\n",
            "m.obj: expected triangles, got none",
        ),
        (
            "v 0 0 0\n\nf 1 2 3\n",
            "m.obj: expected triangles, got none: 1 faces left out: corners that are no vertices (face 1: expected a vertex of 1, got 2)",
        ),
        (
            "v 0 0 0\nf 1 1\n",
            "m.obj: expected triangles, got none: 1 faces left out: too few corners (line 2: expected at least 3, got 2)",
        ),
        (
            "v 0 0 0\nf 1 1 1\n",
            "m.obj: expected triangles with area, got 1 without",
        ),
    ] {
        assert_eq!(read(text).unwrap_err().to_string(), expected);
    }
}

#[test]
fn colours_of_vertices_are_linear_and_white_where_there_are_none() {
    let red = Vec4::new(1.0, 0.0, 0.0, 1.0);
    let grey = Vec3::splat(crate::numerics::linear_from_srgb(128)).extend(1.0);
    for (text, colors) in [
        ("v 0 0 0 1 0 0\nv 1 0 0 1 0 0\nv 0 1 0 1 0 0\n", [red; 3]),
        (
            "v 0 0 0 255 0 0\nv 1 0 0 255 0 0 255\nv 0 1 0 128 128 128\n",
            [red, red, grey],
        ),
        (
            "v 0 0 0\nv 1 0 0 1 0 0\nv 0 1 0 nan 0 0\n",
            [Vec4::ONE, red, Vec4::ONE],
        ),
        (
            "v 0 0 0\nv 1 0 0\nv 0 1 0\n#MRGB ffff0000ffff0000ff808080\n",
            [red, red, grey],
        ),
    ] {
        let model = read(&format!("{text}f 1 2 3\n")).unwrap();
        let mesh = &model.meshes[0];
        for (color, expected) in mesh.colors.iter().zip(colors) {
            assert!(color.distance(expected) < 1e-6, "{text}: {color}");
        }
        assert_eq!((mesh.colors.len(), &*model.notes.join(" ")), (3, ""));
        // The vertex colours become the base colour.
        let material = &model.materials[model.parts[0].material.unwrap()];
        assert_eq!(material.base_color, Vec3::ONE);
    }
    let model = read(&format!("{SQUARE}f 1 2 3 4\n")).unwrap();
    assert!(model.meshes[0].colors.is_empty() && model.materials.is_empty());
}

#[test]
fn far_from_the_origin_is_moved_in_double() {
    let text = "v 500000.25 4500000.5 100\nv 500001.25 4500000.5 100\nv 500000.25 4500001.5 100\nf 1 2 3\n";
    let model = read(text).unwrap();
    assert_eq!(
        model.meshes[0].positions,
        [[0.25, 0.5, 0.0], [1.25, 0.5, 0.0], [0.25, 1.5, 0.0]].map(Vec3::from)
    );
    assert!(
        model.notes[0].contains("moved by (-500000, -4500000, -100)"),
        "{:?}",
        model.notes
    );
}

#[test]
fn materials_split_the_mesh_and_a_missing_library_is_noted() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("m.mtl"),
        "newmtl red\nKd 1 0 0\nNs 0\nnewmtl glow\nKe 2 2 2\n",
    )
    .unwrap();
    let text = format!(
        "mtllib m.mtl\n{SQUARE}f 1 2 3\nusemtl red\nf 1 3 4\nusemtl glow\nf 4 3 1\nusemtl red\nf 4 2 1\n"
    );
    let model = load(text.as_bytes(), "m.obj", folder.path()).unwrap();
    let counts: Vec<_> = model
        .parts
        .iter()
        .map(|p| (p.material, model.meshes[p.mesh].triangles.len()))
        .collect();
    assert_eq!(counts, [(None, 1), (Some(0), 2), (Some(1), 1)]);
    assert_eq!(model.materials[0].base_color, Vec3::X);
    assert_eq!(model.materials[1].emissive, Vec3::splat(2.0));
    let model = load(text.as_bytes(), "m.obj", Path::new("/nowhere")).unwrap();
    assert_eq!(model.parts.len(), 1);
    assert!(model.notes[0].contains("m.mtl"), "{:?}", model.notes);
    // A face that is left out does not shift the materials.
    let text = text.replace("f 1 2 3\n", "f 1 2 9\nf 1 2 3\n");
    let model = load(text.as_bytes(), "m.obj", folder.path()).unwrap();
    assert_eq!(model.parts.len(), 3);
    assert_eq!(model.n_drawn(), 4);
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = load(&bytes, "m.obj", Path::new(""));
    }

    #[test]
    fn arbitrary_statements_never_panic(
        lines in prop::collection::vec("(v|vn|vt|f|usemtl|mtllib|l|#MRGB)( -?[0-9./e,]{1,6}){0,8}\\\\?", 0..30)
    ) {
        let text = format!("{SQUARE}{}", lines.join("\n"));
        if let Ok(model) = read(&text) {
            for mesh in &model.meshes {
                prop_assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < mesh.positions.len()));
                prop_assert!(mesh.positions.iter().all(|p| p.abs().max_element() < 1e6));
                prop_assert!(mesh.colors.is_empty() || mesh.colors.len() == mesh.positions.len());
            }
        }
    }
}
