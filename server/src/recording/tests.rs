//! Whole recordings: real ones, assembled ones, broken ones.

use super::*;

/// The folder of real recordings; without it a test says so loudly and is skipped, unless data
/// are required.
pub(super) fn data(name: &str) -> Option<PathBuf> {
    let Some(root) = std::env::var_os("GHOSTLIGHT_DATA") else {
        let required = std::env::var("GHOSTLIGHT_REQUIRE").is_ok_and(|r| r.contains("data"));
        assert!(
            !required,
            "GHOSTLIGHT_REQUIRE asks for data, but GHOSTLIGHT_DATA is not set"
        );
        eprintln!("SKIPPED: GHOSTLIGHT_DATA not set");
        return None;
    };
    Some(PathBuf::from(root).join(name))
}

#[test]
fn real_recordings_open() {
    for name in [
        "7scenes-redkitchen",
        "rgbd_dataset_freiburg1_desk-snippet",
        "iphone-lidar-3dscannerapp",
        "realsense-static",
    ] {
        let Some(path) = data(name) else { return };
        let start = std::time::Instant::now();
        let options = OpenOptions {
            assume_static: name == "realsense-static",
            ..Default::default()
        };
        let recording = Recording::open(&path, &options).unwrap();
        let t = std::time::Instant::now();
        recording.frame(0).unwrap();
        println!("frame {:?}", t.elapsed());
        println!("{}\n{:?}\n", recording.inspect().unwrap(), start.elapsed());
    }
}
