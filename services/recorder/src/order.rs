//! Restores the order in which a recording's messages were received, or would have been: messages
//! requested again are in the file after those received meanwhile.

use std::collections::{BTreeMap, HashMap, VecDeque};

use crate::RecorderError;
use crate::message::RecordedMessage;
use crate::packing::Unpacked;
use crate::publisher::UNKNOWN_PUBLISHER;

/// Time within which a message is requested again, ns: slightly more than publishers keep.
const WINDOW_NS: u64 = 20_000_000_000;

/// A message, by what its place in the order depends on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbered {
    /// Number of the topic and publisher, see [`Lines`]; `None` if the publisher is not known.
    pub line: Option<usize>,
    /// Whether it was in a batch: in the file, it then follows messages received after it.
    pub packed: bool,
    /// Time of receipt, ns.
    pub log_time_ns: u64,
    /// Time of measurement, ns.
    pub publish_time_ns: u64,
    /// Publisher's sequence number.
    pub sequence: u32,
}

impl Numbered {
    fn delay_ns(&self) -> i128 {
        i128::from(self.log_time_ns) - i128::from(self.publish_time_ns)
    }
}

/// Numbers for topics and their publishers.
#[derive(Default)]
pub(crate) struct Lines {
    by_publisher: HashMap<[u8; 16], Vec<(String, usize)>>,
    count: usize,
}

impl Lines {
    /// The number of a topic and publisher; `None` if the publisher is not known.
    pub fn number(&mut self, topic: &str, publisher: &[u8; 16]) -> Option<usize> {
        if *publisher == UNKNOWN_PUBLISHER {
            return None;
        }
        let topics = self.by_publisher.entry(*publisher).or_default();
        let known = topics.iter().find(|(known, _)| known == topic);
        Some(known.map(|(_, line)| *line).unwrap_or_else(|| {
            let line = self.count;
            self.count += 1;
            topics.push((topic.to_owned(), line));
            line
        }))
    }
}

/// Messages that wait for those that belong before them.
pub(crate) struct Order<T> {
    /// Messages that came in order, by far the most.
    queue: VecDeque<(Place, T)>,
    /// Messages that were requested again, or came in a batch.
    between: BTreeMap<Place, T>,
    taken: u64,
    newest_ns: u64,
    lines: Vec<Option<Line>>,
}

/// Position of a message in the order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    at_ns: u64,
    /// Number in the file of the in-order message at whose position it belongs; its own for a
    /// message in order; `u64::MAX`: none.
    at: u64,
    side: Side,
    /// Order among messages at the same position, by sequence number.
    order: u32,
    number: u64,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Side {
    Before,
    At,
    Behind,
}

/// A publisher's messages of the last seconds. A message that was requested again belongs between
/// its neighbours.
struct Line {
    /// Base from which sequence numbers are compared, so that a wrap of their 32 bits has no
    /// effect.
    base: u32,
    newest: u32,
    /// Usual time from publication to receipt, ns: follows the smallest recent one. For a message
    /// that was requested again it is longer.
    usual_ns: i128,
    /// Positions by sequence number, counted from `base`.
    places: VecDeque<(u32, Place)>,
}

/// Largest growth per message of the usual time from publication to receipt, ns.
const USUAL_GROWS_NS: i128 = 1_000_000;

impl Line {
    fn new(message: &Numbered) -> Self {
        Self {
            base: message.sequence.wrapping_sub(1 << 31),
            newest: message.sequence,
            usual_ns: message.delay_ns(),
            places: VecDeque::new(),
        }
    }

    fn is_late(&self, message: &Numbered) -> bool {
        (message.sequence.wrapping_sub(self.newest) as i32) < 0
    }

    /// When a message of a batch was received, and not before the one before it: the file has
    /// others in between.
    fn next_ns(&self, message: &Numbered) -> u64 {
        let before_ns = self.places.back().map_or(0, |(_, place)| place.at_ns);
        message.log_time_ns.max(before_ns)
    }

    /// Takes the next message in order.
    fn go_on(&mut self, message: &Numbered, place: Place) {
        self.newest = message.sequence;
        self.usual_ns = message.delay_ns().min(self.usual_ns + USUAL_GROWS_NS);
        let oldest_ns = place.at_ns.saturating_sub(WINDOW_NS);
        while let Some((_, oldest)) = self.places.front()
            && oldest.at_ns < oldest_ns
        {
            self.places.pop_front();
        }
        let order = message.sequence.wrapping_sub(self.base);
        self.places.push_back((order, place));
    }

    /// Position of a late message: between its neighbours, where it would have been received.
    fn insert(&mut self, message: &Numbered, number: u64) -> Place {
        let order = message.sequence.wrapping_sub(self.base);
        let next = self.places.partition_point(|(other, _)| *other < order);
        let neighbour = |at: Option<usize>| self.places.get(at?).map(|(_, place)| *place);
        let before = neighbour(next.checked_sub(1));
        let behind = neighbour(Some(next));
        let at_ns = i128::from(message.publish_time_ns) + self.usual_ns;
        let at_ns = u64::try_from(at_ns).unwrap_or(0);
        // Beside an in-order neighbour, or among the messages beside the same one.
        let beside = |one: Place, side| Place {
            side: if one.order == 0 { side } else { one.side },
            order,
            number,
            ..one
        };
        let place = match (before, behind) {
            (Some(one), _) if at_ns <= one.at_ns => beside(one, Side::Behind),
            (_, Some(one)) if at_ns >= one.at_ns => beside(one, Side::Before),
            _ => Place {
                at_ns,
                at: u64::MAX,
                side: Side::At,
                order,
                number,
            },
        };
        self.places.insert(next, (order, place));
        place
    }
}

