//! Messages between the two processes: frames with a head, notes and numbers, in alternating directions.
//!
//! A frame begins with a magic number, its flags and its number (4 bytes each, and 4 unused). An answer has
//! the number of its request. The lengths of the three parts follow (8 bytes each; for numbers, their count),
//! and then the parts. All numbers are little-endian. Heads and notes are encoded in CBOR (RFC 8949), so that
//! every number keeps its bits.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::cell::Cell;
use std::io::{self, ErrorKind, Read, Write};

/// Magic number of this version of the protocol.
const MAGIC: u32 = 0x464d_5501;

const HEADER: usize = 40;

/// Maximum size of a message. A message that claims to be larger is invalid, and is not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameSize {
    /// Maximum size of head and notes in bytes.
    pub text: u64,
    /// Maximum count of numbers.
    pub numbers: u64,
}

impl FrameSize {
    /// Limit for messages of a trusted process.
    pub(crate) const ANY: Self = Self { text: 1 << 36, numbers: 1 << 33 };

    /// Returns the limit for answers with this count of numbers. The limit for text is far above the length
    /// of errors and notes.
    pub const fn of_numbers(numbers: u64) -> Self {
        Self { text: 16 << 20, numbers }
    }
}

/// A message. Its buffers are reused from one message to the next.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Frame {
    /// True if the sender could not complete the request. The head contains the error.
    pub(crate) is_error: bool,
    /// True if the worker must not be used again.
    pub is_last: bool,
    /// Not an answer: true if the request must be repeated, because the first attempt revealed how the model
    /// must be run.
    pub is_repeated: bool,
    /// Not an answer: true if the worker first requests the value of a function.
    pub(super) is_asking: bool,
    /// In a request: true if simulations must use new instances.
    pub needs_new_instance: bool,
    /// In an answer: true if the process had received a request before. Not sent.
    pub is_of_used_process: bool,
    /// Number of the request, or of the request that is answered. Set when a frame is read.
    pub(crate) number: u32,
    head: Vec<u8>,
    pub(crate) notes: Vec<u8>,
    /// Bulk numbers, transferred bit for bit.
    pub numbers: Vec<f64>,
}

impl Frame {
    /// Creates a frame with this head.
    ///
    /// # Errors
    /// Returns an error if the head cannot be encoded.
    pub fn of(head: &impl Serialize) -> io::Result<Self> {
        let mut frame = Self::default();
        // A growing buffer would need twice the memory.
        let mut length = Length(0);
        encode(head, &mut length)?;
        frame.head.reserve_exact(length.0);
        frame.set_head(head)?;
        Ok(frame)
    }

    /// Clears the frame.
    pub fn clear(&mut self) {
        (self.is_error, self.is_last, self.is_repeated, self.is_asking) = (false, false, false, false);
        (self.needs_new_instance, self.is_of_used_process) = (false, false);
        self.head.clear();
        self.notes.clear();
        self.numbers.clear();
    }

    /// Sets the head.
    ///
    /// # Errors
    /// Returns an error if the head cannot be encoded.
    pub fn set_head(&mut self, head: &impl Serialize) -> io::Result<()> {
        self.head.clear();
        encode(head, &mut self.head)
    }

    /// Decodes the head.
    ///
    /// # Errors
    /// Returns an error if the head has a different type.
    pub fn head<T: DeserializeOwned>(&self) -> io::Result<T> {
        decode(&self.head)
    }

    /// Writes the frame with this number, through a buffer.
    pub(crate) fn write(&self, number: u32, to: &mut impl Write, buffer: &mut Vec<u8>) -> io::Result<()> {
        buffer.clear();
        let flags = [self.is_error, self.is_last, self.is_repeated, self.is_asking, self.needs_new_instance];
        let flags = flags.iter().rev().fold(0, |bits, flag| bits << 1 | u32::from(*flag));
        [MAGIC, flags, number, 0].iter().for_each(|word| buffer.extend(word.to_le_bytes()));
        for length in [self.head.len(), self.notes.len(), self.numbers.len()] {
            buffer.extend((length as u64).to_le_bytes());
        }
        for part in [&self.head, &self.notes] {
            if part.len() < PIECE {
                buffer.extend_from_slice(part);
            } else {
                to.write_all(buffer)?;
                buffer.clear();
                to.write_all(part)?;
            }
        }
        for part in self.numbers.chunks(PIECE / 8) {
            if buffer.len() >= PIECE {
                to.write_all(buffer)?;
                buffer.clear();
            }
            part.iter().for_each(|number| buffer.extend(number.to_le_bytes()));
        }
        to.write_all(buffer)
    }

