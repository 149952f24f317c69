//! Hold of a torque-controlled arm while motion is not permitted: the arm brakes and holds the
//! position where it was stopped.

use tangent_mechanics::{Arm, Joints};

/// Bandwidth of the hold, rad/s, critically damped. It acts on accelerations, so one value serves
/// all joints.
const HOLD_RAD_PER_S: f64 = 60.0;
/// Time constant with which the motion and the torques before the stop decay, s. The torques do not
/// jump, as the motors limit their rate.
const FADE_S: f64 = 0.08;

/// State of the hold; a new one for each stop.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct OwnHold<const N: usize> {
    fading: Option<Fading<N>>,
}

#[derive(Clone, Copy, Debug)]
struct Fading<const N: usize> {
    /// Position that is held, rad, and its velocity, rad/s.
    place: Joints<N>,
    speed: Joints<N>,
    /// Difference between the torques before the stop and those of the hold, Nm.
    beyond: Joints<N>,
}

impl<const N: usize> OwnHold<N> {
    /// Torques (Nm), including gravity, for the arm at `q` (rad) and `qd` (rad/s), from the robot's
    /// own `model`; `last` are the torques of the previous period, which lasted `dt` s.
    pub fn torque(
        &mut self,
        model: &Arm<N>,
        q: &Joints<N>,
        qd: &Joints<N>,
        last: &Joints<N>,
        dt: f64,
    ) -> Joints<N> {
        let (mass, bias) = model.mass_matrix_and_bias(q, qd);
        let now = self.fading.get_or_insert_with(|| Fading {
            place: *q,
            speed: *qd,
            beyond: last - bias,
        });
        let share = (dt / FADE_S).min(1.0);
        now.place += now.speed * dt;
        now.speed *= 1.0 - share;
        now.beyond *= 1.0 - share;
        let acceleration = (now.place - q) * (HOLD_RAD_PER_S * HOLD_RAD_PER_S)
            + (now.speed - qd) * (2.0 * HOLD_RAD_PER_S);
        mass * acceleration + bias + now.beyond
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::arms::torque_arm::{TorqueArm, TorqueArmConfig};
    use tangent_mechanics::ModelData;

    #[test]
    fn a_moving_arm_comes_to_rest_near_where_it_was_stopped() {
        let model = Arm::<7>::new(&ModelData::builtin("panda").unwrap()).unwrap();
        let mut arm = TorqueArm::new(model, &TorqueArmConfig::default(), model.home());
        arm.qd = Joints::repeat(0.2);
        let (start, mut hold) = (arm.q, OwnHold::default());
        let mut torque = model.gravity(&arm.q);
        for _ in 0..2000 {
            torque = hold.torque(&model, &arm.q, &arm.qd, &torque, 1e-3);
            for _ in 0..4 {
                arm.step(&torque, &Joints::zeros(), 2.5e-4);
            }
        }
        let way = (arm.q - start).amax();
        assert!(arm.qd.amax() < 1e-6 && way < 0.2 * 1.1 * FADE_S, "{way}");
    }
}
