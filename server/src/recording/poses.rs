//! Poses as text: numbers, possibly of lost poses, matrices of 12 or 16 numbers, and camera axes.

use std::path::Path;

use super::error::Place;
use super::location::Location;
use super::text::{MatrixPose, TextFile, pose_from_matrix};

/// Directions of a camera's y and z axes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Axes {
    /// y down, z forward: the convention of this project.
    OpenCv,
    /// y up, z backward: ARKit, Blender, NeRF tools.
    OpenGl,
}

/// The numbers of a text, separated by white space, commas, semicolons or brackets. Words that are not finite numbers
/// (`-inf`, `nan`, `-1.#IND`) become NaN.
pub(super) fn numbers(text: &str) -> Vec<f64> {
    text.split(|c: char| c.is_whitespace() || ",;[](){}\u{feff}\0".contains(c))
        .filter(|word| !word.is_empty())
        .map(|word| match word.parse() {
            Ok(number) if f64::is_finite(number) => number,
            _ => f64::NAN,
        })
        .collect()
}

/// World from camera, from a row-major 3x4 or 4x4 matrix; `None` if it is not a rigid motion.
pub(super) fn matrix(values: &[f64], axes: Axes) -> Option<MatrixPose> {
    let row = |r: usize| {
        let m = values.get(4 * r..4 * r + 4)?;
        // Multiplying by diag(1, -1, -1, 1) on the right negates the second and third columns.
        Some(match axes {
            Axes::OpenCv => [m[0], m[1], m[2], m[3]],
            Axes::OpenGl => [m[0], -m[1], -m[2], m[3]],
        })
    };
    let last = match values.len() {
        12 => [0.0, 0.0, 0.0, 1.0],
        16 => [values[12], values[13], values[14], values[15]],
        _ => return None,
    };
    let rows = [row(0)?, row(1)?, row(2)?, last];
    pose_from_matrix(&rows, &Place::file(Path::new(""))).ok()
}

/// The pose in a file of its own; `None` if tracking was lost, in any notation.
pub(super) fn read_matrix(path: &Location) -> Option<MatrixPose> {
    let file = TextFile::read(path).ok()?;
    let lines = file.text().lines();
    let data: String = lines
        .filter(|line| !line.trim_start().starts_with('#'))
        .flat_map(|line| [line, "\n"])
        .collect();
    matrix(&numbers(&data), Axes::OpenCv)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_poses_are_none_in_every_spelling() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("p.txt");
        for lost in [
            "",
            "1 0 0",
            "-inf -inf -inf -inf\n".repeat(4).as_str(),
            "nan nan nan nan\n".repeat(4).as_str(),
            "-1.#IND -1.#IND -1.#IND -1.#IND\n".repeat(4).as_str(),
            "0 0 0 0\n".repeat(4).as_str(),
            "1 0 0 0 0 2 0 0 0 0 1 0 0 0 0 1",
        ] {
            std::fs::write(&path, lost).unwrap();
            assert!(
                read_matrix(&Location::from(path.as_path())).is_none(),
                "{lost}"
            );
        }
        assert!(read_matrix(&Location::from(folder.path()).join("none.txt")).is_none());
        for good in [
            "1 0 0 0.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n",
            "# pose\n1,0,0,0.5\n0,1,0,0\n0,0,1,0\n",
            "[[1, 0, 0, 0.5], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]",
        ] {
            std::fs::write(&path, good).unwrap();
            let pose = read_matrix(&Location::from(path.as_path())).unwrap().pose;
            assert_eq!(pose.translation.x, 0.5, "{good}");
        }
    }
}
