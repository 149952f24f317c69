//! Simulates the clock of the host on which a process runs: the process has a bus of its own, and
//! this relay shifts the stamps of its messages. No real clock is changed.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use tangent_runtime::bus::answer::refused;
use tangent_runtime::{Bus, Handle, RawMessage, RawPublisher, RawSubscription};
use tangent_schemas::topics::queries;

use crate::error::{Context, Result};

/// Timeout of a request, longer than a tare takes.
const PATIENCE: Duration = Duration::from_secs(5);
/// Interval at which a relay checks whether it must end.
const LOOK: Duration = Duration::from_millis(20);
/// Capacity of a relay's queue, messages: more than a second of all topics.
const WAITING: usize = 1 << 13;
/// Position of the stamp in CDR: after four bytes of encapsulation come the header's seconds and
/// nanoseconds.
const STAMP: std::ops::Range<usize> = 4..12;
const NS_PER_S: i64 = 1_000_000_000;

/// A host whose clock can be set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Host {
    /// Host of netft.
    Sensor,
    /// Host of bridge and controller.
    Loop,
    /// Host of the estimator.
    Estimator,
}

impl Host {
    /// All hosts.
    pub const ALL: [Self; 3] = [Self::Sensor, Self::Loop, Self::Estimator];

    /// Process that runs on this host.
    pub fn process(self) -> &'static str {
        match self {
            Self::Sensor => "netft",
            Self::Loop => "rtde controller",
            Self::Estimator => "estimator",
        }
    }

    /// Topics published on this host, stamped by its clock.
    fn says(self) -> &'static [&'static str] {
        match self {
            Self::Sensor => &["wrench/*", "health/netft"],
            Self::Loop => &["arm/*", "control/state", "health/rtde", "health/controller"],
            Self::Estimator => &["estimate/*/normal", "health/estimator"],
        }
    }

    /// Topics subscribed to on this host.
    fn reads(self) -> &'static [&'static str] {
        match self {
            Self::Sensor => &["arm/state", "control/state"],
            Self::Loop => &["wrench/tool", "wrench/status", "estimate/*/normal"],
            Self::Estimator => &["arm/state", "wrench/tool", "wrench/status", "control/state"],
        }
    }

    /// Requests that this host answers.
    fn answers(self) -> &'static [&'static str] {
        match self {
            Self::Sensor => &[queries::NETFT_TARE],
            Self::Loop => &[
                queries::CONTROL_TASK,
                queries::CONTROL_SHOW,
                queries::CONTROL_STOP,
                tangent_rtde::queries::UNLOCK,
                tangent_rtde::queries::POWER_ON,
            ],
            Self::Estimator => &[],
        }
    }

    /// Requests that this host sends to others.
    fn asks(self) -> &'static [&'static str] {
        match self {
            Self::Loop => &[queries::NETFT_TARE],
            _ => &[],
        }
    }
}

/// Relays messages and requests between the process's own bus and the cell under test, until it is
/// dropped.
pub struct HostClock {
    ahead_ns: Arc<AtomicI64>,
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    _handles: Vec<Handle>,
}

impl HostClock {
    /// Starts the relay. `far` is the bus of the process on `host`, `near` the one under test.
    ///
    /// # Errors
    /// A bus refuses a topic.
    pub fn start(host: Host, far: &Bus, near: &Bus) -> Result<Self> {
        let ahead_ns = Arc::new(AtomicI64::new(0));
        let mut handles = Vec::new();
        for (keys, asked, answering) in [(host.answers(), far, near), (host.asks(), near, far)] {
            for key in keys {
                handles.push(pass_requests(key, asked.clone(), answering)?);
            }
        }
        let mut clock = Self {
            ahead_ns: Arc::clone(&ahead_ns),
            stop: Arc::default(),
            threads: Vec::new(),
            _handles: handles,
        };
        clock.relay(host.says(), far, near, ahead_ns)?;
        clock.relay(host.reads(), near, far, Arc::default())?;
        Ok(clock)
    }

    /// Steps the clock forward by `by_s` (s) from the next message on; backward if it is negative.
    pub fn step(&self, by_s: f64) {
        self.ahead_ns
            .fetch_add((by_s * 1e9) as i64, Ordering::AcqRel);
    }

