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

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use crate::{Disk, RecordedMessage, RecorderConfig, Recording};

    use super::*;

    fn record(topic: &'static str, sequence: u32, bytes: &'static [u8]) -> Record<'static> {
        Record {
            topic,
            type_name: "std_msgs/msg/String",
            definition: Some("string data\n"),
            publisher: [7; 16],
            sequence,
            log_time_ns: 1_000_000_000 + u64::from(sequence),
            publish_time_ns: 500 + u64::from(sequence),
            bytes,
        }
    }

    #[test]
    fn every_file_begins_with_what_holds() {
        let folder = tempfile::tempdir().unwrap();
        let mut disk = Disk::open(RecorderConfig {
            folder: folder.path().to_owned(),
            free_min_bytes: 0,
            rotate_after: Duration::from_secs(1),
            flush_every: Duration::ZERO,
            ..RecorderConfig::default()
        })
        .unwrap();
        let start = Instant::now();
        for (sequence, bytes) in [(1, &[0, 1, 0, 0, 1][..]), (2, &[0, 1, 0, 0, 2])] {
            let described = record("/robot_description", sequence, bytes);
            disk.take(&described, start);
            disk.latch(&described);
        }
        for sequence in 0..30 {
            let now = start + Duration::from_millis(100) * sequence;
            disk.take(&record("/arm/state", sequence, &[0, 1, 0, 0]), now);
            disk.tend(now);
        }
        let (files, written, _) = disk.finish(start + Duration::from_secs(3));
        assert!(files.len() >= 3, "{}", files.len());
        assert_eq!(written, 32, "a repetition is no message of its own");
        for (number, file) in files.iter().enumerate() {
            let recording = Recording::open(file).unwrap();
            let messages: Vec<RecordedMessage> = recording.messages().collect();
            let described = |m: &&RecordedMessage| m.topic == "/robot_description";
            let described: Vec<_> = messages.iter().filter(described).collect();
            if number == 0 {
                assert_eq!(described.len(), 2);
                continue;
            }
            assert_eq!(messages[0].topic, "/robot_description");
            assert_eq!(described.len(), 1);
            assert_eq!(described[0].bytes, [0, 1, 0, 0, 2], "the newest");
            assert_eq!(described[0].publisher, UNKNOWN_PUBLISHER);
            assert_eq!(described[0].publish_time_ns, 502);
            assert!(described[0].log_time_ns <= messages[1].log_time_ns);
        }
    }

    #[test]
    fn invented_topics_take_no_memory_without_end() {
        let mut latched = Latched::default();
        for publisher in 0..200 {
            let mut one = record("/tf_static", 1, &[0]);
            one.publisher = [publisher; 16];
            latched.take(&one);
            latched.take(&one);
        }
        assert_eq!(latched.records(0).count(), KEPT_MAX);
    }
}
