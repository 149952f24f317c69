//! The state machine against a scripted robot: its requests and their times, and that a cycle
//! allocates no memory.

use nalgebra::{SMatrix, Vector3};
use tangent_actuation::lease::Source;
use tangent_actuation::torque::TorqueLimits;
use tangent_actuation::{Command, MotionLimits};
use tangent_mechanics::Joints;
use tangent_schemas::Name;

use crate::bridge::{Bridge, BridgeConfig, BridgeError, posture_of};
use crate::fci::*;
use crate::session::{Reason, SessionError};

fn config() -> BridgeConfig {
    BridgeConfig {
        settings: vec![Request::SetJointImpedance([3000.0; 7])],
        limits: TorqueLimits {
            motion: MotionLimits {
                speed_rad_per_s: Joints::repeat(1.0),
                position_lower_rad: Joints::repeat(-2.0),
                position_upper_rad: Joints::repeat(2.0),
                tool_speed_max_m_per_s: 1.0,
                tool_turn_rate_max_rad_per_s: 1.0,
                workspace_lower_m: Vector3::repeat(-1.0),
                workspace_upper_m: Vector3::repeat(1.0),
            },
            torque_nm: Joints::repeat(10.0),
            torque_rate_nm_per_s: Joints::repeat(1000.0),
            hold_stiffness: Joints::repeat(10.0),
            hold_damping: Joints::repeat(1.0),
            patience_cycles: 2,
            silence_latch_s: 0.1,
        },
    }
}

struct Bench {
    bridge: Bridge,
    state: RobotState,
    now_s: f64,
    tcp: Vec<u8>,
    udp: Vec<u8>,
}

impl Bench {
    fn new() -> Self {
        let mut bench = Self {
            bridge: Bridge::new(config()),
            state: RobotState {
                robot_mode: RobotMode::Idle.number(),
                controller_mode: ControllerMode::Other.number(),
                ..RobotState::default()
            },
            now_s: 0.0,
            tcp: Vec::with_capacity(1024),
            udp: Vec::with_capacity(1024),
        };
        bench.bridge.open(5000, 0.0, &mut bench.tcp);
        bench
    }

    /// The bridge's last request, with its id.
    fn asked(&mut self) -> Option<(u32, Request)> {
        let mut framer = Framer::new();
        framer.push(&self.tcp);
        self.tcp.clear();
        let message = framer.next_message().unwrap()?;
        let request = (message.id, Request::decode(&message).unwrap());
        assert_eq!(framer.next_message().unwrap(), None, "one at a time");
        Some(request)
    }

    fn answer(&mut self, body: ReplyBody) -> Result<(), BridgeError> {
        let (id, request) = self.asked().unwrap();
        let reply = Reply {
            command: request.command(),
            id,
            body,
        };
        self.bridge.reply(&reply, self.now_s)
    }

    fn cycle(&mut self, commanded: Option<(u8, u64)>) {
        self.now_s += PERIOD_S;
        self.state.message_id += 1;
        let (state, tcp) = (self.state, &mut self.tcp);
        assert!(self.bridge.state(&state, 0, self.now_s, tcp).unwrap());
        let posture = posture_of(&state, Vector3::zeros(), SMatrix::zeros());
        let wanted = commanded.and_then(|(kind, activation)| {
            let source = Source {
                name: Name::from("test/1").unwrap(),
                publisher: [1; 16],
            };
            let admitted = self.bridge.admit(&source, activation, self.now_s);
            admitted.then_some(Command {
                cycle: self.bridge.cycle(),
                kind,
                values: &[0.5; 7],
                acceleration: 0.0,
                activation,
            })
        });
        self.udp.clear();
        self.bridge.command(
            &posture,
            wanted.as_ref(),
            self.now_s,
            &mut self.tcp,
            &mut self.udp,
        );
        if let Ok(answer) = RobotCommand::decode(&self.udp) {
            assert_eq!(answer.message_id, state.message_id);
            self.state.tau_j_d = answer.tau_j_d;
        }
    }

