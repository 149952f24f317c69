//! Encoding of a recorder's questions for missed messages, and of the publishers' answers.
//!
//! A question and its answers identify messages by publisher and sequence number, so that no
//! message is sent that the recorder already has.

use super::attachment::Attachment;

/// Key for questions to the publishers of `key`; with `**`, to all publishers.
pub(crate) fn question_key(key: &str) -> String {
    format!("{PREFIX}{key}")
}

/// First part of the keys for such questions.
pub(crate) const PREFIX: &str = "history/";

/// Largest number of spans in one question.
pub const SPANS_MAX: usize = 1024;

/// A range of messages of one publisher.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Id of the publisher.
    pub publisher: [u8; 16],
    /// First sequence number.
    pub from: u64,
    /// Last sequence number, included.
    pub to: u64,
    /// Only messages published since this time, ns since the Unix epoch on the publisher's host;
    /// `i64::MIN`: all.
    pub since_ns: i64,
}

/// Selects the messages that are wanted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Question {
    /// For publishers that no span names: messages published since this time, ns since the Unix
    /// epoch; `i64::MAX`: none.
    pub others_since_ns: i64,
    /// Spans, at most [`SPANS_MAX`]; further ones are left out.
    pub spans: Vec<Span>,
}

const SPAN_LENGTH: usize = 40;

impl Question {
    /// Encodes it: i64 `others_since_ns`; for each span 16 bytes of id, u64 `from`, u64 `to`, i64
    /// `since_ns`; little-endian.
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(8 + SPAN_LENGTH * self.spans.len());
        bytes.extend(self.others_since_ns.to_le_bytes());
        for span in self.spans.iter().take(SPANS_MAX) {
            bytes.extend(span.publisher);
            bytes.extend(span.from.to_le_bytes());
            bytes.extend(span.to.to_le_bytes());
            bytes.extend(span.since_ns.to_le_bytes());
        }
        bytes
    }

    /// Decodes it; `None` if the bytes are not a question, or have too many spans.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Option<Self> {
        let (others, rest) = bytes.split_first_chunk::<8>()?;
        let spans = rest.chunks_exact(SPAN_LENGTH);
        if !spans.remainder().is_empty() || spans.len() > SPANS_MAX {
            return None;
        }
        let spans = spans.map(|span| {
            let mut reader = Reader(span);
            Some(Span {
                publisher: reader.take()?,
                from: u64::from_le_bytes(reader.take()?),
                to: u64::from_le_bytes(reader.take()?),
                since_ns: i64::from_le_bytes(reader.take()?),
            })
        });
        Some(Self {
            others_since_ns: i64::from_le_bytes(*others),
            spans: spans.collect::<Option<_>>()?,
        })
    }

    /// The part that concerns one publisher; `None` if nothing of that publisher is wanted.
    pub(crate) fn of(&self, publisher: [u8; 16]) -> Option<Vec<Span>> {
        let named = self.spans.iter().filter(|s| s.publisher == publisher);
        let mut spans: Vec<Span> = named.copied().collect();
        if spans.is_empty() && self.others_since_ns < i64::MAX {
            spans.push(Span {
                publisher,
                from: 0,
                to: u64::MAX,
                since_ns: self.others_since_ns,
            });
        }
        (!spans.is_empty()).then_some(spans)
    }
}

impl Span {
    /// Whether the span contains this message.
    pub(crate) fn holds(&self, sequence: u64, source_time_ns: i64) -> bool {
        (self.from..=self.to).contains(&sequence) && source_time_ns >= self.since_ns
    }
}

struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (taken, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*taken)
    }
}

/// One of several answers: messages of one publisher, ordered by sequence number.
///
/// Layout: 16 bytes of id; u8 length and text of the type's name; for each message i64 sequence
/// number, i64 time of publication, u32 length and the bytes; little-endian.
pub(crate) struct Batch {
    bytes: Vec<u8>,
    header: usize,
}

/// A decoded batch.
pub(crate) struct Said<'a> {
    pub type_name: String,
    pub messages: Vec<(Attachment, &'a [u8])>,
}