    /// Reads the next frame, through a buffer. `wait` is called whenever the reader times out and whenever a
    /// part has arrived.
    ///
    /// # Errors
    /// Returns the errors of the reader and of `wait`. Returns `InvalidData` if the data are not a frame, or
    /// if the frame is larger than `most`.
    pub(crate) fn read(
        &mut self,
        from: &mut impl Read,
        buffer: &mut Vec<u8>,
        most: FrameSize,
        wait: &mut dyn FnMut() -> io::Result<()>,
    ) -> io::Result<()> {
        let mut header = [0; HEADER];
        fill(from, &mut header, wait)?;
        let word =
            |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
        if word(0) != MAGIC || word(4) > 31 {
            return Err(bad("the message is not from a worker of this version".to_owned()));
        }
        let flag = |bit: u32| word(4) & bit != 0;
        let length = |part: usize| u64::from(word(16 + 8 * part)) | u64::from(word(20 + 8 * part)) << 32;
        let (text, numbers) = (length(0).saturating_add(length(1)), length(2));
        if text > most.text || numbers > most.numbers {
            return Err(bad(format!("a message of {text} bytes and {numbers} numbers")));
        }
        let lengths = [length(0), length(1), numbers.saturating_mul(8)];
        (self.is_error, self.is_last, self.is_repeated, self.is_asking) =
            (flag(1), flag(2), flag(4), flag(8));
        self.needs_new_instance = flag(16);
        self.number = word(8);
        read_part(from, &mut self.head, lengths[0], wait)?;
        read_part(from, &mut self.notes, lengths[1], wait)?;
        self.numbers.clear();
        let mut left = lengths[2];
        while left > 0 {
            let piece = left.min(PIECE as u64);
            read_part(from, buffer, piece, wait)?;
            let words = buffer.as_chunks::<8>().0;
            self.numbers.try_reserve(words.len()).map_err(|_| io::Error::from(ErrorKind::OutOfMemory))?;
            self.numbers.extend(words.iter().map(|word| f64::from_le_bytes(*word)));
            left -= piece;
        }
        Ok(())
    }
}

/// Counts the bytes written to it.
struct Length(usize);

impl Write for Length {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.0 += bytes.len();
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// A writer that calls `wait` whenever a write times out because the other side does not read.
pub(super) struct PatientWriter<'a, W> {
    pub(super) to: W,
    pub(super) wait: &'a mut dyn FnMut() -> io::Result<()>,
}

impl<W: Write> Write for PatientWriter<'_, W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        loop {
            match self.to.write(bytes) {
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => (self.wait)()?,
                outcome => return outcome,
            }
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.to.flush()
    }
}

thread_local! {
    /// True while a head is encoded or decoded.
    static IS_IN_FRAME: Cell<bool> = const { Cell::new(false) };
}

/// True while this thread encodes or decodes a message. An input function is serialized only then. It cannot
/// be stored, but the worker can request its values.
pub fn is_in_frame() -> bool {
    IS_IN_FRAME.get()
}

/// Runs a function with [`is_in_frame`] true.
fn in_frame<T>(work: impl FnOnce() -> T) -> T {
    let before = IS_IN_FRAME.replace(true);
    let done = work();
    IS_IN_FRAME.set(before);
    done
}

fn encode(head: &impl Serialize, to: impl Write) -> io::Result<()> {
    in_frame(|| ciborium::into_writer(head, to)).map_err(|e| bad(format!("a message cannot be encoded: {e}")))
}

/// Decodes a head or notes.
pub(crate) fn decode<T: DeserializeOwned>(bytes: &[u8]) -> io::Result<T> {
    use ciborium::de::Error;
    in_frame(|| ciborium::from_reader(bytes)).map_err(|error| {
        bad(match error {
            Error::Io(_) => "its header is truncated".to_owned(),
            Error::Syntax(place) => format!("its header is not valid CBOR at byte {place}"),
            Error::Semantic(_, problem) => format!("its header has unexpected contents: {problem}"),
            Error::RecursionLimitExceeded => "its header is nested too deeply".to_owned(),
        })
    })
}

fn bad(message: String) -> io::Error {
    io::Error::new(ErrorKind::InvalidData, message)
}

