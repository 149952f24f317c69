//! Faults between the box and its client.

use std::time::Duration;

/// One fault, active from the next record on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NetbFault {
    /// The box sends the next records, but they never arrive; their number.
    Drop(u32),
    /// The next datagrams arrive twice; their number.
    Duplicate(u32),
    /// The next datagram arrives after the one that follows it.
    Reorder,
    /// The next datagrams are each preceded by a truncated copy; their number.
    Corrupt(u32),
    /// The box loses power for this time: it counts from zero, and forgets client and software
    /// bias.
    Restart(Duration),
    /// The box neither receives nor sends for this time; its clock runs on.
    Silence(Duration),
    /// Another client takes the stream away.
    ForgetClient,
    /// The next records report saturation, with plausible but wrong counts; their number.
    Saturate(u32),
    /// The next records have this status word.
    Status {
        /// The status word.
        word: u32,
        /// Number of records.
        records: u32,
    },
    /// Every record repeats the last one before the fault, with its own sequence (true); or the
    /// fault ends.
    Freeze(bool),
    /// One axis keeps its value, 0 Fx to 5 Tz; `None`: the fault ends.
    StickAxis(Option<usize>),
    /// Some records are well-formed and wrong, by up to half of the integer range; 0: the fault
    /// ends.
    Implausible {
        /// One of this many records.
        one_of: u32,
    },
}
