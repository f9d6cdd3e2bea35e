//! Headers of shared libraries: target operating system, target processors, and length of the file.

use crate::error::{FmiError, Result};
use crate::macros::words;
use base::files::open_regular;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;
use std::{env, fmt};

/// Processor for which a binary is compiled.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Machine {
    /// 32-bit x86.
    X86,
    /// 64-bit x86.
    X86_64,
    /// 32-bit ARM.
    Arm,
    /// 64-bit ARM.
    Aarch64,
    /// 64-bit RISC-V.
    Riscv64,
    /// Any other processor, with its number in the file.
    Other(u32),
}

impl Machine {
    /// Returns the processor for which this library was compiled.
    pub fn host() -> Machine {
        match env::consts::ARCH {
            "x86" => Machine::X86,
            "x86_64" => Machine::X86_64,
            "arm" => Machine::Arm,
            "aarch64" => Machine::Aarch64,
            "riscv64" => Machine::Riscv64,
            _ => Machine::Other(0),
        }
    }
}

impl fmt::Display for Machine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Machine::X86 => f.write_str("x86"),
            Machine::X86_64 => f.write_str("x86_64"),
            Machine::Arm => f.write_str("arm"),
            Machine::Aarch64 => f.write_str("aarch64"),
            Machine::Riscv64 => f.write_str("riscv64"),
            Machine::Other(number) => write!(f, "machine {number}"),
        }
    }
}

words! {
    /// File format of a binary, which determines the operating system.
    #[derive(Debug, Clone, Copy, PartialEq, Eq)]
    pub enum BinaryFormat {
        /// Linux and most other Unix systems.
        Elf = "ELF",
        /// Windows.
        Pe = "Windows",
        /// macOS.
        MachO = "Mach-O",
    }
}

impl BinaryFormat {
    /// Returns the format that this platform loads.
    pub fn host() -> BinaryFormat {
        if cfg!(windows) {
            BinaryFormat::Pe
        } else if cfg!(target_vendor = "apple") {
            BinaryFormat::MachO
        } else {
            BinaryFormat::Elf
        }
    }
}

/// Header of a shared library.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BinaryHeader {
    /// File format.
    pub format: BinaryFormat,
    /// Processors for which the file contains code; more than one only in universal Mach-O files.
    pub machines: Vec<Machine>,
}

impl BinaryHeader {
    /// Reads the header of a file; `None` if it is not a binary of a known format.
    pub fn read(path: &Path) -> io::Result<Option<BinaryHeader>> {
        Self::read_from(&mut open_regular(path)?)
    }

    /// Reads the header of a binary from a stream at its start.
    fn read_from(file: &mut (impl Read + Seek)) -> io::Result<Option<BinaryHeader>> {
        let mut start = Vec::with_capacity(1024);
        file.by_ref().take(1024).read_to_end(&mut start)?;
        let header = match start.get(..4) {
            Some([0x7f, b'E', b'L', b'F']) => elf_machine(&start).map(|m| (BinaryFormat::Elf, vec![m])),
            Some([b'M', b'Z', ..]) => pe_machine(&start, file)?.map(|m| (BinaryFormat::Pe, vec![m])),
            Some([0xcf | 0xce, 0xfa, 0xed, 0xfe]) => {
                u32_le(&start, 4).map(|cpu| (BinaryFormat::MachO, vec![mach_o_machine(cpu)]))
            }
            Some([0xca, 0xfe, 0xba, 0xbe]) => universal_machines(&start).map(|m| (BinaryFormat::MachO, m)),
            _ => None,
        };
        Ok(header.map(|(format, machines)| BinaryHeader { format, machines }))
    }

    /// True if this platform can load the library.
    pub fn runs_here(&self) -> bool {
        self.format == BinaryFormat::host() && self.machines.contains(&Machine::host())
    }
}

impl fmt::Display for BinaryHeader {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.format)?;
        for machine in &self.machines {
            write!(f, " {machine}")?;
        }
        Ok(())
    }
}

