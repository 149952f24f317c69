//! What can be wrong with a robot model.

use crate::names::did_you_mean;

/// Why a robot model was refused. Messages name the model, the key, its value and what is allowed;
/// the caller adds the file's name.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// The text is no model file: not TOML, a key that does not exist, a missing key, a wrong type.
    #[error("not a robot model: {message}")]
    Syntax {
        /// The parser's own words, with line, key and what was expected.
        message: String,
    },
    /// No built-in robot of that name.
    #[error(
        "no robot model is called `{name}`{}; built in are: {known}. A robot of your own is a file: give its path",
        did_you_mean(name, known.split(", "))
    )]
    Unknown {
        /// The name asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// A list has not one entry per joint.
    #[error(
        "robot model `{model}`: `{key}` has {found} entries; `dof` is {dof}, so it needs {dof}"
    )]
    Length {
        /// The model's name.
        model: String,
        /// Path of the key in the file.
        key: String,
        /// Entries in the list.
        found: usize,
        /// Entries needed.
        dof: usize,
    },
    /// A value is outside what is allowed.
    #[error("robot model `{model}`: `{key}` = {value}: {allowed}")]
    Value {
        /// The model's name.
        model: String,
        /// Path of the key in the file.
        key: String,
        /// The value found.
        value: String,
        /// What is allowed instead.
        allowed: &'static str,
    },
    /// The model has another number of joints than the place it is used in.
    #[error("robot model `{model}` has {found} joints; {expected} are needed here")]
    Dof {
        /// The model's name.
        model: String,
        /// Joints of the model.
        found: usize,
        /// Joints needed.
        expected: usize,
    },
}
