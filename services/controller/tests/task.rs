//! The service on a bus without a network: a small arm over a plane publishes packets and obeys the commands, and the
//! queries are those that `tangent task` sends. The packet's publisher is this thread, as the bridge's is in the cell.

#![allow(clippy::unwrap_used)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use allocation_counter::measure;
use nalgebra::Vector3;
use tangent_controller::{Config, ControllerError, run};
use tangent_mechanics::{Arm, Joints, ModelData, Wrench};
use tangent_runtime::bus::answer::done;
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Bus, CellConfig, Handle, Latest, Publisher, Stop};
use tangent_schemas::convert::{cut, joint_array};
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::{
    Answer, ArmCommand, ArmState, ControlState, NormalEstimate, Request, WrenchStatus,
};
use tangent_schemas::topics::{self, queries};

const TASK: &str = r#"
    name = "short line"
    estimators = ["blend"]
    force.reference_n = 3.0
    [path]
    kind = "line"
    to_m = [0.02, 0.0]
    speed_m_per_s = 0.02
"#;
const PERIOD_S: f64 = 0.008;
const PATIENCE: Duration = Duration::from_secs(20);

/// Packets come faster here than in life: what takes life's time needs a task that outlasts it.
fn long_task() -> String {
    TASK.replace("[0.02, 0.0]", "[0.02, 0.0]\n    strokes = 10000")
}

/// Everything but the controller.
struct Cell {
    bus: Bus,
    config: Config,
    stop: Stop,
    service: Option<JoinHandle<Result<(), ControllerError>>>,
    arm_state: Publisher<ArmState>,
    wrench: Publisher<WrenchStamped>,
    status: Publisher<WrenchStatus>,
    estimate: Publisher<NormalEstimate>,
    command: Latest<ArmCommand>,
    control: Latest<ControlState>,
    arm: Arm<6>,
    q: Joints<6>,
    qd: Joints<6>,
    plane_m: f64,
    cycle: u64,
    tares: Arc<AtomicU64>,
    tared: Arc<AtomicBool>,
    latched: u64,
    /// Allocations while packets were answered, so far.
    allocations: u64,
    _tare: Handle,
}

impl Cell {
    fn new() -> Self {
        let bus = Bus::in_process("test");
        let model = ModelData::builtin("ur5").unwrap();
        let config = Config::from_cell(&CellConfig::default_cell(), model).unwrap();
        let arm = config.arm;
        let q = Joints::<6>::from([0.3, -1.6, 1.7, -1.67, -std::f64::consts::FRAC_PI_2, 0.0]);
        let tool = arm.base_from_flange(&q) * config.flange_from_tool;
        let (tares, tared) = (
            Arc::new(AtomicU64::new(0)),
            Arc::new(AtomicBool::new(false)),
        );
        let (count, flag) = (Arc::clone(&tares), Arc::clone(&tared));
        let tare = bus
            .answer(queries::NETFT_TARE, move |_, _| {
                count.fetch_add(1, Ordering::SeqCst);
                flag.store(true, Ordering::SeqCst);
                done("tared")
            })
            .unwrap();
        let stop = Stop::new();
        let service = std::thread::spawn({
            let (config, bus, stop) = (config.clone(), bus.clone(), stop.clone());
            move || run(config, bus, stop)
        });
        let mut cell = Self {
            arm_state: bus.publisher(&topics::ARM_STATE).unwrap(),
            wrench: bus.publisher(&topics::WRENCH_TOOL).unwrap(),
            status: bus.publisher(&topics::WRENCH_STATUS).unwrap(),
            estimate: bus.publisher(&topics::estimate_normal("blend")).unwrap(),
            command: bus.latest(&topics::ARM_COMMAND).unwrap(),
            control: bus.latest(&topics::CONTROL_STATE).unwrap(),
            bus,
            config,
            stop,
            service: Some(service),
            arm,
            q,
            qd: Joints::zeros(),
            plane_m: tool.translation().z - 0.004,
            cycle: 0,
            tares,
            tared,
            latched: 0,
            allocations: 0,
            _tare: tare,
        };
        // Up as soon as it answers a packet, and then the first queries.
        while cell.packet(true).is_none() {
            assert!(!cell.service.as_ref().unwrap().is_finished());
            std::thread::yield_now();
        }
        while cell.ask(queries::CONTROL_TASK, "status", "").is_none() {
            std::thread::yield_now();
        }
        cell
    }

