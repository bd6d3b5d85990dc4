//! What every layout of recordings says of itself.

use super::error::RecordingError;
use super::location::Location;
use super::{Listing, OpenOptions};

/// A way to organise a recording's folder.
pub(super) struct Layout {
    /// For messages.
    pub(super) name: &'static str,
    /// The names of files that identify it, for messages.
    pub(super) looked_for: &'static str,
    /// The frames of a folder; `None` if it is of another layout.
    pub(super) list: fn(&Location, &OpenOptions) -> Result<Option<Listing>, RecordingError>,
}
