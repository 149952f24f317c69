//! Checks licences, sources and duplicates of all dependencies against `deny.toml`, without
//! cargo-deny and without a network. Only cargo-deny checks advisories: their database has to be
//! fetched.

#![allow(clippy::unwrap_used)]

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use common::root;
use serde_json::Value;

/// One package as cargo resolved it.
struct Package {
    name: String,
    version: String,
    license: Option<String>,
    source: Option<String>,
}

fn packages() -> Vec<Package> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--offline", "--locked"])
        // Crates for other platforms are not fetched for a build.
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(root())
        .output()
        .unwrap();
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let resolved: BTreeSet<&str> = metadata["resolve"]["nodes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|node| node["id"].as_str().unwrap())
        .collect();
    let text = |v: &Value| v.as_str().map(str::to_owned);
    metadata["packages"]
        .as_array()
        .unwrap()
        .iter()
        .filter(|p| resolved.contains(p["id"].as_str().unwrap()))
        .map(|p| Package {
            name: text(&p["name"]).unwrap(),
            version: text(&p["version"]).unwrap(),
            license: text(&p["license"]),
            source: text(&p["source"]),
        })
        .collect()
}

fn deny() -> toml::Table {
    let text = std::fs::read_to_string(root().join("deny.toml")).unwrap();
    text.parse().unwrap()
}

fn list<'a>(deny: &'a toml::Table, table: &str, key: &str) -> Vec<&'a str> {
    let values = deny[table][key].as_array().unwrap();
    values.iter().map(|v| v.as_str().unwrap()).collect()
}

/// Whether an SPDX expression is allowed: one side of `OR`, both sides of `AND`. Older crates write
/// `/` for `OR`.
fn allowed(expression: &str, licenses: &[&str]) -> bool {
    let spaced = expression
        .replace('/', " OR ")
        .replace('(', " ( ")
        .replace(')', " ) ")
        .replace(" WITH ", "\u{0}");
    let words: Vec<String> = spaced
        .split_whitespace()
        .map(|w| w.replace('\u{0}', " WITH "))
        .collect();
    let mut at = 0;
    let holds = either(&words, &mut at, licenses);
    holds && at == words.len()
}

fn either(words: &[String], at: &mut usize, licenses: &[&str]) -> bool {
    let mut holds = both(words, at, licenses);
    while words.get(*at).is_some_and(|w| w == "OR") {
        *at += 1;
        holds |= both(words, at, licenses);
    }
    holds
}

fn both(words: &[String], at: &mut usize, licenses: &[&str]) -> bool {
    let mut holds = one(words, at, licenses);
    while words.get(*at).is_some_and(|w| w == "AND") {
        *at += 1;
        holds &= one(words, at, licenses);
    }
    holds
}

fn one(words: &[String], at: &mut usize, licenses: &[&str]) -> bool {
    let Some(word) = words.get(*at) else {
        return false;
    };
    *at += 1;
    if word != "(" {
        return licenses.contains(&word.as_str());
    }
    let holds = either(words, at, licenses);
    let closed = words.get(*at).is_some_and(|w| w == ")");
    *at += 1;
    holds && closed
}

#[test]
fn an_expression_is_read_as_spdx_means_it() {
    let licenses = ["MIT", "Apache-2.0 WITH LLVM-exception"];
    for (expression, holds) in [
        ("MIT", true),
        ("GPL-3.0", false),
        ("GPL-3.0 OR MIT", true),
        ("GPL-3.0/MIT", true),
        ("GPL-3.0 AND MIT", false),
        ("Apache-2.0 WITH LLVM-exception", true),
        ("Apache-2.0", false),
        ("(GPL-3.0 OR MIT) AND MIT", true),
        ("MIT AND (GPL-3.0 OR Zlib)", false),
        ("MIT MIT", false),
        ("", false),
    ] {
        assert_eq!(allowed(expression, &licenses), holds, "{expression}");
    }
}

#[test]
fn every_licence_and_source_is_one_that_deny_toml_allows() {
    let deny = deny();
    let licenses = list(&deny, "licenses", "allow");
    let mut registries = BTreeSet::new();
    let packages = packages();
    assert!(packages.len() > 100, "{}", packages.len());
    for package in &packages {
        let Package { name, version, .. } = package;
        let license = package.license.as_deref().unwrap_or("");
        assert!(
            allowed(license, &licenses),
            "{name} {version}: \"{license}\""
        );
        // A package without a source belongs to the workspace.
        if let Some(source) = &package.source {
            assert!(
                source.starts_with("registry+"),
                "{name} {version}: {source}"
            );
            registries.insert(source.clone());
        }
    }
    // Only cargo's own registry; any other registry or repository would be listed too.
    assert_eq!(registries.len(), 1, "{registries:?}");
}

#[test]
fn every_second_version_of_a_crate_stands_in_deny_toml() {
    let deny = deny();
    let skipped: BTreeSet<&str> = deny["bans"]["skip"]
        .as_array()
        .unwrap()
        .iter()
        .map(|entry| entry["crate"].as_str().unwrap())
        .collect();
    let mut versions: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for package in packages() {
        versions
            .entry(package.name)
            .or_default()
            .push(package.version);
    }
    for (name, versions) in &versions {
        let kept: Vec<&String> = versions
            .iter()
            .filter(|v| !skipped.contains(format!("{name}@{v}").as_str()))
            .collect();
        assert!(kept.len() <= 1, "{name}: {kept:?} (deny.toml, [bans] skip)");
    }
    for entry in &skipped {
        let (name, version) = entry.split_once('@').unwrap();
        let there = versions
            .get(name)
            .is_some_and(|v| v.len() > 1 && v.iter().any(|v| v == version));
        assert!(there, "{entry} is no second version any more: take it out");
    }
}
