//! Many rays at once: clipped sixteen at a time (`segments`), queued (`queue`), walked in lockstep
//! (`walk`, `lockstep`) with exact tests of eight cells at once (`cells`); `trace` puts these together.

mod cells;
mod lockstep;
mod queue;
pub(crate) mod segments;
pub(crate) mod trace;
mod walk;
