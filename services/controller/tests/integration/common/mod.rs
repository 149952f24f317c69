//! A simulated cell without the controller: a small arm over a plane publishes packets and follows
//! the commands, and estimators publish with selectable faults. This thread publishes the packets,
//! as the bridge does in a real cell.

// Each test file takes what it needs.
#![allow(dead_code, clippy::unwrap_used)]

mod speaker;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use allocation_counter::measure;
use nalgebra::Vector3;
#[allow(unused_imports)]
pub use speaker::{Mood, Speaker};
use tangent_controller::{Config, ControllerError, run};
use tangent_mechanics::{Arm, Joints, ModelData, Wrench};
use tangent_runtime::bus::answer::{done, refused};
use tangent_runtime::clock::now_ns;
use tangent_runtime::{Bus, CellConfig, Handle, Latest, Publisher, StateFolder, Stop};
use tangent_schemas::convert::{cut, joint_array};
use tangent_schemas::standard::{Header, WrenchStamped};
use tangent_schemas::tangent::{Answer, ArmCommand, ArmState, ControlState, Request, WrenchStatus};
use tangent_schemas::topics::{self, queries};

/// A path of 20 mm on the plane.
pub const TASK: &str = r#"
    name = "short line"
    estimators = ["blend"]
    force.reference_n = 3.0
    [path]
    kind = "line"
    to_m = [0.02, 0.0]
    speed_m_per_s = 0.02
"#;
/// Reason with which the sensor's service refuses a tare.
pub const REFUSAL: &str = "not tared: somebody leans on the tool; the previous zero stays in force";
/// Time between packets.
pub const PERIOD_S: f64 = 0.008;
/// Timeout of an answer.
pub const PATIENCE: Duration = Duration::from_secs(20);

/// A task that is longer than tests in real time: packets arrive faster here than in reality.
pub fn long_task() -> String {
    TASK.replace("[0.02, 0.0]", "[0.02, 0.0]\n    strokes = 10000")
}

/// A simulated cell without the controller.
pub struct Cell {
    pub bus: Bus,
    pub config: Config,
    pub stop: Stop,
    pub service: Option<JoinHandle<Result<(), ControllerError>>>,
    arm_state: Publisher<ArmState>,
    wrench: Publisher<WrenchStamped>,
    status: Publisher<WrenchStatus>,
    /// Estimators in the order in which they were added; the first is `blend`.
    pub speakers: Vec<Speaker>,
    pub command: Latest<ArmCommand>,
    pub control: Latest<ControlState>,
    pub arm: Arm<6>,
    pub q: Joints<6>,
    qd: Joints<6>,
    plane_m: f64,
    pub cycle: u64,
    pub tares: Arc<AtomicU64>,
    pub tared: Arc<AtomicBool>,
    pub latched: u64,
    /// Whether the bridge reports that the arm is ready.
    pub ready: bool,
    /// Number of tares that are refused before one is granted.
    pub refusals: Arc<AtomicU64>,
    /// Number of allocations while packets were answered.
    pub allocations: u64,
    /// Every phase so far, in order. The packets go on while a request waits for its answer, so a
    /// short phase can be over by then.
    pub phases: Vec<String>,
    /// Holder of the arm's lease.
    pub commander: (&'static str, [u8; 16]),
    _tare: Handle,
}

impl Cell {
    pub fn new() -> Self {
        Self::with_state(|_| None)
    }

