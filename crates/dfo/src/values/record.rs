//! Options by name: plain data from Python, a file or a command line, and its conversion to serde types.

use crate::values::nearest::nearest;
use base::Number;
use serde::de::value::{MapAccessDeserializer, SeqDeserializer};
use serde::de::{self, DeserializeOwned, DeserializeSeed, IntoDeserializer, MapAccess, Unexpected, Visitor};
use serde::{Deserialize, Deserializer, Serialize, forward_to_deserialize_any};
use std::collections::{BTreeMap, btree_map};
use std::fmt;
use std::str::FromStr;
use std::time::Duration;

/// Limit of wall-clock time in seconds that counts as no limit.
const ENDLESS: f64 = 1e15;

/// Maximum number of names to list in an error that already suggests one.
const MOST_LISTED: usize = 24;

/// Values by name.
pub type Record = BTreeMap<String, Value>;

/// Plain data. In contrast to JSON, it includes infinities and NaN.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Value {
    /// None, which means the default, no limit or no bound.
    #[default]
    Nothing,
    /// True or false.
    Flag(bool),
    /// An integer that is at least 0.
    Count(u64),
    /// A negative integer.
    Negative(i64),
    /// A number.
    Number(f64),
    /// A string.
    Text(String),
    /// Several values.
    List(Vec<Value>),
    /// Values by name.
    Record(Record),
    /// A value that is not plain data, as the text to display. It matches no type.
    #[serde(skip)]
    Other(String),
}

impl Value {
    /// Converts the value to a type that serde can read. Names of variants are case-insensitive and accept
    /// `_` for `-`. Counts also accept numbers such as 1e4.
    ///
    /// # Errors
    /// Returns a [`RecordError`] that uses `name` for the value.
    pub fn read<T: DeserializeOwned>(&self, name: &str) -> Result<T, RecordError> {
        T::deserialize(self).map_err(|error| error.of(name, self))
    }

    /// Serialises a value.
    ///
    /// # Errors
    /// Returns an error if the value cannot be serialised.
    pub fn of<T: Serialize>(value: &T) -> Result<Self, RecordError> {
        let json = serde_json::to_value(value).map_err(|e| RecordError::message(e.to_string()))?;
        Ok(json.into())
    }

    /// Parses a string with [`FromStr`].
    ///
    /// # Errors
    /// Returns an error if the value is not a string or cannot be parsed.
    pub fn parse<T: FromStr<Err: fmt::Display>>(&self, name: &str) -> Result<T, RecordError> {
        self.read::<String>(name)?.parse().map_err(|error: T::Err| RecordError::message(error.to_string()))
    }

    /// Converts the value to a limit, an integer that is at least `least`. `None`, infinity and numbers
    /// beyond the range of counters mean no limit.
    ///
    /// # Errors
    /// Returns an error for other numbers and other types.
    pub fn read_limit(&self, name: &str, least: u64) -> Result<Option<usize>, RecordError> {
        let count = match self {
            Self::Nothing => return Ok(None),
            Self::Count(count) => *count,
            Self::Number(number) if *number == f64::INFINITY => return Ok(None),
            // The cast saturates at the largest integer.
            Self::Number(number) if number.fract() == 0.0 && *number >= 0.0 => *number as u64,
            Self::Negative(_) | Self::Number(_) => return Err(self.out_of(name, least)),
            _ => return Err(RecordError::expected("a number", true).of(name, self)),
        };
        if count < least {
            return Err(self.out_of(name, least));
        }
        Ok(usize::try_from(count).ok().filter(|count| *count < usize::MAX / 2))
    }

    /// Converts seconds to a limit of wall-clock time. `None`, infinity and more than 30 million years mean
    /// no limit.
    ///
    /// # Errors
    /// Returns an error if the value is not a positive number.
    pub fn read_time(&self, name: &str) -> Result<Option<Duration>, RecordError> {
        let Some(seconds) =
            self.read::<Option<f64>>(name)?.filter(|seconds| seconds.is_nan() || *seconds <= ENDLESS)
        else {
            return Ok(None);
        };
        match Duration::try_from_secs_f64(seconds) {
            Ok(time) if seconds > 0.0 => Ok(Some(time)),
            _ => Err(RecordError::message(format!("{name} = {self} must be a positive number of seconds"))),
        }
    }

    fn out_of(&self, name: &str, least: u64) -> RecordError {
        RecordError::range(format!("an integer of at least {least}")).of(name, self)
    }
}

