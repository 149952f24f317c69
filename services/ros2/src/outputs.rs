//! States out: messages of the cell, each published under its own name in ROS 2.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use tangent_runtime::{
    Attachment, Bus, BusError, Counter, Gauge, Rate, RawMessage, RawSubscription, Received,
    Subscription,
};
use tangent_schemas::standard::{CompressedImage, Image, JointState};
use tangent_schemas::tangent::ArmState;
use tangent_schemas::topics::{Delivery, Sources, Topic};
use tangent_schemas::{Message, cdr, topics};

use crate::config::Config;
use crate::names::{RosType, topic_of_key};
use crate::node::{Node, TopicPublisher};
use crate::one_source::{OneSource, Refusal};
use crate::troubles::Troubles;
use crate::type_hash;

/// Messages that may wait; beyond, the oldest are dropped.
const QUEUE: usize = 2048;
/// Messages taken between two checks for a stop.
const BATCH: usize = 512;
/// Topics that are published at a time.
const TOPICS_MAX: usize = 256;

/// Everything that is published.
pub struct Outputs {
    messages: RawSubscription,
    arm: Option<Joints>,
    topics: HashMap<String, Option<Shown>>,
    prefix: String,
    period: Duration,
    troubles: Troubles,
    /// Messages sent, not sent, and topics.
    pub sent: Rate,
    lost: Counter,
    count: Gauge,
    unsent: u64,
}

/// One key that is published.
struct Shown {
    type_name: String,
    publisher: TopicPublisher,
    pace: Pace,
    /// For a key that has one publisher at a time; `None` for one that may have several, such as
    /// the health of a service on two hosts.
    source: Option<OneSource>,
}

/// `joint_states`, made from the state of the arm.
struct Joints {
    states: Subscription<ArmState>,
    names: Vec<String>,
    publisher: TopicPublisher,
    pace: Pace,
    bytes: Vec<u8>,
}

/// Leaves out messages beyond a rate.
struct Pace {
    period: Duration,
    next: Option<Instant>,
}

impl Pace {
    fn new(period: Duration) -> Self {
        Self { period, next: None }
    }

    fn is_due(&mut self, at: Instant) -> bool {
        if self.period.is_zero() {
            return true;
        }
        let Some(next) = self.next else {
            self.next = Some(at + self.period);
            return true;
        };
        if at < next {
            return false;
        }
        // The schedule is kept, so that messages a little late do not lower the rate; after a
        // pause it begins anew.
        let following = next + self.period;
        self.next = Some(if at < following {
            following
        } else {
            at + self.period
        });
        true
    }
}

impl Outputs {
    /// Subscribes to the cell's topics.
    ///
    /// # Errors
    /// A pattern is not valid, or a session is closed.
    pub fn new(
        config: &Config,
        bus: &Bus,
        node: &Node,
        troubles: Troubles,
        health: &tangent_runtime::HealthReporter,
    ) -> Result<Self, BusError> {
        let period = match config.rate_max_hz {
            hz if hz > 0.0 => Duration::from_secs_f64(1.0 / hz),
            _ => Duration::ZERO,
        };
        let arm = match &config.joints {
            Some(names) => Some(Joints::new(names, &config.prefix, period, bus, node)?),
            None => None,
        };
        Ok(Self {
            messages: bus.subscribe_raw_all(&config.publish, QUEUE)?,
            arm,
            topics: HashMap::new(),
            prefix: config.prefix.clone(),
            period,
            troubles,
            sent: health.rate("sent"),
            lost: health.lost(),
            count: health.gauge("topics"),
            unsent: 0,
        })
    }

    /// Publishes what has arrived, and waits for at most `patience` for the first message.
    ///
    /// # Errors
    /// The session is closed.
    pub fn turn(&mut self, node: &Node, patience: Duration) -> Result<(), BusError> {
        let mut next = self.messages.recv_timeout(patience);
        for _ in 0..BATCH {
            let Some(message) = next else { break };
            self.pass_on(&message, node)?;
            next = self.messages.try_recv();
        }
        if let Some(joints) = &mut self.arm {
            while let Some(state) = joints.states.try_recv() {
                match joints.publish(&state) {
                    Some(true) => self.sent.tick(),
                    Some(false) => self.unsent += 1,
                    None => {}
                }
            }
        }
        let named = self.topics.values().flatten().count() + usize::from(self.arm.is_some());
        self.count.set(named as f64);
        self.lost.set(self.messages.lost() + self.unsent);
        Ok(())
    }