/// Rejects a file that is shorter than its ELF headers declare (for 64-bit little-endian processors). The
/// loader maps the segments without checking the length, and the first access beyond the end of the file ends
/// the process (SIGBUS). The loaders of Windows and macOS check the length.
///
/// # Errors
/// Returns [`FmiError::LoadFailed`] with both lengths, or [`FmiError::Io`] if the file cannot be read.
pub(crate) fn check_length(library: &Path) -> Result<()> {
    let lengths = open_regular(library).and_then(|mut file| {
        let length = file.metadata()?.len();
        match mapped_length(&mut file) {
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok((length, None)),
            needed => Ok((length, Some(needed?))),
        }
    });
    let what = match lengths.map_err(FmiError::io("read", library))? {
        (length, Some(needed)) if needed <= length => return Ok(()),
        (length, Some(needed)) => {
            format!("the file has {length} bytes, but its headers refer to content up to byte {needed}")
        }
        (length, None) => format!("the file has {length} bytes, too few for its ELF headers"),
    };
    let message = format!("{what}. It was truncated, perhaps when it was copied, downloaded or packed");
    Err(FmiError::LoadFailed { library: library.to_owned(), message })
}

/// Returns the end of the mapped segments and of the dynamic section in an ELF file (System V ABI, chapter
/// 5); 0 for other files.
fn mapped_length(file: &mut File) -> io::Result<u64> {
    const LOADED: u64 = 1;
    const DYNAMIC: u64 = 2;
    let mut header = Vec::new();
    file.take(64).read_to_end(&mut header)?;
    if !header.starts_with(b"\x7fELF\x02\x01") {
        return Ok(0);
    }
    if header.len() < 64 {
        return Err(io::ErrorKind::UnexpectedEof.into());
    }
    let mut segment = vec![0; number::<2>(&header, 54) as usize];
    file.seek(SeekFrom::Start(number::<8>(&header, 32)))?;
    let mut end = 0;
    for _ in 0..number::<2>(&header, 56) {
        file.read_exact(&mut segment)?;
        if [LOADED, DYNAMIC].contains(&number::<4>(&segment, 0)) {
            end = end.max(number::<8>(&segment, 8).saturating_add(number::<8>(&segment, 32)));
        }
    }
    Ok(end)
}

/// Returns a little-endian number of `N` bytes. Bytes beyond the end are read as 0.
fn number<const N: usize>(bytes: &[u8], at: usize) -> u64 {
    (0..N).rev().fold(0, |number, k| number << 8 | u64::from(bytes.get(at + k).copied().unwrap_or(0)))
}

/// Describes the file found in place of a library, for a message.
pub(crate) fn describe(path: &Path) -> String {
    let header = match BinaryHeader::read(path) {
        Ok(Some(header)) => return header.to_string(),
        Ok(None) => open_regular(path).and_then(|file| {
            let mut start = Vec::new();
            file.take(256).read_to_end(&mut start).map(|_| start)
        }),
        Err(error) => Err(error),
    };
    let what = match header {
        Ok(start) if start.is_empty() => "an empty file",
        // https://github.com/git-lfs/git-lfs/blob/main/docs/spec.md
        Ok(start) if start.starts_with(b"version https://git-lfs.github.com/spec/") => {
            "a Git LFS pointer instead of the file; fetch the file with \"git lfs pull\""
        }
        Ok(start) if start.starts_with(b"\x7fELF") || start.starts_with(b"MZ") => "a truncated library",
        Ok(start)
            if std::str::from_utf8(&start[..start.len().min(64)]).is_ok_and(|text| !text.contains('\0')) =>
        {
            "a text file, not a library"
        }
        Ok(_) => "not a library",
        Err(error) => return error.to_string(),
    };
    what.to_owned()
}

/// Reads `e_machine` of an ELF header (System V ABI, chapter 4): two bytes at offset 18.
fn elf_machine(start: &[u8]) -> Option<Machine> {
    let bytes: [u8; 2] = start.get(18..20)?.try_into().ok()?;
    let big_endian = *start.get(5)? == 2;
    let number = if big_endian { u16::from_be_bytes(bytes) } else { u16::from_le_bytes(bytes) };
    Some(match number {
        3 => Machine::X86,
        62 if start.get(4) == Some(&1) => Machine::Other(62), // x32: 32-bit pointers on x86-64
        62 => Machine::X86_64,
        40 => Machine::Arm,
        183 => Machine::Aarch64,
        243 if start.get(4) == Some(&2) => Machine::Riscv64,
        other => Machine::Other(u32::from(other)),
    })
}

