//! Energy tank: a store that active control draws from and dissipation fills, so that the
//! controlled system stays passive. Karacan et al., eqs. (38)-(45) and (57)-(63).
//!
//! `unified_force_impedance` holds one for motion and one for force. The force law of the
//! velocity-controlled arm holds one if `force.tank` is set.

use serde::{Deserialize, Serialize};

use crate::error::{ControlError, check_range};

/// Limits of a tank.
///
/// ```
/// use tangent_control::EnergyTank;
///
/// let tank = EnergyTank {
///     initial_j: 2.0,
///     lower_j: 1.0,
///     upper_j: 2.0,
///     band_j: 0.2,
///     reserve_j: 0.05,
/// };
/// let mut state = tank.start();
/// // Full: a law may take all of its action, and no dissipated energy fits in.
/// assert_eq!((tank.valve(&state), tank.inlet(&state)), (1.0, 0.0));
///
/// // Work down to the reserve shuts the valve, until dissipation has filled the tank again.
/// tank.draw(&mut state, 0.96);
/// assert_eq!(tank.valve(&state), 0.0);
/// tank.fill(&mut state, 0.5);
/// assert_eq!(tank.valve(&state), 1.0);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnergyTank {
    /// Initial energy, J; with the paper's x_t, x_t² / 2.
    pub initial_j: f64,
    /// Minimum energy, J.
    pub lower_j: f64,
    /// Maximum energy, J.
    pub upper_j: f64,
    /// Energy range over which a valve opens or closes, J.
    pub band_j: f64,
    /// Reserve above the lower limit at which the valve is shut, J: covers the work of torques that
    /// are already commanded.
    pub reserve_j: f64,
}

/// Energy now in a tank.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct EnergyTankState {
    energy_j: f64,
}

/// Part of an exchange that the tank could not take or give.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exchange {
    /// Energy that did not fit below the upper limit, J: dissipated.
    pub overflow_j: f64,
    /// Energy requested below the lower limit, J. Zero as long as valve and reserve are respected.
    pub short_j: f64,
}

impl EnergyTank {
    /// A tank filled to its initial energy.
    pub fn start(&self) -> EnergyTankState {
        EnergyTankState {
            energy_j: self.initial_j,
        }
    }

    /// σ of eqs. (44) and (63), 0 to 1: share of its action that a law may take now. Smooth, and 0
    /// at the reserve and below.
    pub fn valve(&self, state: &EnergyTankState) -> f64 {
        smooth((state.energy_j - self.lower_j - self.reserve_j) / self.band_j)
    }

    /// β of eqs. (45) and (60), 0 to 1: share of the dissipated energy that the tank takes in now.
    /// Smooth, and 0 at the upper limit.
    pub fn inlet(&self, state: &EnergyTankState) -> f64 {
        smooth((self.upper_j - state.energy_j) / self.band_j)
    }

    /// Draws `work_j`, the work of the tank's action, J (negative: work was done on it). The port
    /// of eqs. (42) and (61), over one period.
    pub fn draw(&self, state: &mut EnergyTankState, work_j: f64) -> Exchange {
        let wanted = state.energy_j - work_j;
        state.energy_j = wanted.max(self.lower_j).min(self.upper_j);
        Exchange {
            overflow_j: (wanted - state.energy_j).max(0.0),
            short_j: (state.energy_j - wanted).max(0.0),
        }
    }

    /// Adds the dissipated energy `dissipated_j`, J (not negative); the inlet decides how much of
    /// it is kept. Eqs. (39) and (57).
    pub fn fill(&self, state: &mut EnergyTankState, dissipated_j: f64) -> Exchange {
        let kept = self.inlet(state) * dissipated_j.max(0.0);
        let inside = self.draw(state, -kept);
        Exchange {
            overflow_j: dissipated_j.max(0.0) - kept + inside.overflow_j,
            short_j: 0.0,
        }
    }

