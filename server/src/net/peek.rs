//! Finds the request id in a message that is too large to be parsed.

use std::borrow::Cow;
use std::cell::Cell;
use std::fmt;

use serde::de::{Deserializer, IgnoredAny, MapAccess, Visitor};

/// How much of a message is searched, bytes.
const MAX_LOOK: usize = 64 << 10;

struct Look<'a>(&'a Cell<Option<u64>>);

impl<'de> Visitor<'de> for Look<'_> {
    type Value = ();

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<(), A::Error> {
        while let Some(key) = map.next_key::<Cow<'de, str>>()? {
            if key == "id" {
                self.0.set(Some(map.next_value()?));
                return Ok(());
            }
            map.next_value::<IgnoredAny>()?;
        }
        Ok(())
    }
}

/// The `id` of the top-level JSON object, if it is near the beginning or at the very end.
pub(super) fn id_of(text: &str) -> Option<u64> {
    let found = Cell::new(None);
    let mut end = text.len().min(MAX_LOOK);
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    // The text is cut off, so an error at its end is expected.
    let _ = serde_json::Deserializer::from_str(&text[..end]).deserialize_map(Look(&found));
    found.get().or_else(|| id_at_end(text))
}

/// `..., "id": 7}`: the id is here for clients that add it last.
fn id_at_end(text: &str) -> Option<u64> {
    let inside = text.trim_end().strip_suffix('}')?.trim_end();
    let digits = inside.len() - inside.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    let (before, number) = inside.split_at(inside.len() - digits);
    let key = before.trim_end().strip_suffix(':')?.trim_end();
    let comma = key.strip_suffix("\"id\"")?.trim_end();
    comma.ends_with(',').then(|| number.parse().ok())?
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_number_is_found_near_the_beginning_and_at_the_end() {
        let long = "[0],".repeat(50_000);
        let nested = "[".repeat(200_000);
        for (text, id) in [
            (
                r#"{"type":"scene","id":7,"scene":"#.to_owned() + &long,
                Some(7),
            ),
            (format!(r#"{{"id": 12, "scene": [{long}"#), Some(12)),
            (format!(r#"{{"scene":[{long}0], "id" : 31 }}"#), Some(31)),
            // An `id` of a nested object, not the request's own.
            (format!(r#"{{"scene":{{"id":9,"a":[{long}0]}}}}"#), None),
            (format!(r#"{{"scene":"{long}\"id\":5}}"#), None),
            (format!(r#"{{"id":-3,"scene":[{long}"#), None),
            (format!(r#"{{"id":"x","scene":[{long}"#), None),
            (nested, None),
            (long, None),
            ("é".repeat(40_000), None),
        ] {
            assert_eq!(id_of(&text), id, "{}", &text[..40]);
        }
    }

    proptest! {
        #[test]
        fn any_text_can_be_looked_at(text in ".*", padding in 0usize..70_000) {
            id_of(&text);
            id_of(&format!("{{\"id\":1{text}{}", " ".repeat(padding)));
        }
    }
}
