//! Result of a recording.

use std::path::PathBuf;

use crate::repair::Repair;

/// Files and message counts of a recording, returned when it ends.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Summary {
    /// Files of this run, in order.
    pub files: Vec<PathBuf>,
    /// Number of messages in the files.
    pub recorded: u64,
    /// Number of messages in the files that were lost at first and requested again from their
    /// publishers.
    pub recovered: u64,
    /// Number of messages dropped from a full queue while the disk was slow. Each is either
    /// recovered or missing.
    pub queue_dropped: u64,
    /// Number of messages that the disk refused.
    pub disk_refused: u64,
    /// Number of messages that never arrived, by their publishers' sequence numbers, although they
    /// were requested again.
    pub missing: u64,
    /// Truncated files of the folder that were repaired in the meantime.
    pub mended: Vec<Repair>,
}

impl Summary {
    /// Number of messages that should have been recorded and were not.
    pub fn lost(&self) -> u64 {
        self.disk_refused + self.missing
    }
}
