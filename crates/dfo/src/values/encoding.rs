//! Self-describing encoding: CBOR (RFC 8949) with the names of all fields.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Encodes a value as bytes.
///
/// # Errors
/// Returns the error as text. The types that this crate stores never cause one.
pub(crate) fn encode<T: Serialize>(value: &T) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    ciborium::into_writer(value, &mut bytes).map_err(|e| e.to_string())?;
    Ok(bytes)
}

/// Encodes many numbers as one byte string (little endian, 8 bytes each), for `#[serde(with = "numbers")]`.
/// This takes a small fraction of the time of separate numbers. Text formats store separate numbers.
pub(crate) mod numbers {
    use serde::de::{DeserializeOwned, Deserializer, Error};
    use serde::{Deserialize, Serialize, Serializer};
    use serde_bytes::{ByteBuf, Bytes};

    /// A number of 8 bytes.
    pub(crate) trait Word: Copy + Serialize + DeserializeOwned {
        fn to_bytes(self) -> [u8; 8];
        fn from_bytes(bytes: [u8; 8]) -> Self;
    }

    impl Word for f64 {
        fn to_bytes(self) -> [u8; 8] {
            self.to_le_bytes()
        }
        fn from_bytes(bytes: [u8; 8]) -> Self {
            Self::from_le_bytes(bytes)
        }
    }

    impl Word for u64 {
        fn to_bytes(self) -> [u8; 8] {
            self.to_le_bytes()
        }
        fn from_bytes(bytes: [u8; 8]) -> Self {
            Self::from_le_bytes(bytes)
        }
    }

    pub(crate) fn serialize<W: Word, S: Serializer>(values: &[W], to: S) -> Result<S::Ok, S::Error> {
        if to.is_human_readable() {
            return values.serialize(to);
        }
        let bytes: Vec<[u8; 8]> = values.iter().map(|value| value.to_bytes()).collect();
        Bytes::new(bytes.as_flattened()).serialize(to)
    }

    pub(crate) fn deserialize<'de, W: Word, D: Deserializer<'de>>(from: D) -> Result<Vec<W>, D::Error> {
        if from.is_human_readable() {
            return Vec::deserialize(from);
        }
        let bytes = ByteBuf::deserialize(from)?;
        match bytes.as_chunks() {
            (values, []) => Ok(values.iter().map(|value| W::from_bytes(*value)).collect()),
            (_, rest) => Err(D::Error::custom(format!("{} bytes beyond numbers of 8 bytes", rest.len()))),
        }
    }
}

/// Decodes a value from bytes.
///
/// # Errors
/// Returns the reason as text if the bytes do not match the type.
pub(crate) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    ciborium::from_reader(bytes).map_err(|e| match e {
        ciborium::de::Error::Semantic(_, what) => what,
        other => other.to_string(),
    })
}
