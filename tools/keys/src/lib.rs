//! A folder of certificates for the network of one or more cells, with the router's access rules
//! and a cell file for each cell.
//!
//! [`new`] creates an authority, a certificate for each identity, the rules and the cell files. It
//! can be called again: existing files are kept, and cells, hosts and identities are added.
//! [`revoke`] locks identities out, [`list`] shows how long certificates are valid.
//! `docs/security.md` describes the roles and the rules; `tangent_runtime::security` creates the
//! certificates. `tangent keys` calls these functions and prints their results.

mod error;
mod folder;
mod secured;
#[cfg(test)]
mod tests;

pub use error::KeysError;
pub use folder::{Listed, Made, NewKeys, Revoked, list, new, revoke};
