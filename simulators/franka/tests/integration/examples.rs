//! What two examples of libfranka do, `communication_test` and `motion_with_control`, with the
//! third-party client: neither declares a load, and both are written for an arm that floats and
//! whose joints carry the inertia of their motors.

use franka::{Duration, JointVelocities, RobotState, Torques, motion_finished};
use tangent_live::timed;

use crate::client::{client, simulated};

#[test]
fn communication_test_ends_without_a_reflex() {
    timed(|| {
        let simulated = simulated();
        let robot = client(&simulated);
        let torque = [20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0];
        let force = [20.0, 20.0, 20.0, 25.0, 25.0, 25.0];
        robot
            .set_collision_behavior(torque, torque, torque, torque, force, force, force, force)
            .unwrap();
        let start = robot.read_once().unwrap();
        assert_eq!(start.m_load, 0.3, "the tool is in the robot's load");
        let mut time_s = 0.0;
        robot
            .control_torques(
                |_: &RobotState, step: Duration| {
                    time_s += step.as_secs_f64();
                    let torque = Torques::new([0.0; 7]);
                    if time_s < 4.0 {
                        torque
                    } else {
                        motion_finished(torque)
                    }
                },
                false,
                1000.0,
            )
            .unwrap();
        let q = robot.read_once().unwrap().q;
        let moved = (0..7)
            .map(|i| (q[i] - start.q[i]).abs())
            .fold(0.0, f64::max);
        assert!(moved < 5e-3, "{moved} rad");
    });
}

/// Speed of one joint: up to 0.5 rad/s within a second, there for a second, and down again.
fn speed_at(time_s: f64) -> f64 {
    let ramp =
        |t: f64| 0.5 * t - (2.0 * std::f64::consts::PI * t).sin() / (4.0 * std::f64::consts::PI);
    match time_s {
        t if t <= 1.0 => ramp(t),
        t if t <= 2.0 => 0.5,
        t if t <= 3.0 => ramp(3.0 - t),
        _ => 0.0,
    }
}

#[test]
fn motion_with_control_follows_its_velocities() {
    timed(|| {
        let simulated = simulated();
        let robot = client(&simulated);
        robot
            .set_collision_behavior(
                [20.0; 7], [20.0; 7], [10.0; 7], [10.0; 7], [20.0; 6], [20.0; 6], [10.0; 6],
                [10.0; 6],
            )
            .unwrap();
        let start = robot.read_once().unwrap().q;
        let mut speeds = [[0.0; 7]; 5];
        let mut cycle = 0;
        let mut time_s = 0.0;
        robot
            .control_torques_and_joint_velocities(
                |state: &RobotState, _: Duration| {
                    speeds[cycle % 5] = state.dq;
                    cycle += 1;
                    Torques::new(std::array::from_fn(|i| {
                        let mean = speeds.iter().map(|dq| dq[i]).sum::<f64>() / 5.0;
                        200.0 * (state.q_d[i] - state.q[i]) - 10.0 * mean
                    }))
                },
                |_: &RobotState, step: Duration| {
                    time_s += step.as_secs_f64();
                    let mut dq = [0.0; 7];
                    dq[3] = speed_at(time_s);
                    let dq = JointVelocities::new(dq);
                    if time_s < 3.5 {
                        dq
                    } else {
                        motion_finished(dq)
                    }
                },
                true,
                franka::DEFAULT_CUTOFF_FREQUENCY,
            )
            .unwrap();
        let q = robot.read_once().unwrap().q;
        assert!((q[3] - start[3] - 1.0).abs() < 0.02, "{q:?}");
        let snapshot = simulated.snapshot().unwrap();
        assert_eq!(snapshot.state.reflex_reason.to_string(), "");
    });
}
