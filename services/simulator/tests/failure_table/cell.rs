//! A UR cell in simulated time: the robot's controller with the uploaded program, the bridge,
//! conditioning, an estimator, the law. Robot and bridge exchange bytes; there is no socket, clock
//! or thread, so that a fault occurs in exactly the cycle that a test names.

mod link;

use std::fmt;

use nalgebra::Vector6;
use tangent_actuation::lease::Source;
use tangent_control::{
    CommandKind, ControlInput, ControlOutput, Controller as Law, EstimateInput, Fault as TaskFault,
    MAX_ESTIMATORS, Phase, Program, StateInterval, UntaredLoad,
};
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator, build};
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, Wrench};
use tangent_rtde::bridge::Bridge;
use tangent_rtde::codec::Framer;
use tangent_runtime::CellConfig;
use tangent_sensing::{SensorWatchState, Validity};
use tangent_simulated_ur::controller::Controller as Robot;
use tangent_simulated_ur::rtde_server::{Ownership, Session};
use tangent_simulated_ur::{ControllerConfig, Flavour};
use tangent_simulation::{AdmittancePlant, AdmittanceScenario, Truth, VelocityCommand};

use crate::fault::Fault;
use crate::table::pairs::Setup;
use crate::table::sensor::{RecordFaults, SensorChain};
use crate::table::{TableCell, Trial, source};

/// A table one millimetre under the tool, wiped with 3 N.
const TABLE: &str = r#"
    name = "table"
    duration_s = 60.0
    [plant]
    robot = "ur5"
    [plant.surface]
    shape = "plane"
    position_m = [0.0, 0.0, 0.1]
    [plant.sensor]
    noise_n_per_sqrt_hz = 0.002
    noise_nm_per_sqrt_hz = 6e-5
    bias_n = 2.0
    range_n = [130.0, 130.0, 400.0]
    range_nm = [10.0, 10.0, 10.0]
    [plant.start]
    near_m = [0.4, -0.05, 0.1]
    clearance_m = 0.001
    seed_rad = [3.14, -1.57, 1.57, -1.57, -1.57, 0.0]
    [plant.tool.pad]
    radius_m = 0.01
    rings = 1
    [task]
    name = "wipe a table"
    estimators = ["blend"]
    force.reference_n = 3.0
    [task.path]
    kind = "line"
    to_m = [0.1, 0.0]
    speed_m_per_s = 0.02
    strokes = 100
"#;
/// Longest package, bytes.
const PACKAGE_BYTES_MAX: usize = 4096;

/// The simulated UR cell.
pub struct Cell {
    robot: Robot,
    session: Session,
    ownership: Ownership,
    at_robot: Framer,
    to_robot: Vec<u8>,
    plant: AdmittancePlant,
    velocity: VelocityCommand,
    bridge: Bridge,
    at_bridge: Framer,
    settings: tangent_rtde::Config,
    starts: u64,
    sensor: SensorChain,
    /// Counts of the last record before a sensor fault, and number of records since.
    frozen: ([i32; 6], u64),
    pose_before: (Pose<Base, Tool>, f64),
    estimator: Box<dyn NormalEstimator>,
    /// The estimate that the law has, and the time at which it was made, s.
    estimate: Option<(NormalEstimate, f64)>,
    scenario: AdmittanceScenario,
    interval: StateInterval,
    law: Law,
    program: Program,
    source: Source,
    /// Time of its last command, s.
    spoke_s: f64,
    pub output: Option<ControlOutput>,
    pub trial: Trial<Fault>,
}

fn law(scenario: &AdmittanceScenario, plant: &AdmittancePlant) -> Law {
    let config = scenario.controller_config().unwrap();
    let tool = plant.flange_from_tool();
    Law::new(*plant.model(), tool, scenario.limits, config).unwrap()
}

impl Cell {
    /// A person checks a robot that does not move, and lets the bridge send its program again.
    pub fn reset_bridge(&mut self) {
        self.bridge.reset();
    }

    /// Simulated time, s.
    pub fn now_s(&self) -> f64 {
        self.plant.time_s()
    }