impl From<serde_json::Value> for Value {
    fn from(json: serde_json::Value) -> Self {
        use serde_json::Value as Json;
        match json {
            Json::Null => Self::Nothing,
            Json::Bool(flag) => Self::Flag(flag),
            Json::Number(number) => match (number.as_u64(), number.as_i64()) {
                (Some(count), _) => Self::Count(count),
                (None, Some(negative)) => Self::Negative(negative),
                (None, None) => Self::Number(number.as_f64().unwrap_or(f64::NAN)),
            },
            Json::String(text) => Self::Text(text),
            Json::Array(items) => Self::List(items.into_iter().map(Self::from).collect()),
            Json::Object(fields) => Self::Record(fields.into_iter().map(|(n, v)| (n, v.into())).collect()),
        }
    }
}

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Nothing => f.write_str("none"),
            Self::Flag(flag) => write!(f, "{flag}"),
            Self::Count(count) => write!(f, "{count}"),
            Self::Negative(number) => write!(f, "{number}"),
            Self::Number(number) => write!(f, "{}", Number(*number)),
            Self::Text(text) => write!(f, "'{text}'"),
            Self::List(items) => {
                let items: Vec<String> = items.iter().map(Self::to_string).collect();
                write!(f, "[{}]", items.join(", "))
            }
            Self::Record(fields) => {
                let fields: Vec<String> = fields.iter().map(|(n, v)| format!("'{n}': {v}")).collect();
                write!(f, "{{{}}}", fields.join(", "))
            }
            Self::Other(shown) => f.write_str(shown),
        }
    }
}

/// Reason why a value does not fit its option.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordError {
    /// Name of the option, if known.
    name: Option<String>,
    /// Method that the option belongs to.
    method: Option<&'static str>,
    given: Value,
    problem: Problem,
}

#[derive(Debug, Clone, PartialEq)]
enum Problem {
    /// The value must be `what`; `is_type` is true if its type is wrong.
    Expected { what: String, is_type: bool },
    /// The value must be in this range.
    Range(String),
    /// The option requires a checkpoint, and there is none.
    NoCheckpoint,
    /// The value is not one of these words.
    Word(Vec<&'static str>),
    /// The record has no field of this name; the existing names follow.
    Field(Box<(String, &'static [&'static str])>),
    /// The complete message.
    Message(String),
}

impl RecordError {
    fn new(problem: Problem) -> Self {
        Self { name: None, method: None, given: Value::Nothing, problem }
    }

    pub(crate) fn expected(what: impl Into<String>, is_type: bool) -> Self {
        Self::new(Problem::Expected { what: what.into(), is_type })
    }

    pub(crate) fn range(what: impl Into<String>) -> Self {
        Self::new(Problem::Range(what.into()))
    }

    pub(crate) fn without_checkpoint() -> Self {
        Self::new(Problem::NoCheckpoint)
    }

    /// Creates an error with this message.
    pub fn message(text: impl Into<String>) -> Self {
        Self::new(Problem::Message(text.into()))
    }

    /// Creates an error about an unknown name, with the most similar known name. `what` describes the kind of
    /// the name.
    pub fn unknown<N: AsRef<str>>(what: &str, name: &str, expected: &[N]) -> Self {
        let expected: Vec<&str> = expected.iter().map(AsRef::as_ref).collect();
        let meant = nearest(name, expected.iter().copied());
        let hint = meant.map_or(";".to_owned(), |meant| format!("; did you mean '{meant}'?"));
        let listed = match meant.is_some() && expected.len() > MOST_LISTED {
            true => String::new(),
            false => format!(" expected one of: {}", expected.join(", ")),
        };
        Self::message(format!("unknown {what} '{name}'{hint}{listed}"))
    }

    /// Describes an unknown field of the outermost record as an unknown `what`.
    pub(crate) fn among(self, what: &str) -> Self {
        match &self.problem {
            Problem::Field(field) if self.name.is_none() => Self::unknown(what, &field.0, field.1),
            _ => self,
        }
    }

    /// Sets the option and its value, unless a name is already set.
    pub(crate) fn of(mut self, name: &str, given: &Value) -> Self {
        if self.name.is_none() {
            (self.name, self.given) = (Some(name.to_owned()), given.clone());
        }
        self
    }

