//! Command-line flags for information that a recording's folder does not contain.

use std::path::{Path, PathBuf};

use crate::camera::{Intrinsics, Pose};

use super::OpenOptions;
use super::poses::read_matrix;

/// How to read a recording, as flags.
#[derive(Debug, Clone, Default, clap::Args)]
pub struct RecordingArgs {
    /// Intrinsics of the colour camera in pixels, instead of the recording's
    #[arg(long, value_name = "fx,fy,cx,cy", value_parser = intrinsics)]
    pub intrinsics: Option<[f64; 4]>,
    /// Depth units per metre, instead of the recording's
    #[arg(long, value_name = "UNITS_PER_METRE", value_parser = depth_scale)]
    pub depth_scale: Option<f64>,
    /// Poses of the colour camera (TUM, .log, 12 or 16 numbers a line, 4x4 blocks), instead of the
    /// recording's
    #[arg(long, value_name = "FILE")]
    pub trajectory: Option<PathBuf>,
    /// The camera does not move: accept a recording without poses
    #[arg(long = "static", conflicts_with = "trajectory")]
    pub at_rest: bool,
    /// Intrinsics of the depth camera in pixels; depth is then warped into the colour camera
    #[arg(long, value_name = "fx,fy,cx,cy", value_parser = intrinsics)]
    pub depth_intrinsics: Option<[f64; 4]>,
    /// Transform from depth to colour axes, metres: tx,ty,tz or tx,ty,tz,qx,qy,qz,qw or a file with a 4x4 matrix
    #[arg(long, value_name = "POSE|FILE", value_parser = color_from_depth, allow_hyphen_values = true)]
    pub depth_to_color: Option<Pose>,
}

impl RecordingArgs {
    /// The corresponding options for opening recordings.
    pub fn options(&self) -> OpenOptions {
        OpenOptions {
            intrinsics: self.intrinsics,
            depth_units_per_metre: self.depth_scale,
            assume_static: self.at_rest,
            trajectory: self.trajectory.clone(),
            depth_intrinsics: self.depth_intrinsics,
            color_from_depth: self.depth_to_color,
            ..OpenOptions::default()
        }
    }
}

/// `fx,fy,cx,cy` in pixels.
fn intrinsics(text: &str) -> Result<[f64; 4], String> {
    let Some(&[fx, fy, cx, cy]) = list(text).as_deref() else {
        return Err(format!("expected four numbers fx,fy,cx,cy, got {text:?}"));
    };
    // The size is not known here; it comes from the recording.
    Intrinsics::new(fx, fy, cx, cy, 1, 1).map_err(|error| error.to_string())?;
    Ok([fx, fy, cx, cy])
}

/// Units per metre, over zero.
fn depth_scale(text: &str) -> Result<f64, String> {
    match list(text).as_deref() {
        Some(&[scale]) if scale > 0.0 => Ok(scale),
        Some([_]) => Err(format!("expected a number over 0, got {text}")),
        _ => Err(format!(
            "expected a number of units per metre, got {text:?}"
        )),
    }
}

fn color_from_depth(text: &str) -> Result<Pose, String> {
    let pose = match list(text).as_deref() {
        Some(&[tx, ty, tz]) => Pose::from_quaternion([0.0, 0.0, 0.0, 1.0], [tx, ty, tz]),
        Some(&[tx, ty, tz, qx, qy, qz, qw]) => {
            Pose::from_quaternion([qx, qy, qz, qw], [tx, ty, tz])
        }
        Some(numbers) => {
            let n = numbers.len();
            return Err(format!(
                "expected 3 or 7 numbers or a file, got {n} numbers"
            ));
        }
        None => {
            let path = Path::new(text);
            if !path.is_file() {
                return Err(format!("expected 3 or 7 numbers or a file, got {text:?}"));
            }
            return read_matrix(&path.into())
                .map(|matrix| matrix.pose)
                .ok_or_else(|| format!("{text}: expected a rigid 4x4 matrix"));
        }
    };
    pose.map_err(|error| error.to_string())
}

/// Finite numbers separated by commas; `None` for any other text.
fn list(text: &str) -> Option<Vec<f64>> {
    text.split(',')
        .map(|part| part.trim().parse().ok().filter(|x: &f64| x.is_finite()))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transforms_are_numbers_or_a_file() {
        let moved = color_from_depth("-0.025,0,0.001").unwrap();
        assert_eq!(moved.translation.to_array(), [-0.025, 0.0, 0.001]);
        let turned = color_from_depth("0,0,0, 0,0,1,0").unwrap();
        assert_eq!(turned.rotation.to_array(), [0.0, 0.0, 1.0, 0.0]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.txt");
        std::fs::write(&path, "1 0 0 0.5\n0 1 0 0\n0 0 1 0\n0 0 0 1\n").unwrap();
        let read = color_from_depth(path.to_str().unwrap()).unwrap();
        assert_eq!(read.translation.x, 0.5);
        for bad in ["1,2", "1,2,x", "nowhere.txt", "0,0,0,0,0,0,0", "nan,0,0"] {
            assert!(color_from_depth(bad).is_err(), "{bad}");
        }
    }
}
