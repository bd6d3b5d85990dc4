//! Converts errors of scenes and placements to wire errors.

use std::path::Path;

use ghostlight_proto::{Code, WireError};

use crate::scene::{LoadError, PlaceError, SceneError};

pub(super) fn load_refused(error: &LoadError) -> WireError {
    match error {
        LoadError::Memory(over) => WireError::new(
            Code::TooLarge,
            format_args!("scene, {}", over.what),
            format_args!(
                "at most {} bytes (left of the {} for {})",
                over.left, over.limit, over.name
            ),
            format_args!("{} bytes", over.asked),
        ),
        LoadError::Cancelled => {
            WireError::new(Code::Scene, "scene", "a scene that is still wanted", error)
        }
    }
}

/// An error's message for a client, with file names instead of paths, because the folders of this machine are
/// private.
fn describe(error: &SceneError) -> String {
    let text = error.to_string();
    text.split(' ')
        .map(|word| {
            let path = Path::new(word);
            match (path.is_absolute(), path.file_name()) {
                (true, Some(name)) => name.to_string_lossy().into_owned(),
                _ => word.to_owned(),
            }
        })
        .collect::<Vec<_>>()
        .join(" ")
}

pub(super) fn refused(error: SceneError) -> WireError {
    match &error {
        SceneError::Load { source, .. } => return load_refused(source),
        SceneError::Triangles { max, got, .. } => {
            let expected = format_args!("at most {max}");
            return WireError::new(Code::TooLarge, "scene, triangles", expected, got);
        }
        _ => {}
    }
    WireError::new(
        Code::Scene,
        "scene",
        "a scene that can be used",
        describe(&error),
    )
}

pub(super) fn place_refused(error: PlaceError) -> WireError {
    WireError::new(
        Code::Object,
        "place, pixel",
        "a pixel with a measured surface",
        error,
    )
}
