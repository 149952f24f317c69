//! Access control on a cell's network: certificates that identify a process, and the router's rules
//! for each identity.
//!
//! An identity is a role in a cell (`controller.cell1`) or in the whole fleet (`operator`); it is
//! the common name of a certificate. [`Authority`] creates certificates, [`roles`] defines the
//! rights of each role, [`access`] converts them to Zenoh's access rules, and [`Certificate`] reads
//! and checks a file.

pub mod access;
mod authority;
mod certificate;
mod credentials;
mod fleet;
pub mod roles;

pub use authority::{Authority, Issued};
pub use certificate::Certificate;
pub(crate) use credentials::{Expiry, check};
pub use fleet::{Fleet, MANIFEST};

use std::path::PathBuf;

/// Errors of keys, certificates or rules, with what to do about each.
#[derive(Debug, thiserror::Error)]
pub enum SecurityError {
    /// A file does not exist, or may not be read or written.
    #[error("{}: {reason}; {remedy}", .file.display())]
    File {
        /// Path of the file.
        file: PathBuf,
        /// The system's reason.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The contents of a file are not as expected.
    #[error("{}: {reason}", .file.display())]
    Content {
        /// Path of the file.
        file: PathBuf,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// A certificate has expired, or is not valid yet.
    #[error("{}: the certificate of `{identity}` {what}; {remedy}", .file.display())]
    Validity {
        /// Path of the file.
        file: PathBuf,
        /// Identity of the certificate.
        identity: String,
        /// For instance `expired 3 days ago`.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A path contains `{identity}`, and this process has no identity.
    #[error(
        "`zenoh.tls.{key}` = {value} matches several identities: choose one with --identity (`tangent keys list` \
         shows them)"
    )]
    NoIdentity {
        /// Key in the cell file.
        key: &'static str,
        /// Value as it stands in the file.
        value: String,
    },
    /// No certificate can be created for this identity.
    #[error("`{name}` is not an identity: {allowed}")]
    Identity {
        /// Identity as given.
        name: String,
        /// What is allowed.
        allowed: String,
    },
    /// A certificate could not be created.
    #[error("the certificate of `{identity}` could not be made: {reason}")]
    Making {
        /// Identity of the certificate.
        identity: String,
        /// The library's reason.
        reason: String,
    },
}
