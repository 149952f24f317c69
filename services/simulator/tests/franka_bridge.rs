//! The Franka bridge on the simulated robot, both as they run: real sockets, real faults, a torque
//! law in the same process.

#![allow(clippy::unwrap_used)]

use std::path::Path;
use std::sync::atomic::{AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use tangent_control::Phase;
use tangent_franka::fci::RobotMode;
use tangent_franka::{Config, queries};
use tangent_live::timed;
use tangent_runtime::config::{FrankaConfig, RobotDriver};
use tangent_runtime::{Bus, CellConfig, Handle, StateFolder, Stop, Subscription};
use tangent_schemas::tangent::{Answer, ArmCommand, ArmState, ControlState, Request, WrenchStatus};
use tangent_schemas::topics;
use tangent_simulator::Ports;
use tangent_simulator::fci::{FciConfig, FciFault, PlantConfig, SimulatedFranka, Snapshot};

const PATIENCE: Duration = Duration::from_secs(60);
const STIFFNESS: [f64; 7] = [150.0, 150.0, 120.0, 120.0, 40.0, 30.0, 10.0];
const DAMPING: [f64; 7] = [30.0, 30.0, 20.0, 20.0, 4.0, 3.0, 1.0];

/// What the controller of the tests does.
const STILL: u8 = 0;
const IMPEDANCE: u8 = 1;
const SILENT: u8 = 2;
const NAN: u8 = 3;
const STEPS: u8 = 4;

struct Cell {
    simulated: Arc<SimulatedFranka>,
    /// What the tool is pushed up with, where something pushes it.
    push: Option<Push>,
    config: Config,
    bus: Bus,
    stop: Stop,
    states: Subscription<ArmState>,
    act: Arc<AtomicU8>,
    activation: Arc<AtomicU64>,
    _controller: Handle,
    bridge: Option<JoinHandle<Result<(), tangent_franka::Error>>>,
}

fn simulated(plant: PlantConfig) -> SimulatedFranka {
    SimulatedFranka::start(&FciConfig {
        ports: Ports::Ephemeral,
        plant,
        // A busy machine shall make time slow, not lose answers: losses here are those that a test
        // asks for.
        answer_wait_s: 1.0,
        ..FciConfig::default()
    })
    .unwrap()
}

fn config(simulated: &SimulatedFranka) -> Config {
    let mut cell = CellConfig::default_cell();
    cell.robot.model = "panda".into();
    cell.robot.driver = RobotDriver::Franka;
    cell.robot.franka = Some(FrankaConfig {
        fci_port: simulated.address().port(),
        ..FrankaConfig::default()
    });
    cell.sensor.flange_from_sensor.translation_m = [0.0; 3];
    cell.tool.flange_from_tool.translation_m = [0.0, 0.0, 0.12];
    cell.realtime.enabled = false;
    Config::from_cell(&cell).unwrap()
}

impl Cell {
    fn new() -> Self {
        Self::keeping(None)
    }

    /// With a folder for what outlasts the bridge.
    fn keeping(folder: Option<&Path>) -> Self {
        let simulated = Arc::new(simulated(PlantConfig::default()));
        let mut config = config(&simulated);
        config.state = folder.map(StateFolder::new);
        let push = folder.map(|_| Push::start(&simulated));
        let bus = Bus::in_process("test");
        let states = bus.subscribe(&topics::ARM_STATE, 64).unwrap();
        let act = Arc::new(AtomicU8::new(STILL));
        let activation = Arc::new(AtomicU64::new(0));
        let controller = controller(&bus, &act, &activation);
        let stop = Stop::new();
        let bridge = start_bridge(&config, &bus, &stop);
        Self {
            simulated,
            push,
            config,
            bus,
            stop,
            states,
            act,
            activation,
            _controller: controller,
            bridge: Some(bridge),
        }
    }

    /// Another bridge in place of this one, on a bus of its own: whoever spoke on the other is
    /// silent.
    fn again(&mut self) {
        self.stop.trigger();
        self.bridge.take().unwrap().join().unwrap().unwrap();
        self.bus = Bus::in_process("test");
        self.states = self.bus.subscribe(&topics::ARM_STATE, 64).unwrap();
        self._controller = controller(&self.bus, &self.act, &self.activation);
        self.stop = Stop::new();
        self.bridge = Some(start_bridge(&self.config, &self.bus, &self.stop));
    }

    /// Pushes the tool up with so many newtons from now on, and lets the arm settle.
    fn push(&self, force_n: f64) {
        let push = self.push.as_ref().expect("the cell keeps something");
        push.millinewtons
            .store((force_n * 1e3) as u64, Ordering::Release);
        self.states(1500);
    }

    fn tare(&self, action: &str, argument: &str) -> Answer {
        let request = Request {
            action: action.into(),
            argument: argument.into(),
        };
        self.bus
            .ask(topics::queries::NETFT_TARE, &request, PATIENCE)
            .unwrap()
    }

    /// Force along z at the tool, N, and the status that belongs to it.
    fn felt(&self) -> (f64, WrenchStatus) {
        let wrenches = self.bus.subscribe(&topics::WRENCH_TOOL, 1).unwrap();
        let statuses = self.bus.subscribe(&topics::WRENCH_STATUS, 1).unwrap();
        self.states(5);
        let wrench = wrenches.recv_timeout(PATIENCE).unwrap().message;
        let status = statuses.recv_timeout(PATIENCE).unwrap().message;
        (wrench.wrench.force.z, status)
    }

    fn until(&self, what: &str, condition: impl Fn(&ArmState) -> bool) -> ArmState {
        let mut last = None;
        for _ in 0..200_000 {
            let Some(received) = self.states.recv_timeout(PATIENCE) else {
                break;
            };
            if condition(&received.message) {
                return received.message;
            }
            last = Some(received.message);
        }
        panic!("{what} never came; last state {last:?}");
    }

    fn ready(&self) -> ArmState {
        self.until("ready", |s| s.ready && s.runtime_state == 2)
    }

    fn states(&self, n: usize) {
        let first = self.until("states", |_| true).cycle;
        self.until("states", |s| s.cycle >= first + n as u64);
    }

    /// The controller acts so from now on, in a task of its own.
    fn start(&self, act: u8) -> u64 {
        let activation = self.activation.fetch_add(1, Ordering::AcqRel) + 1;
        self.act.store(act, Ordering::Release);
        activation
    }

    fn mode(&self) -> RobotMode {
        self.simulated.snapshot().unwrap().state.mode()
    }

    fn try_ask(&self, key: &str) -> Answer {
        self.bus.ask(key, &Request::default(), PATIENCE).unwrap()
    }

    fn ask(&self, key: &str) -> String {
        let answer = self.try_ask(key);
        assert!(answer.done, "{}", answer.message);
        answer.message
    }

    /// Nothing that left was ever more than the robot bears.
    fn no_step(&self) {
        let step = self.simulated.snapshot().unwrap().torque_step_max_nm;
        assert!(step <= 0.9 + 1e-9, "a step of {step} Nm");
    }
}

impl Drop for Cell {
    fn drop(&mut self) {
        self.stop.trigger();
        if let Some(bridge) = self.bridge.take() {
            let ended = bridge.join();
            assert!(std::thread::panicking() || ended.unwrap().is_ok());
        }
    }
}

/// Pushes the tool with a force that is never quite steady: an estimate that stands still has no
/// zero.
struct Push {
    millinewtons: Arc<AtomicU64>,
    stop: Stop,
    thread: Option<JoinHandle<()>>,
}

impl Push {
    fn start(simulated: &Arc<SimulatedFranka>) -> Self {
        let (millinewtons, stop) = (Arc::new(AtomicU64::new(0)), Stop::new());
        let (force, until, robot) = (
            Arc::clone(&millinewtons),
            stop.clone(),
            Arc::clone(simulated),
        );
        let thread = std::thread::spawn(move || {
            let mut turn = 0;
            while !until.wait(Duration::from_millis(1)) {
                turn = (turn + 617) % 1009;
                let tremble_n = 0.05 * (f64::from(turn) / 1009.0 - 0.5);
                let force_n = force.load(Ordering::Acquire) as f64 * 1e-3;
                robot.fault(FciFault::Push([tremble_n, tremble_n, force_n + tremble_n]));
            }
        });
        Self {
            millinewtons,
            stop,
            thread: Some(thread),
        }
    }
}

impl Drop for Push {
    fn drop(&mut self) {
        self.stop.trigger();
        let _ = self.thread.take().unwrap().join();
    }
}

fn start_bridge(
    config: &Config,
    bus: &Bus,
    stop: &Stop,
) -> JoinHandle<Result<(), tangent_franka::Error>> {
    let (config, bus, stop) = (config.clone(), bus.clone(), stop.clone());
    std::thread::spawn(move || tangent_franka::run(config, bus, stop))
}

/// Turns the first joint to 0.2 rad and back, slowly, for ever; or what else a test wants.
fn controller(bus: &Bus, act: &Arc<AtomicU8>, activation: &Arc<AtomicU64>) -> Handle {
    let commands = bus.publisher(&topics::ARM_COMMAND).unwrap();
    let (act, activation) = (Arc::clone(act), Arc::clone(activation));
    // Of the present task: its activation, when and where it started.
    let start: Mutex<Option<(u64, f64, Vec<f64>)>> = Mutex::new(None);
    bus.on(&topics::ARM_STATE, move |received| {
        let state = &received.message;
        let activation = activation.load(Ordering::Acquire);
        let act = act.load(Ordering::Acquire);
        if act == SILENT {
            return;
        }
        let mut start = start.lock().unwrap();
        if start.as_ref().is_none_or(|(of, ..)| *of != activation) {
            *start = Some((activation, state.robot_time_s, state.q.to_vec()));
        }
        let (_, since_s, q_start) = start.as_ref().unwrap();
        let time_s = state.robot_time_s - since_s;
        let mut torque: Vec<f64> = (0..7)
            .map(|i| {
                let swing = if i == 0 {
                    0.1 * (1.0 - (1.5 * time_s).cos())
                } else {
                    0.0
                };
                STIFFNESS[i] * (q_start[i] + swing - state.q[i]) - DAMPING[i] * state.qd[i]
            })
            .collect();
        match act {
            NAN => torque[3] = f64::NAN,
            STEPS => torque[0] = if state.cycle % 80 < 40 { 8.0 } else { -8.0 },
            _ => {}
        }
        commands.publish(&ArmCommand {
            cycle: state.cycle,
            kind: if act == STILL { 0 } else { 2 },
            values: torque.into_iter().collect(),
            activation,
            source: "test/0".try_into().unwrap(),
            ..ArmCommand::default()
        });
    })
    .unwrap()
}

#[test]
fn it_holds_then_follows_a_torque_law_for_seconds() {
    timed(|| {
        let cell = Cell::new();
        let first = cell.ready();
        cell.states(500);
        let held = cell.until("a state", |_| true);
        for (now, before) in held.q.iter().zip(&first.q) {
            assert!((now - before).abs() < 1e-3);
        }
        let q0 = held.q[0];
        cell.start(IMPEDANCE);
        cell.until("the way out", |s| s.q[0] - q0 > 0.18);
        cell.until("the way back", |s| s.q[0] - q0 < 0.02);
        let state = cell.until("the way out again", |s| s.q[0] - q0 > 0.18);
        assert!(state.ready);
        assert_eq!(state.commanded_by.as_str(), "test/0");
        // Before it was ready the arm sank a little under a tool it had not been told of, and
        // nobody may take an arm that moves.
        assert_eq!(
            state.commands_refused, first.commands_refused,
            "{}",
            state.refusal_reason
        );
        assert_eq!(state.missed_cycles, 0);
        assert!(state.command_latency_s > 0.0);
        let snapshot = cell.simulated.snapshot().unwrap();
        assert_eq!(snapshot.state.control_command_success_rate, 1.0);
        assert_eq!(snapshot.answers_lost, 0);
        cell.no_step();
    });
}

#[test]
fn silence_brings_it_to_rest_and_the_old_task_moves_nothing_more() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        let activation = cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.act.store(SILENT, Ordering::Release);
        let latched = cell.until("the latch", |s| s.activation_latched >= activation);
        assert!(latched.missed_cycles > 0);
        cell.until("rest", |s| s.qd.iter().all(|v| v.abs() < 0.01));
        // The same task again: refused. A new one: followed.
        cell.act.store(IMPEDANCE, Ordering::Release);
        let refused = cell.until("a refusal", |s| s.refusal_reason.contains("latched out"));
        assert!(refused.commands_refused > latched.commands_refused);
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.no_step();
    });
}

