//! A client's socket as a controller treats it: the controller never waits for it. What a client
//! does not read is left out, a whole package at a time.

use std::collections::VecDeque;
use std::io::{self, Read};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::os::fd::AsRawFd;
use std::time::{Duration, Instant};

use nix::sys::socket::{MsgFlags, send, setsockopt, sockopt};

/// Size of the kernel's buffer towards a client, bytes; small, so that a client that does not read
/// is detected.
const SEND_BUFFER_BYTES: usize = 32 * 1024;
/// Most bytes taken from one client in one cycle.
const READ_BYTES_MAX: usize = 64 * 1024;
/// Most packages held back for a delayed client.
const DELAYED_MAX: usize = 4096;
/// Clients of one port at a time; more are closed at once.
pub const CLIENTS_MAX: usize = 32;

/// One client.
#[derive(Debug)]
pub struct Connection {
    stream: TcpStream,
    peer: SocketAddr,
    /// Rest of a package that the kernel accepted in part.
    rest: VecDeque<u8>,
    full_since: Option<Instant>,
    delayed: VecDeque<(Instant, Vec<u8>)>,
    /// Number of packages left out because the client did not read.
    pub skipped: u64,
    /// The client takes nothing any more. What it sent before is still read.
    deaf: bool,
    closed: bool,
}

/// Accepts all waiting clients.
pub fn accept(listener: &TcpListener, present: usize) -> Vec<Connection> {
    let mut new = Vec::new();
    while let Ok((stream, peer)) = listener.accept() {
        if present + new.len() >= CLIENTS_MAX {
            tracing::warn!(target: "simulator", "{peer} rejected: {CLIENTS_MAX} clients are already connected");
            continue;
        }
        match Connection::new(stream, peer) {
            Ok(connection) => new.push(connection),
            Err(error) => tracing::warn!(target: "simulator", "{peer}: {error}"),
        }
    }
    new
}

impl Connection {
    fn new(stream: TcpStream, peer: SocketAddr) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
        setsockopt(&stream, sockopt::SndBuf, &SEND_BUFFER_BYTES).map_err(io::Error::from)?;
        Ok(Self {
            stream,
            peer,
            rest: VecDeque::new(),
            full_since: None,
            delayed: VecDeque::new(),
            skipped: 0,
            deaf: false,
            closed: false,
        })
    }

    /// Address of the client.
    pub fn peer(&self) -> SocketAddr {
        self.peer
    }

    /// Whether the client has disconnected, all that it sent has been read, or it was disconnected.
    pub fn is_closed(&self) -> bool {
        self.closed
    }

    /// Disconnects the client.
    pub fn close(&mut self) {
        self.closed = true;
    }

    /// Reads the bytes that arrived since the last call, at most 64 kB.
    pub fn read(&mut self, out: &mut Vec<u8>) {
        let mut buffer = [0; 4096];
        let limit = out.len() + READ_BYTES_MAX;
        while !self.closed && out.len() < limit {
            match self.stream.read(&mut buffer) {
                Ok(0) => self.closed = true,
                Ok(n) => out.extend_from_slice(&buffer[..n]),
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                Err(_) => self.closed = true,
            }
        }
    }

    /// Sends one package after `delay`, or leaves it out entirely if the client's buffer is full.
    pub fn send_later(&mut self, bytes: &[u8], now: Instant, delay: Duration) {
        if delay.is_zero() && self.delayed.is_empty() {
            self.send(bytes, now);
        } else if self.delayed.len() < DELAYED_MAX {
            self.delayed.push_back((now + delay, bytes.to_vec()));
        }
    }

    /// Sends one package now, or leaves it out entirely if the client's buffer is full.
    pub fn send(&mut self, bytes: &[u8], now: Instant) {
        self.flush(now);
        if self.closed || self.deaf {
            return;
        }
        if !self.rest.is_empty() {
            self.skipped += 1;
            return;
        }
        match self.write(bytes) {
            Some(n) if n < bytes.len() => {
                self.rest.extend(&bytes[n..]);
                self.full_since.get_or_insert(now);
            }
            Some(_) => self.full_since = None,
            None => self.deaf = true,
        }
    }

    /// Sends delayed packages; called once per cycle. `limit`: longest time for which a client may
    /// not read before it is disconnected; `None` if it never has to.
    pub fn tend(&mut self, now: Instant, limit: Option<Duration>) {
        while self.delayed.front().is_some_and(|(due, _)| *due <= now) {
            if let Some((_, bytes)) = self.delayed.pop_front() {
                self.send(&bytes, now);
            }
        }
        self.flush(now);
        let unread = self.full_since.map(|since| now - since);
        if unread
            .zip(limit)
            .is_some_and(|(unread, limit)| unread > limit)
        {
            tracing::info!(target: "simulator", "{} disconnected: it does not read", self.peer);
            self.closed = true;
        }
    }

    fn flush(&mut self, _now: Instant) {
        while !self.rest.is_empty() {
            let chunk: Vec<u8> = self.rest.iter().copied().take(4096).collect();
            match self.write(&chunk) {
                Some(0) => return,
                Some(n) => {
                    self.rest.drain(..n);
                }
                None => {
                    self.deaf = true;
                    self.rest.clear();
                }
            }
        }
        self.full_since = None;
    }

    /// Number of bytes accepted by the kernel; `None` if the client has disconnected.
    fn write(&self, bytes: &[u8]) -> Option<usize> {
        let flags = MsgFlags::MSG_DONTWAIT | MsgFlags::MSG_NOSIGNAL;
        match send(self.stream.as_raw_fd(), bytes, flags) {
            Ok(n) => Some(n),
            Err(nix::errno::Errno::EAGAIN | nix::errno::Errno::EINTR) => Some(0),
            Err(_) => None,
        }
    }
}