    fn set_up(&mut self) {
        let connected = ReplyBody::Connect(ConnectStatus::Success, 5);
        self.answer(connected).unwrap();
        self.cycle(None);
        self.answer(ReplyBody::Setter(SetterStatus::Success))
            .unwrap();
        self.cycle(None);
    }

    fn running(&mut self) {
        self.set_up();
        self.cycle(Some((0, 0)));
        self.cycle(Some((0, 0)));
        self.answer(ReplyBody::Move(MoveStatus::MotionStarted))
            .unwrap();
        self.state.robot_mode = RobotMode::Move.number();
        self.state.motion_generator_mode = MotionMode::JointVelocity.number();
        self.state.controller_mode = ControllerMode::External.number();
        self.cycle(Some((0, 0)));
        assert_eq!(self.bridge.reason(self.now_s), None);
    }
}

#[test]
fn it_connects_sets_up_and_starts_a_motion_with_the_first_command() {
    let mut bench = Bench::new();
    assert_eq!(bench.bridge.reason(0.0), Some(Reason::NoLink));
    bench.set_up();
    // Without a controller nothing moves, and a task may be started.
    assert_eq!(bench.asked(), None);
    assert_eq!(bench.bridge.reason(bench.now_s), None);
    assert!(bench.udp.is_empty());
    bench.cycle(Some((0, 0)));
    bench.cycle(Some((0, 0)));
    assert_eq!(bench.bridge.reason(bench.now_s), Some(Reason::Starting));
    assert!(bench.udp.is_empty());
    let asked = bench.asked().unwrap().1;
    assert!(matches!(
        asked,
        Request::Move {
            controller: MoveController::External,
            generator: MoveGenerator::JointVelocity,
            ..
        }
    ));
}

#[test]
fn another_version_is_reported_by_name() {
    let mut bench = Bench::new();
    let error = bench
        .answer(ReplyBody::Connect(ConnectStatus::IncompatibleVersion, 10))
        .unwrap_err();
    assert_eq!(
        error,
        BridgeError::Session(SessionError::Version { theirs: 10 })
    );
    assert!(
        error
            .to_string()
            .contains("FCI version 10, this bridge version 5")
    );
}

#[test]
fn a_setting_out_of_range_is_an_error_and_one_at_the_wrong_time_is_tried_again() {
    let mut bench = Bench::new();
    bench
        .answer(ReplyBody::Connect(ConnectStatus::Success, 5))
        .unwrap();
    bench.cycle(None);
    bench
        .answer(ReplyBody::Setter(SetterStatus::NotPossible))
        .unwrap();
    for _ in 0..990 {
        bench.cycle(None);
        assert_eq!(bench.asked(), None);
    }
    assert_eq!(bench.bridge.reason(bench.now_s), Some(Reason::SettingUp));
    for _ in 0..20 {
        bench.cycle(None);
    }
    let error = bench
        .answer(ReplyBody::Setter(SetterStatus::InvalidArgument))
        .unwrap_err();
    assert!(
        error.to_string().contains("refuses to set joint impedance"),
        "{error}"
    );
}

#[test]
fn lost_late_and_restarted_states_are_counted_or_reported() {
    let mut bench = Bench::new();
    bench.set_up();
    bench.state.message_id += 3;
    bench.cycle(None);
    assert_eq!(bench.bridge.packets_lost(), 3);
    // A state that arrived and was skipped for a newer one is late, not lost.
    bench.state.message_id += 2;
    let (state, now_s) = (bench.state, bench.now_s);
    assert!(
        bench
            .bridge
            .state(&state, 1, now_s, &mut bench.tcp)
            .unwrap()
    );
    assert_eq!(bench.bridge.packets_lost(), 3);
    let mut old = bench.state;
    old.message_id -= 1;
    assert!(
        !bench
            .bridge
            .state(&old, 0, bench.now_s, &mut bench.tcp)
            .unwrap()
    );
    old.dq[2] = f64::NAN;
    old.message_id += 2;
    assert_eq!(
        bench.bridge.state(&old, 0, bench.now_s, &mut bench.tcp),
        Err(BridgeError::NotFinite)
    );
    bench.state.message_id = 5000;
    bench.cycle(None);
    bench.state.message_id = 3;
    assert_eq!(
        bench
            .bridge
            .state(&bench.state, 0, bench.now_s, &mut bench.tcp),
        Err(BridgeError::Restarted {
            before: 5001,
            now: 3
        })
    );
}

