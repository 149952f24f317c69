//! Estimate of the external torques on an arm's joints from positions, velocities and motor
//! torques.
//!
//! Called once per period for arms without a force sensor at the wrist, such as the simulated
//! Panda: the controller of the real one has such an observer. De Luca, Albu-Schäffer, Haddadin,
//! Hirzinger 2006. Torques that the model leaves out, joint friction above all, count as external.

use nalgebra::{SMatrix, Vector6};
use tangent_mechanics::linear_solve::solve_positive_definite;
use tangent_mechanics::{Arm, Joints};

/// Generalised-momentum observer, `r' = K (M q̈ - τ + C q̇ + g - r)`: the external torques behind a
/// first-order low-pass of bandwidth `K`.
///
/// It does not need the acceleration: the change of the momentum over a period is the mean of the
/// torques.
///
/// ```
/// use tangent_mechanics::{Arm, Joints, ModelData};
/// use tangent_sensing::{MomentumObserver, MomentumObserverState};
///
/// let arm = Arm::<7>::new(&ModelData::builtin("panda")?)?;
/// let observer = MomentumObserver { gain_per_s: 50.0 };
/// let mut state = MomentumObserverState::default();
/// // The motors hold the arm against gravity and against 2 Nm on the last joint.
/// let (q, mut torque) = (arm.home(), arm.gravity(&arm.home()));
/// torque[6] -= 2.0;
/// let mut external = Joints::zeros();
/// for _ in 0..500 {
///     external = observer.update(&mut state, &arm, &q, &Joints::zeros(), &torque, 1e-3);
/// }
/// assert!((external[6] - 2.0).abs() < 1e-6);
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MomentumObserver {
    /// Bandwidth `K`, 1/s.
    pub gain_per_s: f64,
}

/// State of a [`MomentumObserver`]. A new one is the reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MomentumObserverState<const N: usize> {
    last: Option<LastPeriod<N>>,
    residual: Joints<N>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct LastPeriod<const N: usize> {
    mass: SMatrix<f64, N, N>,
    bias: Joints<N>,
    qd: Joints<N>,
}

impl<const N: usize> Default for MomentumObserverState<N> {
    fn default() -> Self {
        Self {
            last: None,
            residual: Joints::zeros(),
        }
    }
}

impl MomentumObserver {
    /// Updates the estimate with one period of `dt_s`, in which the motors exerted `torque` (Nm)
    /// and which ended with the arm at `q` (rad) and `qd` (rad/s). Returns the external torques,
    /// Nm.
    ///
    /// The estimate is zero after the first period. An input that is not finite changes nothing.
    pub fn update<const N: usize>(
        &self,
        state: &mut MomentumObserverState<N>,
        model: &Arm<N>,
        q: &Joints<N>,
        qd: &Joints<N>,
        torque: &Joints<N>,
        dt_s: f64,
    ) -> Joints<N> {
        if !q.iter().all(|v| v.is_finite()) {
            return state.residual;
        }
        self.update_with(state, model.mass_matrix_and_bias(q, qd), qd, torque, dt_s)
    }

    /// As [`update`](Self::update), with the mass matrix and the bias torques of the arm at the end
    /// of the period, for a caller that has them.
    pub fn update_with<const N: usize>(
        &self,
        state: &mut MomentumObserverState<N>,
        (mass, bias): (SMatrix<f64, N, N>, Joints<N>),
        qd: &Joints<N>,
        torque: &Joints<N>,
        dt_s: f64,
    ) -> Joints<N> {
        let sound = |x: &Joints<N>| x.iter().all(|v| v.is_finite());
        if !(sound(&bias) && sound(qd) && sound(torque) && dt_s > 0.0) {
            return state.residual;
        }
        if let Some(last) = state.last {
            let momentum = (mass + last.mass) * (qd - last.qd) * (0.5 / dt_s);
            let external = momentum - torque + (bias + last.bias) * 0.5;
            // Implicit in r, so that every gain is stable.
            let share = self.gain_per_s * dt_s;
            state.residual += (external - state.residual) * (share / (1.0 + share));
        }
        state.last = Some(LastPeriod {
            mass,
            bias,
            qd: *qd,
        });
        state.residual
    }
}

