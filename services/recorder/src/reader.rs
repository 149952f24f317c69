//! How the readers of the MCAP library are set up: for files that may lack their end, with bounds.

use mcap::sans_io::{LinearReaderOptions, MessageReader};

/// Largest record, bytes. A longer one is damage: without a limit, a single flipped bit could
/// request all memory.
pub(crate) const RECORD_BYTES_MAX: usize = 256 << 20;

/// Options for a file that may lack its end.
pub(crate) fn reader_options() -> LinearReaderOptions {
    LinearReaderOptions::default()
        .with_skip_end_magic(true)
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(RECORD_BYTES_MAX)
}

pub(crate) fn message_reader() -> MessageReader {
    MessageReader::new_with_options(reader_options())
}