    fn pass_on(&mut self, message: &RawMessage, node: &Node) -> Result<(), BusError> {
        let key: &str = &message.key;
        // What is derived here must not be published twice.
        if self.arm.is_some() && key == "joint_states" {
            return Ok(());
        }
        if !self.topics.contains_key(key) {
            if self.topics.len() >= TOPICS_MAX {
                let words = format!("more than {TOPICS_MAX} topics: {key} is not published");
                self.troubles.event("topics", words);
                return Ok(());
            }
            let topic = self.declare(message, node)?;
            self.topics.insert(key.to_owned(), topic);
        }
        let Some(Some(topic)) = self.topics.get_mut(key) else {
            return Ok(());
        };
        if topic.type_name != message.type_name {
            let words = format!(
                "{key}: a message of type {} on a topic of {} is not published",
                message.type_name, topic.type_name
            );
            self.troubles.event(key, words);
            return Ok(());
        }
        let attachment = Attachment {
            sequence: message.sequence,
            source_time_ns: message.source_time_ns,
            publisher: message.publisher,
        };
        let admitted = topic.source.as_mut().map_or(Ok(()), |source| {
            source.admit(Some(attachment), message.received, message.received_ns)
        });
        match admitted {
            Ok(()) => {}
            // Matches two patterns.
            Err(Refusal::OutOfOrder) => return Ok(()),
            // It is shown all the same: nothing is done with it but looking.
            Err(Refusal::Late | Refusal::Nameless) => {}
            Err(why) => {
                self.troubles.event(key, format!("{key}: {why}"));
                return Ok(());
            }
        }
        if topic.pace.is_due(message.received) {
            if topic
                .publisher
                .publish(&message.payload, message.source_time_ns)
            {
                self.sent.tick();
            } else {
                self.unsent += 1;
            }
        }
        Ok(())
    }

    /// The publisher for a key that is new; `None` if ROS 2 cannot have it.
    fn declare(&self, message: &RawMessage, node: &Node) -> Result<Option<Shown>, BusError> {
        if [Image::NAME, CompressedImage::NAME].contains(&&*message.type_name) {
            let words = format!("{} is not published: it has images", message.key);
            self.troubles.event(&message.key, words);
            return Ok(None);
        }
        let hash = type_hash::of_message(&message.type_name);
        let of = hash.and_then(|hash| RosType::new(&message.type_name, hash));
        let name = topic_of_key(&self.prefix, &message.key);
        let (Some(of), Some(name)) = (of, name) else {
            let words = format!(
                "{} is not published: type `{}` is unknown, or the key is no name in ROS 2",
                message.key, message.type_name
            );
            self.troubles.event(&message.key, words);
            return Ok(None);
        };
        let one_at_a_time = Topic::<ArmState>::named(message.key.to_string(), Delivery::Stream)
            .sources()
            == Sources::One;
        Ok(Some(Shown {
            type_name: message.type_name.clone().into_owned(),
            publisher: node.publisher(&name, &of)?,
            pace: Pace::new(self.period),
            source: one_at_a_time.then(OneSource::default),
        }))
    }
}

impl Joints {
    fn new(
        names: &[String],
        prefix: &str,
        period: Duration,
        bus: &Bus,
        node: &Node,
    ) -> Result<Self, BusError> {
        let hash = type_hash::of_message(JointState::NAME);
        let of = hash.and_then(|hash| RosType::new(JointState::NAME, hash));
        let of = of.expect("the definition of JointState ships, and a test computes its hash");
        Ok(Self {
            states: bus.subscribe(&topics::ARM_STATE, QUEUE)?,
            names: names.to_vec(),
            publisher: node.publisher(&format!("/{prefix}/joint_states"), &of)?,
            pace: Pace::new(period),
            bytes: Vec::new(),
        })
    }

    /// Whether the message was sent; `None` if it is not due.
    fn publish(&mut self, state: &Received<ArmState>) -> Option<bool> {
        if !self.pace.is_due(state.received) {
            return None;
        }
        let arm = &state.message;
        let message = JointState {
            header: arm.header.clone(),
            name: self.names.clone(),
            position: arm.q.to_vec(),
            velocity: arm.qd.to_vec(),
            effort: Vec::new(),
        };
        cdr::encode(&message, &mut self.bytes).ok()?;
        Some(self.publisher.publish(&self.bytes, state.source_time_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pace_keeps_the_rate_and_starts_anew_after_a_pause() {
        let begin = Instant::now();
        let mut pace = Pace::new(Duration::from_millis(10));
        let due = |pace: &mut Pace, ms: u64| pace.is_due(begin + Duration::from_millis(ms));
        let taken: Vec<u64> = (0..100).filter(|ms| due(&mut pace, *ms)).collect();
        assert_eq!(taken, [0, 10, 20, 30, 40, 50, 60, 70, 80, 90]);
        let late: Vec<u64> = (501..530).filter(|ms| due(&mut pace, *ms)).collect();
        assert_eq!(late, [501, 511, 521]);
        let mut all = Pace::new(Duration::ZERO);
        assert!(due(&mut all, 0) && due(&mut all, 0));
    }
}
