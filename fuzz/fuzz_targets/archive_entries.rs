//! Well-formed archives with some false fields, which random bytes would not produce.
#![no_main]

#[path = "../../crates/fmi/tests/promises/mod.rs"]
mod promises;
mod scratch;
#[path = "../../crates/fmi/tests/zip_bytes/mod.rs"]
mod zip_bytes;

use arbitrary::Arbitrary;
use zip_bytes::{Entry, description, zip};

/// An entry and its false fields.
#[derive(Arbitrary, Debug)]
struct Wish {
    name: Name,
    data: Vec<u8>,
    deflated: bool,
    lie: Option<Lie>,
}

#[derive(Arbitrary, Debug)]
enum Name {
    Usual(u8),
    Free(String),
    Bytes(Vec<u8>),
}

#[derive(Arbitrary, Debug)]
enum Lie {
    LocalName(Vec<u8>),
    Packed(Vec<u8>),
    Method(u16),
    Flags(u16),
    Crc(u32),
    Sizes(u64, u64),
    LocalSizes(u32, u32),
    Mode(u32),
    HeaderOf(u8),
}

const USUAL: [&str; 6] =
    ["modelDescription.xml", "resources/a.txt", "binaries/linux64/m.so", "sources/", "a", "A"];

fn entry(wish: &Wish, count: usize) -> Entry {
    let name = match &wish.name {
        Name::Usual(which) => USUAL[usize::from(*which) % USUAL.len()].as_bytes().to_vec(),
        Name::Free(name) => name.as_bytes().to_vec(),
        Name::Bytes(bytes) => bytes.clone(),
    };
    let honest = if wish.deflated { Entry::deflated("", &wish.data) } else { Entry::stored("", &wish.data) };
    honest.with(|entry| {
        entry.local_name.clone_from(&name);
        entry.name = name;
        match &wish.lie {
            None => {}
            Some(Lie::LocalName(name)) => entry.local_name.clone_from(name),
            Some(Lie::Packed(packed)) => entry.packed.clone_from(packed),
            Some(Lie::Method(method)) => entry.method = *method,
            Some(Lie::Flags(flags)) => entry.flags = *flags,
            Some(Lie::Crc(crc)) => entry.crc32 = *crc,
            Some(Lie::Sizes(packed, unpacked)) => entry.sizes = (*packed, *unpacked),
            Some(Lie::LocalSizes(packed, unpacked)) => entry.local_sizes = (*packed, *unpacked),
            Some(Lie::Mode(mode)) => entry.mode = *mode & 0xffff,
            Some(Lie::HeaderOf(other)) => entry.header_of = Some(usize::from(*other) % count),
        }
    })
}

libfuzzer_sys::fuzz_target!(|wishes: Vec<Wish>| {
    let count = wishes.len() + 1;
    let mut entries = vec![description()];
    entries.extend(wishes.iter().map(|wish| entry(wish, count)));
    promises::hold_for_archive(scratch::file(&zip(&entries)));
});
