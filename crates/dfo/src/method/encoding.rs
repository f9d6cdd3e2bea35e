//! Bytes that say themselves what they hold: CBOR (RFC 8949), with the names of all fields.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// A value as bytes.
///
/// # Errors
/// As text. What this crate stores has none.
pub(crate) fn encode<T: Serialize>(value: &T) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    ciborium::into_writer(value, &mut bytes).map_err(|e| e.to_string())?;
    Ok(bytes)
}

/// A value from bytes.
///
/// # Errors
/// The reason, as text, if the bytes do not fit the type.
pub(crate) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, String> {
    ciborium::from_reader(bytes).map_err(|e| match e {
        ciborium::de::Error::Semantic(_, what) => what,
        other => other.to_string(),
    })
}