    /// Duration of the task's path, s.
    pub fn path_s(&self) -> f64 {
        self.program.path.duration_s()
    }

    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    /// Joint velocity that the robot's program passed to `speedj` last, rad/s.
    pub fn given(&self) -> Vector6<f64> {
        let out = &self.robot.registers.output.doubles;
        Vector6::from_fn(|i, _| out[24 + i])
    }

    /// The program's state and the cause of its last stop.
    pub fn program(&self) -> (i32, i32) {
        let out = &self.robot.registers.output.integers;
        (out[24], out[28])
    }

    /// Effects of faults when they begin, and actions of people when they end.
    fn begin_and_end(&mut self) {
        let Some((begun, ended)) = self.trial.changes() else {
            self.look_after_robot();
            return;
        };
        for fault in begun {
            match fault {
                Fault::ProtectiveStop => self.robot.protective_stop(0, 0, "test"),
                Fault::EmergencyStop => self.robot.emergency_stop(true, true),
                Fault::RobotRestart => {
                    self.robot.restart();
                    self.bridge.close();
                }
                Fault::SensorRestart => {
                    self.sensor.restart();
                    self.sensor.watching = SensorWatchState::default();
                }
                Fault::SensorCorrupt => self.frozen.1 = 0,
                _ => {}
            }
        }
        for fault in ended {
            match fault {
                Fault::EmergencyStop => {
                    self.robot.emergency_stop(true, false);
                    self.robot.power_on();
                    self.robot.release_brakes();
                }
                Fault::RobotRestart if !self.has(Fault::BridgeDead) => self.connect(),
                Fault::BridgeDead => self.start_bridge(),
                _ => {}
            }
        }
    }

    /// A person unlocks a robot after a protective stop, as soon as it accepts that.
    fn look_after_robot(&mut self) {
        if !self.has(Fault::ProtectiveStop) {
            let _ = self.robot.unlock();
        }
    }

    /// Passes the records of the period through watch and conditioning, as the service does.
    fn sense(&mut self) {
        let (pose, at) = self.pose_before;
        let tool = self.tool();
        self.pose_before = (tool.0, self.now_s());
        if self.has(Fault::SensorSilent) || self.has(Fault::SensorRestart) {
            return;
        }
        for sample in self.plant.sensor_samples().to_vec() {
            let counts = self.corrupted(sample.counts);
            let faults = RecordFaults {
                nan: self.has(Fault::SensorNan),
                error: self.has(Fault::SensorError),
                saturated: self.has(Fault::SensorSaturated),
                contact_lost: self.has(Fault::ContactLost),
            };
            let tool = (pose, sample.time_s - at);
            self.sensor.take(&sample, counts, faults, tool);
        }
    }

    /// Changes a record according to the sensor's faults.
    fn corrupted(&mut self, mut counts: [i32; 6]) -> [i32; 6] {
        let (last, since) = &mut self.frozen;
        let has = |fault| self.trial.faults.contains(&fault);
        if has(Fault::SensorFrozen) {
            counts = *last;
        } else if has(Fault::SensorDead) {
            counts = [0; 6];
        } else if has(Fault::AxisStuck) {
            counts[2] = last[2];
        } else {
            *last = counts;
        }
        if has(Fault::ZeroJumped) {
            counts[2] += self.sensor.counts_of(2, 1.5);
        }
        *since += 1;
        if has(Fault::SensorCorrupt) && since.is_multiple_of(4) {
            counts[2] += self.sensor.counts_of(2, 30.0);
        }
        counts
    }

    fn tool(&self) -> (Pose<Base, Tool>, nalgebra::Matrix6<f64>) {
        let arm = self.plant.arm();
        self.plant
            .model()
            .tool_and_jacobian(&arm.q, &self.plant.flange_from_tool())
    }

