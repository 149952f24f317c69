//! The sockets to one robot: requests and replies over TCP, states and answers over UDP.

use std::io::ErrorKind;
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, TcpStream, ToSocketAddrs, UdpSocket};
use std::os::fd::AsRawFd;
use std::time::Duration;

use nix::sys::socket::{MsgFlags, recv};

use crate::fci::{CodecError, Framer, RobotState, STATE_BYTES};

/// Interval between two checks for silence of the robot.
const LOOK: Duration = Duration::from_millis(20);
/// Time after which a robot that accepts no bytes counts as disconnected.
const WRITE_TIMEOUT: Duration = Duration::from_millis(200);

/// Why nothing can be received.
#[derive(Debug, thiserror::Error)]
pub(crate) enum LinkError {
    #[error("{0}")]
    Io(#[from] std::io::Error),
    #[error(transparent)]
    Codec(#[from] CodecError),
}

/// Both sockets, with their buffers.
pub(crate) struct Link {
    pub tcp: TcpStream,
    pub udp: UdpSocket,
    robot: SocketAddr,
    /// Source address of the states, once one has arrived.
    states_from: Option<SocketAddr>,
    pub framer: Framer,
}

impl Link {
    /// Connects to the robot's FCI port, and opens a socket for its states.
    ///
    /// # Errors
    /// There is no such host, or it does not answer.
    pub fn connect(host: &str, port: u16, timeout: Duration) -> std::io::Result<Self> {
        let robot = (host, port).to_socket_addrs()?.next().ok_or_else(|| {
            std::io::Error::new(ErrorKind::NotFound, "the host name has no address")
        })?;
        let any = if robot.is_ipv4() {
            Ipv4Addr::UNSPECIFIED.into()
        } else {
            Ipv6Addr::UNSPECIFIED.into()
        };
        let udp = UdpSocket::bind(SocketAddr::new(any, 0))?;
        udp.set_read_timeout(Some(LOOK))?;
        let tcp = TcpStream::connect_timeout(&robot, timeout)?;
        tcp.set_nodelay(true)?;
        tcp.set_write_timeout(Some(WRITE_TIMEOUT))?;
        tcp.set_nonblocking(true)?;
        Ok(Self {
            tcp,
            udp,
            robot,
            states_from: None,
            framer: Framer::new(),
        })
    }

    /// Sends to the source of the states, to which the socket is connected.
    pub fn send(&self, answer: &[u8]) -> std::io::Result<()> {
        match self.udp.send(answer) {
            Ok(_) => Ok(()),
            // The robot's port is closed for now; the silence is detected elsewhere.
            Err(error) if error.kind() == ErrorKind::ConnectionRefused => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// The newest state received, and the number of older ones skipped; `None` if none arrives for
    /// a while.
    ///
    /// # Errors
    /// The socket fails, or a datagram is not a state.
    pub fn receive(&mut self) -> Result<Option<(RobotState, u64)>, LinkError> {
        let mut bytes = [0; STATE_BYTES + 1];
        let mut newest = None;
        let mut skipped = 0;
        loop {
            let length = match self.receive_one(&mut bytes, newest.is_some()) {
                Ok(Some(length)) => length,
                Ok(None) => continue,
                Err(error) if is_nothing_yet(&error) => break,
                Err(error) if error.kind() == ErrorKind::ConnectionRefused => break,
                Err(error) => return Err(error.into()),
            };
            let state = RobotState::decode(&bytes[..length])?;
            match &newest {
                Some(RobotState { message_id, .. }) if *message_id >= state.message_id => {}
                Some(_) => {
                    skipped += 1;
                    newest = Some(state);
                }
                None => newest = Some(state),
            }
        }
        Ok(newest.map(|state| (state, skipped)))
    }

    /// Length of one datagram; `None` for one that is not from the robot. `only_waiting`: does not
    /// wait for it.
    fn receive_one(
        &mut self,
        bytes: &mut [u8],
        only_waiting: bool,
    ) -> std::io::Result<Option<usize>> {
        if let Some(peer) = self.states_from
            && only_waiting
        {
            // The socket is connected to the peer, so no other datagram is received.
            debug_assert_eq!(self.udp.peer_addr().ok(), Some(peer));
            return Ok(recv(self.udp.as_raw_fd(), bytes, MsgFlags::MSG_DONTWAIT).map(Some)?);
        }
        if self.states_from.is_some() {
            return self.udp.recv(bytes).map(Some);
        }
        let (length, from) = self.udp.recv_from(bytes)?;
        if from.ip() != self.robot.ip() {
            return Ok(None);
        }
        self.udp.connect(from)?;
        self.states_from = Some(from);
        Ok(Some(length))
    }
}

/// Whether the error means only that no data has arrived.
pub(crate) fn is_nothing_yet(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
    )
}
