//! Changes single parameters of a preset, as in `[controller.settings]` of a cell file.

use serde::{Serialize, de::DeserializeOwned};

use crate::error::ControlError;

/// A complete set of parameters with single ones changed.
pub(crate) fn with_changes<T: Serialize + DeserializeOwned>(
    preset: T,
    changes: &toml::Table,
) -> Result<T, ControlError> {
    let wrong = |e: String| ControlError::Syntax(format!("controller settings: {e}"));
    let mut table = toml::Table::try_from(preset).map_err(|e| wrong(e.to_string()))?;
    overlay(&mut table, changes);
    serde_path_to_error::deserialize(toml::Value::Table(table))
        .map_err(|e| wrong(format!("`{}`: {}", e.path(), e.inner().message())))
}

/// Overrides values in `base` by `changes`, table by table.
fn overlay(base: &mut toml::Table, changes: &toml::Table) {
    for (key, value) in changes {
        match (base.get_mut(key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(changes)) => {
                overlay(inner, changes);
            }
            _ => {
                base.insert(key.clone(), value.clone());
            }
        }
    }
}
