//! A relay that delays bytes as a slow, lossy, reordering link makes TCP do: lost or reordered
//! packets arrive late, and everything behind them waits. Above TCP, nothing is ever missing or out
//! of order.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc;
use std::thread;
use std::time::{Duration, Instant};

use tangent_runtime::realtime::setup_thread;

use super::Wire;

/// Priority, equal to the simulated robot's: load on this machine must not delay the relay, because
/// it represents a network link.
const PRIORITY: u8 = 84;

/// Time in which three later packets come, s: a fast retransmit waits for them (RFC 5681, 3.2)
/// besides a round trip.
const THREE_PACKETS_S: f64 = 0.006;

/// Listens until the test process ends.
pub struct Relay {
    port: u16,
}

impl Relay {
    /// Starts a relay between a new port and `port` on this host.
    pub fn to(port: u16, wire: Wire) -> Self {
        let listener = TcpListener::bind("0.0.0.0:0").unwrap();
        let own = listener.local_addr().unwrap().port();
        thread::spawn(move || {
            for near in listener.incoming() {
                let Ok(near) = near else { return };
                let Ok(far) = TcpStream::connect(("127.0.0.1", port)) else {
                    continue;
                };
                for (seed, (from, to)) in [(&near, &far), (&far, &near)].into_iter().enumerate() {
                    carry(
                        from.try_clone().unwrap(),
                        to.try_clone().unwrap(),
                        wire,
                        seed as u64,
                    );
                }
            }
        });
        Self { port: own }
    }

    /// Port of the relay.
    pub fn port(&self) -> u16 {
        self.port
    }
}

/// One direction: one thread receives, another sends when the delay is over.
fn carry(mut from: TcpStream, mut to: TcpStream, wire: Wire, seed: u64) {
    for end in [&from, &to] {
        end.set_nodelay(true).unwrap();
    }
    let (sender, receiver) = mpsc::channel::<(Instant, Vec<u8>)>();
    thread::spawn(move || {
        setup_thread("wire", PRIORITY);
        let mut random = Random(0x9e37_79b9_7f4a_7c15 ^ (seed + 1));
        let mut last = Instant::now();
        let mut buffer = vec![0; 1 << 16];
        while let Ok(n @ 1..) = from.read(&mut buffer) {
            let mut late_s = 1e-3 * (wire.delay_ms + wire.jitter_ms * (2.0 * random.share() - 1.0));
            if random.share() < wire.loss {
                late_s += 2e-3 * wire.delay_ms + THREE_PACKETS_S;
            }
            if random.share() < wire.reorder {
                late_s += 0.5 * THREE_PACKETS_S;
            }
            last = last.max(Instant::now() + Duration::from_secs_f64(late_s.max(0.0)));
            if sender.send((last, buffer[..n].to_vec())).is_err() {
                break;
            }
        }
    });
    thread::spawn(move || {
        setup_thread("wire", PRIORITY);
        for (due, bytes) in receiver {
            thread::sleep(due.saturating_duration_since(Instant::now()));
            if to.write_all(&bytes).is_err() {
                break;
            }
        }
        let _ = to.shutdown(Shutdown::Both);
    });
}

/// xorshift64*: the sequence is identical in every run.
struct Random(u64);

impl Random {
    fn share(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 11) as f64 / (1u64 << 53) as f64
    }
}
