//! Lenient reading of JSON as exporters write it: nulls, `24.0` for 24, numbers that are invalid JSON. Invalid fields
//! are left out one by one with a note; the rest of the document is kept.

use std::fmt;
use std::marker::PhantomData;
use std::ops::Deref;

use serde::Deserialize;
use serde::de::{DeserializeOwned, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::{Number, Value};
use serde_path_to_error::{Path, Segment};

/// Most invalid fields of an item; an item with more is left out as a whole.
const MAX_REPAIRS: usize = 16;

/// Most issues kept per list.
const MAX_ISSUES: usize = 20;

/// Lists of indices: an invalid index is removed, and the others stay valid.
const INDEX_LISTS: [&str; 3] = ["children", "nodes", "joints"];

/// Items of one of the document's arrays, read item by item.
#[derive(Debug)]
pub(super) struct List<T> {
    items: Vec<T>,
    /// Omitted parts: position in the list, and reason.
    pub(super) issues: Vec<String>,
}

impl<T> Default for List<T> {
    fn default() -> Self {
        Self {
            items: Vec::new(),
            issues: Vec::new(),
        }
    }
}

impl<T> Deref for List<T> {
    type Target = [T];

    fn deref(&self) -> &[T] {
        &self.items
    }
}

impl<T> List<T> {
    fn issue(&mut self, issue: String) {
        if self.issues.len() < MAX_ISSUES {
            self.issues.push(issue);
        }
    }
}

impl<'de, T: DeserializeOwned + Default> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Items(PhantomData))
    }
}

struct Items<T>(PhantomData<T>);

impl<T> Items<T> {
    fn none<E>(got: &str) -> Result<List<T>, E> {
        let mut list = List::default();
        list.issue(format!(" left out: expected a list, got {got}"));
        Ok(list)
    }
}

impl<'de, T: DeserializeOwned + Default> Visitor<'de> for Items<T> {
    type Value = List<T>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a list")
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<List<T>, A::Error> {
        let mut list = List::default();
        while let Some(value) = seq.next_element::<Value>()? {
            let item = read_item(value, list.items.len(), &mut list);
            list.items.push(item);
        }
        Ok(list)
    }

