//! Steps the robot and the bridge's state machine together, byte for byte, without sockets and
//! clock.

use nalgebra::Vector3;
use tangent_actuation::Command;
use tangent_actuation::lease::Source;
use tangent_actuation::torque::Posture;
use tangent_franka::bridge::{Bridge, BridgeConfig, posture_of};
use tangent_franka::fci::*;
use tangent_franka::session::Reason;
use tangent_franka::wrench::tool_wrench;
use tangent_mechanics::{Arm, Joints, ModelData};
use tangent_runtime::CellConfig;
use tangent_runtime::config::RobotDriver;
use tangent_schemas::Name;

use super::FciRobot;
use crate::bench::{BenchPlant, Plane, PlantConfig};
use crate::config::FciConfig;
use crate::plant::TorquePlant;

/// Configuration of the bridge that fits the default plant.
fn bridge_config() -> BridgeConfig {
    let mut cell = CellConfig::default_cell();
    cell.robot.model = "panda".into();
    cell.robot.driver = RobotDriver::Franka;
    cell.sensor.flange_from_sensor.translation_m = [0.0; 3];
    cell.tool.flange_from_tool.translation_m = [0.0, 0.0, 0.12];
    tangent_franka::Config::from_cell(&cell).unwrap().bridge
}

struct Rig {
    robot: FciRobot,
    bridge: Bridge,
    arm: Arm<7>,
    now_s: f64,
    tcp: Vec<u8>,
    activation: u64,
    torque_step_max: f64,
    torque: Joints<7>,
    q_start: Joints<7>,
}

/// A controller for tests: returns kind and torques of the command of one cycle.
type Law<'a> = &'a dyn Fn(&Posture<7>) -> Option<(u8, Joints<7>)>;

impl Rig {
    fn new(plant: &PlantConfig) -> Self {
        let plant = BenchPlant::new(plant).unwrap();
        let q_start = plant.reading().q;
        let mut rig = Self {
            robot: FciRobot::new(&FciConfig::default(), Box::new(plant)).unwrap(),
            bridge: Bridge::new(bridge_config()),
            arm: Arm::new(&ModelData::builtin("panda").unwrap()).unwrap(),
            now_s: 0.0,
            tcp: Vec::new(),
            activation: 1,
            torque_step_max: 0.0,
            torque: Joints::zeros(),
            q_start,
        };
        rig.bridge.open(4000, 0.0, &mut rig.tcp);
        rig
    }

    fn exchange(&mut self) {
        let mut framer = Framer::new();
        framer.push(&self.tcp);
        self.tcp.clear();
        while let Some(message) = framer.next_message().unwrap() {
            let request = Request::decode(&message).unwrap();
            self.robot.request(message.id, &request);
        }
        let mut bytes = Vec::new();
        for reply in self.robot.take_replies() {
            reply.encode(&mut bytes);
        }
        framer.clear();
        framer.push(&bytes);
        while let Some(message) = framer.next_message().unwrap() {
            let reply = Reply::decode(&message).unwrap();
            self.bridge.reply(&reply, self.now_s).unwrap();
        }
    }

    /// Runs one millisecond; `lost`: the answer does not arrive.
    fn cycle(&mut self, law: Law<'_>, lost: bool) {
        self.now_s += PERIOD_S;
        self.exchange();
        let mut datagram = Vec::new();
        self.robot.state().encode(&mut datagram);
        let state = RobotState::decode(&datagram).unwrap();
        self.bridge
            .state(&state, 0, self.now_s, &mut self.tcp)
            .unwrap();
        let tool = self.robot.plant().flange_from_tool();
        let q = Joints::from(state.q);
        let (pose, jacobian) = self.arm.tool_and_jacobian(&q, &tool);
        let posture = posture_of(&state, pose.translation(), jacobian);
        let command = law(&posture);
        let values: Option<[f64; 7]> = command.map(|(_, torque)| torque.into());
        let wanted = match (&command, &values) {
            (Some((kind, _)), Some(values)) => {
                let source = Source {
                    name: Name::from("test/1").unwrap(),
                    publisher: [1; 16],
                };
                // A controller without a task sends the activation 0.
                let activation = if *kind == 0 { 0 } else { self.activation };
                let admitted = self.bridge.admit(&source, activation, self.now_s);
                admitted.then_some(Command {
                    cycle: self.bridge.cycle(),
                    kind: *kind,
                    values,
                    acceleration: 0.0,
                    activation,
                })
            }
            _ => None,
        };
        datagram.clear();
        self.bridge.command(
            &posture,
            wanted.as_ref(),
            self.now_s,
            &mut self.tcp,
            &mut datagram,
        );
        let answer = RobotCommand::decode(&datagram).ok();
        if let Some(answer) = &answer {
            let torque = Joints::from(answer.tau_j_d);
            self.torque_step_max = self.torque_step_max.max((torque - self.torque).amax());
            self.torque = torque;
        } else {
            self.torque = Joints::zeros();
        }
        self.robot.step(answer.filter(|_| !lost).as_ref());
    }

