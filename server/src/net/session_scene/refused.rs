//! What a client is told of a scene that cannot be used.

use std::path::Path;

use ghostlight_proto::{Code, WireError};

use crate::scene::{LoadError, SceneError};

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
            WireError::new(Code::Scene, "scene", "one that is still wanted", error)
        }
    }
}

/// The message names file, field, expected and got; paths of this machine are none of the
/// client's business beyond the file's name.
fn told(error: &SceneError) -> String {
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
        told(&error),
    )
}

pub(super) fn object_refused(error: &SceneError) -> WireError {
    WireError::new(
        Code::Object,
        "place, pixel",
        "a pixel with a measured surface",
        told(error),
    )
}
