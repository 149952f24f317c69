//! The folder of keys: its contents, new certificates, revocation.

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tangent_runtime::clock;
use tangent_runtime::security::{Authority, Certificate, Fleet, MANIFEST, access, roles};

use crate::error::KeysError;
use crate::secured;

/// File of the router's access rules, in the folder.
pub(crate) const ACCESS: &str = "access.json5";
/// Host names that every router certificate contains.
const LOOPBACK: [&str; 2] = ["localhost", "127.0.0.1"];

/// Requested contents of a folder of keys.
#[derive(Clone, Debug)]
pub struct NewKeys {
    /// The folder; it is created if it does not exist.
    pub folder: PathBuf,
    /// Names of cells to add to those that the folder has.
    pub cells: Vec<String>,
    /// Names or addresses of the router to add to localhost and those that the folder has.
    pub hosts: Vec<String>,
    /// Hosts that run estimators, each with an identity of its own in each cell.
    pub estimator_hosts: Vec<String>,
    /// Further holders of a role, `ROLE-NAME.CELL` or `ROLE-NAME`.
    pub also: Vec<String>,
    /// Identities whose certificates are created anew.
    pub renew: Vec<String>,
    /// Validity of certificates, days.
    pub days: i64,
}

/// Result of [`new`].
#[derive(Clone, Debug, Serialize)]
pub struct Made {
    /// The folder.
    pub folder: String,
    /// Identities with a new certificate.
    pub made: Vec<String>,
    /// Identities whose certificate already existed.
    pub kept: Vec<String>,
    /// The router's access rules.
    pub access: Option<String>,
    /// Files for `--cell`, one per cell.
    pub cells: Vec<String>,
}

/// Result of [`revoke`].
#[derive(Clone, Debug, Serialize)]
pub struct Revoked {
    /// The router's access rules.
    pub access: PathBuf,
    /// All revoked identities, including those of earlier calls.
    pub revoked: Vec<String>,
}

/// One certificate.
#[derive(Clone, Debug, Serialize)]
pub struct Listed {
    /// Identity in the certificate.
    pub identity: String,
    /// Its file.
    pub file: String,
    /// Remaining validity, days.
    pub days_left: i64,
    /// Whether it is revoked.
    pub revoked: bool,
    /// Reason why it is not valid now.
    pub problem: Option<String>,
}

/// The fleet of the folder, extended by the requested contents.
fn wanted(args: &NewKeys) -> Result<Fleet, KeysError> {
    let good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    for (option, names) in [
        ("--for", &args.cells),
        ("--estimator-host", &args.estimator_hosts),
    ] {
        let bad = names
            .iter()
            .find(|name| !(1..=32).contains(&name.len()) || !name.chars().all(good));
        if let Some(bad) = bad {
            return Err(KeysError::usage(format!(
                "{option} {bad}: 1 to 32 letters, digits, `_` or `-`; a cell's name as in its file"
            )));
        }
    }
    let mut fleet = Fleet::load(&args.folder)?;
    let loopback = LOOPBACK.map(str::to_owned);
    fleet.extend(&args.cells, &loopback, &args.also);
    fleet.extend(&[], &args.hosts, &[]);
    if fleet.cells.is_empty() {
        return Err(KeysError::usage(
            "name a cell: --for CELL, as in its file (cell.name)",
        ));
    }
    for host in &args.estimator_hosts {
        let guests: Vec<String> = fleet
            .cells
            .iter()
            .map(|cell| format!("estimator-{host}.{cell}"))
            .collect();
        fleet.extend(&[], &[], &guests);
    }
    for identity in &args.also {
        let known = roles::parse(identity)
            .is_some_and(|(_, cell)| cell.is_none_or(|cell| fleet.cells.iter().any(|c| c == cell)));
        if !known {
            return Err(KeysError::usage(format!(
                "--also {identity}: ROLE-NAME.CELL or ROLE-NAME, with a role of docs/security.md and one of the cells {}",
                fleet.cells.join(", ")
            )));
        }
    }
    let known = fleet.identities();
    for name in args.renew.iter().chain(&args.also) {
        if fleet.revoked.contains(name) {
            return Err(KeysError::usage(format!(
                "{name} is revoked: a holder of its old key would be admitted again. Give its holder another name, \
                 for instance --also {}",
                another_name(name)
            )));
        }
        if !known.contains(name) {
            return Err(KeysError::usage(format!(
                "--renew {name}: this folder has no such identity (`tangent keys list`); --also adds one"
            )));
        }
    }
    Ok(fleet)
}