    fn cycles(&mut self, n: usize, law: Law<'_>) {
        for _ in 0..n {
            self.cycle(law, false);
        }
    }

    fn ready(&mut self) {
        for _ in 0..200 {
            self.cycle(&still, false);
            if self.bridge.session().is_running() {
                return;
            }
        }
        panic!("no motion: {:?}", self.bridge.reason(self.now_s));
    }

    fn q(&self) -> Joints<7> {
        self.robot.plant().reading().q
    }

    fn speed(&self) -> f64 {
        self.robot.plant().reading().qd.amax()
    }
}

fn still(_: &Posture<7>) -> Option<(u8, Joints<7>)> {
    Some((0, Joints::zeros()))
}

fn silent(_: &Posture<7>) -> Option<(u8, Joints<7>)> {
    None
}

/// A spring and damper of all joints to `q`.
fn impedance(q: Joints<7>) -> impl Fn(&Posture<7>) -> Option<(u8, Joints<7>)> {
    let stiffness = Joints::from([150.0, 150.0, 120.0, 120.0, 40.0, 30.0, 10.0]);
    let damping = Joints::from([30.0, 30.0, 20.0, 20.0, 4.0, 3.0, 1.0]);
    move |p: &Posture<7>| {
        let spring = stiffness.component_mul(&(q - p.q));
        Some((2, spring - damping.component_mul(&p.qd)))
    }
}

#[test]
fn it_is_set_up_and_held_while_a_commander_stands_still() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.ready();
    rig.cycles(2000, &still);
    assert_eq!(rig.bridge.reason(rig.now_s), None);
    let moved = (rig.q() - rig.q_start).amax();
    assert!(moved < 1e-3, "{moved} rad");
    let state = rig.robot.state();
    assert_eq!(state.m_load, 0.3);
    assert_eq!(state.control_command_success_rate, 1.0);
    assert!(state.in_torque_motion());
}

#[test]
fn a_torque_law_moves_it_and_silence_brings_it_to_rest_without_a_step() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.ready();
    let goal = rig.q_start + Joints::from([0.15, 0.05, -0.1, 0.1, 0.1, -0.1, 0.2]);
    let q_start = rig.q_start;
    // Over two seconds, as on a path.
    for cycle in 0..4000 {
        let share = (f64::from(cycle) / 2000.0).min(1.0);
        rig.cycle(&impedance(q_start + (goal - q_start) * share), false);
    }
    let off = (rig.q() - goal).amax();
    assert!(off < 0.02, "{off} rad off");
    // Moves back; in the middle of the motion, no command arrives any more.
    for cycle in 0..600 {
        let share = f64::from(cycle) / 1200.0;
        rig.cycle(&impedance(goal + (q_start - goal) * share), false);
    }
    assert!(rig.speed() > 0.05);
    rig.cycles(3, &silent);
    assert!(
        !rig.bridge.gate().admission.is_commanded() || rig.bridge.gate().admission.missed() > 0
    );
    rig.cycles(900, &silent);
    assert!(rig.speed() < 0.01, "{} rad/s", rig.speed());
    assert!(rig.bridge.session().is_running(), "held, not dropped");
    // After this time the commander counts as lost, and the robot holds itself.
    rig.cycles(300, &silent);
    assert_eq!(rig.robot.mode(), RobotMode::Idle);
    let rest = rig.q();
    rig.cycles(500, &silent);
    assert!((rig.q() - rest).amax() < 1e-4);
    assert!(rig.torque_step_max <= 0.9 + 1e-9, "{}", rig.torque_step_max);
    assert!(rig.bridge.session().reflexes() == 0);
}

#[test]
fn every_step_and_every_number_that_is_none_is_kept_from_the_robot() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.ready();
    let hold = impedance(rig.q_start);
    for cycle in 0..400 {
        let torque = match cycle % 7 {
            3 => Joints::from([f64::NAN; 7]),
            5 => Joints::from([30.0, 0.0, 0.0, -20.0, 5.0, 0.0, -3.0]),
            _ => {
                hold(&posture_of(
                    &rig.robot.state(),
                    Vector3::zeros(),
                    nalgebra::SMatrix::zeros(),
                ))
                .unwrap()
                .1
            }
        };
        rig.cycle(&|_| Some((2, torque)), false);
    }
    assert_eq!(rig.robot.mode(), RobotMode::Move);
    assert!(rig.bridge.gate().admission.refused() > 50);
    assert!(rig.bridge.gate().limited() > 50);
}

