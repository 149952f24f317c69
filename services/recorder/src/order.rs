//! The order in which a recording's messages came, or would have come: those that their publisher was asked for again
//! stand in the file behind what came meanwhile.

use std::collections::{BTreeMap, HashMap, VecDeque};

use crate::RecorderError;
use crate::recording::RecordedMessage;

/// A message is asked for again within this time, ns: what publishers keep, and some more.
const WINDOW_NS: u64 = 20_000_000_000;

/// Messages in order. Without any that came again, that of the file.
pub(crate) struct Ordered<I> {
    source: I,
    waiting: BTreeMap<Place, RecordedMessage>,
    taken: u64,
    newest_ns: u64,
    channels: HashMap<(String, [u8; 16]), Channel>,
    /// The source's last word, where that is an error.
    damage: Option<RecorderError>,
    ended: bool,
}

/// Where a message stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    at_ns: u64,
    /// Number in the file of the message that it stands at; its own for one that came in order.
    at: u64,
    side: Side,
    sequence: u32,
    number: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Side {
    Before,
    At,
    Behind,
}

/// A publisher's messages that came in order, for those that came again between them.
struct Channel {
    newest: u32,
    /// Time from publication to receipt of the newest.
    usual_ns: i128,
    /// Sequence and place of those of the last seconds.
    places: VecDeque<(u32, Place)>,
}

impl Channel {
    /// Where a message stands that is older than the newest: where it would have come, between its neighbours.
    fn place(&self, message: &RecordedMessage, number: u64) -> Place {
        let back = |sequence: u32| self.newest.wrapping_sub(sequence);
        let wanted = back(message.sequence);
        let next = self.places.partition_point(|(s, _)| back(*s) > wanted);
        let behind = self.places.get(next).map(|(_, place)| place);
        let before = next.checked_sub(1).map(|at| &self.places[at].1);
        let at_ns = i128::from(message.publish_time_ns) + self.usual_ns;
        let at_ns = u64::try_from(at_ns).unwrap_or(0);
        let stand = |at_ns, at, side| Place {
            at_ns,
            at,
            side,
            sequence: message.sequence,
            number,
        };
        match (before, behind) {
            (Some(one), _) if at_ns <= one.at_ns => stand(one.at_ns, one.at, Side::Behind),
            (_, Some(one)) if at_ns >= one.at_ns => match before {
                Some(same) if same.at_ns == one.at_ns => stand(same.at_ns, same.at, Side::Behind),
                _ => stand(one.at_ns, one.at, Side::Before),
            },
            _ => stand(at_ns, u64::MAX, Side::At),
        }
    }
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
        let place = self.place(&message);
        self.taken += 1;
        self.waiting.insert(place, message);
    }

    fn place(&mut self, message: &RecordedMessage) -> Place {
        let in_order = Place {
            at_ns: self.newest_ns.max(message.log_time_ns),
            at: self.taken,
            side: Side::At,
            sequence: 0,
            number: self.taken,
        };
        if message.publisher != [0; 16] {
            let name = (message.topic.clone(), message.publisher);
            let channel = self.channels.entry(name).or_insert_with(|| Channel {
                newest: message.sequence,
                usual_ns: 0,
                places: VecDeque::new(),
            });
            if (message.sequence.wrapping_sub(channel.newest) as i32) < 0 {
                return channel.place(message, self.taken);
            }
            channel.newest = message.sequence;
            channel.usual_ns =
                i128::from(message.log_time_ns) - i128::from(message.publish_time_ns);
            let oldest_ns = in_order.at_ns.saturating_sub(WINDOW_NS);
            while let Some((_, place)) = channel.places.front()
                && place.at_ns < oldest_ns
            {
                channel.places.pop_front();
            }
            channel.places.push_back((message.sequence, in_order));
        }
        self.newest_ns = in_order.at_ns;
        in_order
    }
}

impl<I: Iterator<Item = Result<RecordedMessage, RecorderError>>> Iterator for Ordered<I> {
    type Item = Result<RecordedMessage, RecorderError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            let oldest = self.waiting.first_key_value().map(|(place, _)| place.at_ns);
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
    fn a_publishers_messages_stand_in_the_order_of_their_sequences() {
        // Receipt times that jitter by more than the time between two messages, at every wrap of the count.
        for base in [0, u32::MAX - 50] {
            let mut messages = Vec::new();
            for i in 0..100u64 {
                if !(20..60).contains(&i) || i % 7 == 0 {
                    let sequence = base.wrapping_add(i as u32);
                    messages.push(message(1, sequence, 100 + i / 10, 50));
                }
            }
            for i in (20..60).filter(|i| i % 7 != 0) {
                messages.push(message(1, base.wrapping_add(i), 112, 50 + u64::from(i % 3)));
            }
            let found = ordered(&messages);
            // Those of one hole may change places among themselves when their publisher's clock did.
            let holes = |s: u32| s.wrapping_sub(base) / 7;
            assert_eq!(found.len(), 100);
            assert!(found.windows(2).all(|w| holes(w[0].1) <= holes(w[1].1)));
        }
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
