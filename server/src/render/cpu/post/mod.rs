//! The post stage: passes over the linear composite, one file each.

pub mod bloom;
pub(crate) mod composite;
pub mod glare;
pub mod highlight;
mod span;

use composite::PostPass;

/// Every pass, in the order they run.
pub(crate) fn passes() -> Vec<Box<dyn PostPass>> {
    vec![
        Box::<bloom::BloomPass>::default(),
        Box::<glare::GlarePass>::default(),
    ]
}
