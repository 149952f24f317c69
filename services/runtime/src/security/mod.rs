//! Who may do what on a cell's network: certificates that say who a process is, and the router's
//! rules for each.
//!
//! An identity is a role in a cell (`controller.cell1`) or in the whole fleet (`operator`); it is
//! the common name of a certificate. [`Authority`] makes certificates, [`roles`] says what each
//! role may do, [`access`] writes that down as Zenoh's access rules, and [`Certificate`] reads a
//! file back and says what is wrong with it.

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

/// What is wrong with keys, certificates or rules, and what to do about it.
#[derive(Debug, thiserror::Error)]
pub enum SecurityError {
    /// A file is not there, or may not be read or written.
    #[error("{}: {reason}; {remedy}", .file.display())]
    File {
        /// Which one.
        file: PathBuf,
        /// What the system says.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A file holds something else than it should.
    #[error("{}: {reason}", .file.display())]
    Content {
        /// Which one.
        file: PathBuf,
        /// What is wrong with it, and what to do.
        reason: String,
    },
    /// The time of a certificate is over, or has not begun.
    #[error("{}: the certificate of `{identity}` {what}; {remedy}", .file.display())]
    Validity {
        /// Which file.
        file: PathBuf,
        /// Whose certificate.
        identity: String,
        /// For instance `expired 3 days ago`.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// A path contains `{identity}`, and this process was given no identity.
    #[error(
        "`zenoh.tls.{key}` = {value} stands for several identities: say which one with --identity (`tangent keys list` \
         shows them)"
    )]
    NoIdentity {
        /// Key in the cell file.
        key: &'static str,
        /// As it stands there.
        value: String,
    },
    /// An identity that no certificate can be made for.
    #[error("`{name}` is no identity: {allowed}")]
    Identity {
        /// As given.
        name: String,
        /// What is.
        allowed: String,
    },
    /// A certificate could not be made.
    #[error("the certificate of `{identity}` could not be made: {reason}")]
    Making {
        /// Whose.
        identity: String,
        /// What the library says.
        reason: String,
    },
}
