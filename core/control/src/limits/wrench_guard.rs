//! Decides each cycle whether the wrench is missing or invalid: stop within two cycles, retract if
//! the fault persists.

use tangent_sensing::Validity;

use crate::parameters::PatienceConfig;

/// Reaction to the wrench in this cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WrenchVerdict {
    /// Use it.
    Good,
    /// Invalid for less than the patience: no force control with it, no other reaction yet.
    Doubtful,
    /// Stand still.
    Stop(Validity),
    /// Leave the surface.
    Retract(Validity),
}

/// Counts the cycles with an invalid wrench.
#[derive(Clone, Copy, Debug, Default)]
pub struct WrenchGuard {
    bad_cycles: u32,
    stopped_s: f64,
}

impl WrenchGuard {
    /// Processes one cycle: the wrench's own status, whether all its numbers are finite, and its
    /// age, s.
    pub fn step(
        &mut self,
        patience: &PatienceConfig,
        validity: Validity,
        finite: bool,
        age_s: f64,
        dt_s: f64,
    ) -> WrenchVerdict {
        let old =
            age_s.is_nan() || age_s > patience.wrench_cycles * dt_s + patience.wrench_jitter_s;
        let reason = match validity {
            Validity::Valid if !finite => Validity::NotFinite,
            Validity::Valid if old => Validity::Stale,
            other => other,
        };
        if reason.is_valid() {
            *self = Self::default();
            return WrenchVerdict::Good;
        }
        self.bad_cycles = self.bad_cycles.saturating_add(1);
        let silent = matches!(reason, Validity::Stale | Validity::Missing);
        // An old or frozen wrench was already detected over time; any other invalid wrench may be a
        // single sample.
        let waited = silent || reason.is_judged_over_time();
        if !waited && self.bad_cycles < patience.wrench_bad_cycles {
            return WrenchVerdict::Doubtful;
        }
        self.stopped_s += dt_s;
        // Missing data may recover, so the arm waits for a moment. A sensor that is saturated or
        // reports an error gets no such time.
        if !silent || self.stopped_s > patience.wrench_retract_s {
            WrenchVerdict::Retract(reason)
        } else {
            WrenchVerdict::Stop(reason)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT: f64 = 0.008;

    fn step(guard: &mut WrenchGuard, validity: Validity, finite: bool, age: f64) -> WrenchVerdict {
        guard.step(&PatienceConfig::default(), validity, finite, age, DT)
    }

    #[test]
    fn one_bad_sample_is_forgiven_two_are_not() {
        for (validity, finite) in [
            (Validity::Valid, false),
            (Validity::Saturated, true),
            (Validity::SensorError, true),
        ] {
            let mut guard = WrenchGuard::default();
            assert_eq!(
                step(&mut guard, validity, finite, 0.0),
                WrenchVerdict::Doubtful
            );
            assert_eq!(
                step(&mut guard, Validity::Valid, true, 0.0),
                WrenchVerdict::Good
            );
            step(&mut guard, validity, finite, 0.0);
            assert!(matches!(
                step(&mut guard, validity, finite, 0.0),
                WrenchVerdict::Retract(_)
            ));
        }
    }

    #[test]
    fn what_was_judged_over_time_is_not_waited_for_again() {
        for validity in [
            Validity::Frozen,
            Validity::AxisStuck,
            Validity::Unresponsive,
            Validity::Implausible,
            Validity::Misdirected,
            Validity::ZeroJumped,
        ] {
            let mut guard = WrenchGuard::default();
            assert_eq!(
                step(&mut guard, validity, true, 0.0),
                WrenchVerdict::Retract(validity)
            );
        }
    }

    #[test]
    fn silence_stops_within_its_patience_then_retracts() {
        let mut guard = WrenchGuard::default();
        assert_eq!(
            step(&mut guard, Validity::Valid, true, 2.0 * DT),
            WrenchVerdict::Good
        );
        let mut stopped = 0;
        let last = loop {
            match step(&mut guard, Validity::Valid, true, 3.0 * DT) {
                WrenchVerdict::Stop(Validity::Stale) => stopped += 1,
                other => break other,
            }
        };
        assert_eq!(last, WrenchVerdict::Retract(Validity::Stale));
        assert_eq!(stopped, 12);
    }

    #[test]
    fn an_age_that_is_no_number_is_old() {
        let mut guard = WrenchGuard::default();
        assert_eq!(
            step(&mut guard, Validity::Valid, true, f64::NAN),
            WrenchVerdict::Stop(Validity::Stale)
        );
    }
}