impl Batch {
    pub(crate) fn new(publisher: [u8; 16], type_name: &str) -> Self {
        let name = &type_name.as_bytes()[..type_name.len().min(255)];
        let mut bytes = publisher.to_vec();
        bytes.push(name.len() as u8);
        bytes.extend(name);
        Self {
            header: bytes.len(),
            bytes,
        }
    }

    pub(crate) fn push(&mut self, sequence: u64, source_time_ns: i64, payload: &[u8]) {
        self.bytes.extend(sequence.to_le_bytes());
        self.bytes.extend(source_time_ns.to_le_bytes());
        self.bytes.extend((payload.len() as u32).to_le_bytes());
        self.bytes.extend(payload);
    }

    pub(crate) fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.bytes.len() == self.header
    }

    /// Removes all messages.
    pub(crate) fn clear(&mut self) {
        self.bytes.truncate(self.header);
    }

    /// Decodes a batch; `None` if the bytes are not one.
    pub(crate) fn read(bytes: &[u8]) -> Option<Said<'_>> {
        let mut reader = Reader(bytes);
        let publisher = reader.take::<16>()?;
        let [length] = reader.take::<1>()?;
        let (name, rest) = reader.0.split_at_checked(usize::from(length))?;
        reader.0 = rest;
        let mut messages = Vec::new();
        while !reader.0.is_empty() {
            // A sequence number is never negative, here or in an attachment.
            let sequence = u64::try_from(i64::from_le_bytes(reader.take()?)).ok()?;
            let attachment = Attachment {
                sequence,
                source_time_ns: i64::from_le_bytes(reader.take()?),
                publisher,
            };
            let length = u32::from_le_bytes(reader.take()?) as usize;
            let (payload, rest) = reader.0.split_at_checked(length)?;
            reader.0 = rest;
            messages.push((attachment, payload));
        }
        Some(Said {
            type_name: String::from_utf8(name.to_vec()).ok()?,
            messages,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn question() -> Question {
        Question {
            others_since_ns: -5,
            spans: vec![
                Span {
                    publisher: [7; 16],
                    from: 3,
                    to: u64::MAX,
                    since_ns: i64::MIN,
                };
                2
            ],
        }
    }

    #[test]
    fn a_question_comes_through_and_anything_else_is_none() {
        let bytes = question().to_bytes();
        assert_eq!(Question::from_bytes(&bytes), Some(question()));
        for length in 0..bytes.len() {
            let whole = length == 8 || length == 8 + SPAN_LENGTH;
            assert_eq!(Question::from_bytes(&bytes[..length]).is_some(), whole);
        }
        let endless = vec![0; 8 + (SPANS_MAX + 1) * SPAN_LENGTH];
        assert_eq!(Question::from_bytes(&endless), None);
    }

    #[test]
    fn a_publisher_that_is_not_named_answers_from_a_time_on() {
        let mut question = question();
        assert_eq!(question.of([7; 16]).unwrap().len(), 2);
        let others = question.of([8; 16]).unwrap()[0];
        assert!(others.holds(1, -5) && !others.holds(1, -6));
        question.others_since_ns = i64::MAX;
        assert_eq!(question.of([8; 16]), None);
    }

    #[test]
    fn a_batch_comes_through_and_a_torn_one_is_none() {
        let mut batch = Batch::new([9; 16], "a/msg/B");
        assert!(batch.is_empty());
        batch.push(4, -1, &[1, 2, 3]);
        batch.push(5, 6, &[]);
        let said = Batch::read(batch.bytes()).unwrap();
        assert_eq!(said.type_name, "a/msg/B");
        let read: Vec<_> = said
            .messages
            .iter()
            .map(|(a, payload)| (a.publisher, a.sequence, a.source_time_ns, *payload))
            .collect();
        let expected: [(_, _, _, &[u8]); 2] = [([9; 16], 4, -1, &[1, 2, 3]), ([9; 16], 5, 6, &[])];
        assert_eq!(read, expected);
        let header = 16 + 1 + 7;
        for length in 0..batch.bytes().len() {
            let whole = length == header || length == header + 23;
            assert_eq!(Batch::read(&batch.bytes()[..length]).is_some(), whole);
        }
        batch.clear();
        assert!(batch.is_empty());
    }
}
