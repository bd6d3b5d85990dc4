use super::*;
use crate::scene::Mesh;
use crate::scene::test_data::png;
use glam::Vec3;
use proptest::prelude::*;

fn load(bytes: &[u8], name: &str) -> Result<Model, MeshError> {
    super::load(bytes, name, Path::new(""))
}

const ASCII: &str = "ply\nformat ascii 1.0\ncomment a square\nelement vertex 4\nproperty float x\nproperty float y\nproperty double z\nproperty uchar red\nelement extra 1\nproperty list uchar short junk\nelement face 1\nproperty uchar flag\nproperty list uchar int vertex_indices\nend_header\n0 0 0 255\n1 0 0 255\n1 1 0 255\n0 1 0 255\n2 7 8\n0 4 0 1 2 3\n";

fn binary(big: bool) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut out = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty float s\nproperty float t\nelement face 1\nproperty list ushort uint vertex_index\nend_header\n"
    )
    .into_bytes();
    let bytes4 = |x: u32| {
        if big {
            x.to_be_bytes()
        } else {
            x.to_le_bytes()
        }
    };
    for (x, y) in [(0.0f32, 0.0f32), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)] {
        for v in [x, y, 0.0, 0.0, 0.0, 1.0, x, y] {
            out.extend(bytes4(v.to_bits()));
        }
    }
    out.extend(if big {
        4u16.to_be_bytes()
    } else {
        4u16.to_le_bytes()
    });
    for i in 0..4u32 {
        out.extend(bytes4(i));
    }
    out
}

#[test]
fn all_three_formats_hold_the_same_square() {
    for bytes in [ASCII.as_bytes().to_vec(), binary(false), binary(true)] {
        let model = load(&bytes, "m.ply").unwrap();
        let mesh = &model.meshes[0];
        assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(mesh.positions[2], Vec3::new(1.0, 1.0, 0.0));
        assert_eq!(mesh.normals, vec![Vec3::Z; 4]);
        if let Some(&uv) = mesh.uvs.get(2) {
            assert_eq!(uv, Vec2::new(1.0, 0.0));
        }
    }
}

#[test]
fn errors_say_where() {
    let check = |from: &str, to: &str, expected: &str| {
        let text = ASCII.replacen(from, to, 1);
        assert_ne!(text, ASCII);
        let error = load(text.as_bytes(), "m.ply").unwrap_err().to_string();
        assert!(error.starts_with(expected), "{error}");
    };
    check("ply\n", "plx\n", "m.ply: line 1: expected \"ply\"");
    check("ascii", "utf8", "m.ply: line 2: format: expected ascii or");
    check(
        "property float x",
        "property half x",
        "m.ply: line 5: property x: expected a type",
    );
    check(
        "vertex 4",
        "vertex 999999999",
        "m.ply: element vertex: expected 999999999 of them",
    );
    check(
        "vertex 4",
        "vertex -4",
        "m.ply: line 4: element vertex: expected a count, got \"-4\"",
    );
    check(
        "float y",
        "float why",
        "m.ply: element vertex: expected properties x, y and z",
    );
    check(
        "1 1 0 255",
        "1 nan 0 255",
        "m.ply: expected triangles, got none: 1 faces left out: corners that are nowhere (face 1: vertex 3",
    );
    check(
        "1 1 0 255",
        "1 one 0 255",
        "m.ply: expected triangles, got none: 1 faces left out: corners that are nowhere",
    );
    check(
        "0 4 0 1 2 3",
        "0 4 0 1 2 9",
        "m.ply: expected triangles, got none: 1 faces left out: corners that are no vertices",
    );
    check("0 4 0 1 2 3", "0 4 0 1 2", "m.ply: face 0 (byte ");
    check(
        "0 4 0 1 2 3",
        "0 4 0 1 2 -3",
        "m.ply: expected triangles, got none: 1 faces left out: corners that are no vertices",
    );
    check("0 4 0 1 2 3", "0 x 0 1 2 3", "m.ply: face 0 (byte ");
    check(
        "0 4 0 1 2 3",
        "0 2 0 1",
        "m.ply: expected triangles, got none: 1 faces left out: too few corners",
    );
    check(
        "element face 1",
        "element face 0",
        "m.ply: expected a mesh, got a point cloud: 4 vertices and no faces",
    );
    check(
        "int vertex_indices",
        "int other",
        "m.ply: element face: expected a list property vertex_indices",
    );
    check(
        "end_header",
        "end",
        "m.ply: line 14: header: unknown statement",
    );
    let bytes = binary(false);
    for n in 0..bytes.len() {
        assert!(load(&bytes[..n], "m.ply").is_err());
    }
}

