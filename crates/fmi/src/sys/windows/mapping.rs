//! The memory of a shared page: a part of the page file, or a file, that both processes map.

use crate::sys::shared_page::{LENGTH, Page};
use std::fs::File;
use std::io;
use std::os::windows::io::{AsRawHandle, FromRawHandle, OwnedHandle};
use std::ptr::NonNull;
use windows_sys::Win32::Foundation::{HANDLE, INVALID_HANDLE_VALUE};
use windows_sys::Win32::System::Memory::{
    CreateFileMappingW, FILE_MAP_ALL_ACCESS, MEMORY_MAPPED_VIEW_ADDRESS, MapViewOfFile, PAGE_READWRITE,
    UnmapViewOfFile,
};

impl Page {
    /// Creates a page and the handle through which the other process maps it.
    pub(crate) fn new() -> io::Result<(Self, OwnedHandle)> {
        // A part of the page file.
        let handle = mapping(INVALID_HANDLE_VALUE)?;
        Ok((Self::of(&handle)?, handle))
    }

    /// Maps the page in a file of this length.
    pub(crate) fn of_file(file: &File) -> io::Result<Self> {
        Self::of(&mapping(file.as_raw_handle())?)
    }

    /// Maps the page of a handle that [`new`](Self::new) has created.
    pub(crate) fn of(handle: &OwnedHandle) -> io::Result<Self> {
        // SAFETY: a new mapping, at an address chosen by the system. The system refuses a length beyond the
        // end of the mapped memory.
        let view = unsafe { MapViewOfFile(handle.as_raw_handle(), FILE_MAP_ALL_ACCESS, 0, 0, LENGTH) };
        let shared = NonNull::new(view.Value.cast()).ok_or_else(io::Error::last_os_error)?;
        Ok(Self { shared })
    }
}

/// Creates the object through which the memory of a file is mapped.
fn mapping(file: HANDLE) -> io::Result<OwnedHandle> {
    let nothing = std::ptr::null();
    // SAFETY: the handle is open or the one of the page file. The function accepts null pointers for its
    // defaults.
    let handle =
        unsafe { CreateFileMappingW(file, nothing, PAGE_READWRITE, 0, LENGTH as u32, nothing.cast()) };
    if handle.is_null() {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: a new handle, which nothing else closes.
    Ok(unsafe { OwnedHandle::from_raw_handle(handle) })
}

impl Drop for Page {
    fn drop(&mut self) {
        let view = MEMORY_MAPPED_VIEW_ADDRESS { Value: self.shared.as_ptr().cast() };
        // SAFETY: mapped by `of`; references do not outlive the page.
        let _ = unsafe { UnmapViewOfFile(view) };
    }
}
