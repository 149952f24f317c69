//! Errors of the command, for a person on standard error and, with `--json`, for a program on
//! standard output.

use std::ffi::OsStr;
use std::process::ExitCode;

use clap::builder::StyledStr;
use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{Command, CommandFactory};
use serde_json::json;
use tangent_runtime::log;

use crate::cli::Cli;
use crate::output::print_json;

/// Exit code of a bad call.
const USAGE: u8 = 2;

/// Reports that the command has failed with this exit code.
pub fn tell(message: &str, code: u8, as_json: bool) {
    log::line(&format!("tangent: {message}"));
    if as_json {
        print_error(message, code);
    }
}

/// Reports a call that the grammar does not accept, or prints the help that it asks for.
pub fn of_grammar(mut error: clap::Error) -> ExitCode {
    if !error.use_stderr() {
        let _ = error.print();
        return ExitCode::SUCCESS;
    }
    if error.kind() == ErrorKind::InvalidSubcommand {
        let words = format!("there are: {}", verbs().join(", "));
        error.insert(
            ContextKind::Suggested,
            ContextValue::StyledStrs(vec![StyledStr::from(words)]),
        );
    }
    let _ = error.print();
    if std::env::args_os().any(|word| word == "--json") {
        let text = error.render().to_string();
        let message = text.trim().trim_start_matches("error: ");
        print_error(message, USAGE);
    }
    ExitCode::from(USAGE)
}

fn print_error(message: &str, code: u8) {
    // Standard output may be closed; standard error has the message in any case.
    let _ = print_json(&json!({ "error": message, "exit_code": code }));
}

/// Subcommands where the call's words lead: those of `tangent task` for `tangent task strat`.
fn verbs() -> Vec<String> {
    let root = Cli::command();
    let mut at: &Command = &root;
    for word in std::env::args_os().skip(1) {
        if let Some(next) = word.to_str().and_then(|word| at.find_subcommand(word)) {
            at = next;
        } else if !OsStr::to_string_lossy(&word).starts_with('-') {
            break;
        }
    }
    at.get_subcommands()
        .filter(|verb| !verb.is_hide_set())
        .map(|verb| verb.get_name().to_owned())
        .collect()
}
