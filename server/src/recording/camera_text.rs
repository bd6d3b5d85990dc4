//! Converts intrinsics in plain text to equivalent JSON: numbers in a row, matrices, `name: value` lines.

use serde_json::{Map, Value};

use super::error::{Place, RecordingError};
use super::excerpt::quote;
use super::text::{TextFile, number};

/// Converts a text of numbers or of `name: value` lines to equivalent JSON.
pub(super) fn document_of(
    file: &TextFile,
    notes: &mut Vec<String>,
) -> Result<Value, RecordingError> {
    let place = Place::file(file.path());
    let lines = file.lines().take(100).collect::<Result<Vec<_>, _>>()?;
    let mut object = Map::new();
    let mut rows: Vec<Vec<f64>> = Vec::new();
    for line in &lines {
        let split = line.text.split_once(['=', ':']);
        let (name, value) = match split {
            Some((name, value)) => (name.trim(), value.trim()),
            // `fx 525.0`
            None => match line.words.as_slice() {
                [name, value] if number(name).is_none() => (*name, *value),
                _ => ("", line.text),
            },
        };
        let numbers: Vec<Option<f64>> = match split {
            Some(_) => value
                .split([' ', '\t', ',', ';', '[', ']'])
                .filter(|word| !word.is_empty())
                .map(number)
                .collect(),
            None if name.is_empty() => line.words.iter().map(|word| number(word)).collect(),
            None => vec![number(value)],
        };
        if name.is_empty() {
            let numbers: Option<Vec<f64>> = numbers.into_iter().collect();
            match numbers {
                Some(numbers) if numbers.iter().all(|number| number.is_finite()) => {
                    rows.push(numbers);
                }
                Some(_) => {
                    let got = quote(line.text);
                    return Err(line.place().field("intrinsics", "finite numbers", got));
                }
                // A heading before the numbers; between the numbers it is an error.
                None if rows.is_empty() => {}
                None => {
                    let got = quote(line.text);
                    return Err(line.place().field("intrinsics", "numbers", got));
                }
            }
            continue;
        }
        // `Camera.fx` and `camera/fx` mean fx.
        let name = name
            .rsplit(['.', '/'])
            .next()
            .unwrap_or(name)
            .trim_matches('"');
        let list: Vec<Value> = numbers.into_iter().flatten().map(Value::from).collect();
        let value = match list.as_slice() {
            [one] => one.clone(),
            _ => Value::Array(list),
        };
        object.entry(name.to_owned()).or_insert(value);
    }
    if !object.is_empty() {
        return Ok(Value::Object(object));
    }
    let numbers: Vec<f64> = match rows.as_slice() {
        // Four numbers, or a matrix in one line; numbers after the four are distortion or a size.
        [one] => match one.len() {
            9 | 12 | 16 => one.clone(),
            4.. => {
                if one.len() > 4 {
                    let rest = one.len() - 4;
                    notes.push(format!("{rest} numbers after fx fy cx cy are left out."));
                }
                one[..4].to_vec()
            }
            n => {
                let got = format!("{n} words");
                let expected = "4 numbers";
                return Err(place.field("intrinsics fx fy cx cy", expected, got));
            }
        },
        [a, b, c, ..] if [3, 4].contains(&a.len()) && a.len() == b.len() && b.len() == c.len() => {
            [a, b, c]
                .into_iter()
                .flat_map(|row| row[..3].to_vec())
                .collect()
        }
        // Focal lengths, then the principal point.
        [a, b] if a.len() == 2 && b.len() == 2 => [a.as_slice(), b].concat(),
        // One number per line.
        [a, b, c, d, ..] if [a, b, c, d].iter().all(|row| row.len() == 1) => {
            [a[0], b[0], c[0], d[0]].to_vec()
        }
        other => {
            let lengths: Vec<String> = other.iter().take(5).map(|r| r.len().to_string()).collect();
            return Err(place.field(
                "intrinsics",
                "fx fy cx cy on one line or a 3x3, 3x4 or 4x4 matrix",
                format!("{} lines of {} numbers", other.len(), lengths.join(", ")),
            ));
        }
    };
    let numbers: Vec<Value> = numbers.into_iter().map(Value::from).collect();
    Ok(Value::Object(Map::from_iter([(
        "intrinsics".to_owned(),
        Value::Array(numbers),
    )])))
}
