//! A recording as a frame source: owned by a replay, or shared by the sessions of a server.

use std::sync::Arc;

use super::{Recording, RecordingError};
use crate::frame::{BoxError, FrameSource, RgbdFrame};

impl FrameSource for Recording {
    fn n_frames(&self) -> usize {
        self.len()
    }

    fn time_ns(&self, index: usize) -> Option<i64> {
        self.listing.entries.get(index).map(|entry| entry.time_ns)
    }

    fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError> {
        Ok(Self::frame(self, index)?)
    }

    fn leaves_out(&self, error: &BoxError) -> bool {
        is_of_frame(error)
    }
}

impl FrameSource for Arc<Recording> {
    fn n_frames(&self) -> usize {
        self.len()
    }

    fn time_ns(&self, index: usize) -> Option<i64> {
        self.as_ref().time_ns(index)
    }

    fn frame(&mut self, index: usize) -> Result<RgbdFrame, BoxError> {
        Ok(Recording::frame(self, index)?)
    }

    fn leaves_out(&self, error: &BoxError) -> bool {
        is_of_frame(error)
    }
}

fn is_of_frame(error: &BoxError) -> bool {
    let error = error.downcast_ref::<RecordingError>();
    error.is_some_and(RecordingError::is_of_frame)
}