    fn law_step(
        &mut self,
        base_from_tool: Pose<Base, Tool>,
        jacobian: &nalgebra::Matrix6<f64>,
        now_s: f64,
    ) -> ControlOutput {
        let arm = self.plant.arm();
        let twist: Twist<Aligned<Tool, Base>> = Twist::from_vector(&(jacobian * arm.qd));
        let (wrench, tare) = (self.sensor.wrench, self.sensor.conditioner.tare_config());
        let mut estimates = [None; MAX_ESTIMATORS];
        estimates[0] = self.estimate.map(|(estimate, at)| EstimateInput {
            estimate,
            age_s: now_s - at,
        });
        // As in the service: a task that the bridge has rejected moves the arm no more.
        let latched = self.law.phase().is_active()
            && self.bridge.gate().admission.activation_latched() >= self.law.activation();
        let input = ControlInput {
            time_s: now_s,
            dt_s: self
                .interval
                .step(self.bridge.sample().timestamp_s, self.period_s()),
            q: arm.q,
            qd: arm.qd,
            base_from_tool,
            twist,
            speed_scaling: self.bridge.sample().scaling(),
            arm_ready: self.bridge.is_ready() && !latched,
            wrench: wrench.map_or_else(Wrench::zero, |(w, _)| w.wrench),
            wrench_validity: wrench.map_or(Validity::Missing, |(w, _)| w.validity),
            wrench_age_s: wrench.map_or(f64::INFINITY, |(_, at)| now_s - at),
            wrench_delay_s: wrench.map_or(0.0, |(w, _)| w.delay_s),
            bias_age_s: wrench.and_then(|(w, _)| w.bias_age_s),
            zero_bound_n: wrench
                .and_then(|(w, _)| w.bias_age_s)
                .map(|age_s| tare.drift_bound_n(age_s)),
            untared: wrench.map(|(w, _)| UntaredLoad {
                beyond_reference_n: w.reference.map(|(zero, _)| (w.untared - zero).force.norm()),
                rated_share: tare.rated_share(&w.untared),
            }),
            arm_force: None,
            estimates,
            objects: [None; MAX_ESTIMATORS],
            vision: None,
            base: None,
        };
        let output = self.law.step(&input);
        let sensor = &mut self.sensor;
        if output.tare_requested && !sensor.conditioning.is_taring() {
            let ground = output.clearance.tare_ground();
            sensor
                .conditioner
                .start_tare(&mut sensor.conditioning, ground);
        }
        if output.zero_withdrawn {
            sensor.conditioning.withdraw_tare();
        }
        // The estimator's answer is used in the next cycle.
        if !self.has(Fault::EstimateSilent) {
            let estimate = self.estimator.update(&ContactSample {
                time_s: now_s,
                dt_s: input.dt_s,
                base_from_tool,
                twist,
                twist_commanded: output.twist_commanded,
                wrench: input.wrench,
                wrench_delay_s: input.wrench_delay_s,
                wrench_validity: input.wrench_validity,
                wrench_bias_age_s: input.bias_age_s,
                base: None,
            });
            self.estimate = Some((estimate, now_s));
        }
        assert!(output.kind != CommandKind::JointTorque);
        self.output = Some(output);
        output
    }
}

impl Setup for Flavour {
    fn add_to(&self, text: &mut fmt::DebugStruct<'_, '_>) {
        text.field("flavour", self);
    }
}

impl TableCell for Cell {
    type Setup = Flavour;
    type Fault = Fault;
    /// An approach from the end of a retraction takes half of it.
    const PATIENCE: u64 = 10_000;
    const AT_REST: f64 = 1e-6;
    const PAUSE_IS_A_PHASE: bool = true;

