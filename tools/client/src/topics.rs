//! What is published on a cell's bus: the topics, their rates, and their messages as JSON.

mod decode;
mod rate;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use serde::Serialize;
use tangent_mechanics::names::did_you_mean;
use tangent_runtime::bus::RawSubscription;
use tangent_runtime::{Bus, Stop};

pub use decode::{Decoded, decode};
pub use rate::{Rate, RateMeter};

use crate::error::ClientError;

/// Messages that may wait to be read: about a second of everything that a cell publishes.
const QUEUE: usize = 32_768;
/// Longest time between two looks at `stop`.
const LOOK: Duration = Duration::from_millis(100);
/// Time to look for the topics that exist, if the one that was asked for is silent.
const SEARCH: Duration = Duration::from_millis(1500);

/// One topic, as observed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TopicSeen {
    /// Key, relative to the cell.
    pub topic: String,
    /// `PACKAGE/msg/NAME`; empty if the publisher does not state it.
    pub r#type: String,
    /// Number of publishers.
    pub publishers: usize,
    /// Messages a second.
    pub rate_hz: f64,
    /// Payload, bytes a second.
    pub bytes_per_s: f64,
}

/// Subscribes to one topic, to be read by [`RawSubscription::recv_timeout`].
///
/// # Errors
/// The key is not valid, or the bus refuses.
pub fn subscribe(bus: &Bus, key: &str) -> Result<RawSubscription, ClientError> {
    Ok(bus.subscribe_raw(key, QUEUE)?)
}

/// All topics on which something is published within `time` of the first message, sorted. Without
/// any message, it ends after `time`. Ends early at `stop`.
///
/// # Errors
/// The bus refuses.
pub fn list(bus: &Bus, time: Duration, stop: &Stop) -> Result<Vec<TopicSeen>, ClientError> {
    struct Sum {
        type_name: String,
        publishers: Vec<[u8; 16]>,
        messages: u64,
        bytes: u64,
    }
    let all = subscribe(bus, "**")?;
    let mut began = Instant::now();
    let mut seen: BTreeMap<String, Sum> = BTreeMap::new();
    while !stop.is_stopped() {
        let left = time.saturating_sub(began.elapsed());
        if left.is_zero() {
            break;
        }
        let Some(message) = all.recv_timeout(left.min(LOOK)) else {
            continue;
        };
        if seen.is_empty() {
            // Until the router knows of the subscription, nothing arrives: up to a second.
            began = message.received;
        }
        let sum = seen.entry(message.key.to_string()).or_insert_with(|| Sum {
            type_name: message.type_name.to_string(),
            publishers: Vec::new(),
            messages: 0,
            bytes: 0,
        });
        if !sum.publishers.contains(&message.publisher) {
            sum.publishers.push(message.publisher);
        }
        sum.messages += 1;
        sum.bytes += message.payload.len() as u64;
    }
    let seconds = began.elapsed().as_secs_f64().max(1e-3);
    Ok(seen
        .into_iter()
        .map(|(topic, sum)| TopicSeen {
            topic,
            r#type: sum.type_name,
            publishers: sum.publishers.len(),
            rate_hz: sum.messages as f64 / seconds,
            bytes_per_s: sum.bytes as f64 / seconds,
        })
        .collect())
}

/// The error for a topic without messages: names the nearest one, and all others.
///
/// # Errors
/// The bus refuses.
pub fn silent(bus: &Bus, key: &str, waited: Duration) -> Result<ClientError, ClientError> {
    let known = list(bus, SEARCH, &Stop::new())?;
    let names: Vec<&str> = known.iter().map(|seen| seen.topic.as_str()).collect();
    Ok(ClientError::Silent {
        topic: key.to_owned(),
        waited_s: waited.as_secs_f64(),
        suggestion: did_you_mean(key, names.iter().copied()),
        known: if names.is_empty() {
            "no topic of this cell has messages".to_owned()
        } else {
            format!("there are: {}", names.join(", "))
        },
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_schemas::tangent::{ArmState, Health};
    use tangent_schemas::topics;

    #[test]
    fn topics_are_listed_with_type_rate_and_publishers() {
        let bus = Bus::in_process("test");
        let arm = bus.publisher(&topics::ARM_STATE).unwrap();
        let health = bus.publisher(&topics::health("rtde")).unwrap();
        let listing = {
            let bus = bus.clone();
            let time = Duration::from_millis(500);
            std::thread::spawn(move || list(&bus, time, &Stop::new()).unwrap())
        };
        while !listing.is_finished() {
            for _ in 0..9 {
                arm.publish(&ArmState::default());
            }
            health.publish(&Health::default());
            std::thread::yield_now();
        }
        let seen = listing.join().unwrap();
        let names: Vec<&str> = seen.iter().map(|seen| seen.topic.as_str()).collect();
        assert_eq!(names, ["arm/state", "health/rtde"]);
        assert_eq!(seen[0].r#type, "tangent_msgs/msg/ArmState");
        assert_eq!(seen[0].publishers, 1);
        assert!(seen[0].rate_hz > seen[1].rate_hz && seen[0].bytes_per_s > 0.0);
    }

    /// What arrives late because the subscription took its time has its full rate.
    #[test]
    fn the_rate_counts_from_the_first_message() {
        let bus = Bus::in_process("test");
        let arm = bus.publisher(&topics::ARM_STATE).unwrap();
        let listing = {
            let bus = bus.clone();
            let time = Duration::from_millis(500);
            std::thread::spawn(move || list(&bus, time, &Stop::new()).unwrap())
        };
        std::thread::sleep(Duration::from_millis(400));
        let (began, mut sent) = (Instant::now(), 0_u32);
        while !listing.is_finished() {
            arm.publish(&ArmState::default());
            sent += 1;
            std::thread::sleep(Duration::from_millis(2));
        }
        let rate_hz = f64::from(sent) / began.elapsed().as_secs_f64();
        let seen = listing.join().unwrap();
        let found = seen[0].rate_hz / rate_hz;
        assert!((0.7..1.4).contains(&found), "{found} of {rate_hz} Hz");
    }

    #[test]
    fn a_silent_topic_is_answered_with_the_nearest_one() {
        let bus = Bus::in_process("test");
        let arm = bus.publisher(&topics::ARM_STATE).unwrap();
        let asking = bus.clone();
        let asked = std::thread::spawn(move || {
            silent(&asking, "arm/stat", Duration::from_secs(3)).map(|e| e.to_string())
        });
        while !asked.is_finished() {
            arm.publish(&ArmState::default());
            std::thread::yield_now();
        }
        let said = asked.join().unwrap().unwrap();
        for word in ["arm/stat`", "did you mean `arm/state`?", "there are"] {
            assert!(said.contains(word), "{said}");
        }
    }
}