#[test]
fn a_reflex_is_left_by_a_new_task_or_on_request() {
    for by_person in [true, false] {
        let mut bench = Bench::new();
        bench.running();
        bench.cycle(Some((2, 1)));
        assert!(bench.bridge.gate().admission.is_commanded());
        // The robot stops, and its reply on the motion arrives.
        bench.state.robot_mode = RobotMode::Reflex.number();
        bench.state.motion_generator_mode = MotionMode::Idle.number();
        bench.state.controller_mode = ControllerMode::Other.number();
        bench.state.reflex_reason = ErrorFlags::only(ErrorFlags::CARTESIAN_REFLEX);
        let ended = Reply {
            command: crate::fci::Command::Move,
            id: 2,
            body: ReplyBody::Move(MoveStatus::ReflexAborted),
        };
        bench.bridge.reply(&ended, bench.now_s).unwrap();
        for _ in 0..50 {
            bench.cycle(Some((2, 1)));
            assert!(bench.udp.is_empty());
            assert_eq!(bench.asked(), None, "the old task recovers nothing");
        }
        let said = bench.bridge.reason(bench.now_s).unwrap().to_string();
        assert!(said.contains("cartesian_reflex"), "{said}");
        assert_eq!(bench.bridge.session().reflexes(), 1);
        if by_person {
            bench.bridge.recover();
            bench.cycle(Some((0, 1)));
        } else {
            bench.cycle(Some((2, 2)));
        }
        bench
            .answer(ReplyBody::Recovery(RecoveryStatus::Success))
            .unwrap();
        bench.state.robot_mode = RobotMode::Idle.number();
        bench.state.reflex_reason = ErrorFlags::default();
        let command = if by_person { (0, 1) } else { (2, 2) };
        for _ in 0..3 {
            bench.cycle(Some(command));
        }
        bench
            .answer(ReplyBody::Move(MoveStatus::MotionStarted))
            .unwrap();
        bench.state.robot_mode = RobotMode::Move.number();
        bench.state.motion_generator_mode = MotionMode::JointVelocity.number();
        bench.state.controller_mode = ControllerMode::External.number();
        bench.cycle(Some(command));
        bench.cycle(Some(command));
        assert_eq!(bench.bridge.gate().admission.is_commanded(), !by_person);
        assert_eq!(bench.bridge.session().recoveries(), 1);
    }
}

#[test]
fn the_motion_ends_when_the_commander_has_gone() {
    let mut bench = Bench::new();
    bench.running();
    bench.cycle(Some((2, 1)));
    let mut finished = None;
    for cycle in 0..1200 {
        bench.cycle(None);
        let answer = RobotCommand::decode(&bench.udp).unwrap();
        if answer.motion_finished && finished.is_none() {
            finished = Some(cycle);
        }
    }
    assert!((990..1020).contains(&finished.unwrap()), "{finished:?}");
}

#[test]
fn a_soft_stop_stops_at_the_robot() {
    let mut bench = Bench::new();
    bench.running();
    bench.cycle(Some((2, 1)));
    bench.cycle(Some((3, 1)));
    assert_eq!(bench.asked().unwrap().1, Request::StopMove);
    assert!(bench.udp.is_empty());
    assert_eq!(bench.bridge.gate().admission.activation_latched(), 1);
}

#[test]
fn a_cycle_takes_no_memory() {
    let mut bench = Bench::new();
    bench.running();
    bench.cycle(Some((2, 1)));
    let count = allocation_counter::measure(|| {
        for _ in 0..100 {
            bench.cycle(Some((2, 1)));
        }
        for _ in 0..20 {
            bench.cycle(None);
        }
    });
    assert_eq!(count.count_total, 0);
}
