//! Handles and sockets that a process passes to its child, and settings of a process.

use crate::sys::shared_page::note_exception;
use std::io;
use std::net::TcpStream;
use std::os::windows::io::{AsRawHandle, AsRawSocket, FromRawHandle, FromRawSocket, OwnedHandle, RawSocket};
use std::path::Path;
use std::process::Child;
use windows_sys::Win32::Foundation::{DUPLICATE_SAME_ACCESS, DuplicateHandle, HANDLE};
use windows_sys::Win32::Networking::WinSock::{
    FROM_PROTOCOL_INFO, INVALID_SOCKET, WSA_FLAG_NO_HANDLE_INHERIT, WSA_FLAG_OVERLAPPED, WSADuplicateSocketW,
    WSAPROTOCOL_INFOW, WSASocketW,
};
use windows_sys::Win32::System::Diagnostics::Debug::{
    EXCEPTION_POINTERS, SEM_FAILCRITICALERRORS, SEM_NOGPFAULTERRORBOX, SEM_NOOPENFILEERRORBOX, SetErrorMode,
    SetUnhandledExceptionFilter,
};
use windows_sys::Win32::System::ProcessStatus::{K32GetProcessMemoryInfo, PROCESS_MEMORY_COUNTERS};
use windows_sys::Win32::System::Threading::GetCurrentProcess;

/// Value with which a filter ends its process (`excpt.h`).
const EXCEPTION_EXECUTE_HANDLER: i32 = 1;

/// Copies a handle into a child. Returns its number there, for [`take_handle`].
pub(crate) fn give_handle(handle: &OwnedHandle, child: &Child) -> io::Result<u64> {
    let mut given: HANDLE = std::ptr::null_mut();
    // SAFETY: the handles are open, and `given` is a place for the new one.
    let is_given = unsafe {
        DuplicateHandle(
            GetCurrentProcess(),
            handle.as_raw_handle(),
            child.as_raw_handle(),
            &raw mut given,
            0,
            0,
            DUPLICATE_SAME_ACCESS,
        )
    };
    if is_given == 0 { Err(io::Error::last_os_error()) } else { Ok(given.addr() as u64) }
}

/// Takes a handle that the parent of this process has given to it. Called once for each handle.
pub(crate) fn take_handle(number: u64) -> OwnedHandle {
    // SAFETY: the parent has opened this handle for this process, and nothing else uses it.
    unsafe { OwnedHandle::from_raw_handle(std::ptr::without_provenance_mut(number as usize)) }
}

/// Copies a socket into a child. Returns its description, for [`take_socket`].
pub(crate) fn give_socket(socket: &TcpStream, child: &Child) -> io::Result<Vec<u8>> {
    let mut info = WSAPROTOCOL_INFOW::default();
    // SAFETY: the socket is open, and `info` is a place for its description.
    let error = unsafe { WSADuplicateSocketW(socket.as_raw_socket() as usize, child.id(), &raw mut info) };
    if error != 0 {
        return Err(io::Error::last_os_error());
    }
    let first = (&raw const info).cast::<u8>();
    // SAFETY: a structure of integers without padding, of this size.
    Ok(unsafe { std::slice::from_raw_parts(first, size_of::<WSAPROTOCOL_INFOW>()) }.to_vec())
}

/// Takes a socket that the parent of this process has given to it.
pub(crate) fn take_socket(description: &[u8]) -> io::Result<TcpStream> {
    if description.len() != size_of::<WSAPROTOCOL_INFOW>() {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    // The library starts Winsock with the first socket of a process.
    drop(std::net::UdpSocket::bind("127.0.0.1:0"));
    // SAFETY: this many bytes, and any bytes are valid integers.
    let info: WSAPROTOCOL_INFOW = unsafe { std::ptr::read_unaligned(description.as_ptr().cast()) };
    let flags = WSA_FLAG_OVERLAPPED | WSA_FLAG_NO_HANDLE_INHERIT;
    // SAFETY: `info` describes a socket that was copied into this process.
    let socket = unsafe {
        WSASocketW(FROM_PROTOCOL_INFO, FROM_PROTOCOL_INFO, FROM_PROTOCOL_INFO, &raw const info, 0, flags)
    };
    if socket == INVALID_SOCKET {
        return Err(io::Error::last_os_error());
    }
    // SAFETY: a new socket, which nothing else closes.
    Ok(unsafe { TcpStream::from_raw_socket(socket as RawSocket) })
}

/// Returns the memory of a process in bytes.
pub(crate) fn memory_of(child: &Child) -> Option<u64> {
    let mut counters = PROCESS_MEMORY_COUNTERS::default();
    let size = size_of_val(&counters) as u32;
    // SAFETY: the handle is open, and `counters` has this size.
    let is_known = unsafe { K32GetProcessMemoryInfo(child.as_raw_handle(), &raw mut counters, size) };
    (is_known != 0).then_some(counters.WorkingSetSize as u64)
}

/// Makes errors end this process at once, without a window or a debugger. The exit code is the exception.
pub(crate) fn end_on_errors() {
    unsafe extern "system" fn end(pointers: *const EXCEPTION_POINTERS) -> i32 {
        // SAFETY: the system calls a filter with pointers to structures that exist during the call.
        let code = unsafe { pointers.as_ref().and_then(|found| found.ExceptionRecord.as_ref()) };
        if let Some(record) = code {
            note_exception(record.ExceptionCode.cast_unsigned());
        }
        EXCEPTION_EXECUTE_HANDLER
    }
    // SAFETY: the argument is a number.
    unsafe { SetErrorMode(SEM_FAILCRITICALERRORS | SEM_NOGPFAULTERRORBOX | SEM_NOOPENFILEERRORBOX) };
    // SAFETY: the filter uses no memory and little stack, whatever the exception was.
    unsafe { SetUnhandledExceptionFilter(Some(end)) };
}

/// Sets an environment variable of this process, which has one thread.
pub(crate) fn set_variable(name: &str, value: &Path) {
    // SAFETY: no other thread can read the environment.
    unsafe { std::env::set_var(name, value) };
}

/// Removes an environment variable of this process, which has one thread.
pub(crate) fn forget_variable(name: &str) {
    // SAFETY: no other thread can read the environment.
    unsafe { std::env::remove_var(name) };
}
