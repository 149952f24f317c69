//! Errors of a robot model.

use crate::names::did_you_mean;

/// Why a robot model was refused. Messages name the model, the key, its value and what is allowed.
/// The caller adds the name of the file.
///
/// ```
/// use tangent_mechanics::{Arm, ModelData};
/// let panda = ModelData::builtin("panda")?;
/// let error = Arm::<6>::new(&panda).unwrap_err();
/// assert_eq!(error.to_string(), "robot model `panda` has 7 joints; 6 are needed here");
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ModelError {
    /// The text is not a model file: not TOML, an unknown or missing key, or a wrong type.
    #[error("not a robot model: {message}")]
    Syntax {
        /// Message of the parser, with line, key and expected type.
        message: String,
    },
    /// There is no built-in robot of that name.
    #[error(
        "no robot model is called `{name}`{}; built in are: {known}. A robot of your own is a file: give its path",
        did_you_mean(name, known.split(", "))
    )]
    Unknown {
        /// The name asked for.
        name: String,
        /// Names of the built-in robots.
        known: String,
    },
    /// A list does not have one entry per joint.
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
    /// A value is out of its range.
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
    /// The number of joints of the model differs from that of its user.
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