    /// A cell with power, connected and ready; no task runs.
    fn new(flavour: Flavour) -> Self {
        let text = match flavour {
            Flavour::Cb3 => TABLE.to_owned(),
            Flavour::ESeries => TABLE.replace("\"ur5\"", "\"ur5e\"\n    arm.period_s = 0.002"),
        };
        let scenario =
            AdmittanceScenario::parse("table", &text, &[], &tangent_simulation::no_files).unwrap();
        let plant = AdmittancePlant::new(&scenario.plant, 1).unwrap();
        let mut cell = CellConfig::default_cell();
        cell.robot.model = scenario.plant.robot.clone();
        let settings = tangent_rtde::Config::from_cell(&cell).unwrap();
        let robot = Robot::new(
            &ControllerConfig {
                flavour,
                ..ControllerConfig::default()
            },
            &scenario.plant.robot,
            plant.arm(),
        )
        .unwrap();
        let sensor = SensorChain::new(
            &scenario.sensing,
            &scenario.plant.tool.payload,
            plant.flange_from_sensor().inverse() * plant.flange_from_tool(),
            &scenario.plant.sensor,
        );
        let config = scenario.controller_config().unwrap();
        let law = law(&scenario, &plant);
        let mut cell = Self {
            session: Session::new(1, flavour.version()),
            ownership: Ownership::default(),
            at_robot: Framer::new(PACKAGE_BYTES_MAX),
            to_robot: Vec::new(),
            velocity: VelocityCommand::hold(),
            bridge: Bridge::new(settings.bridge.clone()),
            at_bridge: Framer::new(PACKAGE_BYTES_MAX),
            settings,
            starts: 0,
            sensor,
            frozen: ([0; 6], 0),
            pose_before: (plant.truth().base_from_tool, 0.0),
            estimator: build("blend", &scenario.estimation).unwrap(),
            estimate: None,
            interval: StateInterval::default(),
            law,
            program: Program::new(&scenario.task, &config).unwrap(),
            source: source("controller/cell-1", 1),
            spoke_s: 0.0,
            output: None,
            trial: Trial::default(),
            robot,
            scenario,
            plant,
        };
        cell.start_bridge();
        cell.until("the bridge is ready", |c| c.bridge.is_ready());
        cell
    }

    /// One period of the robot: it moves, reports, receives an answer, and acts on it in the next.
    fn step(&mut self) {
        self.trial.cycle += 1;
        self.begin_and_end();
        self.plant.step(&self.velocity);
        let truth = self.plant.truth();
        self.trial.peak_n = self.trial.peak_n.max(truth.wrench.force.norm());
        self.robot
            .observe(self.plant.arm(), truth.wrench.vector().into());
        self.sense();
        if self.has(Fault::RobotRestart) {
            // The robot is still starting, with its brakes engaged.
            self.to_robot.clear();
            self.velocity = VelocityCommand::hold();
            return;
        }
        let package = self
            .session
            .package(self.trial.cycle, &self.robot, &self.robot.summary());
        if self.has(Fault::BridgeDead) {
            self.to_robot.clear();
        } else {
            assert_eq!(self.at_bridge.push(&package), package.len());
            self.bridge_cycle();
        }
        self.robot_hears();
        self.velocity = self.robot.act();
    }

    fn trial(&self) -> &Trial<Fault> {
        &self.trial
    }

    fn trial_mut(&mut self) -> &mut Trial<Fault> {
        &mut self.trial
    }

    fn period_s(&self) -> f64 {
        self.plant.period_s()
    }

    fn phase(&self) -> Phase {
        self.law.phase()
    }

    fn is_sliding(&self) -> bool {
        self.law.phase() == Phase::Slide && self.robot_speed() > 0.01
    }

    fn is_ready(&self) -> bool {
        self.bridge.is_ready()
    }

    fn in_words(&self) -> String {
        format!(
            "{:?}, {:?}, {:?}, {:?}",
            self.law.phase(),
            self.bridge.reason(),
            self.program(),
            self.output.and_then(|o| o.fault)
        )
    }

    fn truth(&self) -> Truth {
        self.plant.truth()
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
        self.plant.arm().qd.amax()
    }

    fn start_task(&mut self) {
        let latched = self.bridge.gate().admission.activation_latched();
        let at = self.tool().0.translation();
        self.law.check_start(&at).unwrap();
        self.law.start(self.program.clone(), latched).unwrap();
    }

    fn pause_task(&mut self) {
        self.law.pause().unwrap();
    }

    fn stop_task(&mut self) {
        self.law.stop();
    }
}
