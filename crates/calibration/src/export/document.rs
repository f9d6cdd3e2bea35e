//! Values as JSON for people to read and arrays of numbers beside it: nothing is lost, neither bits nor what
//! JSON has no word for.
//!
//! JSON has no NaN, no infinity, no bytes, and only texts as keys. An object with one key that begins with
//! `$` stands for them: `{"$number": "NaN"}`, `{"$array": "arrays/0.npy"}`, `{"$bytes": "00ff"}`, `{"$map":
//! [[key, value], ...]}`.

use ciborium::Value;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Map, Value as Json, json};
use std::collections::BTreeMap;

/// Series of numbers from this length on stand beside the text.
const LONG: usize = 8;

/// Deeper values are none of ours.
const DEEPEST: usize = 64;

/// Text and arrays.
#[derive(Debug, Default)]
pub(super) struct Document {
    pub(super) text: Map<String, Json>,
    /// By the names that the text has for them.
    pub(super) arrays: BTreeMap<String, Vec<f64>>,
}

impl Document {
    /// Adds a value by a name.
    pub(super) fn insert<T: Serialize>(&mut self, name: &str, value: &T) -> Result<(), String> {
        let value = Value::serialized(value).map_err(|e| e.to_string())?;
        let json = self.store(value)?;
        self.text.insert(name.to_owned(), json);
        Ok(())
    }

    /// The value of a name.
    pub(super) fn get<T: DeserializeOwned>(&self, name: &str) -> Result<T, String> {
        let json = self.text.get(name).ok_or_else(|| format!("it has no \"{name}\""))?;
        let value = self.restore(json, 0)?;
        value.deserialized().map_err(|e| match e {
            ciborium::value::Error::Custom(what) => format!("{name}: {what}"),
        })
    }

    /// Refuses a text that refers to an array twice: each stands in one place.
    pub(super) fn check_references(&self) -> Result<(), String> {
        fn collect<'j>(json: &'j Json, names: &mut Vec<&'j str>) {
            match json {
                Json::Array(items) => items.iter().for_each(|item| collect(item, names)),
                Json::Object(object) => match special(object) {
                    Some(("$array", Json::String(name))) => names.push(name),
                    _ => object.values().for_each(|value| collect(value, names)),
                },
                _ => {}
            }
        }
        let mut names = Vec::new();
        self.text.values().for_each(|value| collect(value, &mut names));
        names.sort_unstable();
        match names.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => Err(format!("it refers to {} twice", pair[0])),
            None => Ok(()),
        }
    }

    fn store(&mut self, value: Value) -> Result<Json, String> {
        Ok(match value {
            Value::Null => Json::Null,
            Value::Bool(value) => value.into(),
            Value::Text(text) => text.into(),
            Value::Float(number) => number_to_json(number),
            Value::Integer(number) => {
                let number = i128::from(number);
                let unsigned = u64::try_from(number).map(Json::from);
                unsigned.or_else(|_| i64::try_from(number).map(Json::from)).map_err(|e| e.to_string())?
            }
            Value::Bytes(bytes) => json!({ "$bytes": to_hexadecimal(&bytes) }),
            Value::Array(items) => {
                let number = |item: &Value| match item {
                    Value::Float(number) => Some(*number),
                    _ => None,
                };
                match items.iter().map(number).collect::<Option<Vec<f64>>>() {
                    Some(numbers) if numbers.len() >= LONG => {
                        let name = format!("arrays/{}.npy", self.arrays.len());
                        self.arrays.insert(name.clone(), numbers);
                        json!({ "$array": name })
                    }
                    _ => items.into_iter().map(|item| self.store(item)).collect::<Result<_, _>>()?,
                }
            }
            Value::Map(entries) => {
                let is_plain = |(key, _): &(Value, Value)| key.as_text().is_some_and(|k| !k.starts_with('$'));
                if entries.iter().all(is_plain) {
                    let entry = |(key, value): (Value, Value)| {
                        Ok((key.into_text().unwrap_or_default(), self.store(value)?))
                    };
                    Json::Object(entries.into_iter().map(entry).collect::<Result<_, String>>()?)
                } else {
                    let pair = |(key, value)| Ok(json!([self.store(key)?, self.store(value)?]));
                    json!({ "$map": entries.into_iter().map(pair).collect::<Result<Vec<_>, String>>()? })
                }
            }
            other => return Err(format!("there is no way to store {other:?}")),
        })
    }

    fn restore(&self, json: &Json, depth: usize) -> Result<Value, String> {
        if depth > DEEPEST {
            return Err(format!("its values are nested more than {DEEPEST} deep"));
        }
        let inner = |json: &Json| self.restore(json, depth + 1);
        Ok(match json {
            Json::Null => Value::Null,
            Json::Bool(value) => (*value).into(),
            Json::String(text) => Value::Text(text.clone()),
            Json::Number(number) => match (number.as_u64(), number.as_i64(), number.as_f64()) {
                (Some(number), _, _) => number.into(),
                (_, Some(number), _) => number.into(),
                (_, _, Some(number)) => number.into(),
                _ => return Err(format!("{number} is no number that it can hold")),
            },
            Json::Array(items) => Value::Array(items.iter().map(inner).collect::<Result<_, _>>()?),
            Json::Object(object) => match special(object) {
                Some(("$number", Json::String(name))) => number_from_name(name)?.into(),
                Some(("$array", Json::String(name))) => {
                    let array = self.arrays.get(name).ok_or_else(|| format!("it has no {name}"))?;
                    Value::Array(array.iter().map(|number| Value::Float(*number)).collect())
                }
                Some(("$bytes", Json::String(digits))) => Value::Bytes(from_hexadecimal(digits)?),
                Some(("$map", Json::Array(pairs))) => {
                    let pair = |pair: &Json| match pair.as_array().map(Vec::as_slice) {
                        Some([key, value]) => Ok((inner(key)?, inner(value)?)),
                        _ => Err("a map in it has something that is no pair".to_owned()),
                    };
                    Value::Map(pairs.iter().map(pair).collect::<Result<_, _>>()?)
                }
                Some((key, _)) => return Err(format!("\"{key}\" in it is not known")),
                None => {
                    let entry =
                        |(key, value): (&String, &Json)| Ok((Value::Text(key.clone()), inner(value)?));
                    Value::Map(object.iter().map(entry).collect::<Result<_, String>>()?)
                }
            },
        })
    }
}