    /// In the middle of a task that outlasts the test.
    fn sliding_for_long() -> Self {
        let mut cell = Self::new();
        let answer = cell.ask(queries::CONTROL_TASK, "start", &long_task());
        let answer = answer.unwrap();
        assert!(answer.done, "{}", answer.message);
        cell.run_until("slide");
        cell
    }

    /// One packet of the robot: the sensor and the estimator speak, then the arm, and the command is obeyed.
    fn packet(&mut self, sensor: bool) -> Option<ArmCommand> {
        let (tool, jacobian) = self
            .arm
            .tool_and_jacobian(&self.q, &self.config.flange_from_tool);
        let stamp = now_ns();
        let header = Header::new(stamp, "tool");
        let depth = (self.plane_m - tool.translation().z).max(0.0);
        let force = tool.unrotate(&(Vector3::z() * 5000.0 * depth));
        if sensor {
            self.status.publish(&WrenchStatus {
                header: header.clone(),
                bias_age_s: if self.tared.load(Ordering::SeqCst) {
                    0.0
                } else {
                    -1.0
                },
                filter_delay_s: 0.004,
                ..WrenchStatus::default()
            });
            self.wrench.publish(&WrenchStamped {
                header: header.clone(),
                wrench: (&Wrench::<tangent_mechanics::Tool>::new(force, Vector3::zeros())).into(),
            });
        }
        self.estimate.publish(&NormalEstimate {
            header: header.clone(),
            cycle: self.cycle,
            estimator: cut("blend"),
            normal: (&Vector3::z()).into(),
            friction: -1.0,
            ..NormalEstimate::default()
        });
        self.cycle += 1;
        let twist = jacobian * self.qd;
        let state = ArmState {
            header: Header::new(stamp, "base"),
            cycle: self.cycle,
            period_s: PERIOD_S,
            q: joint_array(&self.q),
            qd: joint_array(&self.qd),
            tool_pose: (&tool).into(),
            tool_twist: (&tangent_mechanics::Twist::<tangent_mechanics::Base>::from_vector(&twist))
                .into(),
            ready: true,
            speed_scaling: 1.0,
            activation_latched: self.latched,
            ..ArmState::default()
        };
        let answering = measure(|| {
            self.arm_state.publish(&state);
        });
        self.allocations += answering.count_total;
        let command = self.command.take_new()?.message.clone();
        // Answered within the publish call, and nothing else.
        assert_eq!(command.cycle, self.cycle);
        self.qd = if command.kind == 1 {
            Joints::from_column_slice(&command.values)
        } else {
            Joints::zeros()
        };
        self.q += self.qd * PERIOD_S;
        Some(command)
    }

    /// Asks from another thread while the robot's packets go on; none when nobody answers.
    fn ask(&mut self, key: &'static str, action: &str, argument: &str) -> Option<Answer> {
        let bus = self.bus.clone();
        let request = Request {
            action: action.into(),
            argument: argument.into(),
        };
        let asking = std::thread::spawn(move || bus.ask(key, &request, PATIENCE));
        while !asking.is_finished() {
            self.packet(true);
        }
        asking.join().unwrap().ok()
    }

    fn phase(&mut self) -> String {
        self.control
            .get()
            .map_or_else(String::new, |c| c.message.phase_text.to_string())
    }

    fn run_until(&mut self, phase: &str) {
        for _ in 0..20_000 {
            self.packet(true);
            if self.phase() == phase {
                return;
            }
            // The tare is asked for in a thread of the service, in life's time: the packets wait for it.
            while self.phase() == "tare" && !self.tared.load(Ordering::SeqCst) {
                std::thread::yield_now();
            }
        }
        panic!("never in {phase}: {:?}", self.control.get());
    }

    fn end(mut self) {
        self.stop.trigger();
        let service = self.service.take().unwrap();
        while !service.is_finished() {
            self.packet(true);
            std::thread::yield_now();
        }
        service.join().unwrap().unwrap();
    }
}

