//! Writes the meshes that the project ships.

use std::path::Path;

use glam::Vec3;

use super::SynthError;
use ghostlight::scene::Mesh;
use ghostlight::shapes::shipped;

/// A mesh as binary little-endian PLY with normals.
pub fn ply(mesh: &Mesh) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\ncomment made by ghostlight synth, CC0-1.0\n\
         element vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\n\
         element face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    )
    .into_bytes();
    let mut floats = |v: Vec3| {
        for x in v.to_array() {
            bytes.extend_from_slice(&x.to_le_bytes());
        }
    };
    for (position, normal) in mesh.positions.iter().zip(&mesh.normals) {
        floats(*position);
        floats(*normal);
    }
    for triangle in &mesh.triangles {
        bytes.push(3);
        for index in triangle {
            bytes.extend_from_slice(&index.to_le_bytes());
        }
    }
    bytes
}

/// Writes every shipped mesh as `NAME.ply` into a folder, which is created if it is missing.
pub fn write_meshes(folder: &Path) -> Result<(), SynthError> {
    std::fs::create_dir_all(folder).map_err(|e| SynthError::io(folder, e))?;
    for (name, mesh) in shipped() {
        let path = folder.join(format!("{name}.ply"));
        std::fs::write(&path, ply(&mesh)).map_err(|e| SynthError::io(&path, e))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use ghostlight::shapes::cube;

    use super::*;

    #[test]
    fn ply_states_what_it_holds() {
        let mesh = cube(0.1, 0.01);
        let bytes = ply(&mesh);
        let header = bytes
            .windows(11)
            .position(|w| w == b"end_header\n")
            .unwrap()
            + 11;
        let expected = header + mesh.positions.len() * 24 + mesh.triangles.len() * 13;
        assert_eq!(bytes.len(), expected);
    }
}
