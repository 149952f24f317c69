//! Foxglove service: the topics of a cell, live, for every viewer that speaks the Foxglove
//! WebSocket protocol (Foxglove, Lichtblick).
//!
//! It forwards what the recorder writes, with the same topics, schemas and bytes, and never sends
//! anything to the cell. It reads through a bounded queue, and each viewer has one of its own, so a
//! slow viewer loses messages and delays neither a publisher nor another viewer.

mod channels;
mod config;
mod error;

use std::sync::Arc;
use std::time::{Duration, Instant};

use foxglove::websocket::{ChannelView, Client, ServerListener};
use foxglove::{ChannelId, Context, SinkId};
use tangent_runtime::ring::Ring;
use tangent_runtime::{Beat, Bus, Counter, Gauge, HealthReporter, Rate, Stop};

use channels::Channels;
pub use config::Config;
pub use error::FoxgloveError;

/// Name of the service in topics and health messages.
pub const SERVICE: &str = "foxglove";
/// Longest wait for a message.
const LOOK: Duration = Duration::from_millis(50);
/// Largest number of messages between two looks at the viewers.
const TURN: usize = 1000;
/// Longest time of one turn, on a machine under heavy load: it waits for no viewer.
const TURN_MAX: Duration = Duration::from_secs(10);
/// Largest number of new subscriptions that wait to be sent the latched messages.
const NEWCOMERS_MAX: usize = 1024;
/// Longest wait for the threads that serve the viewers to end.
const END: Duration = Duration::from_secs(1);

/// Serves viewers until `stop`. `listening` is told the port once.
///
/// # Errors
/// The address is in use, or the bus refuses a topic.
pub fn run(
    config: &Config,
    bus: &Bus,
    stop: &Stop,
    listening: impl FnOnce(u16),
) -> Result<(), FoxgloveError> {
    let health = HealthReporter::start(bus, SERVICE)?;
    // Patterns may overlap; a single subscription receives each message once.
    let pattern = match config.include.as_slice() {
        [one] => one.as_str(),
        _ => "**",
    };
    let messages = bus.subscribe_raw(pattern, config.queue)?;
    // One thread: `Channels` relies on it.
    let threads = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .thread_name("foxglove-viewer")
        .enable_all()
        .build()?;
    let context = Context::new();
    let newcomers = Arc::new(Newcomers(Ring::new(NEWCOMERS_MAX)));
    let server = context
        .websocket_server()
        .name(&config.name)
        .bind(config.address.ip().to_string(), config.address.port())
        // Viewers can only read.
        .capabilities([])
        .message_backlog_size(config.viewer_queue)
        .listener(Arc::clone(&newcomers) as _)
        .tokio_runtime(threads.handle())
        .start_blocking()
        .map_err(|error| FoxgloveError::Listen {
            address: config.address,
            reason: error.to_string(),
        })?;
    listening(server.port());
    tracing::info!("viewers: ws://{}:{}", config.address.ip(), server.port());
    let mut channels = Channels::new(&context, threads.handle(), config);
    let meters = Meters::new(&health);
    health.running();
    let beat = Beat::new(SERVICE);
    let mut said = Instant::now();
    while !stop.is_stopped() {
        beat.within(TURN_MAX);
        let first = messages.recv_timeout(LOOK);
        let more = std::iter::from_fn(|| messages.try_recv());
        for message in first.into_iter().chain(more).take(TURN) {
            if channels.forward(&message) {
                meters.messages.tick();
            }
        }
        while let Some((channel, viewer)) = newcomers.0.pop() {
            channels.send_latched(channel, viewer);
        }
        if said.elapsed() >= LOOK {
            said = Instant::now();
            meters.viewers.set(server.client_count() as f64);
            meters.waiting.set(messages.waiting() as f64);
            meters.lost.set(messages.counts().dropped);
        }
    }
    drop(beat);
    drop(server.stop());
    threads.shutdown_timeout(END);
    Ok(())
}

/// Viewers that have just subscribed to a channel.
struct Newcomers(Ring<(ChannelId, SinkId)>);

impl ServerListener for Newcomers {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        if let Some(viewer) = client.sink_id() {
            // Latched messages come again by themselves, if the queue is full.
            let _ = self.0.push((channel.id(), viewer));
        }
    }
}

struct Meters {
    messages: Rate,
    lost: Counter,
    viewers: Gauge,
    waiting: Gauge,
}

impl Meters {
    fn new(health: &HealthReporter) -> Self {
        Self {
            messages: health.rate("messages"),
            lost: health.lost(),
            viewers: health.gauge("viewers"),
            waiting: health.gauge("messages_waiting"),
        }
    }
}

#[cfg(test)]
mod tests;
