//! The words and rules of a switch of estimators: when it happens, why it happened, why it was refused.
//!
//! `estimator_choice` goes by them; the service says them.

use tangent_sensing::Validity;

use crate::{ControlError, NormalConfig, PatienceConfig, SwitchingSpec};

/// Why the estimator in use is the one in use.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SwitchCause {
    /// First of the task's list.
    #[default]
    Task,
    /// Asked for, and near enough to the normal that was in use.
    Asked,
    /// Asked for with force: neither its validity nor its agreement was looked at.
    Forced,
    /// The one before could not be used any more.
    FellBack(Validity),
    /// The preferred one has been good again for the task's `switching.return_after_good_s`.
    Returned,
}

impl SwitchCause {
    /// In words; what stands behind `fell back` is the reason.
    pub fn text(self) -> (&'static str, &'static str) {
        match self {
            Self::Task => ("first of the task's list", ""),
            Self::Asked => ("asked for", ""),
            Self::Forced => ("forced", ""),
            Self::FellBack(reason) => ("fell back: the one before is ", reason.reason()),
            Self::Returned => ("came back after being good again", ""),
        }
    }
}

/// When an estimate can be used, and when another estimator is taken.
#[derive(Clone, Copy, Debug)]
pub struct ChoiceRules {
    /// An estimate further than this from the normal in use is refused, rad.
    pub gate_rad: f64,
    /// The same for one that is to be taken anew, rad.
    pub switch_gate_rad: f64,
    /// Way without a valid estimate before the next estimator is taken, m.
    pub blind_distance_m: f64,
    /// Time of silence or nonsense before the next estimator is taken, s.
    pub patience_s: f64,
    /// Time that the preferred one must have been good before it is taken again, s; none: only when asked for.
    pub return_after_good_s: Option<f64>,
    /// An estimate is felt by sliding: one that says it has none now may only stand still. Otherwise it is given up after `patience_s`.
    pub felt_by_sliding: bool,
}

impl ChoiceRules {
    /// Out of the law's parameters and the task.
    pub fn new(
        normal: &NormalConfig,
        patience: &PatienceConfig,
        switching: &SwitchingSpec,
    ) -> Self {
        Self {
            gate_rad: normal.gate_rad,
            switch_gate_rad: switching
                .disagreement_max_rad
                .unwrap_or(normal.switch_gate_rad),
            blind_distance_m: normal.blind_distance_m,
            patience_s: patience.estimate_s,
            return_after_good_s: switching.return_after_good_s,
            felt_by_sliding: true,
        }
    }
}

/// Why a switch was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SwitchRefusal {
    /// No task runs.
    NoTask,
    /// Not among the estimators that the controller listens to.
    Unknown,
    /// Nothing received, or too old.
    Silent,
    /// Says itself that it has no normal now.
    Invalid(Validity),
    /// Too far from the normal in use.
    Disagrees {
        /// Angle between the two, rad.
        angle_rad: f64,
        /// Allowed, rad.
        allowed_rad: f64,
    },
}

impl SwitchRefusal {
    /// The refusal as an error about `name`, in words.
    pub fn error(self, name: &str) -> ControlError {
        let reason = match self {
            Self::NoTask => {
                "no task runs; name it first in the task's `estimators` instead".to_owned()
            }
            Self::Unknown => "nobody publishes it, or the task's list is full".to_owned(),
            Self::Silent => "no fresh estimate from it: is it running?".to_owned(),
            Self::Invalid(validity) => format!(
                "it has no normal now ({}); try while sliding, or with --force",
                validity.reason()
            ),
            Self::Disagrees {
                angle_rad,
                allowed_rad,
            } => format!(
                "its normal is {:.1} deg from the one in use, allowed are {:.1}; --force switches all the same",
                angle_rad.to_degrees(),
                allowed_rad.to_degrees()
            ),
        };
        ControlError::SwitchRefused {
            name: name.to_owned(),
            reason,
        }
    }
}
