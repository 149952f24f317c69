//! Force on the tool of a torque-controlled arm as its motors show it, independent of any sensor: a
//! generalised-momentum observer on the commanded torques and the joints' motion.

use nalgebra::{SMatrix, Vector3};
use tangent_mechanics::{JointFriction, Joints};
use tangent_sensing::{MomentumObserver, MomentumObserverState, wrench_of_torques};

/// Gain of the observer, 1/s: slow enough for a delay of several periods in the torques.
const OBSERVER_PER_S: f64 = 40.0;

/// State of the estimate. A new one is the reset.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MotorForce<const N: usize> {
    observer: MomentumObserverState<N>,
    torque: Option<Joints<N>>,
}

impl<const N: usize> MotorForce<N> {
    /// Force of the environment on the tool, base axes, N, at the end of a period with `qd`
    /// (rad/s). `dynamics` are the arm's mass matrix and the torques against gravity and Coriolis
    /// forces (Nm) then; `jacobian` is that of the tool. `None` without torques that the arm takes.
    pub fn step(
        &mut self,
        dynamics: (SMatrix<f64, N, N>, Joints<N>),
        friction: &JointFriction<N>,
        qd: &Joints<N>,
        jacobian: &SMatrix<f64, 6, N>,
        dt_s: f64,
    ) -> Option<Vector3<f64>> {
        let Some(torque) = self.torque else {
            self.observer = MomentumObserverState::default();
            return None;
        };
        let observer = MomentumObserver {
            gain_per_s: OBSERVER_PER_S,
        };
        let known = torque - friction.torque(qd);
        let external = observer.update_with(&mut self.observer, dynamics, qd, &known, dt_s);
        let wrench = wrench_of_torques(jacobian, &external);
        Some(wrench.fixed_rows::<3>(0).into_owned())
    }

    /// Takes the torques of the motors in the next period, with those against gravity, Nm; `None`
    /// if the arm takes none.
    pub fn commanded(&mut self, torque: Option<Joints<N>>) {
        self.torque = torque;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector6;
    use tangent_mechanics::{Arm, ModelData};

    #[test]
    fn a_wall_in_the_way_shows_in_the_torques() {
        let arm = Arm::<7>::new(&ModelData::builtin("panda").unwrap()).unwrap();
        let (q, qd) = (arm.home(), Joints::<7>::zeros());
        let jacobian = arm.jacobian(&q);
        let friction = JointFriction::from_lists(&[], &[], 1.0);
        let mut force = MotorForce::default();
        let mut step = |torque| {
            let dynamics = arm.mass_matrix_and_bias(&q, &qd);
            let seen = force.step(dynamics, &friction, &qd, &jacobian, 1e-3);
            force.commanded(torque);
            seen
        };
        let wall = Vector6::new(0.0, 0.0, 25.0, 0.0, 0.0, 0.0);
        let pushed = arm.gravity(&q) - jacobian.tr_mul(&wall);
        assert_eq!(step(Some(pushed)), None);
        let seen = (0..1000).map(|_| step(Some(pushed))).last().flatten();
        let seen = seen.unwrap();
        assert!((seen - Vector3::z() * 25.0).amax() < 0.5, "{seen}");
        step(None);
        assert_eq!(step(None), None);
    }
}
