//! `tangent keys`.

use std::path::PathBuf;

use clap::{Args, Subcommand};

/// What to do with certificates.
#[derive(Debug, Subcommand)]
pub enum KeysCommand {
    /// Make an authority, a certificate for each identity, and the router's access rules; what is
    /// there is kept.
    New(NewKeys),
    /// Lock identities out for good: the router takes them from its access rules, and their names
    /// are not given again.
    Revoke {
        /// Folder, as given to `new`.
        folder: PathBuf,
        /// Identities, as in `tangent keys list`.
        #[arg(required = true)]
        identities: Vec<String>,
    },
    /// Whose certificates are in a folder, and how long they hold.
    List {
        /// Folder, as given to `new`.
        folder: PathBuf,
    },
}

/// Options of `tangent keys new`.
#[derive(Debug, Args)]
pub struct NewKeys {
    /// Folder for all files; made when it does not exist.
    pub folder: PathBuf,
    /// Name of a cell; may be repeated. Cells that the folder has already stay.
    #[arg(long = "for", value_name = "CELL")]
    pub cells: Vec<String>,
    /// Name or address under which the router is dialled, besides localhost; may be repeated. Those
    /// it has already stay.
    #[arg(long = "host", value_name = "HOST")]
    pub hosts: Vec<String>,
    /// A host that runs estimators: an identity of its own in each cell, `estimator-NAME.CELL`,
    /// that can be revoked alone; may be repeated.
    #[arg(long = "estimator-host", value_name = "NAME")]
    pub estimator_hosts: Vec<String>,
    /// A further holder of a role, `ROLE-NAME.CELL` or `ROLE-NAME`, for instance operator-anna; may
    /// be repeated.
    #[arg(long, value_name = "IDENTITY")]
    pub also: Vec<String>,
    /// Make this identity's certificate anew, with the names that it has; may be repeated.
    #[arg(long, value_name = "NAME")]
    pub renew: Vec<String>,
    /// How long certificates hold.
    #[arg(long, default_value_t = 825, value_parser = clap::value_parser!(i64).range(1..=3650))]
    pub days: i64,
}
