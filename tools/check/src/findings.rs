//! Findings about one file.

use serde::Serialize;

/// Errors and notes on one file.
#[derive(Debug, Default, Serialize)]
pub struct Findings {
    /// Errors, each with key, value, what is allowed and what to do.
    pub errors: Vec<String>,
    /// Remarks on what is accepted, or cannot be checked offline.
    pub notes: Vec<String>,
}

impl Findings {
    pub(crate) fn error(&mut self, error: impl std::fmt::Display) {
        let error = error.to_string();
        let error = error.trim().to_owned();
        // Two services may refuse the same key with the same text.
        if !self.errors.contains(&error) {
            self.errors.push(error);
        }
    }

    pub(crate) fn note(&mut self, note: impl Into<String>) {
        self.notes.push(note.into());
    }

    pub(crate) fn extend_notes(&mut self, notes: impl IntoIterator<Item = String>) {
        self.notes.extend(notes);
    }
}
