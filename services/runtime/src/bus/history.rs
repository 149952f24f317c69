//! The last seconds of one publisher's messages, as sent, for a recorder that missed some of them.
//!
//! The publishing thread keeps them, behind the queue that the publisher fills, so that the control
//! loop has no part in it. Full blocks never change: the thread that answers questions shares them
//! without a lock.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::attachment::Attachment;

/// Time for which messages are kept.
pub(crate) const KEPT: Duration = Duration::from_secs(12);
/// Largest memory for one publisher's messages and their index, bytes.
pub(crate) const BYTES_MAX: usize = 16 << 20;
/// Size at which a block is full, bytes.
const BLOCK_BYTES: usize = 64 << 10;
/// Time after which a block is full.
const BLOCK_TIME: Duration = Duration::from_secs(1);

/// Some messages, ordered by sequence number.
#[derive(Clone, Debug, Default)]
pub(crate) struct Block {
    messages: Vec<Place>,
    bytes: Vec<u8>,
}

#[derive(Clone, Copy, Debug)]
struct Place {
    sequence: u64,
    source_time_ns: i64,
    kept: Instant,
    end: usize,
}

impl Block {
    /// Sequence number, time of publication and bytes of each message.
    pub(crate) fn messages(&self) -> impl Iterator<Item = (u64, i64, &[u8])> {
        let mut from = 0;
        self.messages.iter().map(move |place| {
            let bytes = &self.bytes[from..place.end];
            from = place.end;
            (place.sequence, place.source_time_ns, bytes)
        })
    }

    fn size(&self) -> usize {
        self.bytes.capacity() + self.messages.capacity() * size_of::<Place>()
    }
}

/// Recent messages of one publisher.
#[derive(Debug, Default)]
pub(crate) struct History {
    full: VecDeque<Arc<Block>>,
    full_bytes: usize,
    open: Block,
}

impl History {
    /// Adds a message, and drops those beyond the limits of age and size.
    pub(crate) fn keep(&mut self, attachment: &Attachment, payload: &[u8], now: Instant) {
        let since = |place: Option<&Place>| place.map(|p| now.saturating_duration_since(p.kept));
        let old = since(self.open.messages.first()).is_some_and(|age| age >= BLOCK_TIME);
        if old || self.open.bytes.len() >= BLOCK_BYTES {
            let mut block = std::mem::take(&mut self.open);
            block.bytes.shrink_to_fit();
            block.messages.shrink_to_fit();
            self.full_bytes += block.size();
            self.full.push_back(Arc::new(block));
        }
        self.open.bytes.extend_from_slice(payload);
        self.open.messages.push(Place {
            sequence: attachment.sequence,
            source_time_ns: attachment.source_time_ns,
            kept: now,
            end: self.open.bytes.len(),
        });
        while let Some(oldest) = self.full.front() {
            let old = since(oldest.messages.last()).is_some_and(|age| age > KEPT);
            if !old && self.full_bytes + self.open.size() <= BYTES_MAX {
                break;
            }
            self.full_bytes -= oldest.size();
            self.full.pop_front();
        }
        if self.open.size() > BYTES_MAX {
            self.open = Block::default();
        }
    }

    /// The blocks kept now. Copies only one block, for any number of blocks.
    pub(crate) fn blocks(&self) -> Vec<Arc<Block>> {
        let open = Arc::new(self.open.clone());
        self.full.iter().cloned().chain([open]).collect()
    }

    #[cfg(test)]
    fn size(&self) -> usize {
        self.full_bytes + self.open.size()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attachment(sequence: u64) -> Attachment {
        Attachment {
            sequence,
            source_time_ns: -(sequence as i64),
            publisher: [1; 16],
        }
    }

    fn sequences(history: &History) -> Vec<u64> {
        let blocks = history.blocks();
        let messages = blocks.iter().flat_map(|block| block.messages());
        messages.map(|(sequence, ..)| sequence).collect()
    }

    #[test]
    fn twelve_seconds_are_kept_and_hardly_more() {
        let (mut history, start) = (History::default(), Instant::now());
        for ms in 1..=30_000 {
            let payload = ms.to_string();
            let now = start + Duration::from_millis(ms);
            history.keep(&attachment(ms), payload.as_bytes(), now);
            let kept = sequences(&history).len() as u64;
            assert!(kept >= ms.min(12_000) && kept <= 13_100, "{kept} at {ms}");
        }
        for block in history.blocks() {
            for (sequence, time, bytes) in block.messages() {
                assert_eq!(bytes, sequence.to_string().as_bytes());
                assert_eq!(time, -(sequence as i64));
            }
        }
        let kept = sequences(&history);
        assert!(kept.windows(2).all(|pair| pair[1] == pair[0] + 1));
        assert_eq!(kept.last(), Some(&30_000));
    }

    #[test]
    fn large_messages_are_bounded_by_bytes() {
        let (mut history, now) = (History::default(), Instant::now());
        let large = vec![1; 3 << 20];
        for sequence in 1..=20 {
            history.keep(&attachment(sequence), &large, now);
            assert!(history.size() <= BYTES_MAX, "{}", history.size());
        }
        assert_eq!(sequences(&history).last(), Some(&20));
        history.keep(&attachment(21), &vec![1; BYTES_MAX + 1], now);
        assert!(sequences(&history).is_empty());
        history.keep(&attachment(22), b"small", now);
        assert_eq!(sequences(&history), [22]);
    }

    #[test]
    fn what_was_shared_does_not_change() {
        let (mut history, now) = (History::default(), Instant::now());
        history.keep(&attachment(1), b"one", now);
        let before = history.blocks();
        history.keep(&attachment(2), b"two", now);
        assert_eq!(before[0].messages().count(), 1);
        assert_eq!(sequences(&history), [1, 2]);
    }
}
