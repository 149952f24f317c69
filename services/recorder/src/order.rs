//! The order in which a recording's messages came, or would have come: those that their publisher was asked for again
//! stand in the file behind what came meanwhile.

use std::collections::{BTreeMap, HashMap};

use crate::RecorderError;
use crate::recording::RecordedMessage;

/// A message is asked for again within this time, ns: what publishers keep, and some more.
const WINDOW_NS: u64 = 20_000_000_000;

/// Messages in order. Without any that came again, that of the file.
pub(crate) struct Ordered<I> {
    source: I,
    /// By the time at which they stand, and their number in the file.
    waiting: BTreeMap<(u64, u64), RecordedMessage>,
    taken: u64,
    newest_ns: u64,
    /// Per channel: newest sequence, and time from publication to receipt.
    channels: HashMap<(String, [u8; 16]), (u32, i128)>,
    /// The source's last word, where that is an error.
    damage: Option<RecorderError>,
    ended: bool,
}

impl<I: Iterator<Item = Result<RecordedMessage, RecorderError>>> Ordered<I> {
    pub(crate) fn new(source: I) -> Self {
        Self {
            source,
            waiting: BTreeMap::new(),
            taken: 0,
            newest_ns: 0,
            channels: HashMap::new(),
            damage: None,
            ended: false,
        }
    }

    fn take(&mut self, message: RecordedMessage) {
        let stands_ns = self.stands_ns(&message);
        self.waiting.insert((stands_ns, self.taken), message);
        self.taken += 1;
    }

    fn stands_ns(&mut self, message: &RecordedMessage) -> u64 {
        let after = i128::from(message.log_time_ns) - i128::from(message.publish_time_ns);
        let in_order = self.newest_ns.max(message.log_time_ns);
        if message.publisher != [0; 16] {
            let channel = (message.topic.clone(), message.publisher);
            let (newest, usual) = self
                .channels
                .entry(channel)
                .or_insert((message.sequence, after));
            if (message.sequence.wrapping_sub(*newest) as i32) < 0 {
                let stands = i128::from(message.publish_time_ns) + *usual;
                return u64::try_from(stands).unwrap_or(0).min(in_order);
            }
            (*newest, *usual) = (message.sequence, after);
        }
        self.newest_ns = in_order;
        in_order
    }
}

impl<I: Iterator<Item = Result<RecordedMessage, RecorderError>>> Iterator for Ordered<I> {
    type Item = Result<RecordedMessage, RecorderError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            let oldest = self.waiting.first_key_value().map(|((at, _), _)| *at);
            if oldest.is_some_and(|at| self.newest_ns - at.min(self.newest_ns) > WINDOW_NS) {
                break;
            }
            match self.source.next() {
                Some(Ok(message)) => self.take(message),
                Some(Err(error)) => {
                    self.damage = Some(error);
                    self.ended = true;
                }
                None => self.ended = true,
            }
        }
        match self.waiting.pop_first() {
            Some((_, message)) => Some(Ok(message)),
            None => self.damage.take().map(Err),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(publisher: u8, sequence: u32, log_s: u64, publish_s: u64) -> RecordedMessage {
        RecordedMessage {
            topic: "/t".to_owned(),
            type_name: String::new(),
            publisher: [publisher; 16],
            log_time_ns: log_s * 1_000_000_000,
            publish_time_ns: publish_s * 1_000_000_000,
            sequence,
            bytes: Vec::new(),
        }
    }

    fn ordered(messages: &[RecordedMessage]) -> Vec<(u8, u32)> {
        let source = messages.iter().cloned().map(Ok);
        Ordered::new(source)
            .map(|m| m.unwrap())
            .map(|m| (m.publisher[0], m.sequence))
            .collect()
    }

    #[test]
    fn without_messages_that_came_again_it_is_the_files_order() {
        // Receipt times that step back, and another host's clock, change nothing.
        let messages: Vec<_> = (0..200u32)
            .map(|i| message((i % 3) as u8, i, u64::from(1000 + (i ^ 1)), u64::from(i)))
            .collect();
        let numbers: Vec<u32> = ordered(&messages).iter().map(|m| m.1).collect();
        assert_eq!(numbers, (0..200).collect::<Vec<_>>());
    }

    #[test]
    fn what_came_again_stands_where_it_would_have_come() {
        let messages = [
            message(1, 1, 100, 50),
            message(2, 1, 101, 101),
            message(2, 2, 103, 103),
            message(1, 4, 104, 54),
            message(2, 3, 105, 105),
            // Asked for again.
            message(1, 2, 106, 52),
            message(1, 3, 106, 53),
            message(1, 5, 107, 57),
        ];
        let expected = [
            (1, 1),
            (2, 1),
            (1, 2),
            (2, 2),
            (1, 3),
            (1, 4),
            (2, 3),
            (1, 5),
        ];
        assert_eq!(ordered(&messages), expected);
    }

    #[test]
    fn damage_comes_last() {
        let lost = RecorderError::mcap("x".as_ref(), mcap::McapError::BadMagic);
        let source = [Ok(message(1, 1, 1, 1)), Ok(message(1, 2, 2, 2)), Err(lost)];
        let mut ordered = Ordered::new(source.into_iter());
        assert!(ordered.next().unwrap().is_ok() && ordered.next().unwrap().is_ok());
        assert!(ordered.next().unwrap().is_err() && ordered.next().is_none());
    }
}
