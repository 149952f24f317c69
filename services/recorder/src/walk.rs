//! Goes through the records of a piece of a file: where its messages are, and what it defines.

use std::ops::Range;

use mcap::McapError;
use mcap::records::op;

use crate::records::RawRecords;

/// Bytes of a message before its data: channel, sequence, and the two times.
const MESSAGE_HEADER_BYTES: usize = 22;

/// A message's place in a piece.
pub(crate) struct Found {
    pub channel: u16,
    pub sequence: u32,
    pub log_time_ns: u64,
    pub publish_time_ns: u64,
    pub data: Range<usize>,
}

/// The records of a piece.
pub(crate) struct Walked {
    pub messages: Vec<Found>,
    /// Schemas and channels: the number of messages before each, its opcode and its place.
    pub definitions: Vec<(usize, u8, Range<usize>)>,
    pub damage: Option<McapError>,
}

impl Walked {
    /// Goes through the records; `damage` is what lies behind them, if anything.
    pub fn through(plain: &[u8], damage: Option<McapError>) -> Self {
        let mut walked = Self {
            messages: Vec::new(),
            definitions: Vec::new(),
            damage,
        };
        let mut records = RawRecords::of(plain);
        while let Some(record) = records.next() {
            let end = plain.len() - records.rest().len();
            let body = end - record.body.len()..end;
            match record.opcode {
                op::MESSAGE => match found(record.body, body) {
                    Some(found) => walked.messages.push(found),
                    None => {
                        walked.damage = Some(McapError::UnexpectedEoc);
                        return walked;
                    }
                },
                op::SCHEMA | op::CHANNEL => {
                    let before = walked.messages.len();
                    walked.definitions.push((before, record.opcode, body));
                }
                _ => {}
            }
        }
        if !records.rest().is_empty() {
            walked.damage = walked.damage.or(Some(McapError::UnexpectedEoc));
        }
        walked
    }

    /// Ends before the message of this number.
    pub fn cut(&mut self, messages: usize, damage: McapError) {
        self.messages.truncate(messages);
        self.damage = Some(damage);
    }
}

fn found(body: &[u8], place: Range<usize>) -> Option<Found> {
    let (header, _) = body.split_first_chunk::<MESSAGE_HEADER_BYTES>()?;
    let (channel, rest) = header.split_first_chunk()?;
    let (sequence, rest) = rest.split_first_chunk()?;
    let (log_time, rest) = rest.split_first_chunk()?;
    let (publish_time, _) = rest.split_first_chunk()?;
    Some(Found {
        channel: u16::from_le_bytes(*channel),
        sequence: u32::from_le_bytes(*sequence),
        log_time_ns: u64::from_le_bytes(*log_time),
        publish_time_ns: u64::from_le_bytes(*publish_time),
        data: place.start + MESSAGE_HEADER_BYTES..place.end,
    })
}
