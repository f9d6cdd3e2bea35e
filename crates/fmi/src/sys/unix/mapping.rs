//! The memory of a shared page: a file without a name that both processes map.

use crate::sys::shared_page::{LENGTH, Page};
use rustix::mm::{MapFlags, ProtFlags, mmap, munmap};
use std::fs::File;
use std::io;
use std::ptr::NonNull;

impl Page {
    /// Creates a page and the file through which the other process maps it. The file cannot be truncated if
    /// the system supports that.
    pub(crate) fn new() -> io::Result<(Self, File)> {
        let file = anonymous_file()?;
        Ok((Self::of(&file)?, file))
    }

    /// Maps the page in a file that [`new`](Self::new) has created.
    pub(crate) fn of(file: &File) -> io::Result<Self> {
        if file.metadata()?.len() < LENGTH as u64 {
            return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the shared page is too short"));
        }
        let protection = ProtFlags::READ | ProtFlags::WRITE;
        // SAFETY: a new mapping, at an address chosen by the system, of a file that has this length.
        let address = unsafe { mmap(std::ptr::null_mut(), LENGTH, protection, MapFlags::SHARED, file, 0) }?;
        let shared = NonNull::new(address.cast()).ok_or(io::ErrorKind::Other)?;
        Ok(Self { shared })
    }
}

impl Drop for Page {
    fn drop(&mut self) {
        // SAFETY: mapped by `of` with this length; references do not outlive the page.
        let _ = unsafe { munmap(self.shared.as_ptr().cast(), LENGTH) };
    }
}

#[cfg(any(target_os = "linux", target_os = "android"))]
fn anonymous_file() -> io::Result<File> {
    use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, ftruncate, memfd_create};
    let file = memfd_create("fmufit-worker", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
    ftruncate(&file, LENGTH as u64)?;
    // Reading a truncated page would kill the process.
    fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
    Ok(file.into())
}

#[cfg(not(any(target_os = "linux", target_os = "android")))]
fn anonymous_file() -> io::Result<File> {
    let file = tempfile::tempfile()?;
    file.set_len(LENGTH as u64)?;
    Ok(file)
}
