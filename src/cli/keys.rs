//! `tangent keys`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// What to do with certificates.
#[derive(Debug, Subcommand)]
pub enum KeysCommand {
    /// Create an authority, a certificate for each identity, and the router's access rules;
    /// existing files are kept.
    New(NewKeys),
    /// Revoke identities permanently: they are removed from the router's access rules, and their
    /// names are not used again.
    Revoke {
        /// Folder, as given to `new`.
        folder: PathBuf,
        /// Identities, as in `tangent keys list`.
        #[arg(required = true)]
        identities: Vec<String>,
    },
    /// List the certificates in a folder, and how long each is valid.
    List {
        /// Folder, as given to `new`.
        folder: PathBuf,
    },
}

/// Options of `tangent keys new`.
#[derive(Debug, Args)]
pub struct NewKeys {
    /// Folder for all files; created if it does not exist.
    pub folder: PathBuf,
    /// Name of a cell; may be repeated. Cells that the folder already has are kept.
    #[arg(long = "for", value_name = "CELL")]
    pub cells: Vec<String>,
    /// Name or address at which clients reach the router, besides localhost; may be repeated. Those
    /// that the certificate already has are kept.
    #[arg(long = "host", value_name = "HOST")]
    pub hosts: Vec<String>,
    /// Host that runs estimators. It gets an identity of its own in each cell,
    /// `estimator-NAME.CELL`, which can be revoked separately; may be repeated.
    #[arg(long = "estimator-host", value_name = "NAME")]
    pub estimator_hosts: Vec<String>,
    /// Another holder of a role, `ROLE-NAME.CELL` or `ROLE-NAME`, for example operator-anna; may be
    /// repeated.
    #[arg(long, value_name = "IDENTITY")]
    pub also: Vec<String>,
    /// Issue a new certificate for this identity, with the same names; may be repeated.
    #[arg(long, value_name = "NAME")]
    pub renew: Vec<String>,
    /// Days for which new certificates are valid.
    #[arg(long, default_value_t = 825, value_parser = clap::value_parser!(i64).range(1..=3650))]
    pub days: i64,
}
