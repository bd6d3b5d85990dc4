//! JSON Schemas (2020-12) of what people write, from the types that read it.

mod reference;

use schemars::generate::SchemaSettings;
use schemars::{JsonSchema, Schema};

use crate::render::RenderSettings;
use crate::scene::SceneDocument;

pub use reference::markdown;

/// Of scene documents.
pub fn scene() -> Schema {
    of::<SceneDocument>()
}

/// Of render settings.
pub fn settings() -> Schema {
    of::<RenderSettings>()
}

fn of<T: JsonSchema>() -> Schema {
    SchemaSettings::draft2020_12()
        .into_generator()
        .into_root_schema_for::<T>()
}

#[cfg(test)]
mod tests;