    fn visit_unit<E>(self) -> Result<List<T>, E> {
        Ok(List::default())
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<List<T>, A::Error> {
        let mut n = 0;
        while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {
            n += 1;
        }
        // PHP and Lua write an empty object as an empty list.
        if n == 0 {
            return Ok(List::default());
        }
        Self::none("an object")
    }

    fn visit_bool<E>(self, _: bool) -> Result<List<T>, E> {
        Self::none("true or false")
    }

    fn visit_i64<E>(self, _: i64) -> Result<List<T>, E> {
        Self::none("a number")
    }

    fn visit_u64<E>(self, _: u64) -> Result<List<T>, E> {
        Self::none("a number")
    }

    fn visit_f64<E>(self, _: f64) -> Result<List<T>, E> {
        Self::none("a number")
    }

    fn visit_str<E>(self, _: &str) -> Result<List<T>, E> {
        Self::none("a text")
    }
}

/// Reads an item without its invalid fields.
fn read_item<T: DeserializeOwned + Default>(
    mut value: Value,
    index: usize,
    list: &mut List<T>,
) -> T {
    tidy(&mut value, "");
    if value.is_null() {
        return T::default();
    }
    for _ in 0..MAX_REPAIRS {
        let error = match serde_path_to_error::deserialize::<_, T>(&value) {
            Ok(item) => return item,
            Err(error) => error,
        };
        let problem = error.inner().to_string().replace('`', "\"");
        let removed = remove(&mut value, error.path());
        let path = removed.as_deref().unwrap_or_default();
        list.issue(format!("[{index}]{path} left out: {problem}"));
        if removed.is_none() {
            break;
        }
    }
    T::default()
}

/// Removes the smallest optional part of `value` around `path`; returns the path of that part.
fn remove(value: &mut Value, path: &Path) -> Option<String> {
    let segments: Vec<&Segment> = path.iter().collect();
    let last = segments
        .iter()
        .rposition(|s| matches!(s, Segment::Map { .. }))?;
    let mut text = String::new();
    let mut parent = value;
    for segment in &segments[..last] {
        parent = match segment {
            Segment::Map { key } => {
                text.push_str(&format!(".{key}"));
                parent.get_mut(key.as_str())?
            }
            Segment::Seq { index } => {
                text.push_str(&format!("[{index}]"));
                parent.get_mut(*index)?
            }
            // The content of an enum, or something that the path cannot address.
            _ => return None,
        };
    }
    let Segment::Map { key } = segments[last] else {
        return None;
    };
    text.push_str(&format!(".{key}"));
    let object = parent.as_object_mut()?;
    if let Some(Segment::Seq { index }) = segments.get(last + 1)
        && INDEX_LISTS.contains(&key.as_str())
        && let Some(list) = object.get_mut(key).and_then(Value::as_array_mut)
        && *index < list.len()
    {
        list.remove(*index);
        return Some(format!("{text}[{index}]"));
    }
    object.remove(key)?;
    Some(text)
}

/// Removes nulls and `extras`, and converts whole floats to integers.
fn tidy(value: &mut Value, key: &str) {
    match value {
        Value::Object(object) => {
            object.remove("extras");
            for (key, value) in object.iter_mut() {
                tidy(value, key);
            }
            object.retain(|_, value| !value.is_null());
        }
        Value::Array(list) => {
            for value in list.iter_mut() {
                tidy(value, "");
            }
            let has_null = list.iter().any(Value::is_null);
            if !has_null {
                return;
            }
            if INDEX_LISTS.contains(&key) {
                list.retain(|value| !value.is_null());
            } else if key == "weights" {
                for value in list.iter_mut().filter(|value| value.is_null()) {
                    *value = Value::from(0);
                }
            } else if list.iter().any(Value::is_number) || list.iter().all(Value::is_null) {
                // JavaScript writes NaN as null, so a vector with a null is invalid.
                *value = Value::Null;
            } else {
                for value in list.iter_mut().filter(|value| value.is_null()) {
                    *value = Value::Object(serde_json::Map::new());
                }
            }
        }
        Value::Number(number) => {
            if let Some(whole) = whole(number) {
                *value = Value::Number(whole);
            }
        }
        _ => {}
    }
}

/// Converts `24.0` to 24.
fn whole(number: &Number) -> Option<Number> {
    // Every integer up to this value is exact as a float.
    const EXACT: f64 = (1u64 << 53) as f64;
    let x = number.as_f64().filter(|_| number.is_f64())?;
    if x.fract() != 0.0 || x.abs() > EXACT {
        return None;
    }
    // Exact, see above.
    Some(if x < 0.0 {
        Number::from(x as i64)
    } else {
        Number::from(x as u64)
    })
}

/// An index; any other value becomes `None`.
pub(super) fn index<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<usize>, D::Error> {
    let mut value = Value::deserialize(deserializer)?;
    tidy(&mut value, "");
    Ok(value.as_u64().and_then(|x| usize::try_from(x).ok()))
}

/// Names; any other value is skipped.
pub(super) fn names<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<String>, D::Error> {
    let names = match Value::deserialize(deserializer)? {
        Value::Array(list) => list,
        Value::String(name) => vec![Value::String(name)],
        _ => Vec::new(),
    };
    Ok(names
        .into_iter()
        .filter_map(|name| match name {
            Value::String(name) => Some(name),
            _ => None,
        })
        .collect())
}

/// `asset.version`, which some exporters write as a number; empty if missing.
pub(super) fn version<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    let asset = Value::deserialize(deserializer)?;
    Ok(match asset.get("version") {
        Some(Value::String(version)) => version.trim().to_owned(),
        Some(Value::Number(version)) => version.to_string(),
        _ => String::new(),
    })
}

/// Repairs a text that is almost JSON: NaN, infinities and numbers as C prints them, and commas before a closing
/// bracket. `None` if it has none of these.
pub(super) fn mended(text: &str) -> Option<String> {
    let mut out = String::with_capacity(text.len());
    let mut changed = false;
    let mut rest = text;
    while let Some(c) = rest.chars().next() {
        let length = match c {
            '"' => string_length(rest),
            ',' => {
                let next = rest[1..].trim_start().chars().next();
                if matches!(next, Some(']' | '}')) {
                    changed = true;
                    rest = &rest[1..];
                    continue;
                }
                1
            }
            c if is_word(c) => {
                let length = rest.find(|c| !is_word(c)).unwrap_or(rest.len());
                let word = &rest[..length];
                rest = &rest[length..];
                match json_word(word) {
                    Some(good) => {
                        changed = true;
                        out.push_str(&good);
                    }
                    None => out.push_str(word),
                }
                continue;
            }
            c => c.len_utf8(),
        };
        out.push_str(&rest[..length]);
        rest = &rest[length..];
    }
    changed.then_some(out)
}

