//! The table of layouts. A new layout is a file with a [`Layout`] and an entry here.

use super::error::{Place, RecordingError};
use super::layout::Layout;
use super::location::Location;
use super::{
    Listing, OpenOptions, arkit_scenes, container, folders, nerfstudio, open3d, polycam, replica,
    scanner_app, seven_scenes, tum,
};

/// All layouts. The first one that recognises a folder reads it, so layouts with rarer names come first.
const LAYOUTS: &[Layout] = &[
    folders::ICL_NUIM,
    tum::LAYOUT,
    seven_scenes::LAYOUT,
    scanner_app::LAYOUT,
    nerfstudio::LAYOUT,
    replica::LAYOUT,
    arkit_scenes::LAYOUT,
    polycam::LAYOUT,
    folders::LAYOUT,
    open3d::LAYOUT,
];

/// Most nested folders around a recording that contain only the next folder, as archives have them.
const MAX_WRAPPINGS: usize = 4;

/// Name of every layout, and the files that identify it.
pub(super) fn all() -> impl Iterator<Item = (&'static str, &'static str)> {
    LAYOUTS
        .iter()
        .map(|layout| (layout.name, layout.looked_for))
}

/// Detects the layout of a folder and lists its frames. An archive may contain the recording's folder or the content
/// of it.
pub(super) fn list(root: &Location, options: &OpenOptions) -> Result<Listing, RecordingError> {
    if !root.is_dir() {
        let expected = "a folder, or a zip archive of one";
        return Err(container::recognise(root)
            .unwrap_or_else(|| Place::file(root).field("recording", expected, "a file")));
    }
    let mut folder = root.clone();
    for _ in 0..=MAX_WRAPPINGS {
        for layout in LAYOUTS {
            if let Some(listing) = (layout.list)(&folder, options)? {
                return Ok(listing);
            }
        }
        if let Some(error) = container::find_in(&folder) {
            return Err(error);
        }
        match folder.folder_names()?.as_slice() {
            [only] if root.on_disk().is_none() => folder = folder.join(only),
            _ => break,
        }
    }
    let looked_for: Vec<String> = all()
        .map(|(name, looked_for)| format!("{looked_for} ({name})"))
        .collect();
    Err(RecordingError::UnknownLayout {
        path: root.path().to_owned(),
        looked_for: looked_for.join("; "),
    })
}
