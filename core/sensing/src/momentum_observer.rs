//! Torques that the environment puts on a torque-controlled arm's joints, from positions,
//! velocities and motor torques alone.
//!
//! Called once per period for arms without a force sensor at the wrist: the simulated Panda, whose
//! own controller does the same. De Luca, Albu-Schäffer, Haddadin, Hirzinger 2006. Whatever the
//! model leaves out is in the answer too, joint friction first of all.

use nalgebra::{SMatrix, Vector6};
use tangent_mechanics::linear_solve::solve_positive_definite;
use tangent_mechanics::{Arm, Joints};

/// Generalised-momentum observer, `r' = K (M q̈ - τ + C q̇ + g - r)`: the environment's torques
/// behind a low-pass of gain `K`.
///
/// The acceleration never appears: over a period the momentum changes by what the torques were on
/// average.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MomentumObserver {
    /// `K`, 1/s.
    pub gain_per_s: f64,
}

/// Memory of a [`MomentumObserver`]; a new one is the reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MomentumObserverState<const N: usize> {
    last: Option<Last<N>>,
    residual: Joints<N>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Last<const N: usize> {
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
    /// One period of `dt_s` that ended with the arm at `q` (rad) and `qd` (rad/s), and in which the
    /// motors gave `torque` (Nm). Returns the estimate of what the environment did, Nm. Zero after
    /// the first period; input that is not finite changes nothing.
    pub fn update<const N: usize>(
        &self,
        state: &mut MomentumObserverState<N>,
        model: &Arm<N>,
        q: &Joints<N>,
        qd: &Joints<N>,
        torque: &Joints<N>,
        dt_s: f64,
    ) -> Joints<N> {
        let sound = |x: &Joints<N>| x.iter().all(|v| v.is_finite());
        if !(sound(q) && sound(qd) && sound(torque) && dt_s > 0.0) {
            return state.residual;
        }
        let (mass, bias) = model.mass_matrix_and_bias(q, qd);
        if let Some(last) = state.last {
            let momentum = (mass + last.mass) * (qd - last.qd) * (0.5 / dt_s);
            let external = momentum - torque + (bias + last.bias) * 0.5;
            // Implicit in r, so that no gain is unstable.
            let share = self.gain_per_s * dt_s;
            state.residual += (external - state.residual) * (share / (1.0 + share));
        }
        state.last = Some(Last {
            mass,
            bias,
            qd: *qd,
        });
        state.residual
    }
}

/// The wrench at the Jacobian's point and in its axes (N, then Nm) that comes nearest to `torque`
/// (Nm) on the joints: `(J Jᵀ)⁻¹ J τ`, damped where the arm is nearly singular.
pub fn wrench_of_torques<const N: usize>(
    jacobian: &SMatrix<f64, 6, N>,
    torque: &Joints<N>,
) -> Vector6<f64> {
    /// Against a singular value in metres or radians: below 0.03 the answer fades.
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