impl<T> Default for Order<T> {
    fn default() -> Self {
        Self {
            queue: VecDeque::new(),
            between: BTreeMap::new(),
            taken: 0,
            newest_ns: 0,
            lines: Vec::new(),
        }
    }
}

impl<T> Order<T> {
    /// Takes the next message of the file.
    pub fn push(&mut self, message: &Numbered, content: T) {
        let place = self.place(message);
        self.taken += 1;
        match self.queue.back() {
            Some((last, _)) if *last > place => {
                self.between.insert(place, content);
            }
            _ => self.queue.push_back((place, content)),
        }
    }

    /// The oldest message, once no other one can belong before it.
    pub fn pop_settled(&mut self) -> Option<T> {
        let queued = self.queue.front().map(|(place, _)| place.at_ns);
        let between = self.between.first_key_value().map(|(place, _)| place.at_ns);
        let oldest_ns = queued.into_iter().chain(between).min()?;
        if self.newest_ns.saturating_sub(oldest_ns) > WINDOW_NS {
            self.pop()
        } else {
            None
        }
    }

    /// The oldest message.
    pub fn pop(&mut self) -> Option<T> {
        let between = self.between.first_key_value().map(|(place, _)| *place);
        match (self.queue.front(), between) {
            (Some((queued, _)), Some(between)) if between < *queued => {
                self.between.pop_first().map(|(_, content)| content)
            }
            (Some(_), _) => self.queue.pop_front().map(|(_, content)| content),
            (None, _) => self.between.pop_first().map(|(_, content)| content),
        }
    }

    fn place(&mut self, message: &Numbered) -> Place {
        let mut place = Place {
            at_ns: self.newest_ns.max(message.log_time_ns),
            at: self.taken,
            side: Side::At,
            order: 0,
            number: self.taken,
        };
        if let Some(number) = message.line {
            if self.lines.len() <= number {
                self.lines.resize_with(number + 1, || None);
            }
            let line = self.lines[number].get_or_insert_with(|| Line::new(message));
            if line.is_late(message) {
                return line.insert(message, self.taken);
            }
            if message.packed {
                place.at_ns = line.next_ns(message);
            }
            line.go_on(message, place);
        }
        self.newest_ns = self.newest_ns.max(place.at_ns);
        place
    }
}

/// Messages in order; that of the file if none was requested again.
pub(crate) struct Ordered<I> {
    source: I,
    order: Order<RecordedMessage>,
    lines: Lines,
    /// The error with which the source ended, if any.
    damage: Option<RecorderError>,
    ended: bool,
}

impl<I: Iterator<Item = Result<Unpacked, RecorderError>>> Ordered<I> {
    pub(crate) fn new(source: I) -> Self {
        Self {
            source,
            order: Order::default(),
            lines: Lines::default(),
            damage: None,
            ended: false,
        }
    }

    fn take(&mut self, Unpacked { message, packed }: Unpacked) {
        let numbered = Numbered {
            line: self.lines.number(&message.topic, &message.publisher),
            packed,
            log_time_ns: message.log_time_ns,
            publish_time_ns: message.publish_time_ns,
            sequence: message.sequence,
        };
        self.order.push(&numbered, message);
    }
}

impl<I: Iterator<Item = Result<Unpacked, RecorderError>>> Iterator for Ordered<I> {
    type Item = Result<RecordedMessage, RecorderError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            if let Some(message) = self.order.pop_settled() {
                return Some(Ok(message));
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
        match self.order.pop() {
            Some(message) => Some(Ok(message)),
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
        let source = messages.iter().cloned().map(|message| {
            Ok(Unpacked {
                message,
                packed: false,
            })
        });
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
    fn recovered_messages_are_put_back_in_their_place() {
        let messages = [
            message(1, 1, 100, 50),
            message(2, 1, 101, 101),
            message(2, 2, 103, 103),
            message(1, 4, 104, 54),
            message(2, 3, 105, 105),
            // Requested again.
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
        // Receipt times that jitter by more than the time between two messages, at every wrap of
        // the count.
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
            let orders: Vec<u32> = found.iter().map(|m| m.1.wrapping_sub(base)).collect();
            assert_eq!(orders, (0..100).collect::<Vec<_>>());
        }
    }

    #[test]
    fn messages_of_a_batch_stand_among_those_that_came_meanwhile() {
        let mut source: Vec<_> = [(2, 1, 101), (2, 2, 104), (2, 3, 107)]
            .map(|(publisher, sequence, at)| (message(publisher, sequence, at, at), false))
            .into();
        // Written behind them, and the receiver's clock was set back meanwhile.
        for (sequence, at) in [(5, 100), (6, 102), (7, 106), (8, 103), (9, 107)] {
            source.push((message(1, sequence, at, at), true));
        }
        let source = source
            .into_iter()
            .map(|(message, packed)| Ok(Unpacked { message, packed }));
        let found: Vec<_> = Ordered::new(source)
            .map(|m| m.unwrap())
            .map(|m| (m.publisher[0], m.sequence))
            .collect();
        let expected = [
            (1, 5),
            (2, 1),
            (1, 6),
            (2, 2),
            (1, 7),
            (1, 8),
            (2, 3),
            (1, 9),
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn damage_comes_last() {
        let lost = RecorderError::mcap("x".as_ref(), mcap::McapError::BadMagic);
        let source = [Ok(message(1, 1, 1, 1)), Ok(message(1, 2, 2, 2)), Err(lost)];
        let mut ordered = Ordered::new(source.into_iter().map(|read| {
            read.map(|message| Unpacked {
                message,
                packed: false,
            })
        }));
        assert!(ordered.next().unwrap().is_ok() && ordered.next().unwrap().is_ok());
        assert!(ordered.next().unwrap().is_err() && ordered.next().is_none());
    }
}
