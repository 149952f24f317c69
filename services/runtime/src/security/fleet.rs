//! Identities of a folder of keys, kept in it as `keys.toml`, so that later additions and renewals
//! include all of them.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::certificate::Certificate;
use super::{SecurityError, roles};

/// File name within the folder.
pub const MANIFEST: &str = "keys.toml";

/// The cells of a network and the identities that take part.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Fleet {
    /// Names of the cells.
    pub cells: Vec<String>,
    /// Names and addresses at which clients connect to the router.
    pub hosts: Vec<String>,
    /// Identities in addition to one of each role, for instance `estimator-laptop2.cell1`.
    pub also: Vec<String>,
    /// Identities that are locked out permanently; their names are not issued again.
    pub revoked: Vec<String>,
}

impl Fleet {
    /// A fleet with one identity of each role in these cells.
    pub fn of(cells: &[&str]) -> Self {
        Self {
            cells: cells.iter().map(|&cell| cell.to_owned()).collect(),
            ..Self::default()
        }
    }

    /// Reads the fleet of a folder. Without a `keys.toml`, it is derived from the certificates; it
    /// is empty if there are none.
    ///
    /// # Errors
    /// A file cannot be read, or is not a valid list.
    pub fn load(folder: &Path) -> Result<Self, SecurityError> {
        let file = folder.join(MANIFEST);
        match fs::read_to_string(&file) {
            Ok(text) => toml::from_str(&text).map_err(|error| SecurityError::Content {
                reason: error.message().to_owned(),
                file,
            }),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Self::read_back(folder),
            Err(error) => Err(SecurityError::File {
                file,
                reason: error.to_string(),
                remedy: "give this user the right to read it",
            }),
        }
    }

    /// Derives the fleet from the certificates of a folder without a list.
    fn read_back(folder: &Path) -> Result<Self, SecurityError> {
        let mut fleet = Self::default();
        let files = fs::read_dir(folder).into_iter().flatten().flatten();
        for path in files.map(|entry| entry.path()) {
            if path.extension().is_none_or(|extension| extension != "pem") {
                continue;
            }
            let certificate = Certificate::read(&path)?;
            let identity = certificate.identity;
            if identity == roles::ROUTER {
                add(&mut fleet.hosts, certificate.hosts);
            } else if let Some((role, cell)) = roles::parse(&identity) {
                add(&mut fleet.cells, cell.map(str::to_owned));
                if identity != roles::identity(role.name, cell.unwrap_or_default()) {
                    add(&mut fleet.also, [identity]);
                }
            }
        }
        fleet.cells.sort();
        Ok(fleet)
    }

    /// Adds entries that are not in the fleet yet.
    pub fn extend(&mut self, cells: &[String], hosts: &[String], also: &[String]) {
        add(&mut self.cells, cells.iter().cloned());
        add(&mut self.hosts, hosts.iter().cloned());
        add(&mut self.also, also.iter().cloned());
    }

    /// All identities that take part, the router's first; without revoked ones.
    pub fn identities(&self) -> Vec<String> {
        let mut all = roles::identities(&self.cells);
        add(&mut all, self.also.iter().cloned());
        all.retain(|identity| !self.revoked.contains(identity));
        all
    }

    /// The fleet as the text of `keys.toml`.
    pub fn text(&self) -> String {
        let list = |names: &[String]| {
            let names: Vec<String> = names.iter().map(|name| format!("{name:?}")).collect();
            format!("[{}]", names.join(", "))
        };
        format!(
            "# Identities of this folder. Written by `tangent keys`; the access rules are made from it.\n\
             cells = {}\nhosts = {}\nalso = {}\nrevoked = {}\n",
            list(&self.cells),
            list(&self.hosts),
            list(&self.also),
            list(&self.revoked),
        )
    }
}

fn add(names: &mut Vec<String>, more: impl IntoIterator<Item = String>) {
    let mut known: BTreeSet<String> = names.iter().cloned().collect();
    for name in more {
        if known.insert(name.clone()) {
            names.push(name);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::security::Authority;

    #[test]
    fn it_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(Fleet::load(folder.path()).unwrap(), Fleet::default());
        let fleet = Fleet {
            cells: vec!["a".into(), "b".into()],
            hosts: vec!["127.0.0.1".into(), "router.local".into()],
            also: vec!["estimator-x.a".into()],
            revoked: vec!["viewer".into()],
        };
        fs::write(folder.path().join(MANIFEST), fleet.text()).unwrap();
        assert_eq!(Fleet::load(folder.path()).unwrap(), fleet);
        assert!(!fleet.identities().contains(&"viewer".to_owned()));
        fs::write(folder.path().join(MANIFEST), "cell = []").unwrap();
        let said = Fleet::load(folder.path()).unwrap_err().to_string();
        assert!(
            said.contains("keys.toml") && said.contains("cell"),
            "{said}"
        );
    }

    #[test]
    fn without_a_list_the_certificates_are_used() {
        let folder = tempfile::tempdir().unwrap();
        let authority = Authority::open_or_create(folder.path()).unwrap();
        let hosts = ["localhost".to_owned(), "10.0.0.7".into(), "::1".into()];
        authority.issue("router", &hosts, 10).unwrap();
        for identity in ["robot.b", "robot.a", "operator", "estimator-x.a"] {
            authority.issue(identity, &[], 10).unwrap();
        }
        let fleet = Fleet::load(folder.path()).unwrap();
        assert_eq!(fleet.cells, ["a", "b"]);
        assert_eq!(fleet.hosts, hosts);
        assert_eq!(fleet.also, ["estimator-x.a"]);
    }
}
