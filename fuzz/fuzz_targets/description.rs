//! Parses arbitrary bytes as a model description.
#![no_main]

#[path = "../../crates/fmi/tests/promises/mod.rs"]
mod promises;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| promises::hold_for_document(bytes));
