//! A third-party client, `franka-rs`, against the simulated Franka: it connects, changes settings,
//! moves by torque and by joint motions, triggers a reflex and recovers.

use std::time::Duration;

use franka::{
    FciVersion, FrankaError, JointPositions, RealtimeConfig, Robot, RobotMode, Torques,
    motion_finished,
};
use tangent_live::timed;
use tangent_simulated_device::Ports;
use tangent_simulated_franka::{FciConfig, FciFault, SimulatedFranka};

const PATIENCE: Duration = Duration::from_secs(60);

pub fn simulated() -> SimulatedFranka {
    SimulatedFranka::start(&FciConfig {
        ports: Ports::Ephemeral,
        // On a busy machine, time runs slowly instead of losing answers. The client gives up after
        // 1 s without a state, so the robot must go on before.
        answer_wait_s: 0.5,
        ..FciConfig::default()
    })
    .unwrap()
}

pub fn client(robot: &SimulatedFranka) -> Robot {
    Robot::new(&robot.address().to_string(), RealtimeConfig::Ignore).unwrap()
}

fn set_up(robot: &Robot) {
    robot
        .set_collision_behavior(
            [20.0; 7], [40.0; 7], [20.0; 7], [40.0; 7], [20.0; 6], [60.0; 6], [20.0; 6], [60.0; 6],
        )
        .unwrap();
    robot
        .set_load(
            0.3,
            [0.0, 0.0, 0.05],
            [0.001, 0.0, 0.0, 0.0, 0.001, 0.0, 0.0, 0.0, 0.001],
        )
        .unwrap();
}

/// The client offers version 10 first, is refused, and reconnects with 5: two connections, one
/// session.
#[test]
fn it_finds_the_version_and_reads_states() {
    timed(|| {
        let simulated = simulated();
        let robot = client(&simulated);
        assert_eq!(robot.fci_version(), FciVersion::V5);
        assert_eq!(robot.server_version(), 5);
        assert!(simulated.wait_for(PATIENCE, |s| s.connections >= 2));
        let mut last = 0;
        let mut seen = 0;
        robot
            .read(|state| {
                assert_eq!(state.robot_mode, RobotMode::Idle);
                let now = state.time.as_millis();
                assert!(now > last);
                last = now;
                seen += 1;
                seen < 100
            })
            .unwrap();
        let state = robot.read_once().unwrap();
        // The tool's weight is compensated without a word of the client.
        let from_start = state.q[3] + 3.0 * std::f64::consts::FRAC_PI_4;
        assert!(from_start.abs() < 1e-4, "{from_start} rad from the start");
        assert!((state.O_T_EE[15] - 1.0).abs() < 1e-12);
    });
}

#[test]
fn settings_are_taken_and_seen_in_the_state() {
    timed(|| {
        let simulated = simulated();
        let robot = client(&simulated);
        set_up(&robot);
        let mut tool = [0.0; 16];
        for i in 0..4 {
            tool[5 * i] = 1.0;
        }
        tool[14] = 0.12;
        robot.set_ee(tool).unwrap();
        robot.set_joint_impedance([3000.0; 7]).unwrap();
        robot
            .set_filters(100.0, 100.0, 100.0, 100.0, 100.0)
            .unwrap();
        robot.virtual_wall(0).unwrap();
        assert!(robot.set_ee([2.0; 16]).is_err());
        assert!(
            robot.load_model_from_robot().is_err(),
            "the vendor's code is not ours to send"
        );
        let shown = |s: &tangent_simulated_franka::Snapshot| {
            s.state.m_load == 0.3 && s.state.f_t_ee[14] == 0.12
        };
        assert!(simulated.wait_for(PATIENCE, shown));
        let state = robot.read_once().unwrap();
        assert_eq!(state.m_load, 0.3);
        assert_eq!(state.F_T_EE[14], 0.12);
    });
}