/// Reads `Machine` of the COFF header after the PE signature (Microsoft PE format).
fn pe_machine(start: &[u8], file: &mut (impl Read + Seek)) -> io::Result<Option<Machine>> {
    let Some(offset) = u32_le(start, 0x3c) else { return Ok(None) };
    file.seek(SeekFrom::Start(u64::from(offset)))?;
    let mut header = Vec::with_capacity(6);
    file.by_ref().take(6).read_to_end(&mut header)?;
    let [b'P', b'E', 0, 0, low, high] = header[..] else { return Ok(None) };
    Ok(Some(match u16::from_le_bytes([low, high]) {
        0x014c => Machine::X86,
        0x8664 => Machine::X86_64,
        0x01c0 | 0x01c4 => Machine::Arm,
        0xaa64 => Machine::Aarch64,
        0x5064 => Machine::Riscv64,
        other => Machine::Other(u32::from(other)),
    }))
}

/// Converts `cputype` of a Mach-O header (`mach/machine.h`).
fn mach_o_machine(cpu: u32) -> Machine {
    match cpu {
        7 => Machine::X86,
        0x0100_0007 => Machine::X86_64,
        12 => Machine::Arm,
        0x0100_000c => Machine::Aarch64,
        other => Machine::Other(other),
    }
}

/// Reads the processors of a universal Mach-O file. Java class files have the same magic number; their next
/// field, read as a count, is far above any number of processors.
fn universal_machines(start: &[u8]) -> Option<Vec<Machine>> {
    let count = u32_be(start, 4)?;
    if !(1..=30).contains(&count) {
        return None;
    }
    (0..count as usize).map(|slice| u32_be(start, 8 + 20 * slice).map(mach_o_machine)).collect()
}

fn u32_le(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn u32_be(bytes: &[u8], at: usize) -> Option<u32> {
    u32_le(bytes, at).map(u32::swap_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    fn header(bytes: &[u8]) -> Option<BinaryHeader> {
        BinaryHeader::read_from(&mut Cursor::new(bytes)).unwrap()
    }

    fn elf(class: u8, order: u8, machine: [u8; 2]) -> Vec<u8> {
        let mut bytes = vec![0x7f, b'E', b'L', b'F', class, order, 1];
        bytes.resize(18, 0);
        bytes.extend(machine);
        bytes.resize(64, 0);
        bytes
    }

    #[test]
    fn machine_is_read_from_elf_header() {
        for (bytes, machine) in [
            (elf(2, 1, [62, 0]), Machine::X86_64),
            (elf(1, 1, [3, 0]), Machine::X86),
            (elf(2, 1, [183, 0]), Machine::Aarch64),
            (elf(2, 2, [0, 183]), Machine::Aarch64),
            (elf(1, 1, [62, 0]), Machine::Other(62)),
            (elf(2, 1, [21, 0]), Machine::Other(21)),
        ] {
            assert_eq!(
                header(&bytes),
                Some(BinaryHeader { format: BinaryFormat::Elf, machines: vec![machine] })
            );
        }
    }

    #[test]
    fn machine_is_read_from_pe_header() {
        let mut bytes = b"MZ".to_vec();
        bytes.resize(0x3c, 0);
        bytes.extend(2000u32.to_le_bytes());
        bytes.resize(2000, 0);
        bytes.extend(b"PE\0\0\x64\x86");
        assert_eq!(
            header(&bytes),
            Some(BinaryHeader { format: BinaryFormat::Pe, machines: vec![Machine::X86_64] })
        );
    }

    #[test]
    fn machines_are_read_from_mach_o_header() {
        let thin = [0xcf, 0xfa, 0xed, 0xfe, 0x0c, 0, 0, 1];
        assert_eq!(header(&thin).map(|h| h.machines), Some(vec![Machine::Aarch64]));
        let mut fat = vec![0xca, 0xfe, 0xba, 0xbe, 0, 0, 0, 2];
        fat.extend([1, 0, 0, 7]);
        fat.extend([0; 16]);
        fat.extend([1, 0, 0, 12]);
        fat.extend([0; 16]);
        assert_eq!(header(&fat).map(|h| h.machines), Some(vec![Machine::X86_64, Machine::Aarch64]));
    }

    #[test]
    fn binary_header_rejects_other_files() {
        let java = [0xca, 0xfe, 0xba, 0xbe, 0, 0, 0, 52];
        for bytes in [
            &b""[..],
            b"\x7fEL",
            b"\x7fELF",
            b"MZ",
            b"MZ and more text, but not that much of it, and no header",
            &java,
        ] {
            assert_eq!(header(bytes), None, "{bytes:?}");
        }
    }

    #[test]
    fn binary_header_of_test_program_matches_host() {
        let header = BinaryHeader::read(&env::current_exe().unwrap()).unwrap().unwrap();
        assert!(header.runs_here(), "{header}");
    }
}
