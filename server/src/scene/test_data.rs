//! Shared parts of the tests of several formats: recorded data that is not part of the project, and pictures.

use std::path::PathBuf;

/// The folder named by GHOSTLIGHT_DATA. Without one, the test prints that it is skipped, or fails if
/// GHOSTLIGHT_REQUIRE asks for data.
pub(crate) fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("GHOSTLIGHT_DATA").map(PathBuf::from);
    if folder.is_none() {
        let required = std::env::var("GHOSTLIGHT_REQUIRE").is_ok_and(|r| r.contains("data"));
        assert!(
            !required,
            "GHOSTLIGHT_DATA not set, but GHOSTLIGHT_REQUIRE asks for it"
        );
        eprintln!("SKIPPED: GHOSTLIGHT_DATA not set");
    }
    folder
}

/// A picture of one colour, as the bytes of a PNG file.
pub(crate) fn png(width: u32, height: u32, rgba: [u8; 4]) -> Vec<u8> {
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::RgbaImage::from_pixel(width, height, image::Rgba(rgba))
        .write_to(&mut bytes, image::ImageFormat::Png)
        .unwrap();
    bytes.into_inner()
}