    /// Sets the method, the option and its value.
    pub(crate) fn of_method(mut self, method: &'static str, name: &str, given: &Value) -> Self {
        (self.name, self.method, self.given) = (Some(name.to_owned()), Some(method), given.clone());
        if let Problem::Expected { what, is_type } = &mut self.problem {
            // Integers, NaN and infinities have the right type if a number is expected.
            let is_number = match given {
                Value::Count(_) | Value::Negative(_) => true,
                Value::Number(number) => !number.is_finite() || number.fract() == 0.0,
                _ => false,
            };
            *is_type &= !(is_number && (what.contains("number") || what.contains("integer")));
        }
        self
    }

    /// Sets the expected value of an option that accepts several forms.
    pub(crate) fn must_be(&mut self, expected: &str) {
        match &mut self.problem {
            Problem::Expected { what, .. } => expected.clone_into(what),
            Problem::Word(_) => self.problem = Problem::Expected { what: expected.to_owned(), is_type: true },
            _ => {}
        }
    }

    /// Adds that the option may also be None.
    pub(crate) fn or_none(&mut self) {
        if let Problem::Expected { what, .. } = &mut self.problem {
            what.push_str(" or None");
        }
    }

    /// Returns the name of the option.
    pub fn name(&self) -> Option<&str> {
        self.name.as_deref()
    }

    /// True if the type of the value is wrong.
    pub fn is_type(&self) -> bool {
        matches!(self.problem, Problem::Expected { is_type: true, .. })
    }

    /// Returns the message, with the value as the user wrote it.
    pub fn with_given(&self, given: &str) -> String {
        let name = self.name.as_deref().unwrap_or("the value");
        match &self.problem {
            Problem::Expected { what, .. } => match self.method {
                Some(method) => format!("option '{name}' of {method} must be {what}, not {given}"),
                None => format!("{name} must be {what}, not {given}"),
            },
            Problem::Range(range) => format!("{name} = {given} must be {range}"),
            Problem::Word(words) => {
                let listed: Vec<String> = words.iter().map(|word| format!("'{word}'")).collect();
                let text = if let Value::Text(text) = &self.given { text } else { "" };
                let meant = words.iter().find(|word| !text.is_empty() && word.starts_with(text));
                let hint = meant.map_or_else(String::new, |word| format!("; did you mean '{word}'?"));
                format!("{name} = {given} is invalid; expected one of: {}{hint}", listed.join(", "))
            }
            Problem::NoCheckpoint => {
                format!("{name} = {given} requires a checkpoint; specify its file with checkpoint=...")
            }
            Problem::Field(field) => Self::unknown("field", &field.0, field.1).with_given(given),
            Problem::Message(message) => message.clone(),
        }
    }
}

impl fmt::Display for RecordError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.with_given(&self.given.to_string()))
    }
}

impl std::error::Error for RecordError {}

impl de::Error for RecordError {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::message(message.to_string())
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        let expected = expected.to_string();
        let what = match expected.as_str() {
            "usize" | "u64" | "u32" => "an integer of at least 0",
            "f64" => "a number",
            "a boolean" => "True or False",
            "any value" => "plain data",
            "path string" => "a path",
            "a sequence" => "a list",
            "a tuple of size 2" => "a list of two values",
            other => other,
        };
        let is_number =
            matches!(found, Unexpected::Float(_) | Unexpected::Signed(_) | Unexpected::Unsigned(_));
        // The number has the right type but is not allowed, for example a negative count.
        let is_count = matches!(found, Unexpected::Signed(_)) && what.starts_with("an integer");
        Self::expected(what, !(is_count || is_number && what == "a number"))
    }

    fn invalid_value(found: Unexpected<'_>, expected: &dyn de::Expected) -> Self {
        match found {
            // The value is not one of several words.
            Unexpected::Str(_) => Self::expected(expected.to_string(), false),
            _ => Self::invalid_type(found, expected),
        }
    }

    fn unknown_field(field: &str, expected: &'static [&'static str]) -> Self {
        Self::new(Problem::Field(Box::new((field.to_owned(), expected))))
    }

    fn unknown_variant(_: &str, expected: &'static [&'static str]) -> Self {
        Self::new(Problem::Word(expected.to_vec()))
    }
}

