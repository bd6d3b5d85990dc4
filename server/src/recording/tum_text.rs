//! Writes the text files of a TUM recording; `tum_lists` reads them.

use std::fmt::Write as _;

use crate::camera::Pose;

/// A non-negative time in nanoseconds in TUM's form: seconds with six decimals.
pub fn stamp(time_ns: i64) -> String {
    let micros = time_ns / 1_000;
    format!("{}.{:06}", micros / 1_000_000, micros % 1_000_000)
}

/// `rgb.txt`, `depth.txt` and similar lists: pictures in `folder`, named by their times.
pub fn image_list(title: &str, folder: &str, extension: &str, times_ns: &[i64]) -> String {
    let mut text = format!("# {title}\n# timestamp filename\n");
    for &time in times_ns {
        let stamp = stamp(time);
        // Writing to a string cannot fail.
        let _ = writeln!(text, "{stamp} {folder}/{stamp}.{extension}");
    }
    text
}

/// `groundtruth.txt`: times and poses, world from camera.
pub fn trajectory(poses: &[(i64, Pose)]) -> String {
    let mut text = String::from(
        "# ground truth trajectory, world from camera\n# timestamp tx ty tz qx qy qz qw\n",
    );
    for (time, pose) in poses {
        let (t, q) = (pose.translation, pose.rotation);
        // Nanometres and 1e-9 for the quaternion: less than any tracker's noise.
        let _ = writeln!(
            text,
            "{} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            stamp(*time),
            t.x,
            t.y,
            t.z,
            q.x,
            q.y,
            q.z,
            q.w
        );
    }
    text
}