/// A file with four vertices at the corners of a square; `properties` and `values` are added to each.
fn square(properties: &str, values: [&str; 4], rest: &str) -> String {
    let [a, b, c, d] = values;
    let (header, body) = rest.split_once("end_header\n").unwrap();
    format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n{properties}{header}end_header\n0 0 0 {a}\n1 0 0 {b}\n1 1 0 {c}\n0 1 0 {d}\n{body}"
    )
}

const FACE: &str =
    "element face 1\nproperty list uchar int vertex_indices\nend_header\n4 0 1 2 3\n";

#[test]
fn headers_and_lines_are_read_as_they_come() {
    let plain = square("", [""; 4], FACE);
    let with = |comment: &[u8]| {
        let mut bytes = b"ply\nformat ascii 1.0\n".to_vec();
        bytes.extend(comment);
        bytes.extend(&plain.as_bytes()["ply\nformat ascii 1.0\n".len()..]);
        bytes
    };
    let utf16 = std::iter::once(0xFEFF).chain(plain.encode_utf16());
    for bytes in [
        plain.clone().into_bytes(),
        plain.replace('\n', "\r\n").into_bytes(),
        plain.replace('\n', "\r").into_bytes(),
        format!("\u{FEFF}{plain}").into_bytes(),
        utf16.flat_map(u16::to_le_bytes).collect(),
        with(b"comment Datei von M\xFCller\n"),
        with(b"obj_info num_cols 512\nobj_info \xFF\n\n"),
        with(b"comment \n"),
        plain.replace("float", "Float32").into_bytes(),
        plain.replace("vertex_indices", "vertex_index").into_bytes(),
    ] {
        let model = load(&bytes, "m.ply").unwrap();
        assert_eq!(model.meshes[0].triangles, [[0, 1, 2], [0, 2, 3]]);
        assert!(model.notes.is_empty(), "{:?}", model.notes);
    }
    // The byte after the header of a binary file may be a line end.
    let mut bytes = binary(false);
    let at = bytes
        .windows(11)
        .position(|w| w == b"end_header\n")
        .unwrap();
    for byte in &mut bytes[..at + 11] {
        if *byte == b'\n' {
            *byte = b'\r';
        }
    }
    bytes[at + 11] = b'\n';
    assert_eq!(load(&bytes, "m.ply").unwrap().n_drawn(), 2);
}

#[test]
fn bad_faces_and_other_elements_are_left_out_with_a_note() {
    let rest = "element face 4\nproperty list uchar int vertex_indices\nelement edge 1\nproperty int a\nelement empty 0\nproperty int a\nend_header\n4 0 1 2 3\n3 0 1 4\n2 0 1\n3 0 1 -2\n7\n";
    let model = load(square("", [""; 4], rest).as_bytes(), "m.ply").unwrap();
    assert_eq!(model.n_drawn(), 2);
    let notes = model.notes.join("; ");
    for expected in [
        "1 faces left out: too few corners (face 3:",
        "2 faces left out: corners that are no vertices (the first: face 2: expected a vertex of 4, got 5)",
        "left out: 1 edge",
    ] {
        assert!(notes.contains(expected), "{notes}");
    }
    assert_eq!(model.notes.len(), 3, "{notes}");
    // A file that is cut within unneeded elements has all needed ones.
    let cut = square("", [""; 4], rest).replace("\n7\n", "\n");
    assert_eq!(load(cut.as_bytes(), "m.ply").unwrap().n_drawn(), 2);
    // A vertex with invalid coordinates that no face uses.
    let rest = FACE.replace("4 0 1 2 3", "3 0 1 2");
    let lost = square("", [""; 4], &rest).replace("0 1 0 \n", "nan -1.#IND 0 \n");
    let model = load(lost.as_bytes(), "m.ply").unwrap();
    assert_eq!((model.n_drawn(), model.notes.len()), (1, 0));
}

#[test]
fn strips_run_both_ways_and_end_at_minus_one() {
    let rest = "element tristrips 1\nproperty list int int vertex_indices\nend_header\n12 0 1 3 2 -1 -1 1 2 2 3 0 -1\n";
    let model = load(square("", [""; 4], rest).as_bytes(), "m.ply").unwrap();
    let unsigned = rest
        .replace("int int", "int uint")
        .replace("-1", "4294967295");
    let same = load(square("", [""; 4], &unsigned).as_bytes(), "m.ply").unwrap();
    assert_eq!(same.meshes[0].triangles, model.meshes[0].triangles);
    // The second strip repeats a corner; its valid triangles are the other halves of the square.
    let mesh = &model.meshes[0];
    for t in &mesh.triangles[..2] {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        assert!((b - a).cross(c - a).z > 0.0);
    }
    assert_eq!(mesh.triangles[..2], [[0, 1, 3], [3, 1, 2]]);
    assert_eq!(mesh.triangles.len(), 3);
}

