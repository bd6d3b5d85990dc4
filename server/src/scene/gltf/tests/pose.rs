//! Morph targets, skins, flat nodes, instances and vertex colours.

use super::*;

/// A document of one mesh over float data: `lists` are accessors (type, numbers), joints are the
/// bytes of one; `rest` is the JSON of nodes, meshes and so on.
fn document(lists: &[(&str, Vec<f32>)], rest: &str) -> String {
    let mut bytes = Vec::new();
    let (mut accessors, mut views) = (Vec::new(), Vec::new());
    for (kind, numbers) in lists {
        let (width, component, is_byte) = match *kind {
            "JOINTS" => (4, 5121, true),
            "RGBA8" => (4, 5121, true),
            "SCALAR" => (1, 5126, false),
            "VEC3" => (3, 5126, false),
            "VEC4" => (4, 5126, false),
            _ => (16, 5126, false),
        };
        let name = match *kind {
            "JOINTS" | "RGBA8" => "VEC4",
            other => other,
        };
        let start = bytes.len();
        for x in numbers {
            match is_byte {
                true => bytes.push(*x as u8),
                false => bytes.extend(x.to_le_bytes()),
            }
        }
        views.push(format!(
            "{{\"buffer\":0,\"byteOffset\":{start},\"byteLength\":{}}}",
            bytes.len() - start
        ));
        accessors.push(format!(
            "{{\"bufferView\":{},\"componentType\":{component},\"count\":{},\"type\":\"{name}\"}}",
            accessors.len(),
            numbers.len() / width
        ));
    }
    format!(
        "{{\"asset\":{{\"version\":\"2.0\"}},{rest},\"accessors\":[{}],\"bufferViews\":[{}],\"buffers\":[{{\"byteLength\":{},\"uri\":\"data:;base64,{}\"}}]}}",
        accessors.join(","),
        views.join(","),
        bytes.len(),
        base64(&bytes)
    )
}

const TRIANGLE: [f32; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0];

fn triangle() -> (&'static str, Vec<f32>) {
    ("VEC3", TRIANGLE.to_vec())
}

fn corners(model: &Model) -> Vec<Vec3> {
    let part = &model.parts[0];
    model.meshes[part.mesh]
        .positions
        .iter()
        .map(|p| {
            part.model_from_mesh
                .transform_point3(p.as_dvec3())
                .as_vec3()
        })
        .collect()
}

#[test]
fn morph_weights_at_rest_move_the_vertices() {
    let up = ("VEC3", [0.0, 1.0, 0.0].repeat(3));
    let targets = "\"primitives\":[{\"attributes\":{\"POSITION\":0},\"targets\":[{\"POSITION\":1},{\"POSITION\":1}]}]";
    for (mesh, node, y) in [
        ("\"weights\":[0.5,0.25],", "", 0.75),
        ("\"weights\":[0.5,0.25],", "\"weights\":[2,null],", 2.0),
        ("", "", 0.0),
        ("\"weights\":[1.0,0,7],", "", 1.0),
    ] {
        let rest = format!("\"nodes\":[{{{node}\"mesh\":0}}],\"meshes\":[{{{mesh}{targets}}}]");
        let model = read(&document(&[triangle(), up.clone()], &rest)).unwrap();
        assert_eq!(corners(&model)[1], Vec3::new(1.0, y, 0.0), "{mesh}{node}");
    }
    // A target with a different number of vertices is left out.
    let short = ("VEC3", vec![0.0; 6]);
    let rest = format!("\"nodes\":[{{\"mesh\":0}}],\"meshes\":[{{\"weights\":[1],{targets}}}]");
    let model = read(&document(&[triangle(), short], &rest)).unwrap();
    assert!(
        model.notes[0].contains("targets[0].POSITION left out"),
        "{:?}",
        model.notes
    );
}

