//! Data that a service keeps across restarts, crashes and power cuts: small JSON files in the
//! cell's state folder.
//!
//! Only side threads write them, as a write waits for the disk.

use std::fs::{self, File};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::config::CellConfig;

/// State folder of one cell. Each service has files with names of its own in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StateFolder {
    path: PathBuf,
}

/// Errors of reading or writing the state.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The contents of a file are not valid.
    #[error("{file}: cannot be read as kept state ({reason})")]
    Corrupt {
        /// File path.
        file: String,
        /// The parser's reason.
        reason: String,
    },
    /// The system refused the access.
    #[error("{file}: {reason}; give the cell a folder that can be written, [cell] state_folder")]
    System {
        /// File path.
        file: String,
        /// The system's reason.
        reason: String,
    },
}

impl StateFolder {
    /// Folder at this path; the first write creates it.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Folder of the cell: `[cell] state_folder`. `None` for a cell that was not read from a file.
    pub fn of_cell(cell: &CellConfig) -> Option<Self> {
        cell.cell.state_folder.as_ref().map(Self::new)
    }

    /// Path of the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Contents of `name.json`; `None` if there is no such file.
    ///
    /// # Errors
    /// [`StateError`]: a file that cannot be read must not be treated as absent.
    pub fn read<T: DeserializeOwned>(&self, name: &str) -> Result<Option<T>, StateError> {
        let file = self.file(name);
        let text = match fs::read_to_string(&file) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(corrupt(&file, &error)),
        };
        serde_json::from_str(&text)
            .map(Some)
            .map_err(|error| corrupt(&file, &error))
    }

    /// Replaces the contents of `name.json` by `value`, atomically. The data is on the disk when it
    /// returns.
    ///
    /// # Errors
    /// [`StateError::System`].
    pub fn write<T: Serialize>(&self, name: &str, value: &T) -> Result<(), StateError> {
        let file = self.file(name);
        let failed = |error: &dyn std::fmt::Display| StateError::System {
            file: file.display().to_string(),
            reason: error.to_string(),
        };
        let text = serde_json::to_vec_pretty(value).map_err(|e| failed(&e))?;
        fs::create_dir_all(&self.path).map_err(|e| failed(&e))?;
        let fresh = self.path.join(format!("{name}.json.new"));
        let mut out = File::create(&fresh).map_err(|e| failed(&e))?;
        out.write_all(&text).map_err(|e| failed(&e))?;
        out.sync_all().map_err(|e| failed(&e))?;
        fs::rename(&fresh, &file).map_err(|e| failed(&e))?;
        // Syncs the folder, so that the rename is on the disk too.
        File::open(&self.path)
            .and_then(|folder| folder.sync_all())
            .map_err(|e| failed(&e))
    }

    fn file(&self, name: &str) -> PathBuf {
        self.path.join(format!("{name}.json"))
    }
}

fn corrupt(file: &Path, error: &dyn std::fmt::Display) -> StateError {
    StateError::Corrupt {
        file: file.display().to_string(),
        reason: error.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn written_state_is_read_back_and_damage_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let state = StateFolder::new(folder.path().join("a/b"));
        assert_eq!(state.read::<Vec<f64>>("zero").unwrap(), None);
        for zero in [vec![1.0, -0.25], vec![2.0]] {
            state.write("zero", &zero).unwrap();
            assert_eq!(state.read::<Vec<f64>>("zero").unwrap(), Some(zero));
        }
        fs::write(state.path().join("zero.json"), "[2.").unwrap();
        let error = state.read::<Vec<f64>>("zero").unwrap_err().to_string();
        assert!(error.contains("zero.json"), "{error}");
    }

    #[test]
    fn a_folder_that_cannot_be_written_is_named() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let state = StateFolder::new(file.path());
        let error = state.write("zero", &1).unwrap_err().to_string();
        assert!(error.contains("state_folder"), "{error}");
    }
}