#[test]
fn a_few_lost_answers_are_tolerated_and_twenty_are_not() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.ready();
    let hold = impedance(rig.q_start + Joints::repeat(0.02));
    for cycle in 0..1000 {
        // Every tenth answer is lost, and once 19 in a row.
        rig.cycle(&hold, cycle % 10 == 0 || (400..419).contains(&cycle));
    }
    assert_eq!(rig.robot.mode(), RobotMode::Move);
    let rate = rig.robot.state().control_command_success_rate;
    assert!((rate - 0.9).abs() < 0.02, "{rate}");
    for _ in 0..21 {
        rig.cycle(&hold, true);
    }
    assert_eq!(rig.robot.mode(), RobotMode::Reflex);
    rig.cycles(2, &silent);
    assert_eq!(rig.bridge.session().constraint_violations(), 1);
    let said = rig.bridge.reason(rig.now_s).unwrap().to_string();
    assert!(
        said.contains("communication_constraints_violation"),
        "{said}"
    );
}

#[test]
fn a_collision_is_a_reflex_and_a_fresh_task_recovers() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.ready();
    let hold = impedance(rig.q_start);
    rig.cycles(300, &hold);
    rig.robot.push([0.0, 0.0, 90.0]);
    rig.cycles(200, &hold);
    rig.robot.push([0.0; 3]);
    assert_eq!(rig.robot.mode(), RobotMode::Reflex);
    assert!(matches!(
        rig.bridge.reason(rig.now_s),
        Some(Reason::Reflex(_))
    ));
    // The old task continues to send commands, and nothing moves.
    rig.cycles(500, &hold);
    assert_eq!(rig.robot.mode(), RobotMode::Reflex);
    rig.activation = 2;
    rig.cycles(600, &hold);
    assert_eq!(rig.robot.mode(), RobotMode::Move);
    assert!(rig.bridge.gate().admission.is_commanded());
    rig.cycles(2000, &hold);
    assert!((rig.q() - rig.q_start).amax() < 0.01);
    assert_eq!(rig.bridge.session().recoveries(), 1);
}

#[test]
fn a_joint_at_its_stop_needs_an_operator() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.ready();
    let mut beyond = PlantConfig::default().q_rad;
    beyond[6] = 2.897_299_999;
    let mut rig = Rig::new(&PlantConfig {
        q_rad: beyond,
        ..PlantConfig::default()
    });
    for _ in 0..400 {
        rig.cycle(&still, false);
    }
    assert_eq!(rig.robot.mode(), RobotMode::Reflex);
    rig.bridge.recover();
    rig.cycles(20, &still);
    let reason = rig.bridge.reason(rig.now_s).unwrap();
    assert!(matches!(reason, Reason::ManualRecovery(_)), "{reason}");
}

#[test]
fn a_user_stop_ends_the_motion_and_nothing_resumes_by_itself() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.ready();
    let goal = rig.q_start + Joints::repeat(0.05);
    rig.cycles(200, &impedance(goal));
    rig.robot.set_user_stop(true);
    rig.cycles(300, &impedance(goal));
    let said = rig.bridge.reason(rig.now_s).unwrap().to_string();
    assert!(said.contains("user stop"), "{said}");
    rig.robot.set_user_stop(false);
    rig.cycles(300, &impedance(goal));
    assert_eq!(rig.robot.mode(), RobotMode::Move, "held again");
    assert!(!rig.bridge.gate().admission.is_commanded(), "but not moved");
    rig.activation = 2;
    rig.cycles(3000, &impedance(goal));
    assert!((rig.q() - goal).amax() < 0.01);
}

#[test]
fn pressing_on_a_plane_is_felt_with_the_projects_sign() {
    let start = BenchPlant::new(&PlantConfig::default()).unwrap();
    let arm = Arm::<7>::new(&ModelData::builtin("panda").unwrap()).unwrap();
    let q = start.reading().q;
    let (pose, _) = arm.tool_and_jacobian(&q, &start.flange_from_tool());
    let z = pose.translation().z;
    let mut rig = Rig::new(&PlantConfig {
        plane: Some(Plane {
            point_m: [0.0, 0.0, z - 0.002],
            normal: [0.0, 0.0, 1.0],
            stiffness_n_per_m: 2e4,
            damping_n_s_per_m: 100.0,
            friction: 0.2,
        }),
        ..PlantConfig::default()
    });
    rig.ready();
    let hold = impedance(q);
    let press = |p: &Posture<7>| {
        let (kind, torque) = hold(p)?;
        let force = p.tool_jacobian.fixed_rows::<3>(0).transpose() * Vector3::new(0.0, 0.0, -15.0);
        Some((kind, torque + force))
    };
    rig.cycles(3000, &press);
    let truth = rig.robot.plant().truth().unwrap();
    let pushed = truth.wrench.vector()[2];
    assert!(truth.in_contact && pushed > 5.0, "{pushed} N");
    let wrench = tool_wrench(&rig.robot.state(), &rig.robot.plant().flange_from_tool());
    // z of the tool points into the surface, so pressing is a force along -z of the tool.
    let (pose, _) = rig
        .arm
        .tool_and_jacobian(&rig.q(), &rig.robot.plant().flange_from_tool());
    let in_base = pose.rotate(&wrench.vector().fixed_rows::<3>(0).into_owned());
    assert!(
        (in_base.z - pushed).abs() < 0.5,
        "{} N of {pushed} N",
        in_base.z
    );
    assert!(wrench.vector()[2] < -5.0);
}