#[test]
fn concave_faces_are_cut_right() {
    let text = "ply\nformat ascii 1.0\nelement vertex 6\nproperty double x\nproperty double y\nproperty double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n4500002 0 0\n4500002 1 0\n4500001 1 0\n4500001 2 0\n4500000 2 0\n4500000 0 0\n6 0 1 2 3 4 5\n";
    let model = load(text.as_bytes(), "m.ply").unwrap();
    let mesh = &model.meshes[0];
    let area = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.positions[i as usize]);
        0.5 * (b - a).cross(c - a).z
    };
    assert_eq!(mesh.triangles.iter().map(area).sum::<f32>(), 3.0);
    assert!(mesh.triangles.iter().all(|t| area(t) > 0.0));
    assert!(
        model.notes[0].contains("moved by (-4500000, 0, 0)"),
        "{:?}",
        model.notes
    );
}

#[test]
fn colours_of_vertices_and_faces_are_read() {
    let grey = crate::numerics::linear_from_srgb(128);
    for (kind, name, red, half) in [
        ("uchar", "", "255 0 0", "128 128 128"),
        ("uint8", "diffuse_", "255 0 0", "128 128 128"),
        ("ushort", "", "65535 0 0", "32896 32896 32896"),
        ("float", "", "1 0 0", "0.50196078 0.50196078 0.50196078"),
        ("float", "", "255 0 0", "128 128 128"),
        ("int", "", "255 0 0", "128 128 128"),
    ] {
        let properties: String = ["red", "green", "blue"]
            .map(|channel| format!("property {kind} {name}{channel}\n"))
            .concat();
        let text = square(&properties, [red, half, half, half], FACE);
        let model = load(text.as_bytes(), "m.ply").unwrap();
        let mesh = &model.meshes[0];
        assert_eq!((mesh.colors.len(), model.notes.len()), (4, 0));
        assert!(
            mesh.colors[0].distance(Vec4::new(1.0, 0.0, 0.0, 1.0)) < 1e-6,
            "{kind}"
        );
        assert!(
            mesh.colors[1].distance(Vec3::splat(grey).extend(1.0)) < 1e-5,
            "{kind}"
        );
        let material = &model.materials[model.parts[0].material.unwrap()];
        assert_eq!(
            (material.base_color, material.vertex_colors),
            (Vec3::ONE, true)
        );
    }
    // Integer colours of a nearly black mesh are not rescaled.
    let dark = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    let model = load(square(dark, ["1 1 1"; 4], FACE).as_bytes(), "m.ply").unwrap();
    assert!(model.meshes[0].colors[0].x < 0.001);
    let rest = "element face 2\nproperty list uchar int vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n3 0 1 2 255 0 0\n3 0 2 3 0 255 0\n";
    let model = load(square("", [""; 4], rest).as_bytes(), "m.ply").unwrap();
    let mesh = &model.meshes[0];
    for (t, expected) in mesh.triangles.iter().zip([Vec3::X, Vec3::Y]) {
        assert!(
            t.iter()
                .all(|&i| mesh.colors[i as usize].truncate() == expected)
        );
    }
}