#[test]
fn without_a_commander_the_motion_ends_and_begins_again_with_one() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.act.store(SILENT, Ordering::Release);
        cell.until("the motion's end", |s| s.runtime_state == 1 && s.ready);
        assert!(
            cell.simulated
                .wait_for(PATIENCE, |s| s.state.mode() == RobotMode::Idle)
        );
        cell.act.store(STILL, Ordering::Release);
        cell.ready();
    });
}

#[test]
fn what_is_no_number_is_refused_and_a_step_leaves_as_a_ramp() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.act.store(NAN, Ordering::Release);
        let state = cell.until("a refusal", |s| s.commands_refused > 20);
        assert!(
            state.refusal_reason.contains("not a finite number"),
            "{}",
            state.refusal_reason
        );
        cell.until("rest", |s| s.qd.iter().all(|v| v.abs() < 0.02));
        cell.start(STEPS);
        for way in [1.0, -1.0, 1.0] {
            let reached = |s: &Snapshot| s.state.tau_j_d[0] * way == 8.0;
            assert!(cell.simulated.wait_for(PATIENCE, reached));
        }
        assert_eq!(cell.mode(), RobotMode::Move);
        cell.no_step();
    });
}

#[test]
fn lost_packets_are_counted_and_borne() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.simulated.fault(FciFault::DropAnswers(10));
        assert!(cell.simulated.wait_for(PATIENCE, |s| s.answers_lost >= 10));
        cell.states(200);
        assert_eq!(cell.mode(), RobotMode::Move);
        cell.states(200);
        // What the robot went by stayed where it was, and so did the next torque: no step after the
        // gap either.
        let snapshot = cell.simulated.snapshot().unwrap();
        assert!(snapshot.torque_step_max_nm <= 0.9 + 1e-9);
        let before = cell.until("a state", |_| true);
        cell.act.store(STILL, Ordering::Release);
        // The robot does not wait for an answer to what it did not send: the bridge sees the gap.
        let sim = &cell.simulated;
        cell.act.store(SILENT, Ordering::Release);
        cell.until("the motion's end", |s| s.runtime_state == 1);
        sim.fault(FciFault::DropStates(7));
        let after = cell.until("the gap", |s| s.packets_lost > before.packets_lost);
        assert_eq!(after.packets_lost - before.packets_lost, 7);
    });
}

