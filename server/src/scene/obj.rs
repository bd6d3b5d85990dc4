//! Wavefront OBJ: `v`, `vn`, `vt`, polygons with every index form, `usemtl`. Corners that
//! share position, texture coordinate and normal become one vertex. Lines, points, curves,
//! groups and vertex colours are passed over.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, Vec2, Vec3};

use super::error::MeshError;
use super::model::{MAX_TRIANGLES, Model, Part};
use super::sanitise::{coordinate_problem, sanitise_keeping};
use super::{LoadContext, Material, Mesh};
use super::{mtl, normals};

/// Marks a corner without texture coordinate or normal.
const NONE: u32 = u32::MAX;

/// The tokens of an OBJ file: attributes as listed, triangles as triples of corners.
#[derive(Default)]
struct Listing<'a> {
    positions: Vec<Vec3>,
    uvs: Vec<Vec2>,
    normals: Vec<Vec3>,
    /// Position, texture coordinate and normal index of each corner.
    triangles: Vec<[[u32; 3]; 3]>,
    /// `(first triangle, name)` of each `usemtl`.
    materials: Vec<(usize, &'a str)>,
    libraries: Vec<&'a str>,
}

/// As [`load_with`], without limits.
#[cfg(test)]
pub(super) fn load(bytes: &[u8], name: &str, folder: &Path) -> Result<Model, MeshError> {
    load_with(&LoadContext::default(), bytes, name, folder)
}

/// Reads an OBJ file from memory; material libraries are looked up in `folder`.
pub(super) fn load_with(
    context: &LoadContext,
    bytes: &[u8],
    name: &str,
    folder: &Path,
) -> Result<Model, MeshError> {
    let listing = parse(bytes, name)?;
    let had_normals = !listing.normals.is_empty()
        && listing
            .triangles
            .iter()
            .flatten()
            .all(|corner| corner[2] != NONE);
    let mesh = weld(&listing, had_normals);
    let (mut mesh, report, kept) = sanitise_keeping(mesh, name)?;
    if !had_normals {
        mesh = normals::smooth(mesh);
    }
    let mut model = Model {
        report,
        ..Model::default()
    };
    model.note_report();
    assign_materials(context, &mut model, mesh, &kept, &listing, folder);
    Ok(model)
}

fn parse<'a>(bytes: &'a [u8], name: &str) -> Result<Listing<'a>, MeshError> {
    let mut listing = Listing::default();
    let mut polygon: Vec<[u32; 3]> = Vec::new();
    let mut rest = bytes;
    let mut number = 0;
    while !rest.is_empty() {
        number += 1;
        let (line, extra_lines) = take_line(&mut rest);
        let fail = |problem: String| MeshError::at(name, format!("line {number}"), problem);
        let (keyword, values) = split_keyword(&line);
        match keyword {
            b"v" => {
                let [x, y, z] = floats(values).map_err(fail)?;
                let p = Vec3::new(x, y, z);
                if let Some(problem) = coordinate_problem(p) {
                    return Err(fail(format!(
                        "vertex {}: {problem}",
                        listing.positions.len()
                    )));
                }
                listing.positions.push(p);
            }
            b"vn" => listing
                .normals
                .push(Vec3::from(floats(values).map_err(fail)?)),
            b"vt" => {
                // v defaults to 0 and counts up from the bottom; textures here start at the top.
                let mut tokens = tokens(values);
                let u = float(tokens.next().unwrap_or_default()).map_err(fail)?;
                let v = tokens.next().map_or(Ok(0.0), float).map_err(fail)?;
                listing.uvs.push(Vec2::new(u, 1.0 - v));
            }
            b"f" => {
                polygon.clear();
                for token in tokens(values) {
                    polygon.push(corner(token, &listing).map_err(fail)?);
                }
                let [first, others @ ..] = polygon.as_slice() else {
                    return Err(fail("face: expected at least 3 corners, got 0".into()));
                };
                if others.len() < 2 {
                    return Err(fail(format!(
                        "face: expected at least 3 corners, got {}",
                        polygon.len()
                    )));
                }
                for pair in others.windows(2) {
                    listing.triangles.push([*first, pair[0], pair[1]]);
                }
                if listing.triangles.len() > MAX_TRIANGLES {
                    return Err(fail(format!(
                        "expected at most {MAX_TRIANGLES} triangles, got more"
                    )));
                }
            }
            // Borrowed names need a line that lies in the file in one piece.
            b"usemtl" | b"mtllib" => {
                if let Cow::Borrowed(line) = line {
                    let text = std::str::from_utf8(split_keyword(line).1)
                        .map_err(|_| fail("expected a name in UTF-8".into()))?
                        .trim();
                    if keyword == b"usemtl" {
                        listing.materials.push((listing.triangles.len(), text));
                    } else {
                        listing.libraries.push(text);
                    }
                }
            }
            _ => {}
        }
        number += extra_lines;
    }
    Ok(listing)
}

