//! Errors of creating or reading keys.

use std::io;
use std::path::PathBuf;

use tangent_runtime::security::SecurityError;

/// A folder of keys cannot be used as asked.
#[derive(Debug, thiserror::Error)]
pub enum KeysError {
    /// The user has to change the command: what is wrong, and what is allowed.
    #[error("{0}")]
    Usage(String),
    /// The folder cannot be listed.
    #[error("listing {folder}")]
    List {
        /// The folder.
        folder: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The cell file to start from cannot be read.
    #[error("reading {path}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// A certificate, a key or a list of identities is invalid.
    #[error(transparent)]
    Security(#[from] SecurityError),
}

impl KeysError {
    pub(crate) fn usage(words: impl std::fmt::Display) -> Self {
        Self::Usage(words.to_string())
    }
}
