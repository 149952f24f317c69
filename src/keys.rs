//! `tangent keys`: certificates for a cell's network, and the router's access rules.

mod secured;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;
use tangent_runtime::clock;
use tangent_runtime::security::{Authority, Certificate, Fleet, MANIFEST, access, roles};

use crate::cli::{KeysCommand, NewKeys};
use crate::output::{Outcome, bad_usage, print_json};

/// The router's rules, within the folder.
const ACCESS: &str = "access.json5";
/// Under these names the router is always dialled.
const LOOPBACK: [&str; 2] = ["localhost", "127.0.0.1"];

/// Runs one of the keys commands. `cell`: the file that a new cell's file is made from.
///
/// # Errors
/// A folder that cannot be written or read, or a name that is no identity.
pub fn run(command: &KeysCommand, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    match command {
        KeysCommand::New(args) => new(args, cell, json),
        KeysCommand::Revoke { folder, identities } => revoke(folder, identities, json),
        KeysCommand::List { folder } => list(folder, json),
    }
}

#[derive(Serialize)]
struct Made {
    folder: String,
    made: Vec<String>,
    kept: Vec<String>,
    access: Option<String>,
    /// Files that `--cell` takes, one per cell.
    cells: Vec<String>,
}

/// The folder's fleet with what is asked for.
fn wanted(args: &NewKeys) -> Result<Fleet> {
    let good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    for (option, names) in [
        ("--for", &args.cells),
        ("--estimator-host", &args.estimator_hosts),
    ] {
        let bad = names
            .iter()
            .find(|name| !(1..=32).contains(&name.len()) || !name.chars().all(good));
        if let Some(bad) = bad {
            return Err(bad_usage(format!(
                "{option} {bad}: 1 to 32 letters, digits, `_` or `-`; a cell's name as in its file"
            )));
        }
    }
    let mut fleet = Fleet::load(&args.folder)?;
    let loopback = LOOPBACK.map(str::to_owned);
    fleet.extend(&args.cells, &loopback, &args.also);
    fleet.extend(&[], &args.hosts, &[]);
    if fleet.cells.is_empty() {
        return Err(bad_usage(
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
            return Err(bad_usage(format!(
                "--also {identity}: ROLE-NAME.CELL or ROLE-NAME, with a role of docs/security.md and one of the cells {}",
                fleet.cells.join(", ")
            )));
        }
    }
    let everybody = fleet.identities();
    for name in args.renew.iter().chain(&args.also) {
        if fleet.revoked.contains(name) {
            return Err(bad_usage(format!(
                "{name} is revoked: whoever has its old key would be let in again. Give its holder another name, \
                 for instance --also {}",
                another_name(name)
            )));
        }
        if !everybody.contains(name) {
            return Err(bad_usage(format!(
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

fn new(args: &NewKeys, cell: Option<&Path>, json: bool) -> Result<Outcome> {
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
    if json {
        print_json(&made)?;
    } else {
        print_words(&made);
    }
    Ok(Outcome::Done)
}

fn revoke(folder: &Path, identities: &[String], json: bool) -> Result<Outcome> {
    let mut fleet = Fleet::load(folder)?;
    let everybody = fleet.identities();
    for name in identities {
        if name == roles::ROUTER {
            return Err(bad_usage(
                "router: it holds the rules, and is not subject to them. Make a new folder of keys",
            ));
        }
        if fleet.revoked.contains(name) {
            continue;
        }
        if !everybody.contains(name) {
            return Err(bad_usage(format!(
                "{name}: {} has no such identity (`tangent keys list`)",
                folder.display()
            )));
        }
        fleet.revoked.push(name.clone());
    }
    let authority = Authority::open_or_create(folder)?;
    authority.put(MANIFEST, &fleet.text())?;
    let access = authority.put(ACCESS, &access::text(&fleet))?;
    if json {
        print_json(&serde_json::json!({ "revoked": fleet.revoked, "access": access }))?;
    } else {
        println!("revoked: {}", fleet.revoked.join(", "));
        println!(
            "it holds once the router has {}: one that runs as a process of its own takes the file within seconds, any other \
             at its next start",
            access.display()
        );
    }
    Ok(Outcome::Done)
}

fn print_words(made: &Made) {
    println!(
        "{}: made {} certificates, kept {}",
        made.folder,
        made.made.len(),
        made.kept.len()
    );
    for name in &made.made {
        println!("  {name}");
    }
    if let Some(access) = &made.access {
        println!("access rules: {access}");
    }
    for cell in &made.cells {
        println!("cell file: {cell}");
    }
    println!(
        "ca.key makes identities: keep it off the robots' machines. Each machine needs ca.pem and the .pem and .key of \
         the identities that run there"
    );
}

#[derive(Serialize)]
struct Listed {
    identity: String,
    file: String,
    days_left: i64,
    /// It is locked out.
    revoked: bool,
    problem: Option<String>,
}

fn list(folder: &Path, json: bool) -> Result<Outcome> {
    let now_s = clock::now_ns() / 1_000_000_000;
    let mut files: Vec<_> = fs::read_dir(folder)
        .with_context(|| format!("listing {}", folder.display()))?
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
    // What is locked out may expire.
    let bad = all.iter().any(|one| one.problem.is_some() && !one.revoked);
    if json {
        print_json(&serde_json::json!({ "certificates": all }))?;
    } else {
        for one in &all {
            println!(
                "{:<32} {:>5} days left  {}{}",
                one.identity,
                one.days_left,
                one.file,
                if one.revoked { "  REVOKED" } else { "" }
            );
            if let Some(problem) = &one.problem {
                println!("    {problem}");
            }
        }
    }
    Ok(if bad { Outcome::Failed } else { Outcome::Done })
}