/// `estimator-lab.cell1` becomes `estimator-lab2.cell1`.
fn another_name(name: &str) -> String {
    let (words, cell) = match name.split_once('.') {
        Some((words, cell)) => (words, format!(".{cell}")),
        None => (name, String::new()),
    };
    let joint = if words.contains('-') { "" } else { "-" };
    format!("{words}{joint}2{cell}")
}

/// Creates the requested contents that do not exist yet. `cell` is the file from which a new cell's
/// file is made.
///
/// # Errors
/// The folder cannot be written or read, or a name is not an identity.
pub fn new(args: &NewKeys, cell: Option<&Path>) -> Result<Made, KeysError> {
    let fleet = wanted(args)?;
    let authority = Authority::open_or_create(&args.folder)?;
    let mut made = Made {
        folder: args.folder.display().to_string(),
        made: Vec::new(),
        kept: Vec::new(),
        access: None,
        cells: Vec::new(),
    };
    for name in fleet.identities() {
        let files = authority.files(&name);
        let router = name == roles::ROUTER;
        let there = files.certificate.exists() && files.key.exists();
        if there && !args.renew.contains(&name) {
            let lacks = |certificate: Certificate| {
                let lacking = fleet
                    .hosts
                    .iter()
                    .any(|host| !certificate.hosts.contains(host));
                router && lacking
            };
            if !lacks(Certificate::read(&files.certificate)?) {
                made.kept.push(name);
                continue;
            }
        }
        let dialled = if router { &fleet.hosts[..] } else { &[] };
        authority.issue(&name, dialled, args.days)?;
        made.made.push(name);
    }
    authority.put(MANIFEST, &fleet.text())?;
    let access = authority.put(ACCESS, &access::text(&fleet))?;
    made.access = Some(access.display().to_string());
    for name in &fleet.cells {
        let file = args.folder.join(format!("{name}.toml"));
        if !file.exists() {
            let text = secured::cell_file(cell, name, &fleet.hosts)?;
            authority.put(&format!("{name}.toml"), &text)?;
        }
        made.cells.push(file.display().to_string());
    }
    Ok(made)
}

/// Removes identities from the access rules permanently.
///
/// # Errors
/// The folder cannot be written or read, or does not have a name.
pub fn revoke(folder: &Path, identities: &[String]) -> Result<Revoked, KeysError> {
    let mut fleet = Fleet::load(folder)?;
    let known = fleet.identities();
    for name in identities {
        if name == roles::ROUTER {
            return Err(KeysError::usage(
                "router: it applies the rules and is not subject to them. Make a new folder of keys",
            ));
        }
        if fleet.revoked.contains(name) {
            continue;
        }
        if !known.contains(name) {
            return Err(KeysError::usage(format!(
                "{name}: {} has no such identity (`tangent keys list`)",
                folder.display()
            )));
        }
        fleet.revoked.push(name.clone());
    }
    let authority = Authority::open_or_create(folder)?;
    authority.put(MANIFEST, &fleet.text())?;
    let access = authority.put(ACCESS, &access::text(&fleet))?;
    Ok(Revoked {
        access,
        revoked: fleet.revoked,
    })
}

/// Lists the certificates in the folder, by file name.
///
/// # Errors
/// The folder cannot be listed, or a file is not a certificate.
pub fn list(folder: &Path) -> Result<Vec<Listed>, KeysError> {
    let now_s = clock::now_ns() / 1_000_000_000;
    let mut files: Vec<_> = fs::read_dir(folder)
        .map_err(|source| KeysError::List {
            folder: folder.to_owned(),
            source,
        })?
        .flatten()
        .map(|entry| entry.path())
        .filter(|path| path.extension().is_some_and(|e| e == "pem"))
        .collect();
    files.sort();
    let fleet = Fleet::load(folder)?;
    let mut all = Vec::new();
    for file in files {
        let certificate = Certificate::read(&file)?;
        all.push(Listed {
            problem: certificate.check_time(now_s).err().map(|e| e.to_string()),
            days_left: certificate.days_left(now_s),
            revoked: fleet.revoked.contains(&certificate.identity),
            identity: certificate.identity,
            file: file.display().to_string(),
        });
    }
    Ok(all)
}
