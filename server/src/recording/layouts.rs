//! The table of layouts. A new layout is a file with a `list` function, a `Layout` and a line
//! here.

use std::path::Path;

use super::error::{Place, RecordingError};
use super::{
    Listing, OpenOptions, arkit_scenes, container, folders, nerfstudio, open3d, polycam, replica,
    scanner_app, seven_scenes, tum,
};

/// A way to organise a recording's folder.
struct Lister {
    /// The names of files that tell it from others, for people.
    looked_for: &'static str,
    /// The frames of a folder; `None` if it is of another layout.
    list: fn(&Path, &OpenOptions) -> Result<Option<Listing>, RecordingError>,
}

/// All of them; the first that recognises a folder reads it, so those with rarer names come first.
const LAYOUTS: &[Lister] = &[
    Lister {
        // With the other folders below.
        looked_for: "",
        list: folders::list_icl,
    },
    Lister {
        looked_for: tum::LOOKED_FOR,
        list: tum::list,
    },
    Lister {
        looked_for: seven_scenes::LOOKED_FOR,
        list: seven_scenes::list,
    },
    Lister {
        looked_for: scanner_app::LOOKED_FOR,
        list: scanner_app::list,
    },
    Lister {
        looked_for: nerfstudio::LOOKED_FOR,
        list: nerfstudio::list,
    },
    Lister {
        looked_for: replica::LOOKED_FOR,
        list: replica::list,
    },
    Lister {
        looked_for: arkit_scenes::LOOKED_FOR,
        list: arkit_scenes::list,
    },
    Lister {
        looked_for: polycam::LOOKED_FOR,
        list: polycam::list,
    },
    Lister {
        looked_for: folders::LOOKED_FOR,
        list: folders::list,
    },
    Lister {
        looked_for: open3d::LOOKED_FOR,
        list: open3d::list,
    },
];

/// Detects the layout and lists the frames.
pub(super) fn list(root: &Path, options: &OpenOptions) -> Result<Listing, RecordingError> {
    let metadata = std::fs::metadata(root).map_err(|source| RecordingError::Io {
        path: root.to_owned(),
        source,
    })?;
    if !metadata.is_dir() {
        return Err(container::recognise(root)
            .unwrap_or_else(|| Place::file(root).field("recording", "a folder", "a file")));
    }
    for layout in LAYOUTS {
        if let Some(listing) = (layout.list)(root, options)? {
            return Ok(listing);
        }
    }
    if let Some(error) = container::find_in(root) {
        return Err(error);
    }
    let looked_for = LAYOUTS.iter().map(|layout| layout.looked_for);
    let looked_for: Vec<_> = looked_for.filter(|names| !names.is_empty()).collect();
    Err(RecordingError::UnknownLayout {
        path: root.to_owned(),
        looked_for: looked_for.join("; "),
    })
}