/// The next line without its end, joined with the ones it continues on; and how many those are.
fn take_line<'a>(rest: &mut &'a [u8]) -> (Cow<'a, [u8]>, usize) {
    fn one<'a>(rest: &mut &'a [u8]) -> &'a [u8] {
        let end = rest.iter().position(|&b| b == b'\n').unwrap_or(rest.len());
        let (line, after) = rest.split_at(end);
        *rest = after.get(1..).unwrap_or_default();
        line.strip_suffix(b"\r").unwrap_or(line)
    }
    let line = one(rest);
    let Some(head) = line.strip_suffix(b"\\") else {
        return (Cow::Borrowed(line), 0);
    };
    let mut joined = head.to_vec();
    let mut extra = 0;
    while !rest.is_empty() {
        joined.push(b' ');
        let line = one(rest);
        extra += 1;
        match line.strip_suffix(b"\\") {
            Some(head) => joined.extend_from_slice(head),
            None => {
                joined.extend_from_slice(line);
                break;
            }
        }
    }
    (Cow::Owned(joined), extra)
}

fn split_keyword(line: &[u8]) -> (&[u8], &[u8]) {
    let line = line.trim_ascii_start();
    let end = line
        .iter()
        .position(u8::is_ascii_whitespace)
        .unwrap_or(line.len());
    let (keyword, values) = line.split_at(end);
    (keyword, values)
}

fn tokens(values: &[u8]) -> impl Iterator<Item = &[u8]> {
    values
        .split(u8::is_ascii_whitespace)
        .filter(|token| !token.is_empty())
        .take_while(|token| token[0] != b'#')
}

fn show(token: &[u8]) -> String {
    let head = &token[..token.len().min(40)];
    format!("{:?}", String::from_utf8_lossy(head))
}

fn float(token: &[u8]) -> Result<f32, String> {
    std::str::from_utf8(token)
        .ok()
        .and_then(|text| text.parse().ok())
        .ok_or_else(|| format!("expected a number, got {}", show(token)))
}

fn floats(values: &[u8]) -> Result<[f32; 3], String> {
    let mut tokens = tokens(values);
    let mut xyz = [0.0; 3];
    for (i, x) in xyz.iter_mut().enumerate() {
        let token = tokens
            .next()
            .ok_or_else(|| format!("expected 3 numbers, got {i}"))?;
        *x = float(token)?;
    }
    Ok(xyz)
}

/// `v`, `v/t`, `v//n` or `v/t/n`; indices count from 1, or back from the last if negative.
fn corner(token: &[u8], listing: &Listing<'_>) -> Result<[u32; 3], String> {
    let lists = [
        ("vertex", listing.positions.len()),
        ("texture coordinate", listing.uvs.len()),
        ("normal", listing.normals.len()),
    ];
    let mut out = [NONE; 3];
    let mut fields = token.split(|&b| b == b'/');
    for (slot, (what, n)) in out.iter_mut().zip(lists) {
        match fields.next() {
            None => break,
            Some(b"") if what != "vertex" => {}
            Some(field) => {
                *slot = index(field, n).ok_or_else(|| {
                    if n == 0 {
                        return format!(
                            "face: {what} index {}: none is listed before",
                            show(field)
                        );
                    }
                    format!(
                        "face: {what} index: expected 1 to {n} or -{n} to -1, got {}",
                        show(field)
                    )
                })?;
            }
        }
    }
    match fields.next() {
        None => Ok(out),
        Some(_) => Err(format!("face: expected v/vt/vn, got {}", show(token))),
    }
}

