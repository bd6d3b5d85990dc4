//! A report as an HTML page and as CSV tables.

mod csv;
mod html;
mod layout;
mod plot;

pub(super) use csv::csv;
pub(super) use html::html;
