//! Zip archives written byte by byte, so that they can contain errors that no library would write.
#![allow(clippy::unwrap_used, dead_code, unreachable_pub)]

use std::io::Write;

/// Entry of an archive. Every field can be set to a wrong value.
#[derive(Clone)]
pub struct Entry {
    /// Name in the directory.
    pub name: Vec<u8>,
    /// Name in the local header.
    pub local_name: Vec<u8>,
    /// Packed data of the entry.
    pub packed: Vec<u8>,
    pub method: u16,
    pub flags: u16,
    pub crc32: u32,
    /// Sizes in the directory: packed, unpacked.
    pub sizes: (u64, u64),
    /// Sizes in the local header.
    pub local_sizes: (u32, u32),
    /// Unix file type and permissions.
    pub mode: u32,
    /// Points the directory at the local header of another entry.
    pub header_of: Option<usize>,
}

impl Entry {
    pub fn stored(name: &str, data: &[u8]) -> Entry {
        let length = data.len() as u32;
        Entry {
            name: name.into(),
            local_name: name.into(),
            packed: data.to_vec(),
            method: 0,
            flags: 0,
            crc32: crc32fast::hash(data),
            sizes: (length.into(), length.into()),
            local_sizes: (length, length),
            mode: 0o100_644,
            header_of: None,
        }
    }

    pub fn deflated(name: &str, data: &[u8]) -> Entry {
        let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::best());
        encoder.write_all(data).unwrap();
        Entry::packed(name, encoder.finish().unwrap(), data.len() as u64, crc32fast::hash(data))
    }

    /// Returns an entry with this deflate stream.
    pub fn packed(name: &str, packed: Vec<u8>, size: u64, crc32: u32) -> Entry {
        let small = u32::try_from(size).unwrap_or(u32::MAX);
        Entry {
            sizes: (packed.len() as u64, size),
            local_sizes: (packed.len() as u32, small),
            method: 8,
            crc32,
            packed,
            ..Entry::stored(name, b"")
        }
    }

    pub fn with(mut self, change: impl FnOnce(&mut Entry)) -> Entry {
        change(&mut self);
        self
    }

    fn local(&self) -> Vec<u8> {
        let mut bytes = b"PK\x03\x04\x14\x00".to_vec();
        bytes.extend(self.flags.to_le_bytes());
        bytes.extend(self.method.to_le_bytes());
        bytes.extend([0, 0, 0x21, 0]);
        bytes.extend(self.crc32.to_le_bytes());
        bytes.extend(self.local_sizes.0.to_le_bytes());
        bytes.extend(self.local_sizes.1.to_le_bytes());
        bytes.extend((self.local_name.len() as u16).to_le_bytes());
        bytes.extend([0, 0]);
        bytes.extend(&self.local_name);
        bytes.extend(&self.packed);
        bytes
    }

    fn central(&self, offset: u32) -> Vec<u8> {
        let small = |size: u64| u32::try_from(size).unwrap_or(u32::MAX);
        let mut extra = Vec::new();
        for size in [self.sizes.1, self.sizes.0] {
            if small(size) == u32::MAX {
                extra.extend(size.to_le_bytes());
            }
        }
        if !extra.is_empty() {
            let mut head = vec![1, 0, extra.len() as u8, 0];
            head.append(&mut extra);
            extra = head;
        }
        let mut bytes = b"PK\x01\x02\x14\x03\x14\x00".to_vec();
        bytes.extend(self.flags.to_le_bytes());
        bytes.extend(self.method.to_le_bytes());
        bytes.extend([0, 0, 0x21, 0]);
        bytes.extend(self.crc32.to_le_bytes());
        bytes.extend(small(self.sizes.0).to_le_bytes());
        bytes.extend(small(self.sizes.1).to_le_bytes());
        bytes.extend((self.name.len() as u16).to_le_bytes());
        bytes.extend((extra.len() as u16).to_le_bytes());
        bytes.extend([0; 6]);
        bytes.extend((self.mode << 16).to_le_bytes());
        bytes.extend(offset.to_le_bytes());
        bytes.extend(&self.name);
        bytes.extend(extra);
        bytes
    }
}

/// Returns an archive with these entries.
pub fn zip(entries: &[Entry]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut offsets = Vec::new();
    for entry in entries {
        offsets.push(bytes.len() as u32);
        if entry.header_of.is_none() {
            bytes.extend(entry.local());
        }
    }
    let directory = bytes.len();
    for (position, entry) in entries.iter().enumerate() {
        bytes.extend(entry.central(offsets[entry.header_of.unwrap_or(position)]));
    }
    let length = (bytes.len() - directory) as u32;
    bytes.extend(b"PK\x05\x06\0\0\0\0");
    bytes.extend((entries.len() as u16).to_le_bytes());
    bytes.extend((entries.len() as u16).to_le_bytes());
    bytes.extend(length.to_le_bytes());
    bytes.extend((directory as u32).to_le_bytes());
    bytes.extend([0, 0]);
    bytes
}

/// Small valid model description.
pub const DESCRIPTION: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="m" guid="{1}"><ModelExchange modelIdentifier="m"/></fmiModelDescription>
"#;

/// Returns the entry that every FMU has.
pub fn description() -> Entry {
    Entry::deflated("modelDescription.xml", DESCRIPTION.as_bytes())
}
