//! The environment of a scene document: a map's file, or an object that says more.

use std::borrow::Cow;
use std::fmt;

use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::de::value::MapAccessDeserializer;
use serde::de::{self, MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

/// An equirectangular environment map. In JSON also a string alone, the map's file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EnvironmentSpec {
    /// Radiance .hdr file, relative to the document.
    pub map: String,
    /// Multiplies the map.
    pub intensity: f64,
    /// Where the map's up points, in the first camera's axes. By default the normal of the
    /// first surface that an object was placed on, if within 60 degrees of the camera's own
    /// up, else the camera's own up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub up: Option<[f64; 3]>,
    /// Turns the map about its up, degrees; at 0 its middle column lies ahead of the camera.
    pub rotation_deg: f64,
}

/// An equirectangular environment map.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct Fields {
    /// Radiance .hdr file, relative to the document.
    map: String,
    /// Multiplies the map.
    #[serde(default = "one")]
    #[schemars(range(min = 0.0, max = 1e6))]
    intensity: f64,
    /// Where the map's up points, in the first camera's axes. By default the normal of the
    /// first surface that an object was placed on, if within 60 degrees of the camera's own
    /// up, else the camera's own up.
    #[serde(default)]
    up: Option<[f64; 3]>,
    /// Turns the map about its up, degrees; at 0 its middle column lies ahead of the camera.
    #[serde(default)]
    #[schemars(range(min = -3600.0, max = 3600.0))]
    rotation_deg: f64,
}

fn one() -> f64 {
    1.0
}

impl EnvironmentSpec {
    /// A map as it is.
    pub fn of(map: impl Into<String>) -> Self {
        Self {
            map: map.into(),
            intensity: 1.0,
            up: None,
            rotation_deg: 0.0,
        }
    }
}

impl<'de> Deserialize<'de> for EnvironmentSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct FileOrObject;
        impl<'de> Visitor<'de> for FileOrObject {
            type Value = EnvironmentSpec;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("the path of an .hdr file or an object")
            }
            fn visit_str<E: de::Error>(self, map: &str) -> Result<EnvironmentSpec, E> {
                Ok(EnvironmentSpec::of(map))
            }
            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<EnvironmentSpec, A::Error> {
                let Fields {
                    map,
                    intensity,
                    up,
                    rotation_deg,
                } = Fields::deserialize(MapAccessDeserializer::new(map))?;
                Ok(EnvironmentSpec {
                    map,
                    intensity,
                    up,
                    rotation_deg,
                })
            }
        }
        deserializer.deserialize_any(FileOrObject)
    }
}

impl JsonSchema for EnvironmentSpec {
    fn schema_name() -> Cow<'static, str> {
        "Environment".into()
    }

    fn json_schema(generator: &mut SchemaGenerator) -> Schema {
        let fields = generator.subschema_for::<Fields>();
        json_schema!({
            "description": "An equirectangular environment map: its .hdr file, or an object.",
            "anyOf": [{"type": "string"}, fields],
        })
    }
}