    /// Checks that every number is in its range; `name` is the table's name, for messages.
    ///
    /// # Errors
    /// Names the key, the value and the allowed range.
    pub fn check(&self, name: &str) -> Result<(), ControlError> {
        let key = |k: &str| format!("{name}.{k}");
        check_range(&key("lower_j"), self.lower_j, 0.0, 1000.0)?;
        check_range(&key("upper_j"), self.upper_j, self.lower_j + 1e-3, 10_000.0)?;
        let room = self.upper_j - self.lower_j;
        check_range(
            &key("initial_j"),
            self.initial_j,
            self.lower_j,
            self.upper_j,
        )?;
        check_range(&key("reserve_j"), self.reserve_j, 0.0, 0.5 * room)?;
        check_range(&key("band_j"), self.band_j, 1e-3, 0.5 * room)
    }
}

impl EnergyTankState {
    /// Stored energy, J.
    pub fn energy_j(&self) -> f64 {
        self.energy_j
    }
}

/// 0 below 0, 1 above 1, `u² (3 - 2u)` between.
pub(crate) fn smooth(u: f64) -> f64 {
    // NaN also gives 0: the valve is shut.
    if u > 0.0 {
        let u = u.min(1.0);
        u * u * (3.0 - 2.0 * u)
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FORCE: EnergyTank = EnergyTank {
        initial_j: 2.0,
        lower_j: 1.0,
        upper_j: 2.0,
        band_j: 0.2,
        reserve_j: 0.05,
    };

    proptest! {
        #[test]
        fn whatever_happens_it_stays_within_its_limits_and_loses_no_joule(
            steps in prop::collection::vec((-0.5f64..0.5, 0.0f64..0.3), 1..200)) {
            let mut state = FORCE.start();
            for (work, damped) in steps {
                let before = state.energy_j();
                let drawn = FORCE.draw(&mut state, work);
                let filled = FORCE.fill(&mut state, damped);
                prop_assert!(state.energy_j() >= FORCE.lower_j && state.energy_j() <= FORCE.upper_j);
                let books = before - work + damped - drawn.overflow_j - filled.overflow_j + drawn.short_j;
                prop_assert!((books - state.energy_j()).abs() < 1e-12);
            }
        }

        #[test]
        fn who_respects_the_valve_never_comes_short(powers in prop::collection::vec(-60.0f64..60.0, 1..2000)) {
            // A motor of 60 W through the valve in steps of 1 ms; the work of the last command is
            // still to come.
            let mut state = FORCE.start();
            let mut late = 0.0;
            for power in powers {
                prop_assert!(FORCE.draw(&mut state, late).short_j == 0.0);
                late = power * FORCE.valve(&state) * 1e-3;
            }
        }

        #[test]
        fn valve_and_inlet_open_without_a_step(energy in 1.0f64..2.0) {
            let at = |e: f64| EnergyTankState { energy_j: e };
            let h = 1e-6;
            for of in [EnergyTank::valve, EnergyTank::inlet] {
                let change = of(&FORCE, &at(energy + h)) - of(&FORCE, &at(energy));
                prop_assert!(change.abs() <= 1.5 * h / FORCE.band_j * (1.0 + 1e-6));
            }
        }
    }

    #[test]
    fn shut_at_the_limits_and_open_between() {
        let at = |e: f64| EnergyTankState { energy_j: e };
        assert_eq!(FORCE.valve(&at(1.04)), 0.0);
        assert_eq!(FORCE.valve(&at(1.26)), 1.0);
        assert_eq!(FORCE.inlet(&at(2.0)), 0.0);
        assert_eq!(FORCE.inlet(&at(1.79)), 1.0);
        assert_eq!(FORCE.valve(&at(f64::NAN)), 0.0);
    }

    #[test]
    fn a_bad_limit_is_named() {
        let bad = EnergyTank {
            initial_j: 3.0,
            ..FORCE
        };
        let error = bad.check("tanks.force").unwrap_err().to_string();
        assert!(error.contains("tanks.force.initial_j"), "{error}");
        FORCE.check("tanks.force").unwrap();
    }
}
