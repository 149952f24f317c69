//! Single keys of a cell file's table, by dotted name.

use serde::Serialize;
use toml::{Table, Value};

use crate::error::SimulatedCellError;

/// The value of `key`, if it stands there.
pub fn get<'a>(table: &'a Table, key: &str) -> Option<&'a Value> {
    match key.split_once('.') {
        None => table.get(key),
        Some((section, rest)) => get(table.get(section)?.as_table()?, rest),
    }
}

/// Writes `key`, with the tables on the way to it.
///
/// # Errors
/// A value that TOML cannot hold.
pub fn set(table: &mut Table, key: &str, value: impl Serialize) -> Result<(), SimulatedCellError> {
    let value = Value::try_from(value).map_err(|source| SimulatedCellError::Write {
        key: key.to_owned(),
        source,
    })?;
    put(table, key, value);
    Ok(())
}

/// Removes `key` and returns its value.
pub fn remove(table: &mut Table, key: &str) -> Option<Value> {
    match key.split_once('.') {
        None => table.remove(key),
        Some((section, rest)) => remove(table.get_mut(section)?.as_table_mut()?, rest),
    }
}

fn put(table: &mut Table, key: &str, value: Value) {
    let Some((section, rest)) = key.split_once('.') else {
        table.insert(key.to_owned(), value);
        return;
    };
    let inner = table.entry(section).or_insert_with(|| Table::new().into());
    if !inner.is_table() {
        *inner = Table::new().into();
    }
    if let Value::Table(inner) = inner {
        put(inner, rest, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_are_set_read_and_removed_by_their_dotted_names() {
        let mut table: Table = "[robot]\nmodel = \"ur5\"".parse().unwrap();
        set(&mut table, "robot.franka.fci_port", 1337).unwrap();
        set(&mut table, "robot.model", "ur5e").unwrap();
        assert_eq!(get(&table, "robot.model"), Some(&Value::from("ur5e")));
        assert_eq!(
            get(&table, "robot.franka.fci_port"),
            Some(&Value::from(1337))
        );
        assert_eq!(get(&table, "robot.nothing.there"), None);
        assert_eq!(remove(&mut table, "robot.model"), Some(Value::from("ur5e")));
        assert_eq!(get(&table, "robot.model"), None);
    }
}