#[test]
fn a_task_is_started_tared_wiped_and_ended() {
    let mut cell = Cell::new();
    assert_eq!(cell.phase(), "idle");
    cell.latched = 41;
    cell.packet(true);
    let answer = cell.ask(queries::CONTROL_TASK, "start", TASK).unwrap();
    assert!(answer.done, "{}", answer.message);
    cell.run_until("slide");
    assert_eq!(cell.tares.load(Ordering::SeqCst), 1);
    let state = cell.control.get().unwrap().message.clone();
    assert_eq!(state.task.as_str(), "short line");
    assert_eq!(state.estimator.as_str(), "blend");
    assert!(state.activation > 41);
    assert!((state.force_n - 3.0).abs() < 0.5);
    cell.run_until("done");
    let status = cell.ask(queries::CONTROL_TASK, "status", "").unwrap();
    assert!(
        status.data.contains("\"phase\":\"done\""),
        "{}",
        status.data
    );
    cell.end();
}

#[test]
fn what_is_missing_is_named_and_nothing_moves() {
    let mut cell = Cell::new();
    let start = cell.q;
    for (task, word) in [
        ("name = 1", "invalid type"),
        (&TASK.replace("3.0", "-3.0") as &str, "force.reference_n"),
        (&TASK.replace("blend", "nobody"), "nobody"),
    ] {
        let answer = cell.ask(queries::CONTROL_TASK, "start", task).unwrap();
        assert!(!answer.done, "{task}");
        assert!(answer.message.contains(word), "{word}: {}", answer.message);
    }
    for (key, action) in [
        (queries::CONTROL_TASK, "pause"),
        (queries::CONTROL_TASK, "dance"),
        (queries::CONTROL_SELECT, "select"),
    ] {
        assert!(!cell.ask(key, action, "").unwrap().done, "{action}");
    }
    let answer = cell
        .ask(queries::CONTROL_SELECT, "select", "blend")
        .unwrap();
    assert!(answer.message.contains("no task"), "{}", answer.message);
    assert_eq!(cell.q, start);
    cell.end();
}

#[test]
fn the_end_of_the_service_retracts_first() {
    let mut cell = Cell::new();
    let answer = cell.ask(queries::CONTROL_TASK, "start", &long_task());
    assert!(answer.unwrap().done);
    cell.run_until("slide");
    let tool = |cell: &Cell| {
        (cell.arm.base_from_flange(&cell.q) * cell.config.flange_from_tool)
            .translation()
            .z
    };
    let pressed = tool(&cell);
    cell.stop.trigger();
    let service = cell.service.take().unwrap();
    while !service.is_finished() {
        cell.packet(true);
        std::thread::yield_now();
    }
    service.join().unwrap().unwrap();
    assert!(tool(&cell) > pressed + 0.04);
}

#[test]
fn parameters_show_the_tasks_values_and_change_them() {
    let mut cell = Cell::sliding_for_long();
    let again = cell.ask(queries::CONTROL_TASK, "start", TASK).unwrap();
    assert!(!again.done && again.message.contains("stop the running task"));
    let key = "param/controller/force_reference_n";
    let shown = cell.ask(key, "get", "").unwrap();
    assert!(shown.message.contains("= 3 N"), "{}", shown.message);
    assert!(cell.ask(key, "set", "4.5").unwrap().done);
    assert!(!cell.ask(key, "set", "-1").unwrap().done);
    let mut state = ControlState::default();
    for _ in 0..2000 {
        cell.packet(true);
        state = cell.control.get().unwrap().message.clone();
    }
    assert_eq!(state.force_reference_n, 4.5);
    assert!((state.force_n - 4.5).abs() < 0.3, "{}", state.force_n);
    cell.end();
}

#[test]
fn answering_a_packet_allocates_nothing() {
    let mut cell = Cell::sliding_for_long();
    // Somebody records, so that every message is left for the publishing thread as well.
    let recorder = cell.bus.subscribe_raw("**", 64).unwrap();
    for _ in 0..50 {
        cell.packet(true);
    }
    let before = cell.allocations;
    for _ in 0..1000 {
        cell.packet(true);
    }
    assert_eq!(cell.phase(), "slide");
    assert_eq!(cell.allocations, before);
    assert!(recorder.recv_timeout(PATIENCE).is_some());
    cell.end();
}

#[test]
fn a_wrench_that_falls_silent_stops_the_arm() {
    let mut cell = Cell::sliding_for_long();
    // No wrench any more: its age grows on the wall's clock.
    for _ in 0..1_000_000 {
        cell.packet(false);
        if matches!(cell.phase().as_str(), "fault" | "done") {
            break;
        }
    }
    let state = cell.control.get().unwrap().message.clone();
    assert_eq!(state.phase_text.as_str(), "fault");
    assert!(state.fault.contains("wrench"), "{}", state.fault);
    cell.end();
}
