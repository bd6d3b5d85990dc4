use super::*;
use proptest::prelude::*;

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
        "m.ply: vertex 2: expected finite coordinates",
    );
    check("1 1 0 255", "1 one 0 255", "m.ply: vertex 2 (byte ");
    check(
        "0 4 0 1 2 3",
        "0 4 0 1 2 9",
        "m.ply: triangle 1: vertex index 9: expected less than the 4 vertices",
    );
    check("0 4 0 1 2 3", "0 4 0 1 2", "m.ply: face 0 (byte ");
    check("0 4 0 1 2 3", "0 4 0 1 2 -3", "m.ply: face 0 (byte ");
    check(
        "0 4 0 1 2 3",
        "0 2 0 1",
        "m.ply: expected triangles, got none",
    );
    check(
        "face",
        "tristrips",
        "m.ply: expected faces, got triangle strips",
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
            prop_assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < mesh.positions.len()));
            prop_assert!(mesh.positions.iter().all(|p| p.is_finite()));
        }
    }
}