/// The key and the value of an object that stands for something else.
fn special(object: &Map<String, Json>) -> Option<(&str, &Json)> {
    let (key, value) = object.iter().next().filter(|_| object.len() == 1)?;
    key.starts_with('$').then_some((key.as_str(), value))
}

fn number_to_json(number: f64) -> Json {
    match number {
        number if number.is_nan() => json!({ "$number": "NaN" }),
        f64::INFINITY => json!({ "$number": "Infinity" }),
        f64::NEG_INFINITY => json!({ "$number": "-Infinity" }),
        number => number.into(),
    }
}

fn number_from_name(name: &str) -> Result<f64, String> {
    match name {
        "NaN" => Ok(f64::NAN),
        "Infinity" => Ok(f64::INFINITY),
        "-Infinity" => Ok(f64::NEG_INFINITY),
        other => Err(format!("\"{other}\" in it is no number")),
    }
}

fn to_hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hexadecimal(digits: &str) -> Result<Vec<u8>, String> {
    let wrong = || format!("\"{digits}\" in it are no bytes");
    let pair = |pair: &[u8]| {
        let text = std::str::from_utf8(pair).ok().filter(|text| text.len() == 2)?;
        u8::from_str_radix(text, 16).ok()
    };
    digits.as_bytes().chunks(2).map(pair).collect::<Option<_>>().ok_or_else(wrong)
}

/// The numbers as a file of NumPy: one axis, 64 bits, little-endian (numpy.lib.format, version 1.0).
pub(super) fn to_npy(numbers: &[f64]) -> Vec<u8> {
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({},), }}", numbers.len());
    // Mark, version and length take 10 bytes; the header is filled up with spaces so that the numbers begin at a multiple of 64.
    let length = (10 + header.len() + 1).next_multiple_of(64) - 10;
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((length as u16).to_le_bytes());
    bytes.extend(format!("{header:<width$}\n", width = length - 1).bytes());
    bytes.extend(numbers.iter().flat_map(|number| number.to_le_bytes()));
    bytes
}

