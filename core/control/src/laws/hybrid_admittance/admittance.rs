//! Eq. (1) of Tugal et al.: from the force error to a compliant velocity, `f_r - f_e = M v' + D v`.
//!
//! Called by the controller each cycle, in the axes of the contact: z is the surface normal, out of
//! the material.
//!
//! **Sign.** The paper's wrenches are those of the robot on the surface; ours are those of the
//! surface on the robot. Both sides change sign, so the right-hand side stays and the error is
//! *measured minus reference*: pressing too hard moves the tool out.

use nalgebra::Vector6;
use tangent_mechanics::{Contact, Twist, Wrench};

/// Diagonal virtual inertia and damping, and the paper's selection `Ω`. Constant parameters; the
/// motion is in [`AdmittanceState`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Admittance {
    /// Virtual inertia: linear (kg), then angular (kg m²).
    pub inertia: Vector6<f64>,
    /// Virtual damping: linear (Ns/m), then angular (Nms/rad).
    pub damping: Vector6<f64>,
    /// One for force-controlled axes, zero for motion-controlled axes: the paper's `Ω = diag(0, 0,
    /// 1, 1, 1, 0)`.
    pub selection: Vector6<f64>,
}

/// State of eq. (1): the velocity of the last cycle.
#[derive(Clone, Copy, Debug)]
pub struct AdmittanceState {
    /// Twist in contact axes, m/s and rad/s.
    pub twist: Twist<Contact>,
}

impl Default for AdmittanceState {
    fn default() -> Self {
        Self {
            twist: Twist::zero(),
        }
    }
}

impl Admittance {
    /// The paper's selection: force along the normal, torque about the tangential axes.
    pub fn force_along_normal(
        mass_kg: f64,
        inertia_kg_m2: f64,
        damping: f64,
        turn_damping: f64,
    ) -> Self {
        Self {
            inertia: Vector6::new(
                mass_kg,
                mass_kg,
                mass_kg,
                inertia_kg_m2,
                inertia_kg_m2,
                inertia_kg_m2,
            ),
            damping: Vector6::new(
                damping,
                damping,
                damping,
                turn_damping,
                turn_damping,
                turn_damping,
            ),
            selection: Vector6::new(0.0, 0.0, 1.0, 1.0, 1.0, 0.0),
        }
    }

    /// Processes one cycle of `dt_s` with a constant `error` (measured minus reference, N and Nm),
    /// by the exact solution of eq. (1): stable for every ratio of inertia to damping. Returns the
    /// selected velocity.
    pub fn step(
        &self,
        state: &mut AdmittanceState,
        error: &Wrench<Contact>,
        dt_s: f64,
    ) -> Twist<Contact> {
        let error = error.vector();
        let mut v = state.twist.vector();
        for i in 0..6 {
            let steady = error[i] / self.damping[i];
            // A massless axis has no memory: the exponent is minus infinity.
            let memory = (-self.damping[i] * dt_s / self.inertia[i]).exp();
            v[i] = self.selection[i] * (steady + (v[i] - steady) * memory);
        }
        state.twist = Twist::from_vector(&v);
        state.twist
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;
    use proptest::prelude::*;

    fn paper() -> Admittance {
        Admittance::force_along_normal(1.0, 0.04, 150.0, 1.5)
    }

    fn push(force: f64, torque: f64) -> Wrench<Contact> {
        Wrench::new(
            Vector3::new(force, force, force),
            Vector3::new(torque, torque, torque),
        )
    }

    #[test]
    fn a_step_follows_the_closed_form_at_any_rate() {
        let law = paper();
        for dt in [0.002, 0.008] {
            let mut state = AdmittanceState::default();
            for i in 1..=50 {
                let twist = law.step(&mut state, &push(-3.0, 0.1), dt);
                let t = dt * f64::from(i);
                let linear = -3.0 / 150.0 * (1.0 - (-150.0 * t).exp());
                let angular = 0.1 / 1.5 * (1.0 - (-1.5 / 0.04 * t).exp());
                assert!((twist.linear.z - linear).abs() < 1e-12);
                assert!((twist.angular.x - angular).abs() < 1e-12);
                assert!((twist.angular.y - angular).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn only_the_selected_axes_move() {
        let mut state = AdmittanceState::default();
        let twist = paper().step(&mut state, &push(5.0, 5.0), 0.008);
        assert_eq!(
            (twist.linear.x, twist.linear.y, twist.angular.z),
            (0.0, 0.0, 0.0)
        );
        assert!(twist.linear.z > 0.0);
    }

    #[test]
    fn without_mass_the_velocity_is_error_over_damping() {
        let law = Admittance::force_along_normal(0.0, 0.0, 500.0, 1.5);
        let mut state = AdmittanceState::default();
        let twist = law.step(&mut state, &push(1.0, 0.0), 0.008);
        assert_eq!(twist.linear.z, 1.0 / 500.0);
    }

    proptest! {
        /// Passive at its port: the energy out never exceeds the energy in.
        #[test]
        fn energy_out_is_at_most_energy_in(forces in prop::collection::vec(-20.0f64..20.0, 1..200), d in 10.0f64..3000.0) {
            let law = Admittance::force_along_normal(1.0, 0.04, d, 1.5);
            let mut state = AdmittanceState::default();
            let dt = 0.008;
            let mut given = 0.0;
            for force in forces {
                let before = state.twist.linear.z;
                let after = law.step(&mut state, &push(force, 0.0), dt).linear.z;
                // Distance in the cycle, from the closed form: integral of v.
                let steady = force / d;
                let way = steady * dt + (before - steady) * (1.0 - (-d * dt).exp()) / d;
                given += force * way;
                prop_assert!(0.5 * after * after <= given + 1e-9);
            }
        }
    }
}