    fn relay(
        &mut self,
        keys: &[&str],
        from: &Bus,
        to: &Bus,
        ahead_ns: Arc<AtomicI64>,
    ) -> Result<()> {
        let keys: Vec<String> = keys.iter().map(|key| (*key).to_owned()).collect();
        let messages = from.subscribe_raw_all(&keys, WAITING)?;
        let (to, stop) = (to.clone(), Arc::clone(&self.stop));
        let thread = std::thread::Builder::new()
            .name("host-clock".into())
            .spawn(move || pass_messages(&messages, &to, &ahead_ns, &stop))
            .context("a thread for a host's clock")?;
        self.threads.push(thread);
        Ok(())
    }
}

impl Drop for HostClock {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Release);
        for thread in self.threads.drain(..) {
            let _ = thread.join();
        }
    }
}

fn pass_requests(key: &str, asked: Bus, answering: &Bus) -> Result<Handle> {
    let far_key = key.to_owned();
    Ok(answering.answer_in(
        key,
        |_| tangent_runtime::Lane::Slow,
        move |request| {
            asked
                .ask(&far_key, &request.request, PATIENCE)
                .unwrap_or_else(|error| refused(error.to_string()))
                .into()
        },
    )?)
}

/// Relays messages with their publishers' identities and counters, so that the relay is invisible.
fn pass_messages(messages: &RawSubscription, to: &Bus, ahead_ns: &AtomicI64, stop: &AtomicBool) {
    // Uses a priority as high as that of the bus's own threads.
    let _ = tangent_runtime::realtime::setup_thread("host's clock", 70);
    let mut publishers: HashMap<Arc<str>, RawPublisher> = HashMap::new();
    while !stop.load(Ordering::Acquire) {
        let Some(message) = messages.recv_timeout(LOOK) else {
            continue;
        };
        if !publishers.contains_key(&message.key) {
            match to.raw_publisher(&message.key, &message.type_name) {
                Ok(publisher) => {
                    publishers.insert(Arc::clone(&message.key), publisher);
                }
                Err(error) => {
                    tracing::warn!("{}: {error}", message.key);
                    continue;
                }
            }
        }
        let bytes = moved(&message, ahead_ns.load(Ordering::Acquire));
        publishers[&message.key].publish_as(&bytes, message.publisher, message.sequence);
    }
}

/// Returns the message with its stamp shifted.
fn moved(message: &RawMessage, ahead_ns: i64) -> Vec<u8> {
    let mut bytes = message.payload.to_vec();
    if ahead_ns != 0
        && let Some(stamp) = bytes.get_mut(STAMP)
    {
        let (seconds, nanoseconds) = stamp.split_at_mut(4);
        let number = |bytes: &[u8]| u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let stamp_ns = i64::from(number(seconds).cast_signed()) * NS_PER_S
            + i64::from(number(nanoseconds))
            + ahead_ns;
        seconds.copy_from_slice(&(stamp_ns.div_euclid(NS_PER_S) as i32).to_le_bytes());
        nanoseconds.copy_from_slice(&(stamp_ns.rem_euclid(NS_PER_S) as u32).to_le_bytes());
    }
    bytes
}

#[cfg(test)]
mod tests {
    use tangent_mechanics::Tool;
    use tangent_schemas::cdr;
    use tangent_schemas::standard::{Header, WrenchStamped};

    use super::*;

    #[test]
    fn only_the_stamp_is_moved() {
        let bus = Bus::in_process("test");
        let messages = bus.subscribe_raw("wrench/tool", 4).unwrap();
        let publisher = bus
            .raw_publisher("wrench/tool", "geometry_msgs/msg/WrenchStamped")
            .unwrap();
        let mut wrench = WrenchStamped {
            header: Header::in_frame::<Tool>(1_800_000_000_900_000_000),
            ..WrenchStamped::default()
        };
        wrench.wrench.force.z = 3.0;
        let mut bytes = Vec::new();
        cdr::encode(&wrench, &mut bytes).unwrap();
        publisher.publish(&bytes);
        let message = messages.recv_timeout(PATIENCE).unwrap();
        for ahead_ns in [0, 1_200_000_000, -1_200_000_000] {
            let said: WrenchStamped = cdr::decode(&moved(&message, ahead_ns)).unwrap();
            assert_eq!(
                said.header.stamp.to_ns(),
                1_800_000_000_900_000_000 + ahead_ns
            );
            assert_eq!(said.wrench, wrench.wrench);
        }
    }
}