/// The numbers of a file that [`to_npy`] has written.
pub(super) fn from_npy(bytes: &[u8]) -> Result<Vec<f64>, String> {
    let header =
        bytes.get(8..10).and_then(|length| length.first_chunk()).map(|length| u16::from_le_bytes(*length));
    let start = 10 + usize::from(header.unwrap_or_default());
    let rest = bytes.get(start..).ok_or("it is cut")?;
    let (numbers, _) = rest.as_chunks::<8>();
    let numbers: Vec<f64> = numbers.iter().map(|number| f64::from_le_bytes(*number)).collect();
    // What this has not written may mean something else.
    if to_npy(&numbers).get(..start) != bytes.get(..start) || bytes.len() != start + 8 * numbers.len() {
        return Err("it holds something else than a series of 64-bit numbers".to_owned());
    }
    Ok(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    enum Choice {
        None,
        One(f64),
        Named { seed: u64 },
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    struct Everything {
        short: Vec<f64>,
        long: Vec<f64>,
        choices: Vec<Choice>,
        missing: Option<f64>,
        large: u64,
        negative: i64,
        text: String,
        by_name: BTreeMap<String, f64>,
        by_number: BTreeMap<u32, f64>,
        whole: f64,
    }

    #[test]
    fn nothing_is_lost() {
        let long =
            vec![0.1 + 0.2, -0.0, f64::MIN_POSITIVE / 8.0, f64::MAX, f64::INFINITY, 1.0, -3.5e-300, 7.0];
        let value = Everything {
            short: vec![f64::NEG_INFINITY, 1.0 / 3.0, -0.0],
            choices: vec![Choice::None, Choice::One(f64::INFINITY), Choice::Named { seed: u64::MAX }],
            missing: None,
            large: u64::MAX,
            negative: i64::MIN,
            text: "\"\u{0} \u{1f600} $".to_owned(),
            by_name: [("$number".to_owned(), 1.0)].into(),
            by_number: [(7, 2.0)].into(),
            whole: 3.0,
            long,
        };
        let mut document = Document::default();
        document.insert("value", &value).unwrap();
        let text = serde_json::to_string(&document.text).unwrap();
        let document = Document { text: serde_json::from_str(&text).unwrap(), ..document };
        let back: Everything = document.get("value").unwrap();
        assert_eq!(back, value);
        let bits = |numbers: &[f64]| numbers.iter().map(|n| n.to_bits()).collect::<Vec<_>>();
        assert_eq!((bits(&back.long), bits(&back.short)), (bits(&value.long), bits(&value.short)));
        assert_eq!(document.arrays.len(), 1);
    }

    #[test]
    fn numbers_that_are_none_survive() {
        let mut document = Document::default();
        document.insert("all", &vec![f64::NAN; 3]).unwrap();
        document.insert("many", &vec![f64::NAN; 30]).unwrap();
        let all = |name: &str| document.get::<Vec<f64>>(name).unwrap();
        assert!(all("all").iter().chain(&all("many")).all(|n| n.is_nan()));
        assert_eq!((all("all").len(), all("many").len()), (3, 30));
    }

    #[test]
    fn arrays_are_files_of_numpy() {
        for n in [0, 1, 12345] {
            let numbers: Vec<f64> = (0..n).map(|k| 1.0 / f64::from(k)).collect();
            let bytes = to_npy(&numbers);
            assert_eq!((bytes.len() % 64, &bytes[..6]), ((8 * n as usize) % 64, &b"\x93NUMPY"[..]));
            assert_eq!(from_npy(&bytes).unwrap(), numbers);
            assert!(from_npy(&bytes[..bytes.len() - 1]).is_err());
        }
        assert!(from_npy(b"").is_err() && from_npy(&to_npy(&[1.0])[..40]).is_err());
    }

    #[test]
    fn what_is_not_known_is_refused() {
        for (text, expected) in [
            (r#"{"x": {"$array": "arrays/9.npy"}}"#, "it has no arrays/9.npy"),
            (r#"{"x": {"$number": "1"}}"#, "is no number"),
            (r#"{"x": {"$later": 1}}"#, "\"$later\""),
            (r#"{"y": 1}"#, "it has no \"x\""),
            (r#"{"x": "text"}"#, "x: "),
        ] {
            let document = Document { text: serde_json::from_str(text).unwrap(), ..Document::default() };
            let error = document.get::<Vec<f64>>("x").unwrap_err();
            assert!(error.contains(expected), "{error}");
        }
    }
}
