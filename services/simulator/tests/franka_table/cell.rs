//! A Franka cell in simulated time: the robot's controller with arm and surface, the bridge, the
//! watch of the wrench estimate, camera and touch, the law. Robot and bridge exchange bytes; there
//! is no socket, clock or thread, so that a fault occurs in exactly the cycle that a test names.

mod link;

use std::sync::OnceLock;

use nalgebra::Vector3;
use tangent_actuation::lease::Source;
use tangent_control::{
    Clearance, Fault as TaskFault, Law, Phase, StateInterval, TorqueInterface, TorqueLaw,
    UnifiedForceImpedance, UnifiedInput, UnifiedOutput, VisionInput,
};
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator};
use tangent_franka::bridge::Bridge;
use tangent_franka::fci::{PERIOD_S, RobotMode, RobotState};
use tangent_mechanics::{Arm, Joints, Pose, Tool, Twist, Wrench};
use tangent_runtime::CellConfig;
use tangent_runtime::config::FRANKA_TORQUE_RATE_SHARE;
use tangent_sensing::{RecordWatch, RecordWatchConfig, RecordWatchState, Validity};
use tangent_simulated_franka::{FciConfig, FciRobot, TactileArm};
use tangent_simulation::{NormalCamera, Surface, Truth, VisuoTactileScenario, stated_arm};

use crate::fault::Fault;
use crate::table::arrivals::Arrivals;
use crate::table::{TableCell, Trial, source};

/// The published wave and the cell that ships for it.
const WAVE: &str = include_str!("../../../../scenarios/karacan/karacan_wave.toml");
const CELL: &str = include_str!("../../../../deploy/cell.karacan.toml");
/// Changes to the scenario: start two millimetres above the surface and square to it, soon on the
/// path after contact, and soon off the surface.
const CHANGES: [&str; 11] = [
    "plant.start.clearance_m=0.002",
    "plant.start.tilt_rad=0.0",
    "plant.start_spread.tilt_rad=0.0",
    "plant.start_spread.position_m=0.0",
    "plant.start_spread.clearance_m=0.0",
    "control.touch.settle_s=0.3",
    "control.touch.tare_s=0.1",
    "control.patience.wrench_jitter_s=0.002",
    "task.end.retract_distance_m=0.02",
    "plant.arm.sub_steps=2",
    "plant.tool.pad.rings=1",
];
/// Cycles in which the watch of the wrench learns the estimate's normal variation, and the result;
/// nothing is judged before.
const LEARNS: u64 = 1_100;
static LEARNT: OnceLock<RecordWatchState> = OnceLock::new();
/// Silence after which the bridge considers the robot disconnected, and the pause before it
/// connects again, s.
const STATE_TIMEOUT_S: f64 = 1.0;
const PAUSE_S: f64 = 0.2;
/// Resolution in which changes of the estimate are detected, counts per newton.
const COUNTS_PER_UNIT: f64 = 1e6;
/// Number of readings of a tool that hangs free, kept to be replayed.
const FREE_READINGS: usize = 200;

/// A command of a controller.
#[derive(Clone, Copy, Debug)]
struct Sent {
    cycle: u64,
    kind: u8,
    values: [f64; 7],
    activation: u64,
}

/// A wrench as the controller receives it, and the time of its measurement, s.
#[derive(Clone, Copy, Debug)]
struct Heard {
    wrench: Wrench<Tool>,
    validity: Validity,
    at_s: f64,
}

/// The simulated Franka cell.
pub struct Cell {
    robot: FciRobot,
    surface: Surface,
    camera: NormalCamera,
    scenario: VisuoTactileScenario,
    settings: tangent_franka::Config,
    bridge: Bridge,
    connected: bool,
    /// Time at which the bridge may connect again, the pause after that, and the number of states
    /// at the last connection.
    retry: (f64, f64, u64),
    heard_s: f64,
    tcp: Vec<u8>,
    /// Number of states that no process read, and the last few of them.
    skipped: u64,
    states: Vec<RobotState>,
    watch: (RecordWatch, RecordWatchState),
    /// The estimate before a fault of it.
    kept: [f64; 6],
    free: Vec<Wrench<Tool>>,
    wrench: Option<Heard>,
    stated: Arm<7>,
    interval: StateInterval,
    law: UnifiedForceImpedance,
    activation: u64,
    source: Source,
    starts: u8,
    spoke_s: f64,
    touch: Box<dyn NormalEstimator>,
    /// Settings of the law: largest age of an estimate from touch, and lag of the robot's estimate,
    /// s.
    patience_s: f64,
    lag_s: f64,
    /// The estimate from touch, and the bridge's cycle to which it belongs.
    touched: Option<(NormalEstimate, u64)>,
    seen: Option<VisionInput>,
    arrivals: Arrivals<Sent>,
    pub output: Option<UnifiedOutput>,
    pub trial: Trial<Fault>,
    /// True position of the tool, base axes, m.
    at: Vector3<f64>,
    /// Whether an external force pushes the tool, until the robot stops.
    knocked: bool,
    /// Number of answers that reached the robot, and the last of them, Nm.
    pub answers: u64,
    pub answered: Joints<7>,
}

