//! Lists of extensions: those that are supported, those that can be left out with a note, and those that cannot
//! because they define geometry.

use super::format::Root;

/// Supported extensions.
const UNDERSTOOD: &[&str] = &[
    "EXT_mesh_gpu_instancing",
    "EXT_meshopt_compression",
    "EXT_texture_webp",
    "KHR_draco_mesh_compression",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_transmission",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_meshopt_compression",
    "KHR_node_visibility",
    "KHR_texture_transform",
];

/// Extensions without which surfaces are missing or in the wrong place, and how to convert the file.
const GEOMETRY: &[(&str, &str)] = &[
    ("KHR_binary_glTF", "convert it to glTF 2.0"),
    ("WEB3D_quantized_attributes", "convert it to glTF 2.0"),
    ("CESIUM_primitive_geojson", "export it as triangles"),
    ("EXT_implicit_cylinder_region", "export it as triangles"),
    ("EXT_implicit_ellipsoid_region", "export it as triangles"),
    ("EXT_primitive_voxels", "export it as triangles"),
    ("KHR_gaussian_splatting", "export it as triangles"),
    ("KHR_implicit_shapes", "export it as triangles"),
    ("MPEG_mesh_linking", "export it without linked meshes"),
    ("MPEG_buffer_circular", "export it with plain buffers"),
    ("MPEG_accessor_timed", "export it with plain accessors"),
];

/// Parts of the names of extensions that define geometry, to recognise unknown ones.
const GEOMETRY_PARTS: [&str; 4] = ["compression", "quantiz", "splat", "implicit"];

/// Converters that undo most extensions.
const CONVERT: &str = "convert it (gltf-transform copy in.glb out.glb)";

/// Checks that the file can be shown without its unsupported required extensions; the error names the first one for
/// which this is not so.
pub(super) fn check_required(root: &Root) -> Result<(), String> {
    for name in &root.extensions_required {
        if UNDERSTOOD.contains(&name.as_str()) {
            continue;
        }
        let known = GEOMETRY
            .iter()
            .find(|(prefix, _)| name.starts_with(prefix))
            .map(|(_, advice)| *advice);
        let lower = name.to_lowercase();
        let guessed = GEOMETRY_PARTS
            .iter()
            .any(|part| lower.contains(part))
            .then_some(CONVERT);
        if let Some(advice) = known.or(guessed) {
            return Err(format!(
                "{name} is not supported, and says where surfaces are: {advice}"
            ));
        }
    }
    Ok(())
}

/// Extensions whose content is left out, each once, in file order.
pub(super) fn left_out(root: &Root) -> Vec<&str> {
    let mut names: Vec<&str> = Vec::new();
    for name in root.extensions_used.iter().chain(&root.extensions_required) {
        if !UNDERSTOOD.contains(&name.as_str())
            && name != "MSFT_lod"
            && !names.contains(&name.as_str())
        {
            names.push(name);
        }
    }
    names
}
