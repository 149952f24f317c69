//! What can go wrong on the way from a box.

use std::time::Duration;

/// One fault, in force from the next record on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NetbFault {
    /// The next so many records are sent by the box and never arrive.
    Drop(u32),
    /// The next so many datagrams arrive twice.
    Duplicate(u32),
    /// The next datagram arrives after the one that follows it.
    Reorder,
    /// The next so many datagrams are each preceded by a damaged copy, cut short.
    Corrupt(u32),
    /// Power lost for so long: counts from zero, forgets client and software bias.
    Restart(Duration),
    /// Neither hears nor speaks for so long; its clock runs on.
    Silence(Duration),
    /// Another client takes the stream away.
    ForgetClient,
    /// The next so many records say saturation, with plausible and wrong counts.
    Saturate(u32),
    /// The next so many records carry this status word.
    Status {
        /// The word.
        word: u32,
        /// How many records.
        records: u32,
    },
    /// Every record says what the last one before says, with its own sequence (true), or lives
    /// again.
    Freeze(bool),
    /// One axis stands still, 0 Fx to 5 Tz; none: all live again.
    StickAxis(Option<usize>),
    /// One of so many records is well-formed and wrong, by up to half of its integers; 0: none.
    Implausible {
        /// One of so many.
        one_of: u32,
    },
}
