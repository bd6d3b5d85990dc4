//! Small recordings in every layout, for tests that damage them.

use super::*;
use crate::codec::png;

pub(super) const WIDTH: u32 = 16;
pub(super) const HEIGHT: u32 = 12;

/// Colour whose red channel identifies the frame.
pub(super) fn color(index: usize) -> Vec<u8> {
    let rgb: Vec<u8> = (0..WIDTH * HEIGHT)
        .flat_map(|i| [index as u8, i as u8, 9])
        .collect();
    png::encode_rgb8(WIDTH, HEIGHT, &rgb, png::Effort::Fast).unwrap()
}

/// Depth that varies, so that a cut file lacks some of it.
pub(super) fn depth() -> Vec<u8> {
    let units: Vec<u16> = (0..WIDTH * HEIGHT)
        .map(|i| 1000 + (i * i % 977) as u16)
        .collect();
    png::encode_gray16(WIDTH, HEIGHT, &units, png::Effort::Fast).unwrap()
}

pub(super) fn write(root: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = root.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

/// A matrix that moves by 0.1 m per frame along x.
pub(super) fn matrix(index: usize) -> String {
    format!(
        "1 0 0 {:.1}\n0 1 0 0\n0 0 1 0\n0 0 0 1\n",
        0.1 * index as f64
    )
}

const CAMERA: &str = r#"{"fx": 20, "fy": 20, "cx": 7.5, "cy": 5.5}"#;

/// A layout, and the names of its frames.
#[derive(Debug, Clone, Copy)]
pub(super) struct Made {
    pub(super) layout: &'static str,
    pub(super) color: fn(usize) -> String,
    pub(super) depth: fn(usize) -> String,
    /// The file with the pose of a frame.
    pub(super) pose: fn(usize) -> String,
}

pub(super) const LAYOUTS: [Made; 4] = [
    Made {
        layout: "TUM RGB-D",
        color: |i| format!("rgb/{i}.0.png"),
        depth: |i| format!("depth/{i}.0.png"),
        pose: |_| "groundtruth.txt".to_owned(),
    },
    Made {
        layout: "7-Scenes",
        color: |i| format!("frame-{i:06}.color.png"),
        depth: |i| format!("frame-{i:06}.depth.png"),
        pose: |i| format!("frame-{i:06}.pose.txt"),
    },
    Made {
        layout: "Open3D",
        color: |i| format!("color/{i:06}.png"),
        depth: |i| format!("depth/{i:06}.png"),
        pose: |_| "trajectory.log".to_owned(),
    },
    Made {
        layout: "3D Scanner App",
        color: |i| format!("frame_{i:05}.png"),
        depth: |i| format!("depth_{i:05}.png"),
        pose: |i| format!("frame_{i:05}.json"),
    },
];

/// A frame's pose in the form of its layout's file. `pose` has rows of four numbers; for TUM, the seven numbers after
/// the stamp.
fn pose_text(layout: &'static str, index: usize, pose: &str) -> String {
    match layout {
        "TUM RGB-D" => format!("{index}.0 {pose}\n"),
        "Open3D" => format!("{index} {index} {}\n{pose}\n", index + 1),
        "3D Scanner App" => {
            let numbers: Vec<&str> = pose.split_whitespace().collect();
            format!(
                r#"{{"time": {index}, "intrinsics": [20, 0, 7.5, 0, 20, 5.5, 0, 0, 1], "cameraPoseARFrame": [{}]}}"#,
                numbers.join(", ")
            )
        }
        _ => pose.to_owned(),
    }
}

impl Made {
    /// Writes `n` frames at x = 0, 0.1, ...; `lost` replaces the pose of frame 2.
    pub(super) fn write(&self, root: &Path, n: usize, lost: Option<&str>) {
        let layout = self.layout;
        let mut lists = [String::new(), String::new()];
        let mut poses = String::new();
        for i in 0..n {
            write(root, &(self.color)(i), color(i));
            write(root, &(self.depth)(i), depth());
            lists[0] += &format!("{i}.0 {}\n", (self.color)(i));
            lists[1] += &format!("{i}.0 {}\n", (self.depth)(i));
            let good = match layout {
                "TUM RGB-D" => format!("{:.1} 0 0 0 0 0 1", 0.1 * i as f64),
                _ => matrix(i),
            };
            let pose = pose_text(layout, i, lost.filter(|_| i == 2).unwrap_or(&good));
            match layout {
                "TUM RGB-D" | "Open3D" => poses += &pose,
                _ => write(root, &(self.pose)(i), pose),
            }
        }
        match layout {
            "TUM RGB-D" => {
                write(root, "rgb.txt", &lists[0]);
                write(root, "depth.txt", &lists[1]);
                write(root, "groundtruth.txt", poses);
                write(root, "camera.json", CAMERA);
            }
            "Open3D" => {
                write(root, "trajectory.log", poses);
                write(root, "camera.json", CAMERA);
            }
            "7-Scenes" => write(root, "camera-intrinsics.txt", "20 20 7.5 5.5"),
            _ => {}
        }
    }
}

/// Camera positions of the frames along x, tenths of a metre.
pub(super) fn tenths(recording: &Recording) -> Vec<i64> {
    let tenth = |pose: &Pose| (pose.translation.x * 10.0).round() as i64;
    recording.poses().iter().map(tenth).collect()
}

/// Indices of the frames by their pictures' red channel.
pub(super) fn reds(recording: &Recording) -> Vec<usize> {
    let red = |i| usize::from(recording.frame(i).unwrap().color.rgba[0][0]);
    (0..recording.len()).map(red).collect()
}
