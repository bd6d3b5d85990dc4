//! A report as a page and as tables.

mod csv;
mod html;
mod layout;
mod plot;

pub(super) use csv::csv;
pub(super) use html::html;
