//! Depth maps of real recordings, for tests.

use std::path::{Path, PathBuf};

use crate::camera::Intrinsics;
use crate::frame::DepthImage;

/// The folder with the recordings, if this run has one.
fn data() -> Option<PathBuf> {
    if let Some(folder) = std::env::var_os("GHOSTLIGHT_DATA") {
        return Some(folder.into());
    }
    let required = std::env::var("GHOSTLIGHT_REQUIRE").unwrap_or_default();
    assert!(
        !required.contains("data"),
        "GHOSTLIGHT_REQUIRE asks for data, but GHOSTLIGHT_DATA is not set"
    );
    println!("SKIPPED: GHOSTLIGHT_DATA not set");
    None
}

/// Up to `n` evenly spaced files of a folder whose names begin and end as given.
fn files(folder: &Path, begin: &str, end: &str, n: usize) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .unwrap_or_else(|error| panic!("{}: {error}", folder.display()))
        .map(|entry| entry.unwrap().path())
        .filter(|path| {
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            name.starts_with(begin) && name.ends_with(end)
        })
        .collect();
    files.sort();
    let step = (files.len() / n).max(1);
    files.into_iter().step_by(step).take(n).collect()
}

/// Folder, first and last part of file names, units per metre, focal lengths and principal point.
type Recording = (&'static str, &'static str, &'static str, f64, [f64; 4]);

pub(super) fn sets_of_recordings() -> [Recording; 4] {
    [
        (
            "7scenes-redkitchen",
            "frame",
            ".depth.png",
            1000.0,
            [585.0, 585.0, 320.0, 240.0],
        ),
        (
            "rgbd_dataset_freiburg1_desk-snippet/depth",
            "",
            ".png",
            5000.0,
            [517.3, 516.5, 318.6, 255.3],
        ),
        (
            "iphone-lidar-3dscannerapp",
            "depth",
            ".png",
            1000.0,
            [193.86, 193.86, 129.4, 94.9],
        ),
        (
            "realsense-static/depth",
            "",
            ".png",
            1000.0,
            [423.81, 423.81, 319.5, 236.5],
        ),
    ]
}

/// Depth maps of each recording, `n` of each, cropped to a window in the middle of at most the given size; empty
/// without the data.
pub(super) fn recorded_maps(
    sets: [Recording; 4],
    n: usize,
    width: u32,
    height: u32,
) -> Vec<(&'static str, DepthImage, Intrinsics)> {
    let Some(data) = data() else {
        return Vec::new();
    };
    let mut maps = Vec::new();
    for (folder, begin, end, units, [fx, fy, cx, cy]) in sets {
        for path in files(&data.join(folder), begin, end, n) {
            let image = image::open(&path).unwrap().into_luma16();
            let (width, height) = (image.width().min(width), image.height().min(height));
            let (x, y) = ((image.width() - width) / 2, (image.height() - height) / 2);
            let window = image::imageops::crop_imm(&image, x, y, width, height).to_image();
            let (cx, cy) = (cx - f64::from(x), cy - f64::from(y));
            let intrinsics = Intrinsics::new(fx, fy, cx, cy, width, height).unwrap();
            let depth = DepthImage::from_units(width, height, &window, units, 100.0);
            maps.push((folder, depth, intrinsics));
        }
    }
    maps
}