#[test]
fn its_torque_loop_turns_a_joint_and_ends_the_motion() {
    timed(|| {
        let simulated = simulated();
        let robot = client(&simulated);
        set_up(&robot);
        let start = robot.read_once().unwrap().q;
        let stiffness = [150.0, 150.0, 120.0, 120.0, 40.0, 30.0, 10.0];
        let damping = [30.0, 30.0, 20.0, 20.0, 4.0, 3.0, 1.0];
        let mut time_s = 0.0;
        let goal = |time_s: f64| {
            let mut q = start;
            q[0] += 0.2 * (time_s / 2.0).min(1.0);
            q
        };
        robot
            .control_torques(
                |state: &franka::RobotState, step: franka::Duration| {
                    time_s += step.as_secs_f64();
                    let q = goal(time_s);
                    let torque = std::array::from_fn(|i| {
                        stiffness[i] * (q[i] - state.q[i]) - damping[i] * state.dq[i]
                    });
                    if time_s < 3.0 {
                        Torques::new(torque)
                    } else {
                        motion_finished(Torques::new(torque))
                    }
                },
                true,
                franka::MAX_CUTOFF_FREQUENCY,
            )
            .unwrap();
        let state = robot.read_once().unwrap();
        assert!((state.q[0] - start[0] - 0.2).abs() < 0.02, "{:?}", state.q);
        assert_eq!(state.robot_mode, RobotMode::Idle);
        let snapshot = simulated.snapshot().unwrap();
        assert_eq!(snapshot.state.reflex_reason.to_string(), "");
        assert!(snapshot.torque_step_max_nm < 1.0);
    });
}

#[test]
fn its_joint_motion_is_followed_by_the_robots_own_controller() {
    timed(|| {
        let simulated = simulated();
        let robot = client(&simulated);
        set_up(&robot);
        let start = robot.read_once().unwrap().q_d;
        let mut time_s = 0.0;
        robot
            .control_joint_positions(
                |_: &franka::RobotState, step: franka::Duration| {
                    time_s += step.as_secs_f64();
                    let mut q = start;
                    q[5] += 0.05 * (1.0 - (std::f64::consts::PI * time_s.min(1.0)).cos());
                    if time_s < 1.2 {
                        JointPositions::new(q)
                    } else {
                        motion_finished(JointPositions::new(q))
                    }
                },
                franka::ControllerMode::JointImpedance,
                true,
                franka::MAX_CUTOFF_FREQUENCY,
            )
            .unwrap();
        let q = robot.read_once().unwrap().q;
        assert!((q[5] - start[5] - 0.1).abs() < 5e-3, "{q:?}");
    });
}

#[test]
fn it_receives_a_collision_and_recovers() {
    timed(|| {
        let simulated = simulated();
        let robot = client(&simulated);
        set_up(&robot);
        let faults = simulated.faults();
        let mut cycles = 0;
        let start = robot.read_once().unwrap().q;
        let ended = robot.control_torques(
            |state: &franka::RobotState, _: franka::Duration| {
                cycles += 1;
                if cycles == 300 {
                    faults(FciFault::Push([0.0, 0.0, 100.0]));
                }
                Torques::new(std::array::from_fn(|i| {
                    20.0 * (start[i] - state.q[i]) - state.dq[i]
                }))
            },
            true,
            franka::MAX_CUTOFF_FREQUENCY,
        );
        faults(FciFault::Push([0.0; 3]));
        let Err(FrankaError::Control(exception)) = ended else {
            panic!("{ended:?}");
        };
        let said = exception.to_string();
        assert!(said.contains("reflex"), "{said}");
        let state = robot.read_once().unwrap();
        assert_eq!(state.robot_mode, RobotMode::Reflex);
        robot.automatic_error_recovery().unwrap();
        // While the client waited for the recovery, its socket's buffer filled up, so the first
        // states that it reads are old.
        let mut reads = 0;
        robot
            .read(|state| {
                reads += 1;
                state.robot_mode != RobotMode::Idle && reads < 1000
            })
            .unwrap();
        assert!(reads < 1000);
        assert!(simulated.wait_for(PATIENCE, |s| s.state.errors.is_empty()));
    });
}