#[test]
fn textures_of_corners_and_of_vertices_are_found() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("tex.png"), png(1, 1, [255, 0, 0, 255])).unwrap();
    std::fs::write(folder.path().join("my b.png"), png(1, 1, [0, 255, 0, 255])).unwrap();
    let comments = "comment TextureFile tex.png\ncomment TextureFile my b.png\n";
    let wedges = "element face 2\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber\nend_header\n3 0 1 2 6 0 0 1 0 1 1 1\n3 0 2 3 6 0 0 .5 .5 0 1 0\n";
    let text =
        square("", [""; 4], wedges).replace("element vertex", &format!("{comments}element vertex"));
    let model = super::load(text.as_bytes(), "m.ply", folder.path()).unwrap();
    assert!(model.notes.is_empty(), "{:?}", model.notes);
    assert_eq!(model.parts.len(), 2);
    for (part, (color, uv)) in model.parts.iter().zip([
        ([0, 255, 0, 255], Vec2::new(1.0, 0.0)),
        ([255, 0, 0, 255], Vec2::new(0.5, 0.5)),
    ]) {
        let texture = model.materials[part.material.unwrap()]
            .base_color_texture
            .as_ref();
        assert_eq!(texture.unwrap().rgba[0], color);
        // Corner (1, 1) has its own texture coordinates in each part.
        let mesh = &model.meshes[part.mesh];
        let corner = mesh.positions.iter().position(|p| p.x == 1.0 && p.y == 1.0);
        assert_eq!(mesh.uvs[corner.unwrap()], uv);
    }
    // Per vertex, with the usual names.
    for [u, v] in [["s", "t"], ["u", "v"], ["texture_u", "texture_v"]] {
        let properties = format!("property float {u}\nproperty float {v}\n");
        let text = square(&properties, ["0 0", "1 0", "1 1", "0 1"], FACE).replace(
            "element vertex",
            "comment TextureFile C:\\x\\TEX.png\nelement vertex",
        );
        let model = super::load(text.as_bytes(), "m.ply", folder.path()).unwrap();
        assert!(model.materials[0].base_color_texture.is_some());
        assert_eq!(model.meshes[0].uvs[2], Vec2::new(1.0, 0.0));
    }
    // Texture -1 means none, and so do missing coordinates.
    let none =
        square("", [""; 4], wedges).replace("element vertex", &format!("{comments}element vertex"));
    let none = none.replace("1 0 1 1 1\n", "1 0 1 1 -1\n");
    let model = super::load(none.as_bytes(), "m.ply", folder.path()).unwrap();
    assert_eq!(model.parts[0].material, None);
    let plain =
        square("", [""; 4], FACE).replace("element vertex", &format!("{comments}element vertex"));
    let model = super::load(plain.as_bytes(), "m.ply", folder.path()).unwrap();
    assert_eq!((model.parts[0].material, model.notes.len()), (None, 1));
    // A texture takes precedence over colours.
    let properties = "property float s\nproperty float t\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n";
    let both = square(properties, ["0 0 9 9 9"; 4], FACE)
        .replace("element vertex", &format!("{comments}element vertex"));
    let model = super::load(both.as_bytes(), "m.ply", folder.path()).unwrap();
    assert!(model.meshes[0].colors.is_empty() && !model.meshes[0].uvs.is_empty());
    assert!(
        model.notes[0].starts_with("vertex colours left out"),
        "{:?}",
        model.notes
    );
    // A missing texture is noted.
    let text = text.replace("tex.png", "gone.png");
    let model = super::load(text.as_bytes(), "m.ply", folder.path()).unwrap();
    assert!(model.notes[0].contains("gone.png"), "{:?}", model.notes);
}

proptest! {
    #[test]
    fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
        let _ = load(&bytes, "m.ply");
        let mut with_magic = b"ply\n".to_vec();
        with_magic.extend(&bytes);
        let _ = load(&with_magic, "m.ply");
    }

    #[test]
    fn mutated_files_never_panic(
        which in 0..3,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8),
    ) {
        let mut bytes = match which {
            0 => ASCII.as_bytes().to_vec(),
            n => binary(n == 1),
        };
        for (at, byte) in changes {
            let at = at.index(bytes.len());
            bytes[at] = byte;
        }
        if let Ok(model) = load(&bytes, "m.ply") {
            let mesh = &model.meshes[0];
            prop_assert!(mesh.colors.is_empty() || mesh.colors.len() == mesh.positions.len());
            prop_assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < mesh.positions.len()));
            prop_assert!(mesh.positions.iter().all(|p| p.is_finite()));
        }
    }
}

#[test]
fn faces_may_come_before_what_their_vertices_have() {
    let vertices = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\nproperty float nz\nproperty float s\nproperty float t\n";
    let body = "0 0 0 0 0.6 0.8 0 1\n1 0 0 0 0.6 0.8 1 1\n0 1 0 0 0.6 0.8 1 0\n";
    let faces = "element face 1\nproperty list uchar int vertex_indices\n";
    let wedges = "element face 1\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\n";
    let file = |faces: &str, face: &str| {
        format!("ply\nformat ascii 1.0\n{faces}{vertices}end_header\n{face}\n{body}")
    };
    let mesh = |text: &str| {
        let model = load(text.as_bytes(), "m.ply").unwrap();
        assert!(model.notes.is_empty(), "{:?}", model.notes);
        Mesh::clone(&model.meshes[0])
    };
    let plain = mesh(&file(faces, "3 0 1 2"));
    assert_eq!(plain.normals, [Vec3::new(0.0, 0.6, 0.8); 3]);
    assert_eq!(
        plain.uvs,
        [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]].map(Vec2::from)
    );
    // Texture coordinates of corners take precedence over those of vertices.
    let corners = mesh(&file(wedges, "3 0 1 2 6 .5 1 .5 1 .5 1"));
    assert_eq!(corners.uvs, [Vec2::new(0.5, 0.0); 3]);
}
