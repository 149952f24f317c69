//! Which block of a layer goes out next: a changed one, else each in turn, so that a viewer that
//! comes late, or jumps in a recording, sees all of them after a while.

use std::collections::BTreeSet;
use std::time::{Duration, Instant};

/// Number of points in a block, which is one marker.
pub const BLOCK: usize = 256;
/// Largest number of points of a layer.
pub const POINTS_MAX: usize = 16 * BLOCK;
/// Shortest interval between two blocks with changes.
const CHANGED: Duration = Duration::from_secs(1);
/// Interval between two blocks without changes.
const AGAIN: Duration = Duration::from_secs(2);

/// Order in which the blocks of a layer are published.
#[derive(Debug, Default)]
pub struct Blocks {
    changed: BTreeSet<usize>,
    /// Blocks that viewers still show and that no longer exist.
    gone: BTreeSet<usize>,
    sent: Option<Instant>,
    /// The block that was sent last without a change.
    turn: usize,
}

impl Blocks {
    /// The block has changed, or is new.
    pub fn change(&mut self, block: usize) {
        self.changed.insert(block);
    }

    /// The block no longer exists.
    pub fn remove(&mut self, block: usize) {
        self.changed.remove(&block);
        self.gone.insert(block);
    }

    /// Blocks that viewers must remove before they take new ones.
    pub fn gone(&mut self) -> BTreeSet<usize> {
        std::mem::take(&mut self.gone)
    }

    /// The block of `first..end` to publish now, if any.
    pub fn next(&mut self, now: Instant, first: usize, end: usize) -> Option<usize> {
        let waited = |least| self.sent.is_none_or(|sent| now >= sent + least);
        if first >= end || !waited(CHANGED) {
            return None;
        }
        let block = match self.changed.pop_first() {
            Some(changed) => changed,
            None if waited(AGAIN) => {
                let next = self.turn + 1;
                self.turn = if (first..end).contains(&next) {
                    next
                } else {
                    first
                };
                self.turn
            }
            None => return None,
        };
        self.sent = Some(now);
        (first..end).contains(&block).then_some(block)
    }
}
