//! TCP connections that a program opens: `socket_open` and its like.

use std::collections::HashMap;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::Duration;

use tangent_urscript::{SocketState, Sockets};

/// Most connections at once.
const CONNECTIONS_MAX: usize = 32;
/// Time after which an attempt to connect is given up.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
/// Most bytes that are kept for a program that does not read them; the rest stays with the system.
const RECEIVED_MAX: usize = 64 * 1024;

/// The connections of a program, by name.
#[derive(Debug, Default)]
pub struct Network {
    connections: HashMap<String, Connection>,
}

#[derive(Debug)]
enum Connection {
    /// A thread of its own looks the host up and connects.
    Opening(Receiver<io::Result<TcpStream>>),
    Open(Peer),
}

#[derive(Debug)]
struct Peer {
    stream: TcpStream,
    received: Vec<u8>,
    /// The other side has closed it; what it sent before can still be read.
    ended: bool,
}

impl Network {
    /// Closes all connections, as the end of a program does.
    pub fn close_all(&mut self) {
        self.connections.clear();
    }

    /// The connection, if it is open.
    fn peer(&mut self, name: &str) -> Option<&mut Peer> {
        let connection = self.connections.get_mut(name)?;
        if let Connection::Opening(outcome) = connection {
            match outcome.try_recv() {
                Ok(Ok(stream)) => {
                    *connection = Connection::Open(Peer {
                        stream,
                        received: Vec::new(),
                        ended: false,
                    });
                }
                Err(TryRecvError::Empty) => return None,
                Ok(Err(error)) => {
                    tracing::debug!(target: "simulator", "socket_open({name:?}): {error}");
                    self.connections.remove(name);
                    return None;
                }
                Err(TryRecvError::Disconnected) => {
                    self.connections.remove(name);
                    return None;
                }
            }
        }
        match self.connections.get_mut(name) {
            Some(Connection::Open(peer)) => Some(peer),
            _ => None,
        }
    }
}

impl Sockets for Network {
    fn open(&mut self, name: &str, host: &str, port: u16) {
        self.connections.remove(name);
        if self.connections.len() >= CONNECTIONS_MAX {
            tracing::warn!(target: "simulator", "socket_open({name:?}): {CONNECTIONS_MAX} connections are open");
            return;
        }
        let (sender, outcome) = channel();
        let host = host.to_owned();
        let started = std::thread::Builder::new()
            .name("socket_open".to_owned())
            .spawn(move || {
                let _ = sender.send(connect(&host, port));
            });
        if started.is_ok() {
            let connection = Connection::Opening(outcome);
            self.connections.insert(name.to_owned(), connection);
        }
    }

    fn state(&mut self, name: &str) -> SocketState {
        if let Some(peer) = self.peer(name) {
            peer.read();
            if peer.ended && peer.received.is_empty() {
                return SocketState::Closed;
            }
            return SocketState::Open;
        }
        if self.connections.contains_key(name) {
            SocketState::Opening
        } else {
            SocketState::Closed
        }
    }

    fn close(&mut self, name: &str) -> bool {
        self.connections.remove(name).is_some()
    }

    fn send(&mut self, name: &str, bytes: &[u8]) -> bool {
        let Some(peer) = self.peer(name) else {
            return false;
        };
        let sent = !peer.ended && peer.stream.write_all(bytes).is_ok();
        if !sent {
            // A message cut in half is worse than a closed connection.
            peer.ended = true;
        }
        sent
    }

    fn received(&mut self, name: &str) -> Option<&mut Vec<u8>> {
        let peer = self.peer(name)?;
        peer.read();
        Some(&mut peer.received)
    }
}

impl Peer {
    fn read(&mut self) {
        let mut buffer = [0; 4096];
        while !self.ended && self.received.len() < RECEIVED_MAX {
            match self.stream.read(&mut buffer) {
                Ok(0) => self.ended = true,
                Ok(n) => self.received.extend_from_slice(&buffer[..n]),
                Err(e) if e.kind() == ErrorKind::WouldBlock => return,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => self.ended = true,
            }
        }
    }
}

fn connect(host: &str, port: u16) -> io::Result<TcpStream> {
    let mut last = io::Error::from(ErrorKind::NotFound);
    for address in (host, port).to_socket_addrs()? {
        match TcpStream::connect_timeout(&address, CONNECT_TIMEOUT) {
            Ok(stream) => {
                stream.set_nodelay(true)?;
                stream.set_nonblocking(true)?;
                return Ok(stream);
            }
            Err(error) => last = error,
        }
    }
    Err(last)
}
