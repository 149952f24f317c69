//! The socket and the clock around [`RdtBox`].

use std::net::UdpSocket;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::Receiver;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_netft::codec::FT_RATE_HZ;
use tangent_runtime::realtime::setup_thread;

use crate::fault::NetbFault;
use crate::rdt::RdtBox;
use crate::{Shared, lock};

/// Polling interval for requests while no client is served.
const IDLE: Duration = Duration::from_millis(1);
/// Polling interval for a sample that the plant has not computed yet.
const LOOK: Duration = Duration::from_micros(200);
/// Longest time for which records are made up for after the thread was suspended, s; beyond it, the
/// clock jumps.
const CATCH_UP_S: f64 = 2.0;

pub(crate) fn spawn(
    socket: UdpSocket,
    shared: Arc<Shared>,
    faults: Receiver<NetbFault>,
) -> std::io::Result<JoinHandle<()>> {
    socket.set_nonblocking(true)?;
    std::thread::Builder::new()
        .name("netb-rdt".into())
        .spawn(move || {
            if let Some(priority) = shared.config.realtime_priority {
                setup_thread("simulated sensor box", priority);
            }
            serve(&socket, &shared, &faults);
        })
}

fn serve(socket: &UdpSocket, shared: &Shared, faults: &Receiver<NetbFault>) {
    let mut simulated = RdtBox::new(shared.config.threshold_counts, shared.config.noise_counts);
    let mut request = [0; 64];
    let mut due = Instant::now();
    let mut deaf_until = due;
    while !shared.stop.load(Ordering::Relaxed) {
        for fault in faults.try_iter() {
            simulated.inject(fault);
            if let NetbFault::Restart(time) | NetbFault::Silence(time) = fault {
                deaf_until = Instant::now() + time;
            }
        }
        let now = Instant::now();
        let deaf = now < deaf_until;
        while let Ok((length, from)) = socket.recv_from(&mut request) {
            if !deaf && simulated.request(&request[..length], from) {
                shared.requests.fetch_add(1, Ordering::Relaxed);
            }
        }
        let settings = *lock(&shared.settings);
        let step = RdtBox::step(settings.rate_hz);
        let interval = Duration::from_secs_f64(f64::from(step) / FT_RATE_HZ);
        let behind = now.saturating_duration_since(due).as_secs_f64();
        if behind > CATCH_UP_S {
            let counts = (behind * FT_RATE_HZ) as u32 / step * step;
            simulated.skip(counts);
            due += Duration::from_secs_f64(f64::from(counts) / FT_RATE_HZ);
        }
        let mut waits = false;
        while due <= now {
            // The record is late, but has the count of its time: the receiver's clock follows the
            // earliest records.
            let Some(sample) = lock(&shared.samples).at(due, now) else {
                waits = true;
                break;
            };
            let made = simulated.tick(sample, settings, |datagram, to| {
                // If the client has gone or the buffer is full, the network loses the datagram, as
                // with a real box.
                if !deaf {
                    let _ = socket.send_to(datagram, to);
                }
            });
            shared.sent.fetch_add(u64::from(made), Ordering::Relaxed);
            due += interval;
        }
        let next = if waits {
            now + LOOK
        } else if simulated.is_streaming() {
            due
        } else {
            due.max(now + IDLE)
        };
        std::thread::sleep(next.saturating_duration_since(Instant::now()).min(5 * IDLE));
    }
}
