//! Cables that can be damaged: a relay for the sensor's datagrams, and one for a TCP connection.

use std::collections::VecDeque;
use std::io::{ErrorKind, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use crate::error::{Context, Result};

/// Interval at which a relay checks whether it must end.
const LOOK: Duration = Duration::from_millis(20);
/// Number of datagrams kept for replay: half a second at 500 Hz.
const KEPT: usize = 250;

/// Damage to the sensor's datagrams.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Damage {
    /// No damage.
    None,
    /// Nothing passes in either direction, as with a cable that is unplugged.
    Unplugged,
    /// Datagrams are lost at random.
    Lost {
        /// Share of lost datagrams, per mille.
        per_mille: u32,
    },
    /// Some datagrams are preceded by damaged ones: truncated, overlong, and random.
    Corrupted {
        /// One of this many datagrams.
        one_of: u32,
    },
    /// Some datagrams are followed by one from half a second before.
    Replayed {
        /// One of this many datagrams.
        one_of: u32,
    },
    /// Every record has these bits in its status word.
    Status {
        /// The status word.
        word: u32,
    },
    /// Every record repeats the counts of the first; the sequences continue.
    Frozen,
    /// One axis of every record repeats the count of the first.
    AxisStuck {
        /// Axis, 0 Fx to 5 Tz.
        axis: usize,
    },
    /// Some records are well-formed and wrong: random loads of up to 100 N and Nm in place of the
    /// true ones.
    Implausible {
        /// One of this many records.
        one_of: u32,
    },
}

/// Position of the counts in a record: six big-endian numbers of four bytes after two sequences and
/// the status.
const COUNTS: std::ops::Range<usize> = 12..36;
/// Counts per N and per Nm of the simulated box.
const COUNTS_PER_UNIT: u64 = 1_000_000;

/// Relays the sensor's UDP stream between its box and the client that requested it last.
pub struct SensorWire {
    port: u16,
    damage: Arc<Mutex<Damage>>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
}

impl SensorWire {
    /// Listens on a free loopback port in place of the box.
    pub fn start(rdt: SocketAddr) -> Result<Self> {
        let near = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).context("a port for the sensor")?;
        let far = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).context("a port for the sensor")?;
        far.connect(rdt)?;
        near.set_read_timeout(Some(LOOK))?;
        far.set_read_timeout(Some(LOOK))?;
        let port = near.local_addr()?.port();
        let damage = Arc::new(Mutex::new(Damage::None));
        let stop = Arc::new(AtomicBool::new(false));
        let client = Arc::new(Mutex::new(None));
        let requests = Requests {
            near: near.try_clone()?,
            far: far.try_clone()?,
            client: Arc::clone(&client),
            damage: Arc::clone(&damage),
        };
        let records = Records {
            near,
            far,
            client,
            damage: Arc::clone(&damage),
            before: VecDeque::with_capacity(KEPT),
            held: None,
            count: 0,
            random: 0x2545_f491_4f6c_dd1d,
        };
        let (ends, ends_too) = (Arc::clone(&stop), Arc::clone(&stop));
        let threads = vec![
            std::thread::Builder::new()
                .name("wire-requests".into())
                .spawn(move || requests.run(&ends))?,
            std::thread::Builder::new()
                .name("wire-records".into())
                .spawn(move || records.run(&ends_too))?,
        ];
        Ok(Self {
            port,
            damage,
            stop,
            threads,
        })
    }

    /// Loopback port of the relay.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Sets the damage from the next datagram on.
    pub fn set(&self, damage: Damage) {
        *lock(&self.damage) = damage;
    }
}

impl Drop for SensorWire {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Requests {
    near: UdpSocket,
    far: UdpSocket,
    client: Arc<Mutex<Option<SocketAddr>>>,
    damage: Arc<Mutex<Damage>>,
}

impl Requests {
    fn run(self, stop: &AtomicBool) {
        let mut buffer = [0; 2048];
        while !stop.load(Ordering::Acquire) {
            if let Ok((n, from)) = self.near.recv_from(&mut buffer) {
                *lock(&self.client) = Some(from);
                if *lock(&self.damage) != Damage::Unplugged {
                    let _ = self.far.send(&buffer[..n]);
                }
            }
        }
    }
}

struct Records {
    near: UdpSocket,
    far: UdpSocket,
    client: Arc<Mutex<Option<SocketAddr>>>,
    damage: Arc<Mutex<Damage>>,
    before: VecDeque<Vec<u8>>,
    /// Counts that frozen records repeat.
    held: Option<[u8; 24]>,
    count: u32,
    random: u64,
}

impl Records {
    fn run(mut self, stop: &AtomicBool) {
        // The relay must be as prompt as a cable, even on a busy machine.
        let _ = tangent_runtime::realtime::setup_thread("sensor's wire", 85);
        let mut buffer = [0; 2048];
        while !stop.load(Ordering::Acquire) {
            let Ok(n) = self.far.recv(&mut buffer) else {
                continue;
            };
            let Some(to) = *lock(&self.client) else {
                continue;
            };
            self.pass(&mut buffer[..n], to);
        }
    }