fn index(field: &[u8], n: usize) -> Option<u32> {
    let (negative, digits) = match field.strip_prefix(b"-") {
        Some(digits) => (true, digits),
        None => (false, field),
    };
    // 18 digits fit into u64 without a check at each.
    if digits.is_empty() || digits.len() > 18 {
        return None;
    }
    let mut value = 0u64;
    for &digit in digits {
        if !digit.is_ascii_digit() {
            return None;
        }
        value = value * 10 + u64::from(digit - b'0');
    }
    let value = usize::try_from(value)
        .ok()
        .filter(|v| (1..=n).contains(v))?;
    u32::try_from(if negative { n - value } else { value - 1 }).ok()
}

/// One vertex per distinct corner.
fn weld(listing: &Listing<'_>, use_normals: bool) -> Mesh {
    let plain = listing
        .triangles
        .iter()
        .flatten()
        .all(|&[_, t, n]| t == NONE && (n == NONE || !use_normals));
    if plain {
        return Mesh {
            positions: listing.positions.clone(),
            triangles: listing.triangles.iter().map(|t| t.map(|c| c[0])).collect(),
            ..Mesh::default()
        };
    }
    let has_uvs = listing.triangles.iter().flatten().any(|c| c[1] != NONE);
    let mut mesh = Mesh::default();
    let mut vertices = HashMap::with_capacity(listing.positions.len());
    mesh.triangles.reserve(listing.triangles.len());
    for triangle in &listing.triangles {
        let welded = triangle.map(|[p, t, n]| {
            let key = (p, t, if use_normals { n } else { NONE });
            *vertices.entry(key).or_insert_with(|| {
                mesh.positions.push(listing.positions[p as usize]);
                if has_uvs {
                    let uv = listing.uvs.get(t as usize);
                    mesh.uvs.push(uv.copied().unwrap_or_default());
                }
                if use_normals {
                    mesh.normals.push(listing.normals[n as usize]);
                }
                (mesh.positions.len() - 1) as u32
            })
        });
        mesh.triangles.push(welded);
    }
    mesh
}

/// Splits the mesh by `usemtl` and reads the materials named.
fn assign_materials(
    context: &LoadContext,
    model: &mut Model,
    mesh: Mesh,
    kept: &[u32],
    listing: &Listing<'_>,
    folder: &Path,
) {
    let used: Vec<&str> = listing.materials.iter().map(|&(_, name)| name).collect();
    let library = if used.is_empty() {
        HashMap::new()
    } else {
        mtl::load(context, &listing.libraries, folder, &mut model.notes)
    };
    let mut slots: HashMap<&str, usize> = HashMap::new();
    for &name in &used {
        if let Some(material) = library.get(name)
            && !slots.contains_key(name)
        {
            slots.insert(name, model.materials.len());
            model.materials.push(material.clone());
        }
    }
    let mut groups: Vec<(Option<usize>, Vec<[u32; 3]>)> = Vec::new();
    let mut group_of: HashMap<Option<usize>, usize> = HashMap::new();
    let mut next = 0;
    let mut current = None;
    for (triangle, &source) in mesh.triangles.iter().zip(kept) {
        while let Some(&(first, name)) = listing.materials.get(next)
            && first <= source as usize
        {
            current = slots.get(name).copied();
            next += 1;
        }
        let group = *group_of.entry(current).or_insert_with(|| {
            groups.push((current, Vec::new()));
            groups.len() - 1
        });
        groups[group].1.push(*triangle);
    }
    if let [(material, _)] = groups.as_slice() {
        model.push_part(mesh, *material);
        return;
    }
    for (material, triangles) in groups {
        model.push_part(mesh.subset(triangles), material);
    }
}

impl Model {
    /// Adds a mesh that lies where the file says.
    pub(super) fn push_part(&mut self, mesh: Mesh, material: Option<usize>) {
        self.parts.push(Part {
            mesh: self.meshes.len(),
            material,
            model_from_mesh: DAffine3::IDENTITY,
        });
        self.meshes.push(Arc::new(mesh));
    }

