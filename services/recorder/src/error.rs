//! Errors of a recording. Each message names the file.

use std::io;
use std::path::{Path, PathBuf};

/// A recording could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// The operating system reports an error.
    #[error("recording {path}: {source}{}", advice(source))]
    Io {
        /// File or folder.
        path: PathBuf,
        /// Error of the system.
        source: io::Error,
    },
    /// The content of the file is not valid, or it could not be written.
    #[error("recording {path}: {source}{}", mcap_advice(source))]
    Mcap {
        /// File.
        path: PathBuf,
        /// Error of the format's library.
        source: mcap::McapError,
    },
    /// A message in the file cannot be decoded as its type.
    #[error(
        "recording {path}: message {index} on {topic} cannot be decoded as {type_name}: {reason}"
    )]
    Message {
        /// File.
        path: PathBuf,
        /// Position in the file, from 0.
        index: u64,
        /// Topic.
        topic: String,
        /// Type.
        type_name: &'static str,
        /// Reason given by the decoder.
        reason: String,
    },
    /// A repair would leave less free space than must stay free.
    #[error(
        "recording {path}: not repaired: {free_mb} MB are free, the repair needs up to {needed_mb} MB, and {kept_mb} MB \
         are kept free; free some space, set [recorder] keep_bytes or keep_days, or set [recorder] folder to another \
         disk. It is repaired as soon as there is room; its complete part can be read before that"
    )]
    NoRoom {
        /// File.
        path: PathBuf,
        /// Free now.
        free_mb: u64,
        /// Needed for the repaired copy.
        needed_mb: u64,
        /// Kept free.
        kept_mb: u64,
    },
    /// A repair was stopped because the recorder ends.
    #[error("recording {path}: the repair was stopped; the next start continues it")]
    Stopped {
        /// File.
        path: PathBuf,
    },
    /// A thread could not be started.
    #[error("recorder: no thread could be started: {source}")]
    Thread {
        /// Error of the system.
        source: io::Error,
    },
    /// The bus refused a subscription.
    #[error("recorder: {0}")]
    Bus(#[from] tangent_runtime::BusError),
}

impl RecorderError {
    pub(crate) fn io(path: &Path, source: io::Error) -> Self {
        Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    pub(crate) fn mcap(path: &Path, source: mcap::McapError) -> Self {
        Self::Mcap {
            path: path.to_owned(),
            source,
        }
    }
}

fn advice(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::StorageFull => {
            "; free some space or set [recorder] folder to another disk: what has been recorded so far is kept"
        }
        io::ErrorKind::PermissionDenied => {
            "; let this user write there, or set [recorder] folder to another place"
        }
        io::ErrorKind::NotFound => "; check the path",
        _ => "",
    }
}

fn mcap_advice(error: &mcap::McapError) -> &'static str {
    match error {
        mcap::McapError::Io(e) => advice(e),
        mcap::McapError::BadMagic => {
            "; this is not an MCAP file, or it was cut before its first record"
        }
        _ => "",
    }
}
