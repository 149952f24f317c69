//! The UDP socket to one box, with a large buffer that is read until it is empty.

use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::os::fd::AsRawFd;
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::socket::{MsgFlags, recv, setsockopt, sockopt};
use socket2::{Domain, Protocol, SockRef, Socket, Type};

use crate::NetftError;
use crate::codec::Request;

/// Kernel memory of one queued record, bytes: a record of 36 bytes in the smallest packet buffer.
const KERNEL_BYTES_PER_DATAGRAM: usize = 832;

/// A connected socket: the kernel drops datagrams from other senders.
#[derive(Debug)]
pub struct RdtSocket {
    socket: UdpSocket,
    granted_bytes: usize,
}

impl RdtSocket {
    /// Connects, and requests a buffer of `buffer_bytes`, of which less may be granted. Reading
    /// waits for at most `wait`.
    ///
    /// # Errors
    /// The address is not valid, or the system refused a socket.
    pub fn connect(
        address: &str,
        port: u16,
        buffer_bytes: usize,
        wait: Duration,
    ) -> Result<Self, NetftError> {
        let unreachable = |reason: String| NetftError::Unreachable {
            address: format!("{address}:{port}"),
            reason,
        };
        let target: SocketAddr = (address, port)
            .to_socket_addrs()
            .map_err(|error| unreachable(error.to_string()))?
            .next()
            .ok_or_else(|| unreachable("the name has no address".into()))?;
        let socket = open(target, buffer_bytes, wait).map_err(|source| NetftError::System {
            action: "opening the RDT socket",
            source,
        })?;
        let granted_bytes = SockRef::from(&socket).recv_buffer_size().unwrap_or(0);
        Ok(Self {
            socket,
            granted_bytes,
        })
    }

    /// Number of records, one per datagram, that the granted buffer holds.
    pub fn buffer_records(&self) -> usize {
        self.granted_bytes / KERNEL_BYTES_PER_DATAGRAM
    }

    /// Describes the granted buffer, with advice if it is too small for `rate_hz`.
    pub fn buffer_words(&self, rate_hz: f64, asked_bytes: usize) -> String {
        let records = self.buffer_records();
        let seconds = records as f64 / rate_hz;
        let mut words = format!(
            "socket buffer {} kB: {records} records, {seconds:.2} s at {rate_hz} Hz",
            self.granted_bytes / 1024
        );
        if seconds < 1.0 {
            words.push_str(&format!(
                "; a pause longer than that loses records: allow more with `sysctl -w net.core.rmem_max={asked_bytes}`"
            ));
        }
        words
    }

    /// Sends a request. A box that does not receive it causes no error here; it is detected by its
    /// silence.
    pub fn send(&self, request: Request) {
        if let Err(error) = self.socket.send(&request.to_bytes()) {
            tracing::debug!("a request could not be sent: {error}");
        }
    }

    /// The next datagram, waiting for it; `None` if the time is up.
    pub fn wait<'a>(&self, buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        match self.socket.recv(buffer) {
            Ok(length) => Some(&buffer[..length]),
            Err(_) => None,
        }
    }

    /// The next datagram, if one has arrived.
    pub fn next<'a>(&self, buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        loop {
            match recv(self.socket.as_raw_fd(), buffer, MsgFlags::MSG_DONTWAIT) {
                Ok(length) => return Some(&buffer[..length]),
                Err(Errno::EINTR) => {}
                Err(_) => return None,
            }
        }
    }
}

fn open(target: SocketAddr, buffer_bytes: usize, wait: Duration) -> std::io::Result<UdpSocket> {
    let socket = Socket::new(
        Domain::for_address(target),
        Type::DGRAM,
        Some(Protocol::UDP),
    )?;
    // The kernel doubles the requested size, and reports the doubled one.
    let asked = buffer_bytes / 2;
    // With CAP_NET_ADMIN the size may exceed rmem_max.
    if setsockopt(&socket, sockopt::RcvBufForce, &asked).is_err() {
        socket.set_recv_buffer_size(asked)?;
    }
    socket.set_read_timeout(Some(wait))?;
    socket.connect(&target.into())?;
    Ok(socket.into())
}