/// Length in bytes of the string at the start of `text`, including the quotes.
fn string_length(text: &str) -> usize {
    let mut escaped = false;
    for (i, byte) in text.bytes().enumerate().skip(1) {
        match byte {
            _ if escaped => escaped = false,
            b'\\' => escaped = true,
            b'"' => return i + 1,
            _ => {}
        }
    }
    text.len()
}

fn is_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '+' | '-' | '.' | '#' | '_' | '(' | ')')
}

/// The replacement of a word that is not a valid JSON number; `None` for words that are kept.
fn json_word(word: &str) -> Option<String> {
    if matches!(word, "true" | "false" | "null") || serde_json::from_str::<Number>(word).is_ok() {
        return None;
    }
    let number: Option<f64> = word.parse().ok();
    Some(match number.and_then(Number::from_f64) {
        Some(number) => number.to_string(),
        None => "null".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(Debug, Default, PartialEq, Deserialize)]
    #[serde(default)]
    struct Item {
        count: usize,
        children: Vec<usize>,
        translation: Option<[f64; 3]>,
        parts: Vec<Part>,
    }

    #[derive(Debug, Default, PartialEq, Deserialize)]
    #[serde(default)]
    struct Part {
        mode: Option<u32>,
    }

    fn read(text: &str) -> List<Item> {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn floats_and_nulls_are_taken_as_meant() {
        let list = read(
            r#"[{"count":24.0,"children":[1,null,2e0],"translation":[1,null,2],"extras":{"a":[{}]}},null]"#,
        );
        assert_eq!(
            list[0],
            Item {
                count: 24,
                children: vec![1, 2],
                ..Item::default()
            }
        );
        assert_eq!((list.len(), list.issues.len()), (2, 0));
        for empty in ["null", "{}", "[]"] {
            assert!(read(empty).is_empty() && read(empty).issues.is_empty());
        }
        assert_eq!(read("3").issues.len(), 1);
        assert_eq!(read(r#"{"a":1}"#).issues.len(), 1);
    }

    #[test]
    fn a_bad_field_goes_alone() {
        let list = read(
            r#"[{"count":"x","children":[3,-1,4],"translation":[1,2],"parts":[{"mode":4},{"mode":[]},null]},7,{"count":5}]"#,
        );
        assert_eq!(list[0].children, [3, 4]);
        assert_eq!(list[0].parts.len(), 3);
        assert_eq!(list[0].parts[0].mode, Some(4));
        assert_eq!((list[1].count, list[2].count), (0, 5));
        let starts = [
            "[0].count",
            "[0].children[1]",
            "[0].translation",
            "[0].parts[1].mode",
            "[1]",
        ];
        for start in starts {
            let issue = list.issues.iter().find(|i| i.starts_with(start));
            assert!(issue.is_some(), "{start}: {:?}", list.issues);
        }
        assert_eq!(list.issues.len(), starts.len(), "{:?}", list.issues);
    }

    #[test]
    fn numbers_that_are_no_json_are_mended_outside_of_strings() {
        let text =
            r#"{"a": [NaN, -Infinity, 1.#QNAN, -nan(ind), +1, .5, 1e999, 1,], "NaN,]": "x\",}",}"#;
        let value: Value = serde_json::from_str(&mended(text).unwrap()).unwrap();
        assert_eq!(
            value,
            serde_json::json!({"a": [null, null, null, null, 1.0, 0.5, null, 1], "NaN,]": "x\",}"})
        );
        assert_eq!(mended(r#"{"a": [1.5e3, true, null, "é NaN"]}"#), None);
    }

    proptest! {
        #[test]
        fn any_text_is_mended_without_a_panic(text in "\\PC{0,60}") {
            let _ = mended(&text);
        }
    }
}
