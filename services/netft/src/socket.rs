//! The UDP socket to one box: deep, and read to the bottom.

use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::os::fd::AsRawFd;
use std::time::Duration;

use nix::errno::Errno;
use nix::sys::socket::{MsgFlags, recv, setsockopt, sockopt};
use socket2::{Domain, Protocol, SockRef, Socket, Type};

use crate::NetftError;
use crate::codec::Request;

/// Kernel memory that one waiting record takes, bytes: 36 bytes of record in a packet buffer of the
/// smallest size.
const KERNEL_BYTES_PER_DATAGRAM: usize = 832;

/// A connected socket: the kernel drops what anybody else sends.
#[derive(Debug)]
pub struct RdtSocket {
    socket: UdpSocket,
    granted_bytes: usize,
}

impl RdtSocket {
    /// Connects, with as deep a buffer as is granted of `buffer_bytes`. Reading waits at most
    /// `wait`.
    ///
    /// # Errors
    /// The address is none, or the system has no socket to give.
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

    /// Records of one datagram each that the granted buffer holds.
    pub fn buffer_records(&self) -> usize {
        self.granted_bytes / KERNEL_BYTES_PER_DATAGRAM
    }

    /// What the kernel granted, in words, with what to do when it is too little for `rate_hz`.
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

    /// Sends a request. A box that is gone is no error here: its silence says it.
    pub fn send(&self, request: Request) {
        if let Err(error) = self.socket.send(&request.to_bytes()) {
            tracing::debug!("a request could not be sent: {error}");
        }
    }

    /// One datagram, waiting for it; none when the time is up.
    pub fn wait<'a>(&self, buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        match self.socket.recv(buffer) {
            Ok(length) => Some(&buffer[..length]),
            Err(_) => None,
        }
    }

    /// One datagram, if one is there.
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
    // The kernel doubles what is asked for, and so does what it reports.
    let asked = buffer_bytes / 2;
    // With the right to (CAP_NET_ADMIN) beyond rmem_max, else up to it.
    if setsockopt(&socket, sockopt::RcvBufForce, &asked).is_err() {
        socket.set_recv_buffer_size(asked)?;
    }
    socket.set_read_timeout(Some(wait))?;
    socket.connect(&target.into())?;
    Ok(socket.into())
}
