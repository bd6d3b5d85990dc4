//! The stages on the processor.

pub mod bloom;
pub mod glare;
pub mod highlight;