    fn pass(&mut self, datagram: &mut [u8], to: SocketAddr) {
        self.count = self.count.wrapping_add(1);
        let damage = *lock(&self.damage);
        let count = self.count;
        let due = |one_of: u32| count.is_multiple_of(one_of.max(1));
        match damage {
            Damage::Unplugged => return,
            Damage::Lost { per_mille } if self.draw() % 1000 < u64::from(per_mille) => return,
            Damage::Corrupted { one_of } if due(one_of) => {
                let _ = self.near.send_to(&datagram[..datagram.len() - 1], to);
                let _ = self
                    .near
                    .send_to(&[datagram as &[u8], &[0; 7]].concat(), to);
                // The noise is shorter than a record: only the network's own checksum can detect
                // noise of a record's length.
                let noise: Vec<u8> = (0..count % 36).map(|_| self.draw() as u8).collect();
                let _ = self.near.send_to(&noise, to);
            }
            Damage::Status { word } => {
                // Layout of a record: two sequences, the status, six counts; each four bytes,
                // big-endian.
                for record in datagram.chunks_exact_mut(36) {
                    record[8..12].copy_from_slice(&word.to_be_bytes());
                }
            }
            Damage::Frozen => {
                for record in datagram.chunks_exact_mut(36) {
                    self.hold(record, 0..24);
                }
            }
            Damage::AxisStuck { axis } => {
                for record in datagram.chunks_exact_mut(36) {
                    self.hold(record, 4 * axis..4 * axis + 4);
                }
            }
            Damage::Implausible { one_of } if due(one_of) => {
                for bytes in datagram[COUNTS].chunks_exact_mut(4) {
                    let load = self.draw() % (200 * COUNTS_PER_UNIT);
                    let count = load as i32 - (100 * COUNTS_PER_UNIT) as i32;
                    bytes.copy_from_slice(&count.to_be_bytes());
                }
            }
            _ => {}
        }
        if !matches!(damage, Damage::Frozen | Damage::AxisStuck { .. }) {
            self.held = None;
        }
        let _ = self.near.send_to(datagram, to);
        if let Damage::Replayed { one_of } = damage
            && due(one_of)
            && let Some(old) = self.before.front()
        {
            let _ = self.near.send_to(old, to);
        }
        if self.before.len() == KEPT {
            self.before.pop_front();
        }
        self.before.push_back(datagram.to_vec());
    }

    /// Writes the held counts of these bytes into a record; the first record sets them.
    fn hold(&mut self, record: &mut [u8], bytes: std::ops::Range<usize>) {
        let counts = &mut record[COUNTS];
        let held = self.held.get_or_insert_with(|| {
            let mut held = [0; 24];
            held.copy_from_slice(counts);
            held
        });
        counts[bytes.clone()].copy_from_slice(&held[bytes]);
    }

    /// xorshift64: which datagrams are lost does not matter, as long as the losses are irregular.
    fn draw(&mut self) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random
    }
}

/// Damage to a TCP connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Cut {
    /// No damage.
    None = 0,
    /// Nothing passes and no error is reported, as with a cable that is unplugged.
    Unplugged = 1,
    /// Connections are closed, new ones too.
    Closed = 2,
}

/// Relays TCP connections from a free port of loopback.
pub struct Link {
    port: u16,
    state: Arc<AtomicU8>,
    stop: Arc<AtomicBool>,
    listener: Option<JoinHandle<()>>,
}

impl Link {
    /// Relays connections from [`Link::port`] to `to`.
    pub fn start(to: SocketAddr) -> Result<Self> {
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).context("a port for a link")?;
        listener.set_nonblocking(true)?;
        let port = listener.local_addr()?.port();
        let state = Arc::new(AtomicU8::new(Cut::None as u8));
        let stop = Arc::new(AtomicBool::new(false));
        let (cut, ends) = (Arc::clone(&state), Arc::clone(&stop));
        let listener = std::thread::Builder::new()
            .name("link".into())
            .spawn(move || accept(&listener, to, &cut, &ends))?;
        Ok(Self {
            port,
            state,
            stop,
            listener: Some(listener),
        })
    }

    /// Loopback port of the relay.
    pub fn port(&self) -> u16 {
        self.port
    }

    /// Sets the damage from now on.
    pub fn set(&self, cut: Cut) {
        self.state.store(cut as u8, Ordering::Release);
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        if let Some(listener) = self.listener.take() {
            let _ = listener.join();
        }
    }
}

fn accept(listener: &TcpListener, to: SocketAddr, cut: &Arc<AtomicU8>, stop: &Arc<AtomicBool>) {
    while !stop.load(Ordering::Acquire) {
        let Ok((near, _)) = listener.accept() else {
            std::thread::sleep(LOOK);
            continue;
        };
        if cut.load(Ordering::Acquire) != Cut::None as u8 {
            continue;
        }
        let Ok(far) = TcpStream::connect(to) else {
            continue;
        };
        for (from, into) in [(&near, &far), (&far, &near)] {
            let (Ok(from), Ok(into)) = (from.try_clone(), into.try_clone()) else {
                continue;
            };
            let (cut, stop) = (Arc::clone(cut), Arc::clone(stop));
            // The thread ends with its connection, or with the link.
            let _ = std::thread::Builder::new()
                .name("link-copy".into())
                .spawn(move || copy(from, into, &cut, &stop));
        }
    }
}

fn copy(mut from: TcpStream, mut into: TcpStream, cut: &AtomicU8, stop: &AtomicBool) {
    let _ = tangent_runtime::realtime::setup_thread("link", 70);
    let _ = from.set_nonblocking(false);
    let _ = from.set_read_timeout(Some(LOOK));
    let _ = into.set_nodelay(true);
    let mut buffer = [0; 16 * 1024];
    while !stop.load(Ordering::Acquire) {
        match cut.load(Ordering::Acquire) {
            c if c == Cut::Closed as u8 => break,
            c if c == Cut::Unplugged as u8 => {
                std::thread::sleep(LOOK);
                continue;
            }
            _ => {}
        }
        match from.read(&mut buffer) {
            Ok(0) => break,
            Ok(n) => {
                if into.write_all(&buffer[..n]).is_err() {
                    break;
                }
            }
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {}
            Err(_) => break,
        }
    }
    let _ = from.shutdown(Shutdown::Both);
    let _ = into.shutdown(Shutdown::Both);
}
