//! Errors of tasks, configurations and requests.

use tangent_mechanics::names::did_you_mean;
use thiserror::Error;

/// Errors of this crate. Each states what is wrong, the value, the allowed range, and the remedy.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ControlError {
    /// The text is no valid TOML, or a key is unknown, missing or of the wrong type.
    #[error("task: {0}")]
    Syntax(String),
    /// A number is out of its range.
    #[error("`{key}` is {value}: allowed is {allowed}")]
    Range {
        /// Dotted path of the key.
        key: String,
        /// Value given.
        value: String,
        /// Allowed range.
        allowed: String,
    },
    /// No preset of this name.
    #[error("no controller preset `{name}`{}: the presets are `default` and `paper`", did_you_mean(name, ["default", "paper"]))]
    UnknownPreset {
        /// Name requested.
        name: String,
    },
    /// A request does not fit the phase the controller is in.
    #[error("cannot {request} while {phase}: {remedy}")]
    WrongPhase {
        /// Request.
        request: &'static str,
        /// Phase, as text.
        phase: &'static str,
        /// What to do instead.
        remedy: &'static str,
    },
    /// The tool may touch something, and the direction away from it is not known.
    #[error(
        "cannot start a task: the tool may touch something since a task that did not end in free space, and the direction \
         away from it is not known{}; move the tool clear by hand or with the pendant, check that it hangs free, then run \
         `tangent task start FILE --clear`",
        moved(.moved_m)
    )]
    MayTouch {
        /// Distance of the tool from its position at that time, m; `None` if it is not known.
        moved_m: Option<f64>,
    },
    /// An estimator switch was refused.
    #[error("estimator `{name}` refused: {reason}")]
    SwitchRefused {
        /// Name of the requested estimator.
        name: String,
        /// Reason of the refusal.
        reason: String,
    },
    /// No live parameter of this name.
    #[error("no parameter `{name}`{}: there are {known}", did_you_mean(name, known.split(", ")))]
    UnknownParameter {
        /// Name requested.
        name: String,
        /// Known parameters.
        known: String,
    },
}

fn moved(moved_m: &Option<f64>) -> String {
    moved_m.map_or_else(String::new, |m| {
        format!(": the tool was moved by {m:.3} m since")
    })
}

impl ControlError {
    pub(crate) fn range(key: impl Into<String>, value: impl ToString, allowed: &str) -> Self {
        Self::Range {
            key: key.into(),
            value: value.to_string(),
            allowed: allowed.into(),
        }
    }
}

/// Checks that `value` is finite and within `lower..=upper`.
pub(crate) fn check_range(
    key: &str,
    value: f64,
    lower: f64,
    upper: f64,
) -> Result<(), ControlError> {
    if value.is_finite() && value >= lower && value <= upper {
        return Ok(());
    }
    Err(ControlError::range(
        key,
        value,
        &format!("{lower} to {upper}"),
    ))
}