fn skinned(weights: Vec<f32>, joints: Vec<f32>, skin: &str) -> Result<Model, MeshError> {
    // The inverse bind matrix moves by -1 in x.
    let mut inverse_bind = DAffine3::IDENTITY;
    inverse_bind.translation = DVec3::NEG_X;
    let columns = glam::DMat4::from(inverse_bind)
        .to_cols_array()
        .map(|x| x as f32);
    let rest = format!(
        r#""nodes":[{{"mesh":0,"skin":0,"translation":[50,0,0],"scale":[0.01,0.01,0.01]}},{{"translation":[0,0,7],"children":[2]}},{{"scale":[2,2,2]}}],
        "scenes":[{{"nodes":[0,1]}}],"meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"JOINTS_0":1,"WEIGHTS_0":2}}}}]}}],"skins":[{skin}]"#
    );
    read(&document(
        &[
            triangle(),
            ("JOINTS", joints),
            ("VEC4", weights),
            ("MAT4", columns.repeat(2)),
        ],
        &rest,
    ))
}

#[test]
fn joints_place_the_vertices_and_the_node_does_not() {
    let skin = r#"{"joints":[1,2],"inverseBindMatrices":3}"#;
    let first = [1.0, 0.0, 0.0, 0.0].repeat(3);
    let joints = [1.0, 0.0, 0.0, 0.0].repeat(3);
    let moved = |p: [f32; 3]| Vec3::new(2.0 * p[0] - 2.0, 2.0 * p[1], 2.0 * p[2] + 7.0);
    let expected: Vec<Vec3> = TRIANGLE
        .as_chunks::<3>()
        .0
        .iter()
        .map(|&p| moved(p))
        .collect();
    let model = skinned(first.clone(), joints.clone(), skin).unwrap();
    assert_eq!(corners(&model), expected);
    // Weights that do not sum to one are normalised.
    let model = skinned(
        first.iter().map(|w| w * 0.3).collect(),
        joints.clone(),
        skin,
    )
    .unwrap();
    assert!((corners(&model)[2] - expected[2]).length() < 1e-5);
    // Without weights, the first joint places the vertices.
    let model = skinned(vec![0.0; 12], joints.clone(), skin).unwrap();
    assert_eq!(corners(&model), expected);
    assert!(
        model
            .notes
            .iter()
            .any(|n| n.contains("3 vertices without a weight"))
    );
    // A joint that does not exist has no weight.
    let two = [0.5, 0.5, 0.0, 0.0].repeat(3);
    let far = [1.0, 9.0, 0.0, 0.0].repeat(3);
    let model = skinned(two, far, skin).unwrap();
    assert_eq!(corners(&model), expected);
    assert!(model.notes.iter().any(|n| n.contains("3 weights left out")));
    // Missing inverse bind matrices are identities.
    let model = skinned(first.clone(), joints.clone(), r#"{"joints":[1,2]}"#).unwrap();
    assert_eq!(corners(&model)[0], Vec3::new(0.0, 0.0, 7.0));
    // With a skin without joints, the node's transform is used.
    let model = skinned(first, joints, "{}").unwrap();
    assert_eq!(corners(&model)[0], Vec3::new(50.0, 0.0, 0.0));
    assert!(
        model
            .notes
            .iter()
            .any(|n| n.contains("skins[0] has no joints"))
    );
}

#[test]
fn a_node_of_scale_0_leaves_a_flat_mesh() {
    let rest = |scale: &str| {
        format!(
            "\"nodes\":[{{\"mesh\":0,\"translation\":[0,0,3],\"scale\":{scale}}}],\"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0}}}}]}}]"
        )
    };
    let model = read(&document(&[triangle()], &rest("[2,1,0]"))).unwrap();
    assert_eq!(corners(&model)[1], Vec3::new(2.0, 0.0, 3.0));
    assert_eq!(
        (model.n_drawn(), model.parts[0].model_from_mesh),
        (1, DAffine3::IDENTITY)
    );
    let error = read(&document(&[triangle()], &rest("[0,0,1]"))).unwrap_err();
    assert!(error.to_string().contains("has area"), "{error}");
}

#[test]
fn instances_hidden_nodes_and_coarser_versions() {
    let places = ("VEC3", vec![0.0, 0.0, 0.0, 5.0, 0.0, 0.0]);
    let rest = r#""nodes":[{"mesh":0,"extensions":{"EXT_mesh_gpu_instancing":{"attributes":{"TRANSLATION":1}},"MSFT_lod":{"ids":[1]}}},{"mesh":0},{"extensions":{"KHR_node_visibility":{"visible":false}},"children":[3]},{"mesh":0}],
        "scenes":[{"nodes":[0,1,2]}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#;
    let model = read(&document(&[triangle(), places], rest)).unwrap();
    assert_eq!((model.parts.len(), model.meshes.len()), (2, 1));
    assert_eq!(
        model.parts[1].model_from_mesh.translation,
        DVec3::new(5.0, 0.0, 0.0)
    );
    assert!(
        model
            .notes
            .iter()
            .any(|n| n.starts_with("nodes[3] left out: it is hidden"))
    );
    assert!(model.notes.iter().any(|n| n.starts_with("MSFT_lod")));
}

#[test]
fn vertex_colours_of_every_type() {
    let mesh = |material: &str| {
        format!(
            "\"nodes\":[{{\"mesh\":0}}],\"meshes\":[{{\"primitives\":[{{\"attributes\":{{\"POSITION\":0,\"COLOR_0\":1}}{material}}}]}}],\"materials\":[{{\"alphaMode\":\"MASK\"}}]"
        )
    };
    let red = ("VEC3", [1.0, 0.25, 0.0].repeat(3));
    let model = read(&document(&[triangle(), red], &mesh(""))).unwrap();
    assert_eq!(
        model.meshes[0].colors,
        [glam::Vec4::new(1.0, 0.25, 0.0, 1.0); 3]
    );
    // No other statement assigns the colours to a material.
    let material = &model.materials[model.parts[0].material.unwrap()];
    assert_eq!((material.base_color, material.metallic), (Vec3::ONE, 0.0));
    // Bytes are normalized even if not marked so; alpha is used for the mask.
    let bytes = ("RGBA8", [255.0, 0.0, 51.0, 0.0].repeat(3));
    let model = read(&document(&[triangle(), bytes], &mesh(",\"material\":0"))).unwrap();
    assert_eq!(
        model.meshes[0].colors,
        [glam::Vec4::new(1.0, 0.0, 0.2, 0.0); 3]
    );
    assert_eq!(model.materials[0].alpha, AlphaMode::Mask { cutoff: 0.5 });
}

/// Surveyed coordinates: in the vertices, in a node, or shared by many nodes.
#[test]
fn what_lies_far_away_is_moved_in_double() {
    let far = [500_000.0_f32, 4_500_000.0, 100.0];
    let vertices: Vec<f32> = TRIANGLE
        .iter()
        .zip(far.iter().cycle())
        .map(|(x, offset)| x + offset)
        .collect();
    let in_vertices = document(
        &[("VEC3", vertices)],
        r#""nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#,
    );
    let in_node = document(
        &[triangle()],
        r#""nodes":[{"mesh":0,"translation":[500000.25,4500000.125,100]}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#,
    );
    for (text, moved) in [
        (in_vertices, [0.0; 3]),
        // Exact in double precision.
        (in_node, [0.25, 0.125, 0.0]),
    ] {
        let model = read(&text).unwrap();
        let expected = TRIANGLE.as_chunks::<3>().0.iter();
        let expected: Vec<Vec3> = expected
            .map(|&p| Vec3::from(p) + Vec3::from(moved))
            .collect();
        assert_eq!(corners(&model), expected);
        assert!(
            model
                .notes
                .iter()
                .any(|n| n.contains("moved by (-500000, -4500000, -100)")),
            "{:?}",
            model.notes
        );
    }
    // Two objects far apart from each other stay where they are.
    let apart = document(
        &[triangle()],
        r#""nodes":[{"mesh":0},{"mesh":0,"translation":[5000,0,0]}],"scenes":[{"nodes":[0,1]}],"meshes":[{"primitives":[{"attributes":{"POSITION":0}}]}]"#,
    );
    let model = read(&apart).unwrap();
    assert!(model.notes.is_empty(), "{:?}", model.notes);
    assert_eq!(model.parts[1].model_from_mesh.translation.x, 5000.0);
}