impl Cell {
    /// A person has checked that the tool hangs free, and confirms it.
    pub fn say_clear(&mut self) {
        self.law.begin(Clearance::Assumed);
        self.law.stop();
    }

    /// A person lets the robot leave its reflex.
    pub fn recover(&mut self) {
        self.bridge.recover();
    }

    /// Simulated time, s.
    pub fn now_s(&self) -> f64 {
        self.trial.cycle as f64 * PERIOD_S
    }

    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    pub fn mode(&self) -> RobotMode {
        self.robot.mode()
    }

    /// Time of exposure of the newest frame that the law has, s.
    pub fn seen_s(&self) -> f64 {
        self.seen.unwrap().time_s
    }

    pub fn activation(&self) -> u64 {
        self.activation
    }

    fn tool(&self) -> Pose<tangent_mechanics::Base, Tool> {
        let q = self.robot.plant().reading().q;
        self.stated.base_from_flange(&q) * self.settings.flange_from_tool
    }

    fn tool_speed(&self) -> f64 {
        let now = self.robot.plant().reading();
        let (_, jacobian) = self
            .stated
            .tool_and_jacobian(&now.q, &self.settings.flange_from_tool);
        (jacobian * now.qd).fixed_rows::<3>(0).norm()
    }

    /// Effects of faults when they begin, and actions of people when they end.
    fn begin_and_end(&mut self) {
        let Some((begun, ended)) = self.trial.changes() else {
            return;
        };
        for fault in begun {
            match fault {
                Fault::BridgeDead | Fault::Disconnected => self.lost(),
                Fault::Collision => {
                    self.knocked = true;
                    self.robot.push([0.0, 0.0, 90.0]);
                }
                Fault::UserStop => self.robot.set_user_stop(true),
                _ => {}
            }
        }
        for fault in ended {
            match fault {
                Fault::BridgeDead => {
                    self.bridge = Bridge::new(self.settings.bridge.clone());
                    self.start_controller();
                    self.retry = (self.now_s(), PAUSE_S, 0);
                }
                Fault::ControllerDead => self.start_controller(),
                Fault::UserStop => self.robot.set_user_stop(false),
                Fault::CommandSwapped => self.arrivals.forget(),
                _ => {}
            }
        }
    }

    /// Estimates from touch and camera in this cycle.
    fn look(&mut self, now_s: f64) -> Option<(NormalEstimate, f64)> {
        let silent = self.has(Fault::EstimatesSilent);
        if let Some(mut frame) = self.camera.take(now_s) {
            if self.has(Fault::CameraNan) {
                frame.normal = Vector3::repeat(f64::NAN);
            }
            if self.has(Fault::CameraAskew) {
                let turn = nalgebra::Rotation3::new(Vector3::new(1.0, 0.0, 0.0));
                frame.normal = turn * frame.normal;
            }
            if !self.has(Fault::CameraDark) && !silent {
                self.seen = Some(frame);
            }
        }
        self.touched
            .map(|(said, cycle)| (said, (self.bridge.cycle() - cycle) as f64 * PERIOD_S))
            .filter(|(_, age_s)| *age_s <= self.patience_s)
    }

