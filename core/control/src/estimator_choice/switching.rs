//! Switches between estimators: their rules, their causes, and why one is refused.
//!
//! `estimator_choice` applies the rules; the service reports causes and refusals.

use tangent_sensing::Validity;

use crate::error::ControlError;
use crate::laws::hybrid_admittance::NormalConfig;
use crate::parameters::PatienceConfig;
use crate::task::SwitchingSpec;

/// Why the estimator in use was chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SwitchCause {
    /// It is the first of the task's list.
    #[default]
    Task,
    /// It was requested, and its normal was close enough to the one in use.
    Asked,
    /// It was requested with force: neither its validity nor its agreement was checked.
    Forced,
    /// The estimator before it could no longer be used, for this reason.
    FellBack(Validity),
    /// It is the preferred one, and has been usable again for the task's
    /// `switching.return_after_good_s`.
    Returned,
}

impl SwitchCause {
    /// The cause as text, followed by the reason of a fallback (otherwise empty).
    pub fn text(self) -> (&'static str, &'static str) {
        match self {
            Self::Task => ("first of the task's list", ""),
            Self::Asked => ("asked for", ""),
            Self::Forced => ("forced", ""),
            Self::FellBack(reason) => ("fell back: the previous one is ", reason.reason()),
            Self::Returned => ("returned after it was valid again", ""),
        }
    }
}

/// Rules by which an estimate is used and another estimator is chosen.
#[derive(Clone, Copy, Debug)]
pub struct ChoiceRules {
    /// Largest angle between an estimate of the current estimator and the normal in use, rad.
    pub gate_rad: f64,
    /// Largest angle between the normal in use and that of an estimator to switch to, rad.
    pub switch_gate_rad: f64,
    /// Distance slid without a valid estimate before the next estimator is chosen, m.
    pub blind_distance_m: f64,
    /// Time without an estimate, or with unusable ones, before the next estimator is chosen, s.
    pub patience_s: f64,
    /// Time for which the preferred estimator must be usable before it is chosen again, s; `None`:
    /// only on request.
    pub return_after_good_s: Option<f64>,
    /// Whether the estimators measure by sliding. An invalid estimate may then only mean that the
    /// tool stands still, and is tolerated until `blind_distance_m` has been slid. Otherwise it is
    /// tolerated for `patience_s`.
    pub felt_by_sliding: bool,
}

impl ChoiceRules {
    /// Rules from the parameters of the law and the task, for estimators that measure by sliding.
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

/// Largest angle between two normals for a switch without force, in a torque law whose task does
/// not set one, rad.
const TORQUE_SWITCH_GATE_RAD: f64 = 0.2;

impl ChoiceRules {
    /// Rules of a torque law. For `felt_by_sliding`, see the field.
    pub fn of_torques(
        patience: &PatienceConfig,
        switching: &SwitchingSpec,
        felt_by_sliding: bool,
    ) -> Self {
        let normal = NormalConfig {
            switch_gate_rad: TORQUE_SWITCH_GATE_RAD,
            ..NormalConfig::default()
        };
        Self {
            felt_by_sliding,
            ..Self::new(&normal, patience, switching)
        }
    }
}

/// Why a switch was refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SwitchRefusal {
    /// No task runs.
    NoTask,
    /// The controller does not read this estimator.
    Unknown,
    /// No estimate was received, or the newest one is too old.
    Silent,
    /// The estimator reports that it has no valid normal.
    Invalid(Validity),
    /// Its normal is too far from the one in use.
    Disagrees {
        /// Angle between the two normals, rad.
        angle_rad: f64,
        /// Largest angle allowed, rad.
        allowed_rad: f64,
    },
}

impl SwitchRefusal {
    /// The refusal as an error about estimator `name`.
    pub fn error(self, name: &str) -> ControlError {
        let reason = match self {
            Self::NoTask => {
                "no task runs; name it first in the task's `estimators` instead".to_owned()
            }
            Self::Unknown => "no estimator publishes it, or the task's list is full".to_owned(),
            Self::Silent => "no fresh estimate from it: is it running?".to_owned(),
            Self::Invalid(validity) => format!(
                "it has no normal now ({}); try while sliding, or with --force",
                validity.reason()
            ),
            Self::Disagrees {
                angle_rad,
                allowed_rad,
            } => format!(
                "its normal is {:.1} deg from the one in use, and {:.1} is allowed; --force switches all the same",
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
