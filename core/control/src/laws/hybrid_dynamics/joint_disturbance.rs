//! What the model of the joints' friction misses, estimated from the arm's motion: a
//! generalised-momentum observer whose known torques are those of the motors, of the compensated
//! friction and of the measured wrench.

use nalgebra::SMatrix;
use tangent_mechanics::{JointFriction, Joints};
use tangent_sensing::{MomentumObserver, MomentumObserverState};

use super::FrictionDoubtConfig;

/// State of the estimate.
#[derive(Clone, Copy, Debug)]
pub(super) struct JointDisturbance<const N: usize> {
    observer: MomentumObserverState<N>,
    /// Torques of the motors in the last period less those that compensated friction, Nm.
    driving: Option<Joints<N>>,
}

impl<const N: usize> Default for JointDisturbance<N> {
    fn default() -> Self {
        Self {
            observer: MomentumObserverState::default(),
            driving: None,
        }
    }
}

impl<const N: usize> JointDisturbance<N> {
    /// Motor torques beyond `friction` that balance what acts on the joints, Nm, at the end of a
    /// period with `qd` (rad/s). `dynamics` are the arm's mass matrix and the torques against
    /// gravity and Coriolis forces (Nm) then, `contact` the torques of the measured wrench on the
    /// joints, Nm.
    ///
    /// The result is within the stated share of the modelled friction. A contact that the sensor
    /// does not measure looks like friction; without the bound the arm would push against it.
    pub fn step(
        &mut self,
        config: &FrictionDoubtConfig,
        dynamics: (SMatrix<f64, N, N>, Joints<N>),
        friction: &JointFriction<N>,
        qd: &Joints<N>,
        contact: &Joints<N>,
        dt_s: f64,
    ) -> Joints<N> {
        let Some(driving) = self.driving.filter(|_| config.share > 0.0) else {
            return Joints::zeros();
        };
        let observer = MomentumObserver {
            gain_per_s: config.observer_per_s,
        };
        let known = driving + contact;
        let missed = -observer.update_with(&mut self.observer, dynamics, qd, &known, dt_s);
        Joints::from_fn(|i, _| {
            let modelled = friction.coulomb[i] + friction.viscous[i] * qd[i].abs();
            let most = config.share * modelled;
            missed[i].clamp(-most, most)
        })
    }

    /// Takes the torques commanded for the next period and the part of them that compensates
    /// modelled friction, Nm.
    pub fn commanded(&mut self, torque: &Joints<N>, rubbed: &Joints<N>) {
        self.driving = Some(torque - rubbed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tangent_mechanics::{Arm, ModelData};

    fn arm() -> Arm<6> {
        Arm::new(&ModelData::builtin("smart3s_substitute").unwrap()).unwrap()
    }

    /// Moves the arm at constant speed against `truth`, with the observer's answer applied.
    fn found(truth: &JointFriction<6>, modelled: &JointFriction<6>, share: f64) -> Joints<6> {
        let config = FrictionDoubtConfig {
            share,
            observer_per_s: 60.0,
        };
        let (arm, dt) = (arm(), 1e-3);
        let mut disturbance = JointDisturbance::default();
        let (mut q, qd) = (arm.home(), Joints::<6>::repeat(0.05));
        let mut doubt = Joints::zeros();
        for _ in 0..1000 {
            let dynamics = arm.mass_matrix_and_bias(&q, &qd);
            doubt = disturbance.step(&config, dynamics, modelled, &qd, &Joints::zeros(), dt);
            // At constant speed the motors balance gravity, Coriolis terms and the true friction.
            let (_, bias) = dynamics;
            let rubbed = modelled.torque(&qd);
            disturbance.commanded(&(bias + truth.torque(&qd)), &rubbed);
            q += qd * dt;
        }
        doubt
    }

    #[test]
    fn friction_that_the_model_misses_is_found() {
        let truth = JointFriction::<6>::from_lists(&[10.0], &[5.0], 0.001);
        let modelled = JointFriction::<6>::from_lists(&[10.0], &[4.0], 0.001);
        let doubt = found(&truth, &modelled, 0.5);
        assert!(doubt.iter().all(|x| (x - 1.0).abs() < 0.1), "{doubt}");
    }

    #[test]
    fn it_stays_within_its_share_of_the_model_and_needs_one() {
        let truth = JointFriction::<6>::from_lists(&[0.0], &[50.0], 0.001);
        let modelled = JointFriction::<6>::from_lists(&[0.0], &[4.0], 0.001);
        assert_eq!(found(&truth, &modelled, 0.5), Joints::<6>::repeat(2.0));
        assert_eq!(found(&truth, &modelled, 0.0), Joints::<6>::zeros());
        let none = JointFriction::<6>::from_lists(&[], &[], 0.001);
        assert_eq!(found(&truth, &none, 0.5), Joints::<6>::zeros());
    }
}