    /// The controller answers a state.
    fn law_step(&mut self, state: &RobotState, now_s: f64) -> Sent {
        let touch = self.look(now_s);
        let latched = self.bridge.gate().admission.activation_latched();
        // As in the service: a task that the bridge has rejected moves the arm no more.
        let ended = self.law.phase().is_active() && latched >= self.activation;
        let heard = self.wrench;
        let input = UnifiedInput {
            time_s: now_s,
            dt_s: self
                .interval
                .step(state.message_id as f64 * PERIOD_S, PERIOD_S),
            q: Joints::from(state.q),
            qd: Joints::from(state.dq),
            arm_ready: self.is_ready() && !ended,
            wrench: heard.map_or_else(Wrench::zero, |h| h.wrench),
            wrench_validity: heard.map_or(Validity::Missing, |h| h.validity),
            wrench_age_s: heard.map_or(f64::INFINITY, |h| now_s - h.at_s),
            untared: None,
            vision: self.seen,
            touch: touch.map(|(said, _)| said),
            touch_age_s: touch.map_or(f64::INFINITY, |(_, age_s)| age_s),
        };
        let output = self.law.step(&input);
        assert!(output.torque.iter().all(|x| x.is_finite()));
        self.output = Some(output);
        self.feel(&input, &output);
        Sent {
            cycle: self.bridge.cycle(),
            kind: if output.phase.is_active() { 2 } else { 0 },
            values: output.torque.into(),
            activation: self.activation,
        }
    }

    /// The normal from touch for the next cycles, from the wrench as the law has corrected it.
    fn feel(&mut self, input: &UnifiedInput, output: &UnifiedOutput) {
        if self.has(Fault::TouchSilent) || self.has(Fault::EstimatesSilent) {
            return;
        }
        let tool = &self.settings.flange_from_tool;
        let (_, jacobian) = self.stated.tool_and_jacobian(&input.q, tool);
        let zeroed = !matches!(output.phase, Phase::Tare | Phase::Clear);
        let felt = output
            .wrench
            .filter(|_| zeroed && input.wrench_validity.is_valid());
        let twist = Twist::from_vector(&(jacobian * input.qd));
        let said = self.touch.update(&ContactSample {
            time_s: input.time_s,
            dt_s: input.dt_s,
            base_from_tool: output.base_from_tool,
            twist,
            twist_commanded: twist,
            wrench: felt.unwrap_or(Wrench::zero()),
            wrench_delay_s: self.lag_s,
            wrench_validity: if felt.is_some() {
                Validity::Valid
            } else {
                Validity::Missing
            },
            wrench_bias_age_s: felt.map(|_| input.time_s),
            base: None,
        });
        self.touched = Some((said, self.bridge.cycle()));
    }
}

impl TableCell for Cell {
    type Setup = ();
    type Fault = Fault;
    const PATIENCE: u64 = 30_000;
    const AT_REST: f64 = 2e-3;
    const PAUSE_IS_A_PHASE: bool = false;

    /// A cell that is connected and held, with a controller that waits for a task.
    fn new((): ()) -> Self {
        let changes: Vec<String> = CHANGES.iter().map(|s| (*s).to_owned()).collect();
        let scenario = VisuoTactileScenario::parse("karacan_wave", WAVE, &changes).unwrap();
        let config = CellConfig::parse("cell.karacan.toml", CELL).unwrap();
        let settings = tangent_franka::Config::from_cell(&config).unwrap();
        let franka = config.robot.franka();
        let plant = TactileArm::new(&scenario.plant, franka.delay_periods, 1).unwrap();
        let stated = stated_arm::<7>(&scenario.plant.robot, &scenario.plant.tool).unwrap();
        let parameters = scenario.law().unwrap();
        let law = UnifiedForceImpedance::new(
            stated,
            settings.flange_from_tool,
            scenario.limits,
            &parameters,
            &scenario.task,
            TorqueInterface {
                delay_periods: franka.delay_periods,
                gravity_by_arm: true,
                effort_share: franka.torque_share,
                rate_share: FRANKA_TORQUE_RATE_SHARE,
            },
        )
        .unwrap();
        let mut cell = Self {
            surface: plant.surface().clone(),
            camera: NormalCamera::new(&scenario.plant.camera, 1),
            robot: FciRobot::new(&FciConfig::default(), Box::new(plant)).unwrap(),
            bridge: Bridge::new(settings.bridge.clone()),
            connected: false,
            retry: (0.0, PAUSE_S, 0),
            heard_s: 0.0,
            tcp: Vec::new(),
            skipped: 0,
            states: Vec::new(),
            watch: (
                RecordWatch::new(&RecordWatchConfig::default(), 1.0 / PERIOD_S),
                RecordWatchState::default(),
            ),
            kept: [0.0; 6],
            free: Vec::new(),
            wrench: None,
            touch: scenario.touch().unwrap(),
            touched: None,
            patience_s: parameters.patience.estimate_s,
            lag_s: parameters.touch.wrench_lag_s,
            seen: None,
            arrivals: Arrivals::default(),
            stated,
            interval: StateInterval::default(),
            law,
            activation: 0,
            source: source("controller/cell-1", 1),
            starts: 1,
            spoke_s: 0.0,
            output: None,
            trial: Trial::default(),
            at: Vector3::zeros(),
            knocked: false,
            answers: 0,
            answered: Joints::zeros(),
            settings,
            scenario,
        };
        cell.at = cell.truth().base_from_tool.translation();
        // No task has been started yet.
        cell.say_clear();
        cell.connect();
        let learnt = LEARNT.get().copied();
        cell.watch.1 = learnt.unwrap_or_default();
        cell.until("the arm is ready", Cell::is_ready);
        if learnt.is_none() {
            cell.steps(LEARNS);
            // Another thread may have set it first.
            let _ = LEARNT.set(cell.watch.1);
            return Self::new(());
        }
        cell
    }