#[test]
fn answers_that_never_come_are_a_violation_and_a_person_recovers() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.simulated.fault(FciFault::DropAnswers(20));
        let state = cell.until("the reflex", |s| {
            s.not_ready_reason
                .contains("communication_constraints_violation")
        });
        assert!(!state.ready);
        assert_eq!(state.robot_mode, i32::from(RobotMode::Reflex.number()));
        assert_eq!(state.safety_mode, 3);
        cell.act.store(STILL, Ordering::Release);
        cell.ask(queries::RECOVER);
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
    });
}

#[test]
fn a_collision_is_a_reflex_and_a_fresh_task_recovers() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.simulated.fault(FciFault::Push([0.0, 0.0, 100.0]));
        let state = cell.until("the reflex", |s| !s.ready);
        assert!(
            state.not_ready_reason.contains("reflex"),
            "{}",
            state.not_ready_reason
        );
        cell.simulated.fault(FciFault::Push([0.0; 3]));
        // The task that ran into it goes on talking: nothing recovers by itself.
        cell.states(500);
        assert_eq!(cell.mode(), RobotMode::Reflex);
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
    });
}

#[test]
fn user_stop_and_guiding_are_said_and_leave_nothing_behind() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        let activation = cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.simulated.fault(FciFault::UserStop(true));
        let state = cell.until("the stop", |s| !s.ready && s.safety_mode == 5);
        assert!(
            state.not_ready_reason.contains("user stop"),
            "{}",
            state.not_ready_reason
        );
        cell.simulated.fault(FciFault::UserStop(false));
        let state = cell.ready();
        assert!(state.activation_latched >= activation);
        cell.states(300);
        let state = cell.until("a state", |_| true);
        assert!(
            state.qd.iter().all(|v| v.abs() < 0.02),
            "the old task moves nothing"
        );
        cell.act.store(SILENT, Ordering::Release);
        cell.until("the motion's end", |s| s.runtime_state == 1 && s.ready);
        cell.simulated.fault(FciFault::Guiding(true));
        cell.until("guiding", |s| s.not_ready_reason.contains("guided by hand"));
        cell.simulated.fault(FciFault::Guiding(false));
        cell.until("the end of guiding", |s| s.ready);
    });
}

