//! The description of a layout of recordings.

use super::error::RecordingError;
use super::location::Location;
use super::{Listing, OpenOptions};

/// A way to organise a recording's folder.
pub(super) struct Layout {
    /// Name, for messages.
    pub(super) name: &'static str,
    /// The names of files that identify it, for messages.
    pub(super) looked_for: &'static str,
    /// Lists the frames of a folder; `None` if the folder has another layout.
    pub(super) list: fn(&Location, &OpenOptions) -> Result<Option<Listing>, RecordingError>,
}
