//! Reads TOML, with errors that a person can act on: file, line, key, the present value, and what
//! is allowed.

use std::path::Path;

use serde::de::DeserializeOwned;
use tangent_mechanics::names::{did_you_mean, nearest};
use toml::de::DeTable;

/// Errors of a configuration file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{file}: {reason}")]
    Read {
        /// File path as given.
        file: String,
        /// The system's reason.
        reason: String,
    },
    /// The file is not valid TOML.
    #[error("{file}, line {line}: not TOML: {reason}")]
    Syntax {
        /// File path as given.
        file: String,
        /// Line number, from 1.
        line: usize,
        /// The parser's reason.
        reason: String,
    },
    /// An unknown key.
    #[error("{file}, line {line}: unknown key `{key}`{}", suggest(.suggestion, .allowed))]
    UnknownKey {
        /// File path as given.
        file: String,
        /// Line number, from 1.
        line: usize,
        /// Dotted key.
        key: String,
        /// The key that was probably meant.
        suggestion: Option<String>,
        /// All keys that are allowed there.
        allowed: String,
    },
    /// A required key is missing.
    #[error("{file}: `{key}` is missing")]
    Missing {
        /// File path as given.
        file: String,
        /// Dotted key.
        key: String,
    },
    /// A value of another type, or of another kind than listed.
    #[error("{file}, line {line}: `{key}` = {value}: {reason}")]
    Type {
        /// File path as given.
        file: String,
        /// Line number, from 1.
        line: usize,
        /// Dotted key.
        key: String,
        /// Value as it stands in the file.
        value: String,
        /// What was expected.
        reason: String,
    },
    /// A value that is not allowed.
    #[error("{file}{}: `{key}` = {value} is not allowed: {allowed}", at(*.line))]
    Value {
        /// File path as given.
        file: String,
        /// Line number of the key or of its table, from 1; 0 if the file has neither.
        line: usize,
        /// Dotted key.
        key: String,
        /// Value as it stands in the file.
        value: String,
        /// What is allowed.
        allowed: String,
    },
}

fn at(line: usize) -> String {
    if line == 0 {
        return String::new();
    }
    format!(", line {line}")
}

fn suggest(suggestion: &Option<String>, allowed: &str) -> String {
    match suggestion {
        Some(near) => format!(", did you mean `{near}`? (there are: {allowed})"),
        None => format!(" (there are: {allowed})"),
    }
}

/// Reads a TOML file into a type, with this crate's errors.
///
/// # Errors
/// [`ConfigError`].
pub fn read_toml<T: DeserializeOwned>(path: &Path) -> Result<T, ConfigError> {
    let file = path.display().to_string();
    let text = std::fs::read_to_string(path).map_err(|error| ConfigError::Read {
        file: file.clone(),
        reason: error.to_string(),
    })?;
    toml_from_str(&file, &text)
}

/// Reads a TOML text into a type; errors refer to it as `file`.
///
/// # Errors
/// [`ConfigError`].
pub fn toml_from_str<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, ConfigError> {
    let syntax = |error: toml::de::Error| ConfigError::Syntax {
        file: file.to_owned(),
        line: line_of(text, error.span().unwrap_or_default().start),
        reason: error.message().replace('\n', ", "),
    };
    let document = toml::Deserializer::parse(text).map_err(syntax)?;
    serde_path_to_error::deserialize(document).map_err(|error| {
        let path = error.path().to_string();
        let path = if path == "." { String::new() } else { path };
        explain(file, text, path, error.inner())
    })
}

/// `path` is the dotted key that the error is about, or the table that it is in.
fn explain(file: &str, text: &str, path: String, error: &toml::de::Error) -> ConfigError {
    let file = file.to_owned();
    let span = error.span().unwrap_or(0..0);
    let line = line_of(text, span.start);
    let message = error.message();
    if let Some(field) = quoted_after(message, "missing field `") {
        return ConfigError::Missing {
            file,
            key: join(&path, field),
        };
    }
    if let Some(field) = quoted_after(message, "unknown field `") {
        let allowed = expected(message);
        return ConfigError::UnknownKey {
            file,
            line,
            key: if path.ends_with(field) {
                path
            } else {
                join(&path, field)
            },
            suggestion: nearest(field, allowed.iter().copied()).map(str::to_owned),
            allowed: allowed.join(", "),
        };
    }
    let value = text.get(span).unwrap_or_default();
    let meant = quoted_after(message, "unknown variant `")
        .map(|variant| did_you_mean(variant, expected(message)))
        .unwrap_or_default();
    ConfigError::Type {
        file,
        line,
        key: path,
        value: value.lines().next().unwrap_or_default().to_owned(),
        reason: message.replace('\n', ", ") + &meant,
    }
}

/// Names that serde lists after "expected".
fn expected(message: &str) -> Vec<&str> {
    message
        .split_once("expected")
        .map(|(_, rest)| rest.split('`').skip(1).step_by(2).collect())
        .unwrap_or_default()
}

fn quoted_after<'a>(message: &'a str, start: &str) -> Option<&'a str> {
    message.strip_prefix(start)?.split('`').next()
}

fn join(path: &str, key: &str) -> String {
    if path.is_empty() {
        key.to_owned()
    } else {
        format!("{path}.{key}")
    }
}

pub(super) fn line_of(text: &str, offset: usize) -> usize {
    let end = offset.min(text.len());
    text.as_bytes()[..end]
        .iter()
        .filter(|byte| **byte == b'\n')
        .count()
        + 1
}

/// Line number and text of a dotted key's value.
pub(super) fn locate(text: &str, key: &str) -> Option<(usize, String)> {
    let document = DeTable::parse(text).ok()?;
    let mut parts = key.split('.');
    let mut value = document.get_ref().get(parts.next()?)?;
    for part in parts {
        value = value.get_ref().as_table()?.get(part)?;
    }
    let shown = text.get(value.span()).unwrap_or_default();
    Some((line_of(text, value.span().start), shown.to_owned()))
}
