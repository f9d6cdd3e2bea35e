//! A reader with its own position in a file. It does not move the position that all users of the file share,
//! including other threads and forked children. Small reads use a buffer, which moves with the position.

use crate::platform;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};

/// Size of the buffer in bytes. A directory is read in pieces of about ten bytes.
const WINDOW: usize = 1 << 12;

/// A position in a file.
#[derive(Debug)]
pub(super) struct Positioned<'a> {
    file: &'a File,
    position: u64,
    window: Vec<u8>,
    window_start: u64,
}

impl<'a> Positioned<'a> {
    /// Creates a reader at the start of the file.
    pub(super) fn new(file: &'a File) -> Self {
        Self { file, position: 0, window: Vec::new(), window_start: 0 }
    }
}

impl Read for Positioned<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = if buffer.len() < WINDOW {
            let mut at = self.position.wrapping_sub(self.window_start);
            if at >= self.window.len() as u64 {
                self.window.resize(WINDOW, 0);
                let n = platform::read_at(self.file, &mut self.window, self.position);
                self.window.truncate(*n.as_ref().unwrap_or(&0));
                n?;
                (self.window_start, at) = (self.position, 0);
            }
            (&self.window[at as usize..]).read(buffer)?
        } else {
            platform::read_at(self.file, buffer, self.position)?
        };
        self.position += n as u64;
        Ok(n)
    }
}

impl Seek for Positioned<'_> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let target = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
            SeekFrom::End(by) => self.file.metadata()?.len().checked_add_signed(by),
        };
        self.position = target.ok_or(io::ErrorKind::InvalidInput)?;
        Ok(self.position)
    }
}