#[test]
fn unsupported_requests_are_refused_by_the_protocols_codes() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.exchange();
    let wide = Deviation::WIDE;
    let motion = |controller, generator| Request::Move {
        controller,
        generator,
        path_deviation: wide,
        goal_deviation: wide,
    };
    let ask = |rig: &mut Rig, request: Request| {
        rig.robot.request(900, &request);
        rig.robot.take_replies().pop().map(|reply| reply.body)
    };
    let cases = [
        (
            motion(
                MoveController::CartesianImpedance,
                MoveGenerator::CartesianPosition,
            ),
            ReplyBody::Move(MoveStatus::InvalidArgument),
        ),
        (Request::StopMove, ReplyBody::Stop(StopStatus::NotPossible)),
        (Request::LoadModelLibrary(0, 0), ReplyBody::Model(false)),
        (
            Request::SetLoad(Load {
                mass_kg: f64::NAN,
                com_in_flange_m: [0.0; 3],
                inertia_kg_m2: [0.0; 9],
            }),
            ReplyBody::Setter(SetterStatus::InvalidArgument),
        ),
        (
            Request::SetEeToK([1.0; 16]),
            ReplyBody::Setter(SetterStatus::InvalidArgument),
        ),
    ];
    for (request, wanted) in cases {
        assert_eq!(ask(&mut rig, request), Some(wanted), "{request:?}");
    }
    let good = motion(MoveController::External, MoveGenerator::JointVelocity);
    let started = Some(ReplyBody::Move(MoveStatus::MotionStarted));
    assert_eq!(ask(&mut rig, good), started);
    let second = Some(ReplyBody::Move(MoveStatus::NotPossible));
    assert_eq!(ask(&mut rig, good), second);
    let setter = Some(ReplyBody::Setter(SetterStatus::NotPossible));
    assert_eq!(
        ask(&mut rig, Request::SetJointImpedance([100.0; 7])),
        setter
    );
    // A jump in torque that bypasses the bridge.
    for _ in 0..20 {
        let id = rig.robot.state().message_id;
        rig.robot
            .step(Some(&RobotCommand::torque(id, [0.0; 7], false)));
    }
    let id = rig.robot.state().message_id;
    let mut torque = [0.0; 7];
    torque[4] = 1.01;
    rig.robot
        .step(Some(&RobotCommand::torque(id, torque, false)));
    let state = rig.robot.state();
    assert_eq!(state.errors.to_string(), "controller_torque_discontinuity");
    assert_eq!(state.mode(), RobotMode::Reflex);
}

/// The bug: the robot waited for the answer to the first state of a motion as long as libfranka
/// waits for the second state, which is 1 s. Whichever ran out first ended or began the motion.
#[test]
fn one_state_begins_a_motion() {
    let mut rig = Rig::new(&PlantConfig::default());
    let (mut begins, mut moves) = (0, 0);
    for _ in 0..300 {
        rig.cycle(&still, false);
        begins += u32::from(rig.robot.begins_motion());
        moves += u32::from(rig.robot.wants_answer());
        assert!(begins > 0 || moves == 0, "it moves without a beginning");
    }
    assert!(begins == 1 && moves > 100, "{begins} of {moves}");
}

/// The bug: without noise of its own, the estimate of an arm at rest repeated, and was taken for
/// that of a broken sensor.
#[test]
fn the_estimate_of_an_arm_at_rest_never_repeats() {
    let mut rig = Rig::new(&PlantConfig::default());
    rig.cycles(5000, &still);
    let mut last = rig.robot.state().k_f_ext_hat_k;
    for _ in 0..1000 {
        rig.cycle(&still, false);
        let now = rig.robot.state().k_f_ext_hat_k;
        for (now, last) in now.iter().zip(&last) {
            assert_ne!(now, last);
        }
        last = now;
    }
}