    /// One period of the robot: it sends its state, receives an answer or not, and moves.
    fn step(&mut self) {
        self.trial.cycle += 1;
        self.begin_and_end();
        if self.knocked && self.robot.mode() != RobotMode::Move {
            self.knocked = false;
            self.robot.push([0.0; 3]);
        }
        self.camera.expose(self.now_s(), &self.surface, &self.at);
        let mut datagram = Vec::new();
        self.robot.state().encode(&mut datagram);
        let state = RobotState::decode(&datagram).unwrap();
        let answer = self.exchange(state);
        if let Some(answer) = &answer {
            self.answers += 1;
            self.answered = Joints::from(answer.tau_j_d);
        }
        self.robot.step(answer.as_ref());
        let truth = self.truth();
        self.at = truth.base_from_tool.translation();
        self.trial.peak_n = self.trial.peak_n.max(truth.wrench.force.norm());
    }

    fn trial(&self) -> &Trial<Fault> {
        &self.trial
    }

    fn trial_mut(&mut self) -> &mut Trial<Fault> {
        &mut self.trial
    }

    fn period_s(&self) -> f64 {
        PERIOD_S
    }

    fn phase(&self) -> Phase {
        self.law.phase()
    }

    fn is_sliding(&self) -> bool {
        self.law.phase() == Phase::Slide && self.tool_speed() > 0.02
    }

    /// The torque motion runs, no other source drives the arm, and a task could move it.
    fn is_ready(&self) -> bool {
        let holder = self.bridge.lease().holder();
        self.connected
            && self.bridge.reason(self.now_s()).is_none()
            && holder.is_none_or(|holder| *holder == self.source)
    }

    fn in_words(&self) -> String {
        format!(
            "{:?}, {:?}, {:?}, {:?}",
            self.law.phase(),
            self.bridge.reason(self.now_s()),
            self.robot.mode(),
            self.output.and_then(|o| o.fault)
        )
    }

    fn truth(&self) -> Truth {
        self.robot.plant().truth().unwrap()
    }

    fn shown_n(&self) -> f64 {
        self.output.unwrap().force_n.unwrap()
    }

    fn task_fault(&self) -> Option<TaskFault> {
        self.output.unwrap().fault
    }

    fn progress(&self) -> f64 {
        self.output.unwrap().path_progress
    }

    fn reference_n(&self) -> f64 {
        self.scenario.task.force.reference_n
    }

    fn robot_speed(&self) -> f64 {
        self.robot.plant().reading().qd.amax()
    }

    /// As the service does for a start request while the arm is ready.
    fn start_task(&mut self) {
        let clearance = self.law.clearance();
        let at = self.tool().translation();
        self.law.check_start(&clearance, &at).unwrap();
        self.law.begin(clearance);
        let latched = self.bridge.gate().admission.activation_latched();
        self.activation = self.activation.max(latched) + 1;
    }

    fn pause_task(&mut self) {
        self.law.pause(true).unwrap();
    }

    fn stop_task(&mut self) {
        self.law.stop();
    }
}
