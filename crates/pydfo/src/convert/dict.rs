//! Dictionaries for Python in which each field is written once.

/// Creates a dictionary from fields of a structure, under their names, and from other values.
macro_rules! dict {
    ($py:expr; $($source:expr => $($field:ident),+ $(,)?)? $(; $($name:literal: $value:expr),+ $(,)?)?) => {{
        let dict = pyo3::types::PyDict::new($py);
        $($(dict.set_item(pyo3::intern!($py, stringify!($field)), &$source.$field)?;)+)?
        $($(dict.set_item(pyo3::intern!($py, $name), $value)?;)+)?
        dict
    }};
}

pub(crate) use dict;