#[test]
fn a_cut_connection_is_made_again_and_a_frozen_robot_too() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        for (fault, connections) in [(FciFault::Disconnect, 2), (FciFault::Freeze(2.5), 3)] {
            let activation = cell.start(IMPEDANCE);
            cell.until("motion", |s| s.qd[0] > 0.1);
            cell.simulated.fault(fault);
            assert!(
                cell.simulated
                    .wait_for(PATIENCE, |s| s.connections >= connections)
            );
            // A cut latches what was. States from before it may still wait to be read here.
            cell.until("ready again", |s| {
                s.activation_latched >= activation && s.ready && s.runtime_state == 2
            });
            cell.states(200);
            let state = cell.until("a state", |_| true);
            assert!(state.qd.iter().all(|v| v.abs() < 0.02));
            assert!(state.cycle > 0);
        }
    });
}

#[test]
fn its_wrench_is_the_environments_and_can_be_tared() {
    timed(|| {
        let cell = Cell::new();
        let mut wrenches = cell.bus.latest(&topics::WRENCH_TOOL).unwrap();
        let mut statuses = cell.bus.latest(&topics::WRENCH_STATUS).unwrap();
        cell.ready();
        cell.states(300);
        cell.simulated.fault(FciFault::Push([0.0, 0.0, 6.0]));
        cell.states(1500);
        let pushed = wrenches.get().unwrap().message.wrench.force.clone();
        // The tool points down: up in the base is -z of the tool.
        assert!((pushed.z + 6.0).abs() < 0.5, "{pushed:?}");
        assert!(pushed.x.abs() < 0.5 && pushed.y.abs() < 0.5, "{pushed:?}");
        assert_eq!(statuses.get().unwrap().message.validity, 0);
        assert!(statuses.get().unwrap().message.bias_age_s < 0.0);
        // What presses is no zero: the estimate is off by a newton or two, not by six.
        let refused = cell.try_ask(topics::queries::NETFT_TARE);
        assert!(
            !refused.done && refused.message.contains("touches"),
            "{}",
            refused.message
        );
        assert!(statuses.get().unwrap().message.bias_age_s < 0.0);
        cell.simulated.fault(FciFault::Push([0.0, 0.0, 2.0]));
        cell.states(1500);
        cell.ask(topics::queries::NETFT_TARE);
        cell.states(100);
        let tared = wrenches.get().unwrap().message.wrench.force.clone();
        assert!(tared.z.abs() < 0.2, "{tared:?}");
        assert!(statuses.get().unwrap().message.bias_age_s >= 0.0);
    });
}

