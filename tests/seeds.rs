//! Property tests draw the same cases in every run. A test that fails only at times would be run
//! again until it passes, and its counterexample would be lost. `.ci/search` draws new cases, and
//! runs every target with property tests.

// Reads the sources.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};

use proptest::prelude::ProptestConfig;
use proptest::test_runner::RngSeed;

#[test]
fn property_tests_draw_the_same_cases_every_time() {
    // From `.cargo/config.toml`, which cargo reads for everything that it runs inside the
    // repository.
    assert_ne!(ProptestConfig::default().rng_seed, RngSeed::Random);
}

/// Rust files under `folder`.
fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            let hidden = path.file_name().unwrap().to_string_lossy().starts_with('.');
            if !hidden && !path.ends_with("target") {
                sources(&path, found);
            }
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

#[test]
fn every_property_test_is_searched_with_fresh_seeds() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let search = std::fs::read_to_string(root.join(".ci/search")).unwrap();
    // Test filters of the commands that run integration tests with fresh seeds.
    let commands = search.replace("\\\n", " ");
    let filters: Vec<&str> = commands
        .lines()
        .filter_map(|line| line.split_once("--test integration -- "))
        .flat_map(|(_, words)| words.split_whitespace().take_while(|word| *word != "||"))
        .collect();
    let mut files = Vec::new();
    for folder in ["core", "schemas", "services", "simulators", "src", "tests"] {
        sources(&root.join(folder), &mut files);
    }
    // In two parts, so that this file does not match.
    let draws = [concat!("proptest", "!"), concat!("Test", "Runner::new")];
    let mut seen = 0;
    for file in files {
        let text = std::fs::read_to_string(&file).unwrap();
        let own_seed = concat!("RngSeed", "::Fixed");
        assert!(
            !text.contains(own_seed),
            "{}: a seed of its own",
            file.display()
        );
        let integration =
            file.iter().any(|part| part == "tests") && !file.iter().any(|p| p == "src");
        if !integration || !draws.iter().any(|word| text.contains(word)) {
            continue;
        }
        seen += 1;
        // A file of tests, or those that use the module in a folder beside them.
        let name = file.file_stem().unwrap().to_string_lossy();
        let targets = if name == "mod" {
            let module = file.parent().unwrap();
            let uses = format!("crate::{}", module.file_name().unwrap().to_string_lossy());
            std::fs::read_dir(module.parent().unwrap())
                .unwrap()
                .map(|entry| entry.unwrap().path())
                .filter(|path| path.extension().is_some_and(|e| e == "rs"))
                .filter(|path| std::fs::read_to_string(path).unwrap().contains(&uses))
                .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
                .collect()
        } else {
            vec![name.into_owned()]
        };
        assert!(!targets.is_empty(), "{}: used by no test", file.display());
        for target in targets {
            assert!(
                filters.contains(&target.as_str()),
                ".ci/search does not run --test integration -- {target}"
            );
        }
    }
    assert!(seen >= 6, "only {seen} files of tests that draw were found");
}