    /// Starts the controller with the stored state that `state` returns for the tool's position,
    /// base axes, m.
    pub fn with_state(state: impl FnOnce(Vector3<f64>) -> Option<StateFolder>) -> Self {
        let bus = Bus::in_process("test");
        let model = ModelData::builtin("ur5").unwrap();
        let mut config = Config::from_cell(&CellConfig::default_cell(), model).unwrap();
        let arm = config.arm;
        let q = Joints::<6>::from([0.3, -1.6, 1.7, -1.67, -std::f64::consts::FRAC_PI_2, 0.0]);
        let tool = arm.base_from_flange(&q) * config.flange_from_tool;
        config.state = state(tool.translation());
        let (tares, tared) = (
            Arc::new(AtomicU64::new(0)),
            Arc::new(AtomicBool::new(false)),
        );
        let (count, flag) = (Arc::clone(&tares), Arc::clone(&tared));
        let refusals = Arc::new(AtomicU64::new(0));
        let refuse = Arc::clone(&refusals);
        let tare = bus
            .answer(queries::NETFT_TARE, move |_, _| {
                count.fetch_add(1, Ordering::SeqCst);
                if refuse.load(Ordering::SeqCst) > 0 {
                    refuse.fetch_sub(1, Ordering::SeqCst);
                    return refused(REFUSAL);
                }
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
            speakers: vec![Speaker::new(&bus, "blend")],
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
            ready: true,
            refusals,
            allocations: 0,
            phases: Vec::new(),
            commander: ("", [0; 16]),
            _tare: tare,
        };
        // The controller is running once it answers a packet; then it answers queries.
        while cell.packet(true).is_none() {
            assert!(!cell.service.as_ref().unwrap().is_finished());
            std::thread::yield_now();
        }
        while cell.ask(queries::CONTROL_TASK, "status", "").is_none() {
            std::thread::yield_now();
        }
        cell
    }

    /// Adds an estimator, which publishes from now on.
    pub fn add(&mut self, name: &str) {
        self.speakers.push(Speaker::new(&self.bus, name));
    }

    /// State that the controller published in this cycle.
    pub fn said(&mut self) -> ControlState {
        self.control.get().unwrap().message.clone()
    }

    /// A cell in the middle of a task that is longer than the test.
    pub fn sliding_for_long() -> Self {
        let mut cell = Self::new();
        cell.slide(&long_task());
        cell
    }

    /// Starts a task and continues until it slides.
    pub fn slide(&mut self, task: &str) {
        let answer = self.ask(queries::CONTROL_TASK, "start", task).unwrap();
        assert!(answer.done, "{}", answer.message);
        self.run_until("slide");
    }

    /// One packet of the robot: sensor and estimators publish, then the arm, and the command is
    /// carried out.
    pub fn packet(&mut self, sensor: bool) -> Option<ArmCommand> {
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
        for speaker in &mut self.speakers {
            speaker.speak(self.cycle, stamp);
        }
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
            ready: self.ready,
            not_ready_reason: cut(if self.ready { "" } else { "protective stop" }),
            speed_scaling: 1.0,
            activation_latched: self.latched,
            commanded_by: cut(self.commander.0),
            commander_id: self.commander.1,
            ..ArmState::default()
        };
        let answering = measure(|| {
            self.arm_state.publish(&state);
        });
        self.allocations += answering.count_total;
        let phase = self.phase();
        if self.phases.last() != Some(&phase) {
            self.phases.push(phase);
        }
        let command = self.command.take_new()?.message.clone();
        // Answered within the publish call, with exactly one command.
        assert_eq!(command.cycle, self.cycle);
        self.qd = if command.kind == 1 {
            Joints::from_column_slice(&command.values)
        } else {
            Joints::zeros()
        };
        self.q += self.qd * PERIOD_S;
        Some(command)
    }

    /// Sends a request from another thread while the robot's packets continue; `None` if there is
    /// no answer.
    pub fn ask(&mut self, key: &'static str, action: &str, argument: &str) -> Option<Answer> {
        let bus = self.bus.clone();
        let request = Request {
            action: action.into(),
            argument: argument.into(),
        };
        let asking = std::thread::spawn(move || bus.ask(key, &request, PATIENCE));
        while !asking.is_finished() {
            self.wait_for_tare();
            self.packet(true);
        }
        asking.join().unwrap().ok()
    }

    pub fn phase(&mut self) -> String {
        self.control
            .get()
            .map_or_else(String::new, |c| c.message.phase_text.to_string())
    }

    /// The tare is requested by a thread of the service, in real time: the packets wait for it.
    fn wait_for_tare(&mut self) {
        while self.phase() == "tare" && !self.tared.load(Ordering::SeqCst) {
            std::thread::yield_now();
        }
    }

    /// Sends packets until the task is in `phase`.
    pub fn run_until(&mut self, phase: &str) {
        for _ in 0..20_000 {
            self.packet(true);
            if self.phase() == phase {
                return;
            }
            self.wait_for_tare();
        }
        panic!("never in {phase}: {:?}", self.control.get());
    }

    pub fn end(mut self) {
        self.stop.trigger();
        let service = self.service.take().unwrap();
        while !service.is_finished() {
            self.packet(true);
            std::thread::yield_now();
        }
        service.join().unwrap().unwrap();
    }
}