/// Least-squares wrench (N, then Nm), at the point and in the axes of the Jacobian, that explains
/// `torque` (Nm) on the joints: `(J Jᵀ)⁻¹ J τ`, damped near singularities.
///
/// ```
/// use nalgebra::Vector6;
/// use tangent_mechanics::{Arm, ModelData};
/// use tangent_sensing::wrench_of_torques;
///
/// let arm = Arm::<7>::new(&ModelData::builtin("panda")?)?;
/// let jacobian = arm.jacobian(&arm.home());
/// let wrench = Vector6::new(0.0, 0.0, 10.0, 0.0, 0.0, 0.0);
/// let found = wrench_of_torques(&jacobian, &(jacobian.transpose() * wrench));
/// assert!((found - wrench).amax() < 0.05);
/// # Ok::<(), tangent_mechanics::ModelError>(())
/// ```
pub fn wrench_of_torques<const N: usize>(
    jacobian: &SMatrix<f64, 6, N>,
    torque: &Joints<N>,
) -> Vector6<f64> {
    /// Added to the squared singular values (m or rad): below 0.03 m, the wrench decays.
    const DAMPING: f64 = 1e-5;
    let square = jacobian * jacobian.transpose() + SMatrix::<f64, 6, 6>::identity() * DAMPING;
    solve_positive_definite(&square, &(jacobian * torque)).unwrap_or_else(Vector6::zeros)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use tangent_mechanics::{ModelData, Pose};

    const DT: f64 = 1e-3;

    fn panda() -> Arm<7> {
        Arm::new(&ModelData::builtin("panda").unwrap()).unwrap()
    }

    proptest! {
        #[test]
        fn a_constant_push_on_a_moving_arm_is_found(
            qd in prop::array::uniform7(-0.3f64..0.3), push in prop::array::uniform7(-5.0f64..5.0)) {
            let arm = panda();
            let observer = MomentumObserver { gain_per_s: 80.0 };
            let mut state = MomentumObserverState::default();
            let (mut q, mut qd) = (arm.home(), Joints::<7>::from(qd));
            let push = Joints::<7>::from(push);
            let mut found = Joints::<7>::zeros();
            for _ in 0..400 {
                // Motors hold against the push but for a part that keeps the arm turning about.
                let torque = arm.gravity(&q) - push - qd * 2.0;
                for _ in 0..10 {
                    let qdd = arm.forward_dynamics(&q, &qd, &(torque + push));
                    qd += qdd * (DT / 10.0);
                    q += qd * (DT / 10.0);
                }
                found = observer.update(&mut state, &arm, &q, &qd, &torque, DT);
            }
            prop_assert!((found - push).amax() < 0.02, "{found} {push}");
        }
    }

    #[test]
    fn a_step_comes_through_with_the_stated_time_constant() {
        let arm = panda();
        let observer = MomentumObserver { gain_per_s: 50.0 };
        let mut state = MomentumObserverState::default();
        let (q, rest) = (arm.home(), Joints::<7>::zeros());
        let held = arm.gravity(&q) - Joints::<7>::repeat(1.0);
        let mut found = Joints::<7>::zeros();
        for _ in 0..21 {
            found = observer.update(&mut state, &arm, &q, &rest, &held, DT);
        }
        // 20 ms are one time constant.
        assert!((found[3] - (1.0 - (-1.0f64).exp())).abs() < 0.02, "{found}");
    }

    #[test]
    fn joint_friction_is_part_of_the_answer() {
        let arm = panda();
        let observer = MomentumObserver { gain_per_s: 50.0 };
        let mut state = MomentumObserverState::default();
        let (mut q, qd) = (arm.home(), Joints::<7>::repeat(0.05));
        let mut found = Joints::<7>::zeros();
        for _ in 0..500 {
            q += qd * DT;
            // Motors that keep up a constant speed against 0.5 Nm of friction.
            let (_, bias) = arm.mass_matrix_and_bias(&q, &qd);
            found = observer.update(&mut state, &arm, &q, &qd, &bias.add_scalar(0.5), DT);
        }
        assert!(found.iter().all(|x| (x + 0.5).abs() < 0.01), "{found}");
    }

    #[test]
    fn a_wrench_comes_back_from_its_torques() {
        let arm = panda();
        let jacobian = arm.jacobian_at(&arm.home(), &Pose::identity());
        let wrench = Vector6::new(3.0, -2.0, 15.0, 0.2, 0.1, -0.3);
        let back = wrench_of_torques(&jacobian, &jacobian.tr_mul(&wrench));
        assert!((back - wrench).norm() < 0.01, "{back}");
    }

    #[test]
    fn nonsense_changes_nothing() {
        let arm = panda();
        let observer = MomentumObserver { gain_per_s: 50.0 };
        let mut state = MomentumObserverState::default();
        let (q, rest) = (arm.home(), Joints::<7>::zeros());
        observer.update(&mut state, &arm, &q, &rest, &arm.gravity(&q), DT);
        let before = state;
        let bad = Joints::<7>::repeat(f64::NAN);
        observer.update(&mut state, &arm, &q, &bad, &arm.gravity(&q), DT);
        assert_eq!(before, state);
    }
}
