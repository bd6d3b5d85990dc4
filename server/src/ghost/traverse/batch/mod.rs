//! Traces many rays at once: rays are clipped sixteen at a time (`segments`), queued (`queue`), and traversed in
//! lockstep (`walk`, `lockstep`) with exact tests of eight cells at once (`cells`); `trace` combines these steps.

mod cells;
mod lockstep;
mod queue;
pub(crate) mod segments;
pub(crate) mod trace;
mod walk;
