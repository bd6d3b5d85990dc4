//! The post stage: passes over the linear composite, one file each.

pub mod bloom;
pub(crate) mod composite;
pub mod glare;
pub mod highlight;
mod span;

use bloom::BloomPass;
use composite::PostPass;
use glare::GlarePass;

/// Every pass, in the order they run.
pub(crate) fn passes() -> Vec<Box<dyn PostPass>> {
    vec![Box::<BloomPass>::default(), Box::<GlarePass>::default()]
}