/// A bridge that was started anew knew nothing of the controller's last word: it took the force of
/// a pressing tool for its zero.
#[test]
fn a_tare_after_a_restart_is_refused_while_the_tool_presses() {
    timed(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut cell = Cell::keeping(Some(folder.path()));
        cell.ready();
        cell.push(3.0);
        let control = cell.bus.publisher(&topics::CONTROL_STATE).unwrap();
        let deadline = Instant::now() + PATIENCE;
        // On the disk while the task runs: a crash writes nothing.
        let file = folder.path().join("franka.json");
        while !std::fs::read_to_string(&file)
            .unwrap_or_default()
            .contains("\"contact_possible\": true")
        {
            assert!(Instant::now() < deadline, "nothing is written down");
            control.publish(&ControlState {
                phase: Phase::Slide as u8,
                contact_possible: true,
                ..ControlState::default()
            });
            std::thread::park_timeout(Duration::from_millis(5));
        }
        cell.again();
        cell.ready();
        cell.states(1500);
        let refused = cell.tare("tare", "");
        assert!(!refused.done, "{}", refused.message);
        for words in ["silent", "slide", "tare --clear"] {
            assert!(refused.message.contains(words), "{}", refused.message);
        }
        let (force_n, status) = cell.felt();
        assert!((force_n + 3.0).abs() < 0.5, "{force_n} N of 3 N are left");
        assert!(status.bias_age_s < 0.0);
        // A person has looked: the tool hangs free.
        cell.push(0.0);
        let tared = cell.tare("tare", "clear");
        assert!(tared.done, "{}", tared.message);
        assert!(cell.felt().1.bias_said_clear);
    });
}

