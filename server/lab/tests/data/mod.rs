//! Recorded data that is not part of the project.

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
        println!("SKIPPED: GHOSTLIGHT_DATA not set");
    }
    folder
}
