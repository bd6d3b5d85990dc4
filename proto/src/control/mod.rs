//! Control messages: JSON objects with a `type` (README, sections 2 and 3).

mod reply;
mod request;

pub use reply::*;
pub use request::*;

use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::{Code, WireError};

/// Id and type of a message, and the whole object.
fn envelope(text: &str) -> Result<(Option<u64>, String, Value), WireError> {
    let malformed = |expected: &str, got: &dyn std::fmt::Display| {
        WireError::new(Code::Malformed, "control message", expected, got)
    };
    let body: Value = serde_json::from_str(text).map_err(|e| malformed("a JSON object", &e))?;
    let Some(object) = body.as_object() else {
        return Err(malformed("a JSON object", &"another JSON value"));
    };
    let id = match object.get("id") {
        None | Some(Value::Null) => None,
        Some(id) => Some(
            id.as_u64()
                .ok_or_else(|| malformed("an id that is an integer from 0", id))?,
        ),
    };
    let kind = match object.get("type") {
        Some(Value::String(kind)) => kind.clone(),
        Some(other) => return Err(malformed("a type that is a string", other)),
        None => return Err(malformed("a type", &"none")),
    };
    Ok((id, kind, body))
}

fn body_as<T: DeserializeOwned>(body: Value, what: &str) -> Result<T, WireError> {
    serde_json::from_value(body)
        .map_err(|e| WireError::new(Code::Malformed, what, "the fields that the format lists", e))
}