/// 3 N passed for a zero: only 5 N were too many.
#[test]
fn a_zero_that_jumps_is_refused_over_a_restart_too() {
    timed(|| {
        let folder = tempfile::tempdir().unwrap();
        let mut cell = Cell::keeping(Some(folder.path()));
        cell.ready();
        cell.states(1500);
        let (_, status) = cell.felt();
        assert!(status.reference_age_s < 0.0 && status.rated_share >= 0.0);
        let tared = cell.tare("tare", "");
        assert!(tared.done, "{}", tared.message);
        let (_, status) = cell.felt();
        assert!(status.bias_age_s >= 0.0 && status.reference_age_s >= 0.0);
        assert_eq!(status.reference, status.bias);
        let jumps = |cell: &Cell| {
            cell.push(3.0);
            let refused = cell.tare("tare", "");
            assert!(!refused.done, "{}", refused.message);
            assert!(refused.message.contains("jump"), "{}", refused.message);
            let (force_n, status) = cell.felt();
            assert!((force_n + 3.0).abs() < 0.5, "{force_n} N of 3 N are left");
            // What a zero could hide is in the reading before it.
            let beyond_n = status.untared.force.z - status.reference.force.z;
            assert!((beyond_n + 3.0).abs() < 0.5, "{beyond_n} N");
            assert!(
                (0.04..0.1).contains(&status.rated_share),
                "{}",
                status.rated_share
            );
        };
        jumps(&cell);
        cell.again();
        cell.ready();
        let (_, status) = cell.felt();
        assert!(status.bias_age_s > 1.0, "{} s", status.bias_age_s);
        jumps(&cell);
        cell.push(0.0);
        let tared = cell.tare("tare", "");
        assert!(tared.done, "{}", tared.message);
        // In contact after all: it is taken back, and so is what was written down.
        assert!(cell.tare("withdraw", "").done);
        let (_, status) = cell.felt();
        assert!(status.bias_age_s < 0.0 && status.reference_age_s > 1.0);
    });
}