/// Describes a value for serde errors.
fn found(value: &Value) -> Unexpected<'_> {
    match value {
        Value::Nothing => Unexpected::Unit,
        Value::Flag(flag) => Unexpected::Bool(*flag),
        Value::Count(count) => Unexpected::Unsigned(*count),
        Value::Negative(number) => Unexpected::Signed(*number),
        Value::Number(number) => Unexpected::Float(*number),
        Value::Text(text) => Unexpected::Str(text),
        Value::List(_) => Unexpected::Seq,
        Value::Record(_) => Unexpected::Map,
        Value::Other(_) => Unexpected::Other("no data"),
    }
}

impl<'v> IntoDeserializer<'v, RecordError> for &'v Value {
    type Deserializer = Self;

    fn into_deserializer(self) -> Self {
        self
    }
}

/// Counts are also read from numbers such as 1e4.
macro_rules! counts {
    ($($method:ident)*) => {
        $(fn $method<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, RecordError> {
            match self {
                Value::Number(x) if x.fract() == 0.0 && (0.0..=9_007_199_254_740_992.0).contains(x) => {
                    visitor.visit_u64(*x as u64)
                }
                _ => self.deserialize_any(visitor),
            }
        })*
    };
}

impl<'de> Deserializer<'de> for &'de Value {
    type Error = RecordError;

    fn deserialize_any<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, RecordError> {
        match self {
            Value::Nothing => visitor.visit_unit(),
            Value::Flag(flag) => visitor.visit_bool(*flag),
            Value::Count(count) => visitor.visit_u64(*count),
            Value::Negative(number) => visitor.visit_i64(*number),
            Value::Number(number) => visitor.visit_f64(*number),
            Value::Text(text) => visitor.visit_borrowed_str(text),
            Value::List(items) => {
                let mut items = SeqDeserializer::new(items.iter());
                let read = visitor.visit_seq(&mut items)?;
                items.end().map(|()| read)
            }
            Value::Record(fields) => visitor.visit_map(Fields::of(fields)),
            Value::Other(_) => Err(de::Error::invalid_type(found(self), &visitor)),
        }
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, RecordError> {
        match self {
            Value::Nothing => visitor.visit_none(),
            _ => visitor.visit_some(self),
        }
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, RecordError> {
        match self {
            Value::Text(text) => {
                let requested = text.to_ascii_lowercase().replace('_', "-");
                let word = variants.iter().find(|word| word.eq_ignore_ascii_case(&requested));
                visitor.visit_enum(word.copied().unwrap_or(text).into_deserializer())
            }
            Value::Record(fields) if fields.len() == 1 => {
                visitor.visit_enum(MapAccessDeserializer::new(Fields::of(fields)))
            }
            _ => Err(de::Error::invalid_type(found(self), &"a string")),
        }
    }

    /// Rejects lists, because their fields would not have names.
    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, RecordError> {
        match self {
            Value::List(_) => Err(de::Error::invalid_type(found(self), &"a table of names and values")),
            _ => self.deserialize_any(visitor),
        }
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value, RecordError> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value, RecordError> {
        match self {
            Value::Count(flag @ (0 | 1)) => visitor.visit_bool(*flag == 1),
            _ => self.deserialize_any(visitor),
        }
    }

    counts! { deserialize_u32 deserialize_u64 }

    forward_to_deserialize_any! {
        i8 i16 i32 i64 u8 u16 f32 f64 char str string bytes byte_buf unit unit_struct seq tuple
        tuple_struct struct identifier ignored_any
    }
}

/// Fields of a record. Errors about their values contain their names.
struct Fields<'v> {
    rest: btree_map::Iter<'v, String, Value>,
    current: Option<(&'v str, &'v Value)>,
}

impl<'v> Fields<'v> {
    fn of(fields: &'v Record) -> Self {
        Self { rest: fields.iter(), current: None }
    }
}

impl<'v> MapAccess<'v> for Fields<'v> {
    type Error = RecordError;

    fn next_key_seed<K: DeserializeSeed<'v>>(&mut self, seed: K) -> Result<Option<K::Value>, RecordError> {
        let Some((name, value)) = self.rest.next() else { return Ok(None) };
        self.current = Some((name, value));
        let name: de::value::BorrowedStrDeserializer<'v, RecordError> =
            de::value::BorrowedStrDeserializer::new(name);
        seed.deserialize(name).map(Some)
    }

    fn next_value_seed<S: DeserializeSeed<'v>>(&mut self, seed: S) -> Result<S::Value, RecordError> {
        let Some((name, value)) = self.current.take() else {
            return Err(RecordError::message("a value was requested before its name"));
        };
        seed.deserialize(value).map_err(|error| error.of(name, value))
    }
}
