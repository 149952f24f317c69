//! Messages that hold until the next one of their topic, such as the robot's description: every
//! file of a recording begins with the newest ones, so that it can be read without those before.

use std::collections::HashMap;

use crate::message::Record;
use crate::publisher::UNKNOWN_PUBLISHER;

/// Largest number of messages kept; further topics and publishers are not repeated.
const KEPT_MAX: usize = 64;

/// The newest message of each latched topic and publisher.
#[derive(Default)]
pub(crate) struct Latched(HashMap<(String, [u8; 16]), Kept>);

struct Kept {
    type_name: String,
    definition: Option<String>,
    sequence: u32,
    publish_time_ns: u64,
    bytes: Vec<u8>,
}

impl Latched {
    /// Keeps the message in place of an older one.
    pub(crate) fn take(&mut self, record: &Record<'_>) {
        let key = (record.topic.to_owned(), record.publisher);
        if let Some(kept) = self.0.get_mut(&key)
            && kept.type_name == record.type_name
        {
            kept.sequence = record.sequence;
            kept.publish_time_ns = record.publish_time_ns;
            if kept.bytes != record.bytes {
                kept.bytes = record.bytes.to_vec();
            }
            return;
        }
        if self.0.len() < KEPT_MAX || self.0.contains_key(&key) {
            let kept = Kept {
                type_name: record.type_name.to_owned(),
                definition: record.definition.map(str::to_owned),
                sequence: record.sequence,
                publish_time_ns: record.publish_time_ns,
                bytes: record.bytes.to_vec(),
            };
            self.0.insert(key, kept);
        }
    }

    /// The messages for the start of a file. They have channels without a publisher, so that nobody
    /// takes the repetition for a message of the publisher.
    pub(crate) fn records(&self, time_ns: u64) -> impl Iterator<Item = Record<'_>> {
        self.0.iter().map(move |((topic, _), kept)| Record {
            topic,
            type_name: &kept.type_name,
            definition: kept.definition.as_deref(),
            publisher: UNKNOWN_PUBLISHER,
            sequence: kept.sequence,
            log_time_ns: time_ns,
            publish_time_ns: kept.publish_time_ns,
            bytes: &kept.bytes,
        })
    }
}