/// The mean of a moving arm's estimate is nobody's zero.
#[test]
fn an_arm_that_moves_is_not_tared() {
    timed(|| {
        let cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        let refused = cell.tare("tare", "");
        assert!(
            !refused.done && refused.message.contains("moved"),
            "{}",
            refused.message
        );
        assert!(cell.felt().1.bias_age_s < 0.0);
    });
}

#[test]
fn an_end_in_order_leaves_the_robot_idle() {
    timed(|| {
        let mut cell = Cell::new();
        cell.ready();
        cell.start(IMPEDANCE);
        cell.until("motion", |s| s.qd[0] > 0.1);
        cell.stop.trigger();
        cell.bridge.take().unwrap().join().unwrap().unwrap();
        assert!(
            cell.simulated
                .wait_for(PATIENCE, |s| s.state.mode() == RobotMode::Idle)
        );
        let snapshot = cell.simulated.snapshot().unwrap();
        assert!(
            snapshot.state.reflex_reason.is_empty(),
            "{}",
            snapshot.state.reflex_reason
        );
        cell.no_step();
    });
}

/// Another robot's version is said by name, and asked again with pauses, not in a flood.
#[test]
fn a_port_that_is_none_of_ours_is_tried_again() {
    timed(|| {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let simulated = simulated(PlantConfig::default());
        let mut config = config(&simulated);
        config.port = listener.local_addr().unwrap().port();
        let stop = Stop::new();
        let (bus, s) = (Bus::in_process("test"), stop.clone());
        let bridge = std::thread::spawn(move || tangent_franka::run(config, bus, s));
        // Answers each connection with a version 10, as an FR3 would.
        for _ in 0..2 {
            let (mut stream, _) = listener.accept().unwrap();
            let mut request = [0; 16];
            std::io::Read::read_exact(&mut stream, &mut request).unwrap();
            let mut reply = vec![0, 0, 0, 0];
            reply.extend_from_slice(&request[4..8]);
            reply.extend([15, 0, 0, 0, 1, 10, 0]);
            std::io::Write::write_all(&mut stream, &reply).unwrap();
            // Held until the bridge closes it.
            let _ = std::io::Read::read(&mut stream, &mut request);
        }
        stop.trigger();
        bridge.join().unwrap().unwrap();
    });
}

/// Whoever sends rubbish is cut off, and the next client is served.
#[test]
fn the_robot_survives_hostile_clients() {
    timed(|| {
        let simulated = simulated(PlantConfig::default());
        let mut seed = 0x2545_F491_4F6C_DD1Du64;
        for round in 0..40 {
            let mut stream = std::net::TcpStream::connect(simulated.address()).unwrap();
            let mut bytes = vec![0u8; 16 + round * 40];
            for byte in &mut bytes {
                seed ^= seed << 13;
                seed ^= seed >> 7;
                seed ^= seed << 17;
                *byte = seed as u8;
            }
            if round % 2 == 0 {
                // A header that is right, for a command there is, and a payload that is not.
                bytes[..4].copy_from_slice(&(round as u32 % 14).to_le_bytes());
                let size = bytes.len() as u32;
                bytes[8..12].copy_from_slice(&size.to_le_bytes());
            }
            let _ = std::io::Write::write_all(&mut stream, &bytes);
        }
        assert!(!simulated.has_ended());
        let stop = Stop::new();
        let (bus, s, c) = (Bus::in_process("test"), stop.clone(), config(&simulated));
        let states = bus.subscribe(&topics::ARM_STATE, 64).unwrap();
        let bridge = std::thread::spawn(move || tangent_franka::run(c, bus, s));
        while !states.recv_timeout(PATIENCE).unwrap().message.ready {}
        stop.trigger();
        bridge.join().unwrap().unwrap();
    });
}
