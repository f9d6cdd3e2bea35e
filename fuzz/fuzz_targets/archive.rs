//! Opens arbitrary bytes as an archive.
#![no_main]

#[path = "../../crates/fmi/tests/promises/mod.rs"]
mod promises;
mod scratch;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| promises::hold_for_archive(scratch::file(bytes)));
