//! `tangent keys`: certificates for a cell's network, and the router's access rules.

use std::path::Path;

use anyhow::Result;
use tangent_keys::{Made, list, new, revoke};

use crate::cli::{KeysCommand, NewKeys};
use crate::output::{Outcome, print_json};
use crate::table::Columns;

/// Runs one of the keys commands. `cell`: the file from which a new cell's file is made.
///
/// # Errors
/// The folder cannot be written or read, or a name is not an identity.
pub fn run(command: &KeysCommand, cell: Option<&Path>, json: bool) -> Result<Outcome> {
    match command {
        KeysCommand::New(args) => print_made(&new(&wanted(args), cell)?, json),
        KeysCommand::Revoke { folder, identities } => print_revoked(folder, identities, json),
        KeysCommand::List { folder } => print_list(folder, json),
    }
}

fn wanted(args: &NewKeys) -> tangent_keys::NewKeys {
    tangent_keys::NewKeys {
        folder: args.folder.clone(),
        cells: args.cells.clone(),
        hosts: args.hosts.clone(),
        estimator_hosts: args.estimator_hosts.clone(),
        also: args.also.clone(),
        renew: args.renew.clone(),
        days: args.days,
    }
}

fn print_made(made: &Made, json: bool) -> Result<Outcome> {
    if json {
        print_json(made)?;
        return Ok(Outcome::Done);
    }
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
        "ca.key signs new identities: keep it off the robots' machines. Each machine needs ca.pem and the .pem and .key of \
         the identities that run there"
    );
    Ok(Outcome::Done)
}

fn print_revoked(folder: &Path, identities: &[String], json: bool) -> Result<Outcome> {
    let revoked = revoke(folder, identities)?;
    if json {
        print_json(&revoked)?;
    } else {
        println!("revoked: {}", revoked.revoked.join(", "));
        println!(
            "it takes effect when the router has read {}: a router in a process of its own reads the file within seconds, \
             any other at its next start",
            revoked.access.display()
        );
    }
    Ok(Outcome::Done)
}

fn print_list(folder: &Path, json: bool) -> Result<Outcome> {
    let all = list(folder)?;
    // A revoked certificate may expire.
    let bad = all.iter().any(|one| one.problem.is_some() && !one.revoked);
    if json {
        print_json(&serde_json::json!({ "certificates": all }))?;
    } else {
        let mut table = Columns::new(&["identity", ">days left", "file", "remark"]);
        for one in &all {
            let revoked = if one.revoked { "REVOKED" } else { "" };
            let remark = [Some(revoked), one.problem.as_deref()];
            let remark: Vec<&str> = remark.into_iter().flatten().collect();
            table.row([
                one.identity.clone(),
                one.days_left.to_string(),
                one.file.clone(),
                remark.join(" ").trim().to_owned(),
            ]);
        }
        table.print(0);
    }
    Ok(if bad { Outcome::Failed } else { Outcome::Done })
}
