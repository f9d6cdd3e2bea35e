//! Orders of a process to its template, with descriptors for the worker that is started.

use crate::worker::frame::Frame;
use rustix::net::{
    RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags, SendAncillaryBuffer, SendAncillaryMessage,
    SendFlags, recvmsg, sendmsg,
};
use std::ffi::CStr;
use std::io::{self, ErrorKind, IoSlice, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::fd::{BorrowedFd, OwnedFd};
use std::os::unix::net::UnixStream;

/// Environment variable with the folder of the template, or of the worker.
pub(super) const FOLDER: &CStr = c"FMUFIT_WORKER_FOLDER";

/// Environment variable with the folder for temporary files, which is the worker's folder.
pub(super) const TEMPORARY: &CStr = c"TMPDIR";

/// Order to the template. Its byte and the descriptors are sent before the frame. The template answers only
/// the last one; a worker reports its own arrival.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub(super) enum Order {
    /// Load the problem in the frame.
    Load = b'L',
    /// Start a worker. The order contains its number, [`Start`](crate::worker::handshake::Start) and
    /// [`DESCRIPTORS`]. The socket of the worker then carries its first messages or an error.
    Start = b'S',
    /// End a worker, by its number, and the processes that it has left behind. The answer is its exit status.
    End = b'E',
}

/// Number of descriptors: the socket, the shared page, and the pipe for printed output.
pub(super) const DESCRIPTORS: usize = 3;

/// Sends an order.
pub(super) fn send(
    socket: &UnixStream,
    order: Order,
    frame: &Frame,
    descriptors: &[BorrowedFd<'_>],
) -> io::Result<()> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(DESCRIPTORS))];
    let mut control = SendAncillaryBuffer::new(&mut space);
    if !descriptors.is_empty() && !control.push(SendAncillaryMessage::ScmRights(descriptors)) {
        return Err(ErrorKind::InvalidInput.into());
    }
    let bytes = [order as u8];
    // On other systems the signal is ignored, as in all Rust and Python programs.
    #[cfg(target_os = "linux")]
    let flags = SendFlags::NOSIGNAL;
    #[cfg(not(target_os = "linux"))]
    let flags = SendFlags::empty();
    rustix::io::retry_on_intr(|| sendmsg(socket, &[IoSlice::new(&bytes)], &mut control, flags))?;
    frame.write(0, &mut &*socket, &mut Vec::new())
}

/// Receives the byte of the next order, with its descriptors.
pub(super) fn receive(socket: &UnixStream) -> io::Result<(u8, Vec<OwnedFd>)> {
    let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmRights(DESCRIPTORS))];
    let mut ancillary = RecvAncillaryBuffer::new(&mut space);
    let mut order = [0];
    let mut to = [IoSliceMut::new(&mut order)];
    #[cfg(target_os = "linux")]
    let flags = RecvFlags::CMSG_CLOEXEC;
    #[cfg(not(target_os = "linux"))]
    let flags = RecvFlags::empty();
    let received = rustix::io::retry_on_intr(|| recvmsg(socket, &mut to, &mut ancillary, flags))?;
    let rights = ancillary.drain().filter_map(|message| match message {
        RecvAncillaryMessage::ScmRights(rights) => Some(rights),
        _ => None,
    });
    let descriptors = rights.flatten().collect();
    if received.bytes == 0 { Err(ErrorKind::UnexpectedEof.into()) } else { Ok((order[0], descriptors)) }
}
