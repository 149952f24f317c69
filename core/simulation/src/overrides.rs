//! `--set key=value` on a scenario: one dotted path, one TOML value.

use toml::{Table, Value};

/// Why an override cannot be applied.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OverrideError {
    /// Not of the form `key=value`.
    #[error(
        "--set {text}: write it as key=value, for instance plant.contact.stiffness_n_per_m=10000"
    )]
    Form {
        /// The override as given.
        text: String,
    },
    /// A part of the path holds a value where a table is needed.
    #[error("--set {text}: `{at}` is {kind}, not a table, so `{next}` cannot be in it")]
    NotATable {
        /// The override as given.
        text: String,
        /// Path so far.
        at: String,
        /// Kind of the value found there.
        kind: &'static str,
        /// Next part of the path.
        next: String,
    },
    /// A part of the path must be an index into a list but is not.
    #[error(
        "--set {text}: `{at}` is a list of {len}, so `{next}` must be a number from 0 to {last}"
    )]
    Index {
        /// The override as given.
        text: String,
        /// Path so far.
        at: String,
        /// Length of the list.
        len: usize,
        /// Part of the path that was given.
        next: String,
        /// Highest index.
        last: usize,
    },
}

/// Sets one value. Missing tables on the path are created; whether the key exists is checked when
/// the scenario is read. A value that is not valid TOML is taken as a string.
///
/// # Errors
/// The part of the path that is wrong.
pub fn apply(table: &mut Table, text: &str) -> Result<(), OverrideError> {
    let form = || OverrideError::Form {
        text: text.to_owned(),
    };
    let (key, value) = text.split_once('=').ok_or_else(form)?;
    let parts: Vec<&str> = key.trim().split('.').collect();
    if parts.iter().any(|part| part.is_empty()) {
        return Err(form());
    }
    let value = parse(value.trim());
    let (last, way) = parts.split_last().ok_or_else(form)?;
    let mut root = Value::Table(std::mem::take(table));
    let result = descend(&mut root, way, last, text).map(|slot| *slot = value);
    if let Value::Table(changed) = root {
        *table = changed;
    }
    result
}

fn parse(text: &str) -> Value {
    let as_toml = toml::from_str::<Table>(&format!("value = {text}"));
    match as_toml.ok().and_then(|mut table| table.remove("value")) {
        Some(value) => value,
        None => Value::String(text.to_owned()),
    }
}

fn descend<'a>(
    root: &'a mut Value,
    way: &[&str],
    last: &str,
    text: &str,
) -> Result<&'a mut Value, OverrideError> {
    let mut at = root;
    let mut path = String::new();
    for (i, part) in way.iter().chain([&last]).enumerate() {
        let is_last = i == way.len();
        at = match at {
            Value::Table(table) => table.entry(*part).or_insert_with(|| {
                if is_last {
                    Value::Boolean(false)
                } else {
                    Value::Table(Table::new())
                }
            }),
            Value::Array(list) => {
                let len = list.len();
                let index = part.parse::<usize>().ok();
                index
                    .and_then(|i| list.get_mut(i))
                    .ok_or_else(|| OverrideError::Index {
                        text: text.to_owned(),
                        at: path.clone(),
                        len,
                        next: (*part).to_owned(),
                        last: len.saturating_sub(1),
                    })?
            }
            other => {
                return Err(OverrideError::NotATable {
                    text: text.to_owned(),
                    at: path,
                    kind: other.type_str(),
                    next: (*part).to_owned(),
                });
            }
        };
        if !path.is_empty() {
            path.push('.');
        }
        path.push_str(part);
    }
    Ok(at)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        toml::from_str("a = 1\n[b]\nc = [1.0, 2.0]\nd = 'x'").unwrap()
    }

    fn set(text: &str) -> Result<Table, OverrideError> {
        let mut changed = table();
        apply(&mut changed, text).map(|()| changed)
    }

    #[test]
    fn values_keep_their_type_and_words_are_text() {
        assert_eq!(set("a=2").unwrap()["a"], Value::Integer(2));
        assert_eq!(set("a = 2.5").unwrap()["a"], Value::Float(2.5));
        assert_eq!(
            set("b.d=blend").unwrap()["b"]["d"],
            Value::String("blend".to_owned())
        );
        assert_eq!(set("b.c=[3]").unwrap()["b"]["c"][0], Value::Integer(3));
        assert_eq!(set("b.c.1=7").unwrap()["b"]["c"][1], Value::Integer(7));
        assert_eq!(
            set("e.f.g=true").unwrap()["e"]["f"]["g"],
            Value::Boolean(true)
        );
    }

    #[test]
    fn what_cannot_be_set_is_said() {
        let error = |text: &str| set(text).unwrap_err().to_string();
        assert!(error("a").contains("key=value"));
        assert!(error("=3").contains("key=value"));
        assert!(error("a.b=3").contains("`a` is integer, not a table, so `b`"));
        assert!(
            error("b.c.2=3").contains("`b.c` is a list of 2, so `2` must be a number from 0 to 1")
        );
    }

    #[test]
    fn a_failed_override_leaves_the_table_whole() {
        let mut changed = table();
        assert!(apply(&mut changed, "b.d.e=1").is_err());
        assert_eq!(changed, table());
    }
}