    /// The material of parts that have vertex colours and nothing else: they are the base colour.
    pub(super) fn push_vertex_colored(&mut self) -> usize {
        self.materials.push(Material {
            name: "vertex colours".to_owned(),
            base_color: Vec3::ONE,
            ..Material::default()
        });
        self.materials.len() - 1
    }
}

impl Mesh {
    /// Some of its triangles with only the vertices that they use.
    fn subset(&self, mut triangles: Vec<[u32; 3]>) -> Self {
        let mut renamed = HashMap::new();
        let mut subset = Self::default();
        for index in triangles.iter_mut().flatten() {
            let old = *index as usize;
            *index = *renamed.entry(old).or_insert_with(|| {
                subset.positions.push(self.positions[old]);
                subset.normals.extend(self.normals.get(old));
                subset.uvs.extend(self.uvs.get(old));
                subset.colors.extend(self.colors.get(old));
                (subset.positions.len() - 1) as u32
            });
        }
        subset.triangles = triangles;
        subset
    }
}

#[cfg(test)]
mod tests {
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
        ] {
            let model = read(&format!("{SQUARE}vt 0.25 0.25\nvn 0 0 2\n{face}")).unwrap();
            assert_eq!(model.meshes[0].triangles.len(), 2, "{face}");
            assert_eq!(model.meshes[0].positions.len(), 4, "{face}");
            assert_eq!(model.meshes[0].normals, vec![Vec3::Z; 4], "{face}");
            if let Some(uv) = model.meshes[0].uvs.first() {
                assert_eq!(*uv, Vec2::new(0.25, 0.75));
            }
        }
    }

    #[test]
    fn corners_are_split_only_where_attributes_differ() {
        let text = format!("{SQUARE}vt 0 0\nvt 1 1\nf 1/1 2/1 3/1\nf 1/1 3/2 4/1\n");
        assert_eq!(read(&text).unwrap().meshes[0].positions.len(), 5);
    }

    #[test]
    fn errors_name_the_line() {
        for (text, expected) in [
            ("v 0 0\n", "m.obj: line 1: expected 3 numbers, got 2"),
            (
                "v 0 zero 0\n",
                "m.obj: line 1: expected a number, got \"zero\"",
            ),
            (
                "v 0 0 0\nv 0 nan 0\n",
                "m.obj: line 2: vertex 1: expected finite coordinates under 1e6 in size, got NaN",
            ),
            (
                "v 0 0 1e39\n",
                "m.obj: line 1: vertex 0: expected finite coordinates under 1e6 in size, got inf",
            ),
            (
                "v 0 0 0\n\nf 1 2 3\n",
                "m.obj: line 3: face: vertex index: expected 1 to 1 or -1 to -1, got \"2\"",
            ),
            (
                "v 0 0 0\nf 0 1 1\n",
                "m.obj: line 2: face: vertex index: expected 1 to 1 or -1 to -1, got \"0\"",
            ),
            (
                "v 0 0 0\nf 1 1\n",
                "m.obj: line 2: face: expected at least 3 corners, got 2",
            ),
            (
                "f 1/1/1/1 2 3\n",
                "m.obj: line 1: face: vertex index \"1\": none is listed before",
            ),
            ("", "m.obj: expected triangles, got none"),
            (
                "v 0 0 0\nf 1 1 1\n",
                "m.obj: expected triangles with area, got 1 without",
            ),
        ] {
            assert_eq!(read(text).unwrap_err().to_string(), expected);
        }
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
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..300)) {
            let _ = load(&bytes, "m.obj", Path::new(""));
        }

        #[test]
        fn arbitrary_statements_never_panic(
            lines in prop::collection::vec("(v|vn|vt|f|usemtl|mtllib)( -?[0-9./]{1,6}){0,5}\\\\?", 0..30)
        ) {
            let text = format!("{SQUARE}{}", lines.join("\n"));
            if let Ok(model) = read(&text) {
                let mesh = &model.meshes[0];
                prop_assert!(mesh.triangles.iter().flatten().all(|&i| (i as usize) < mesh.positions.len()));
            }
        }
    }
}
