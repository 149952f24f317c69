//! Parameters that can be set while a task runs.

use crate::error::{ControlError, check_range};
use crate::limits::Limits;

/// A live parameter, as in `param/controller/NAME`. Each takes effect over a ramp.
///
/// ```
/// use tangent_control::{Limits, Parameter};
///
/// let force = Parameter::parse("force_reference_n", 5.0)?;
/// assert_eq!(force, Parameter::ForceReference);
/// // The default limits end a task at 40 N.
/// assert_eq!(force.range_within(&Limits::default()), (0.5, 40.0));
/// assert!(Parameter::parse("force_reference_n", 500.0).is_err());
/// # Ok::<(), tangent_control::ControlError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// Pressing force, N.
    ForceReference,
    /// Speed along the path, m/s.
    Speed,
    /// Gain of eq. (4), 1/s.
    AlignmentGain,
    /// Damping of eq. (1) along the normal, Ns/m: the minimum if it is adaptive.
    Damping,
}

impl Parameter {
    /// All live parameters.
    pub const ALL: [Self; 4] = [
        Self::ForceReference,
        Self::Speed,
        Self::AlignmentGain,
        Self::Damping,
    ];

    /// Name on the bus, with its unit.
    pub fn name(self) -> &'static str {
        match self {
            Self::ForceReference => "force_reference_n",
            Self::Speed => "speed_m_per_s",
            Self::AlignmentGain => "alignment_gain_per_s",
            Self::Damping => "damping_n_s_per_m",
        }
    }

    /// Minimum and maximum on an arm with these limits: the force stays below the one at which the
    /// task would end.
    pub fn range_within(self, limits: &Limits) -> (f64, f64) {
        let (lower, upper) = self.range();
        match self {
            Self::ForceReference => (lower, upper.min(limits.force_max_n).max(lower)),
            _ => (lower, upper),
        }
    }

    /// Minimum and maximum on any arm.
    pub fn range(self) -> (f64, f64) {
        match self {
            Self::ForceReference => (0.5, 100.0),
            Self::Speed => (0.0, 0.25),
            Self::AlignmentGain => (0.0, 10.0),
            Self::Damping => (10.0, 1e4),
        }
    }

    /// Parameter by name; checks that `value` is in its range.
    pub fn parse(name: &str, value: f64) -> Result<Self, ControlError> {
        let parameter = Self::ALL
            .into_iter()
            .find(|p| p.name() == name)
            .ok_or_else(|| ControlError::UnknownParameter {
                name: name.to_owned(),
                known: Self::ALL.map(Self::name).join(", "),
            })?;
        let (lower, upper) = parameter.range();
        check_range(name, value, lower, upper)?;
        Ok(parameter)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_by_name_and_checked() {
        for parameter in Parameter::ALL {
            let (lower, upper) = parameter.range();
            assert_eq!(Parameter::parse(parameter.name(), lower), Ok(parameter));
            assert!(Parameter::parse(parameter.name(), upper * 1.1 + 1.0).is_err());
            assert!(Parameter::parse(parameter.name(), f64::NAN).is_err());
        }
        let error = Parameter::parse("force", 1.0).unwrap_err().to_string();
        assert!(error.contains("force_reference_n"), "{error}");
    }

    #[test]
    fn no_force_is_asked_for_beyond_the_limit() {
        let limits = Limits {
            force_max_n: 30.0,
            ..Limits::default()
        };
        assert_eq!(Parameter::ForceReference.range_within(&limits), (0.5, 30.0));
        assert_eq!(
            Parameter::Speed.range_within(&limits),
            Parameter::Speed.range()
        );
    }
}
