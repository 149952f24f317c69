//! `tangent keys`: certificates for a cell's network, and the router's access rules.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;
use tangent_runtime::clock;
use tangent_runtime::security::{Authority, Certificate, access, roles};

use crate::cli::{KeysCommand, NewKeys};
use crate::output::{Outcome, bad_usage, print_json};

/// The router's rules, within the folder.
const ACCESS: &str = "access.json5";
/// Under these names the router is always dialled.
const LOOPBACK: [&str; 2] = ["localhost", "127.0.0.1"];

/// Runs one of the keys commands.
///
/// # Errors
/// A folder that cannot be written or read, or a name that is no identity.
pub fn run(command: &KeysCommand, json: bool) -> Result<Outcome> {
    match command {
        KeysCommand::New(args) => new(args, json),
        KeysCommand::List { folder } => list(folder, json),
    }
}

#[derive(Serialize)]
struct Made {
    folder: String,
    made: Vec<String>,
    kept: Vec<String>,
    access: Option<String>,
}

fn new(args: &NewKeys, json: bool) -> Result<Outcome> {
    let good = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    for cell in &args.cells {
        if !(1..=32).contains(&cell.len()) || !cell.chars().all(good) {
            return Err(bad_usage(format!(
                "--for {cell}: a cell's name, as in its file: 1 to 32 letters, digits, `_` or `-`"
            )));
        }
    }
    let hosts: Vec<String> = LOOPBACK
        .iter()
        .map(|host| (*host).to_owned())
        .chain(args.hosts.iter().cloned())
        .collect();
    let authority = Authority::open_or_create(&args.folder)?;
    let mut wanted = if args.cells.is_empty() {
        Vec::new()
    } else {
        roles::identities(&args.cells)
    };
    for name in &args.renew {
        if !wanted.contains(name) {
            wanted.push(name.clone());
        }
    }
    let mut made = Made {
        folder: args.folder.display().to_string(),
        made: Vec::new(),
        kept: Vec::new(),
        access: None,
    };
    for name in wanted {
        let files = authority.files(&name);
        if files.certificate.exists() && files.key.exists() && !args.renew.contains(&name) {
            made.kept.push(name);
            continue;
        }
        let dialled = if name == roles::ROUTER {
            &hosts[..]
        } else {
            &[]
        };
        authority.issue(&name, dialled, args.days)?;
        made.made.push(name);
    }
    if !args.cells.is_empty() {
        let path = args.folder.join(ACCESS);
        fs::write(&path, access::text(&args.cells))
            .with_context(|| format!("writing {}", path.display()))?;
        made.access = Some(path.display().to_string());
    }
    if json {
        print_json(&made)?;
    } else {
        print_words(&made);
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
    let mut all = Vec::new();
    for file in files {
        let certificate = Certificate::read(&file)?;
        all.push(Listed {
            problem: certificate.check_time(now_s).err().map(|e| e.to_string()),
            days_left: certificate.days_left(now_s),
            identity: certificate.identity,
            file: file.display().to_string(),
        });
    }
    let bad = all.iter().any(|one| one.problem.is_some());
    if json {
        print_json(&serde_json::json!({ "certificates": all }))?;
    } else {
        for one in &all {
            println!(
                "{:<32} {:>5} days left  {}",
                one.identity, one.days_left, one.file
            );
            if let Some(problem) = &one.problem {
                println!("    {problem}");
            }
        }
    }
    Ok(if bad { Outcome::Failed } else { Outcome::Done })
}
