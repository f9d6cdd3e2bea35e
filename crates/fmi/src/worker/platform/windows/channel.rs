//! Connection of a worker with its caller: a pair of sockets, because pipes have no time limits.

/// The worker's end.
pub(in crate::worker) type Channel = std::net::TcpStream;

/// The caller's end.
pub(in crate::worker) type Connection = Channel;