/// Memory is allocated as the bytes arrive, so a false length allocates none. Parts longer than this are sent
/// without copying.
const PIECE: usize = 1 << 20;

fn read_part(
    from: &mut impl Read,
    part: &mut Vec<u8>,
    length: u64,
    wait: &mut dyn FnMut() -> io::Result<()>,
) -> io::Result<()> {
    part.clear();
    let mut left = usize::try_from(length).map_err(|_| bad(format!("a message of {length} bytes")))?;
    while left > 0 {
        let (begin, piece) = (part.len(), left.min(PIECE));
        part.try_reserve(piece).map_err(|_| io::Error::from(ErrorKind::OutOfMemory))?;
        part.resize(begin + piece, 0);
        fill(from, &mut part[begin..], wait)?;
        left -= piece;
    }
    Ok(())
}

fn fill(from: &mut impl Read, mut to: &mut [u8], wait: &mut dyn FnMut() -> io::Result<()>) -> io::Result<()> {
    while !to.is_empty() {
        match from.read(to) {
            Ok(0) => return Err(ErrorKind::UnexpectedEof.into()),
            Ok(n) if n == to.len() => return Ok(()),
            Ok(n) => {
                to = &mut to[n..];
                // A sender that sends single bytes does not prolong the wait.
                wait()?;
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => wait()?,
            Err(e) => return Err(e),
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(bytes: &[u8]) -> io::Result<Frame> {
        let mut frame = Frame::default();
        let mut wait = || Err(ErrorKind::TimedOut.into());
        frame.read(&mut &bytes[..], &mut Vec::new(), FrameSize::ANY, &mut wait)?;
        Ok(frame)
    }

    fn written(frame: &Frame) -> Vec<u8> {
        let mut bytes = Vec::new();
        frame.write(7, &mut bytes, &mut Vec::new()).unwrap();
        bytes
    }

    #[test]
    fn long_frames_are_transferred_with_bounded_buffer() {
        let mut frame = Frame::of(&"x".repeat(3 * PIECE)).unwrap();
        frame.numbers = (0..PIECE / 2).map(|k| k as f64).collect();
        let (mut bytes, mut buffer) = (Vec::new(), Vec::new());
        frame.write(7, &mut bytes, &mut buffer).unwrap();
        assert!(buffer.capacity() <= 4 * PIECE, "{}", buffer.capacity());
        let (mut found, mut buffer) = (Frame::default(), Vec::new());
        let mut wait = || Err(ErrorKind::TimedOut.into());
        found.read(&mut &bytes[..], &mut buffer, FrameSize::ANY, &mut wait).unwrap();
        assert!(buffer.capacity() <= PIECE && found.head == frame.head && found.numbers == frame.numbers);
    }

    proptest! {
        #[test]
        fn frames_survive_transfer(text: String, bits: Vec<u64>, flags: (bool, bool, bool, bool)) {
            let mut frame = Frame::of(&text).unwrap();
            (frame.is_error, frame.is_last, frame.is_repeated, frame.is_asking) = flags;
            frame.numbers = bits.iter().map(|bits| f64::from_bits(*bits)).collect();
            let found = read(&written(&frame)).unwrap();
            prop_assert_eq!(found.head::<String>().unwrap(), text);
            let bits_found: Vec<u64> = found.numbers.iter().map(|x| x.to_bits()).collect();
            prop_assert_eq!(bits_found, bits);
            let flags_found = (found.is_error, found.is_last, found.is_repeated, found.is_asking);
            prop_assert_eq!(flags_found, flags);
            prop_assert_eq!(found.number, 7);
        }

        #[test]
        fn frame_rejects_invalid_bytes(mut bytes: Vec<u8>, cut in 0usize..100, flip in 0usize..100, bit in 0u8..8) {
            prop_assert!(read(&bytes).is_err());
            let mut frame = Frame::of(&bytes).unwrap();
            frame.numbers = vec![1.0; 3];
            bytes = written(&frame);
            let cut = cut % bytes.len();
            prop_assert!(read(&bytes[..cut]).is_err());
            let flip = flip % bytes.len();
            bytes[flip] ^= 1 << bit;
            // There must be no panic and no allocation for missing data. A frame that is read must be valid.
            if let Ok(frame) = read(&bytes) {
                prop_assert!(frame.numbers.len() <= 3);
            }
        }
    }
}
