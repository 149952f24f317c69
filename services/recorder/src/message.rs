//! One message, on its way into a recording and as read from one.

use mcap::Message;

use crate::publisher::of_channel;

/// One message as received from the bus.
#[derive(Clone, Copy, Debug)]
pub struct Record<'a> {
    /// Topic with its leading slash.
    pub topic: &'a str,
    /// ROS 2 message type, `PACKAGE/msg/NAME`.
    pub type_name: &'a str,
    /// Text of the `.msg` definition with its dependencies; `None` for a type this build does not
    /// know.
    pub definition: Option<&'a str>,
    /// Publisher's id; zeros if the publisher does not state it.
    pub publisher: [u8; 16],
    /// Publisher's sequence number.
    pub sequence: u32,
    /// Time of receipt by the recorder, ns since the Unix epoch.
    pub log_time_ns: u64,
    /// Time of measurement as stated by the publisher, ns since the Unix epoch.
    pub publish_time_ns: u64,
    /// CDR with its encapsulation header.
    pub bytes: &'a [u8],
}

/// One message of a recording.
#[derive(Clone, Debug)]
pub struct RecordedMessage {
    /// Topic with its leading slash.
    pub topic: String,
    /// ROS 2 message type.
    pub type_name: String,
    /// Time of receipt by the recorder, ns since the Unix epoch.
    pub log_time_ns: u64,
    /// Time of measurement, ns since the Unix epoch.
    pub publish_time_ns: u64,
    /// Publisher's id; zeros if the publisher did not state it, and in recordings of older
    /// versions.
    pub publisher: [u8; 16],
    /// Publisher's sequence number, lower 32 bits.
    pub sequence: u32,
    /// CDR.
    pub bytes: Vec<u8>,
}

impl From<Message<'_>> for RecordedMessage {
    fn from(m: Message<'_>) -> Self {
        Self {
            topic: m.channel.topic.clone(),
            type_name: m
                .channel
                .schema
                .as_ref()
                .map_or_else(String::new, |s| s.name.clone()),
            publisher: of_channel(&m.channel.metadata),
            log_time_ns: m.log_time,
            publish_time_ns: m.publish_time,
            sequence: m.sequence,
            bytes: m.data.into_owned(),
        }
    }
}
