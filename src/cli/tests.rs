//! Tests that the grammar is valid, and that the documentation agrees with it.

use std::fs;
use std::path::{Path, PathBuf};

use clap::{CommandFactory, Parser};

use super::Cli;

#[test]
fn the_grammar_is_sound() {
    Cli::command().debug_assert();
}

fn pages(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let path = entry.path();
        if path.is_dir() {
            pages(&path, found);
        } else if path.extension().is_some_and(|e| e == "md") {
            found.push(path);
        }
    }
}

/// Every command in a fenced block of the README and the documentation must be accepted by the
/// program, and every file that it names below `deploy/` and `scenarios/` must exist.
#[test]
fn every_documented_command_is_taken() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = vec![root.join("README.md")];
    pages(&root.join("docs"), &mut found);
    let mut commands = 0;
    for page in found {
        let text = fs::read_to_string(&page).unwrap();
        let mut fenced = false;
        for line in text.lines() {
            if line.trim_start().starts_with("```") {
                fenced = !fenced;
            }
            let line = line.trim_start().trim_start_matches("$ ");
            let line = line
                .strip_prefix("cargo run --release -- ")
                .map_or(line.to_owned(), |rest| format!("tangent {rest}"));
            if !fenced || !line.starts_with("tangent ") {
                continue;
            }
            let words: Vec<&str> = line
                .split(" #")
                .next()
                .unwrap()
                .split(['|', '>', '&'])
                .next()
                .unwrap()
                .split_whitespace()
                .map(|word| word.trim_matches(['"', '\'']))
                .collect();
            if let Err(error) = Cli::try_parse_from(&words) {
                let fine = matches!(
                    error.kind(),
                    clap::error::ErrorKind::DisplayHelp | clap::error::ErrorKind::DisplayVersion
                );
                assert!(fine, "{}: `{line}`: {error}", page.display());
            }
            for word in words {
                if word.starts_with("deploy/") || word.starts_with("scenarios/") {
                    assert!(
                        root.join(word).exists(),
                        "{}: `{line}`: {word}",
                        page.display()
                    );
                }
            }
            commands += 1;
        }
    }
    assert!(
        commands > 10,
        "only {commands} commands found: is the search broken?"
    );
}

/// Every link of the README and the documentation to a file of the repository must lead to an
/// existing file.
#[test]
fn every_link_leads_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = vec![root.join("README.md")];
    pages(&root.join("docs"), &mut found);
    for page in found {
        let text = fs::read_to_string(&page).unwrap();
        for part in text.split("](").skip(1) {
            let target = part.split([')', '#', ' ']).next().unwrap();
            if target.is_empty() || target.contains("://") {
                continue;
            }
            let path = page.parent().unwrap().join(target);
            assert!(path.exists(), "{}: {target}", page.display());
        }
    }
}
