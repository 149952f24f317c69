//! A UR cell in simulated time: the robot's controller with the uploaded program, the bridge,
//! conditioning, an estimator, the law. Bytes go to and fro between robot and bridge; there is no
//! socket, clock or thread, so that a fault comes in the very cycle that a test names.

use nalgebra::Vector6;
use tangent_actuation::Command;
use tangent_actuation::lease::{SILENCE_S, Source};
use tangent_actuation::velocity::Posture;
use tangent_control::{
    CommandKind, ControlInput, ControlOutput, Controller as Law, EstimateInput, MAX_ESTIMATORS,
    Phase, Program, StateInterval, UntaredLoad,
};
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator, build};
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, Wrench};
use tangent_rtde::bridge::{Bridge, BridgeConfig, BridgeEvent};
use tangent_rtde::codec::Framer;
use tangent_runtime::CellConfig;
use tangent_schemas::Name;
use tangent_sensing::{
    ConditionedWrench, Payload, Reading, RecordWatchConfig, SensorCondition, SensorRecord,
    SensorWatch, SensorWatchState, Validity, Watched, WrenchConditioner, WrenchConditionerState,
    pressing_at,
};
use tangent_simulation::{Plant, Scenario, Truth, VelocityCommand};
use tangent_simulator::controller::Controller as Robot;
use tangent_simulator::rtde_server::{Effect, Ownership, Session};
use tangent_simulator::{ControllerConfig, Flavour};

use crate::fault::Fault;

/// A table a millimetre under the tool, wiped with 3 N.
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
/// Longest wait for anything, cycles: an approach from where a retraction ended takes half of it.
const PATIENCE: u64 = 10_000;
/// Longest package, bytes.
const PACKAGE_BYTES_MAX: usize = 4096;

/// The cell.
pub struct Cell {
    robot: Robot,
    session: Session,
    ownership: Ownership,
    at_robot: Framer,
    to_robot: Vec<u8>,
    plant: Plant,
    velocity: VelocityCommand,
    bridge: Bridge,
    at_bridge: Framer,
    settings: tangent_rtde::Config,
    starts: u64,
    conditioner: WrenchConditioner,
    conditioning: WrenchConditionerState,
    watch: SensorWatch,
    watching: SensorWatchState,
    /// The last record before a sensor's fault, counts, and records since.
    frozen: ([i32; 6], u64),
    wrench: Option<(ConditionedWrench, f64)>,
    scale: [f64; 6],
    pose_before: (Pose<Base, Tool>, f64),
    estimator: Box<dyn NormalEstimator>,
    /// What the law has of it, and when it was made.
    estimate: Option<(NormalEstimate, f64)>,
    scenario: Scenario,
    interval: StateInterval,
    law: Law,
    program: Program,
    source: Source,
    /// When it was last heard, s.
    spoke_s: f64,
    pub output: Option<ControlOutput>,
    pub cycle: u64,
    /// What is wrong now.
    pub faults: Vec<Fault>,
    /// What was in the cycle before.
    faults_before: Vec<Fault>,
    /// Largest true force since it was set to zero, N.
    pub peak_n: f64,
}

fn source(name: &str, id: u8) -> Source {
    Source {
        name: Name::from(name).unwrap(),
        publisher: [id; 16],
    }
}

fn law(scenario: &Scenario, plant: &Plant) -> Law {
    let config = scenario.controller_config().unwrap();
    let tool = plant.flange_from_tool();
    Law::new(*plant.model(), tool, scenario.limits, config).unwrap()
}

impl Cell {
    /// Powered, connected and ready; no task runs.
    pub fn new(flavour: Flavour) -> Self {
        let text = match flavour {
            Flavour::Cb3 => TABLE.to_owned(),
            Flavour::ESeries => TABLE.replace("\"ur5\"", "\"ur5e\"\n    arm.period_s = 0.002"),
        };
        let scenario =
            Scenario::parse("table", &text, &[], &|_| Err("no file".to_owned())).unwrap();
        let plant = Plant::new(&scenario.plant, 1).unwrap();
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
        let payload = &scenario.plant.tool.payload;
        let conditioner = WrenchConditioner::new(
            &scenario.sensing,
            &Payload {
                mass_kg: payload.mass_kg,
                com_in_sensor_m: payload.com_in_sensor_m,
                inertia_kg_m2: payload.inertia_kg_m2,
            },
            plant.flange_from_sensor().inverse() * plant.flange_from_tool(),
            scenario.plant.sensor.rate_hz,
        )
        .unwrap();
        let config = scenario.controller_config().unwrap();
        let law = law(&scenario, &plant);
        let sensor = &scenario.plant.sensor;
        let (range, range_nm) = (sensor.range_n, sensor.range_nm);
        let (n, nm) = (1.0 / sensor.counts_per_n, 1.0 / sensor.counts_per_nm);
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
            conditioning: WrenchConditionerState::default(),
            conditioner,
            watch: SensorWatch::new(
                &RecordWatchConfig::default(),
                sensor.rate_hz,
                [
                    range[0],
                    range[1],
                    range[2],
                    range_nm[0],
                    range_nm[1],
                    range_nm[2],
                ],
            ),
            watching: SensorWatchState::default(),
            frozen: ([0; 6], 0),
            wrench: None,
            scale: [n, n, n, nm, nm, nm],
            pose_before: (plant.truth().base_from_tool, 0.0),
            estimator: build("blend", &scenario.estimation).unwrap(),
            estimate: None,
            interval: StateInterval::default(),
            law,
            program: Program::new(&scenario.task, &config).unwrap(),
            source: source("controller/cell-1", 1),
            spoke_s: 0.0,
            output: None,
            cycle: 0,
            faults: Vec::new(),
            faults_before: Vec::new(),
            peak_n: 0.0,
            robot,
            scenario,
            plant,
        };
        cell.start_bridge();
        cell.until("the bridge is ready", |c| c.bridge.is_ready());
        cell
    }

    /// The bridge's process starts, anew if there was one; the controller in it too.
    fn start_bridge(&mut self) {
        self.starts += 1;
        // What the service keeps over restarts: whether the tool may touch.
        let known = self.law.clearance();
        self.law = law(&self.scenario, &self.plant);
        self.law.set_clearance(known).unwrap();
        self.estimator = build("blend", &self.scenario.estimation).unwrap();
        self.estimate = None;
        self.output = None;
        self.bridge = Bridge::new(BridgeConfig {
            seed: self.starts,
            ..self.settings.bridge.clone()
        });
        self.connect();
    }

    /// Starts the task.
    pub fn start_task(&mut self) {
        let latched = self.bridge.gate().admission.activation_latched();
        let at = self.tool().0.translation();
        self.law.check_start(&at).unwrap();
        self.law.start(self.program.clone(), latched).unwrap();
    }

    /// A person looks after a robot that does not move, and has the bridge send its program again.
    pub fn reset_bridge(&mut self) {
        self.bridge.reset();
    }

    /// Ends the task.
    pub fn stop_task(&mut self) {
        self.law.stop();
    }

    /// A task in this phase, as far as it has come in the first cycle of it.
    pub fn in_phase(flavour: Flavour, phase: Phase) -> Self {
        let mut cell = match phase {
            Phase::Slide => return Self::sliding(flavour),
            Phase::Hold | Phase::Retract | Phase::Clear => Self::sliding(flavour),
            _ => Self::new(flavour),
        };
        match phase {
            Phase::Hold => cell.law.pause().unwrap(),
            Phase::Retract => cell.law.stop(),
            Phase::Clear => {
                // A task that ended on the surface.
                cell.faults = vec![Fault::NoCommand];
                cell.steps((0.4 / cell.period_s()) as u64);
                cell.faults.clear();
                cell.until("the task is over", |c| !c.phase().is_active());
                cell.until("the bridge is ready", |c| c.bridge.is_ready());
                cell.start_task();
            }
            _ => cell.start_task(),
        }
        cell.until("it is in the phase", |c| c.phase() == phase);
        cell.peak_n = 0.0;
        cell
    }

    /// On the path.
    pub fn sliding(flavour: Flavour) -> Self {
        let mut cell = Self::new(flavour);
        cell.start_task();
        cell.until("it slides", |c| {
            c.law.phase() == Phase::Slide && c.robot_speed() > 0.01
        });
        cell.peak_n = 0.0;
        cell
    }

    /// Simulated time, s.
    pub fn now_s(&self) -> f64 {
        self.plant.time_s()
    }

    pub fn period_s(&self) -> f64 {
        self.plant.period_s()
    }

    pub fn phase(&self) -> Phase {
        self.law.phase()
    }

    /// Time that the task's path takes, s.
    pub fn path_s(&self) -> f64 {
        self.program.path.duration_s()
    }

    pub fn bridge(&self) -> &Bridge {
        &self.bridge
    }

    pub fn truth(&self) -> Truth {
        self.plant.truth()
    }

    /// Velocity that the robot's program gave to `speedj` last, rad/s.
    pub fn given(&self) -> Vector6<f64> {
        let out = &self.robot.registers.output.doubles;
        Vector6::from_fn(|i, _| out[24 + i])
    }

    /// The program's state and the cause of its last stop.
    pub fn program(&self) -> (i32, i32) {
        let out = &self.robot.registers.output.integers;
        (out[24], out[28])
    }

    /// Largest joint speed of the arm as it truly moves, rad/s.
    pub fn robot_speed(&self) -> f64 {
        self.plant.arm().qd.amax()
    }

    /// Cycles until `done`.
    pub fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let begun = self.cycle;
        while !done(self) {
            self.step();
            assert!(
                self.cycle - begun < PATIENCE,
                "never: {what}; {:?}, {:?}, {:?}, {:?}",
                self.law.phase(),
                self.bridge.reason(),
                self.program(),
                self.output.and_then(|o| o.fault)
            );
        }
    }

    pub fn steps(&mut self, n: u64) {
        for _ in 0..n {
            self.step();
        }
    }

    pub fn has(&self, fault: Fault) -> bool {
        self.faults.contains(&fault)
    }

    /// One period of the robot: it moves, reports, is answered, and acts on the answer in the next.
    pub fn step(&mut self) {
        self.cycle += 1;
        self.begin_and_end();
        self.plant.step(&self.velocity);
        let truth = self.plant.truth();
        self.peak_n = self.peak_n.max(truth.wrench.force.norm());
        self.robot
            .observe(self.plant.arm(), truth.wrench.vector().into());
        self.sense();
        if self.has(Fault::RobotRestart) {
            // It is not up yet, and its brakes hold it.
            self.to_robot.clear();
            self.velocity = VelocityCommand::hold();
            return;
        }
        let package = self
            .session
            .package(self.cycle, &self.robot, &self.robot.summary());
        if self.has(Fault::BridgeDead) {
            self.to_robot.clear();
        } else {
            assert_eq!(self.at_bridge.push(&package), package.len());
            self.bridge_cycle();
        }
        self.robot_hears();
        self.velocity = self.robot.act();
    }

    /// What faults do when they begin, and people when they are over.
    fn begin_and_end(&mut self) {
        if self.faults == self.faults_before {
            self.look_after_robot();
            return;
        }
        let before = std::mem::replace(&mut self.faults_before, self.faults.clone());
        let now = self.faults.clone();
        for fault in now.iter().filter(|fault| !before.contains(fault)) {
            match fault {
                Fault::ProtectiveStop => self.robot.protective_stop(0, 0, "test"),
                Fault::EmergencyStop => self.robot.emergency_stop(true, true),
                Fault::RobotRestart => {
                    self.robot.restart();
                    self.bridge.close();
                }
                Fault::SensorRestart => {
                    let zero = self.conditioning.reference().copied();
                    self.conditioning = WrenchConditionerState::default();
                    self.conditioning.set_tare(zero);
                    self.watching = SensorWatchState::default();
                }
                Fault::SensorCorrupt => self.frozen.1 = 0,
                _ => {}
            }
        }
        for fault in before.iter().filter(|fault| !now.contains(fault)) {
            match fault {
                Fault::EmergencyStop => {
                    self.robot.emergency_stop(true, false);
                    self.robot.power_on();
                    self.robot.release_brakes();
                }
                Fault::RobotRestart if !now.contains(&Fault::BridgeDead) => self.connect(),
                Fault::BridgeDead => self.start_bridge(),
                _ => {}
            }
        }
    }

    /// Somebody unlocks a robot that stopped protectively, as soon as it lets them.
    fn look_after_robot(&mut self) {
        if !self.has(Fault::ProtectiveStop) {
            let _ = self.robot.unlock();
        }
    }

    /// Bridge and robot have a connection of their own from here on.
    fn connect(&mut self) {
        self.at_bridge = Framer::new(PACKAGE_BYTES_MAX);
        self.at_robot = Framer::new(PACKAGE_BYTES_MAX);
        self.starts += 1;
        self.session = Session::new(self.starts, self.robot.config().flavour.version());
        self.ownership = Ownership::default();
        self.to_robot.clear();
        let now_s = self.now_s();
        self.bridge.open(now_s, &mut self.to_robot).unwrap();
    }

    fn bridge_cycle(&mut self) {
        let now_s = self.now_s();
        while let Some(package) = self.at_bridge.next_package().unwrap() {
            let event = self
                .bridge
                .package(package, now_s, &mut self.to_robot)
                .unwrap();
            if event == BridgeEvent::Cycle {
                self.answer(now_s);
            }
        }
        if let Some(session) = self.bridge.take_upload() {
            let series = self.bridge.link().version().series();
            let program = self.settings.program(session, series);
            self.robot.upload(&program.render().unwrap());
        }
    }

    fn robot_hears(&mut self) {
        let sent = std::mem::take(&mut self.to_robot);
        assert_eq!(self.at_robot.push(&sent), sent.len());
        let mut answers = Vec::new();
        while let Some(package) = self.at_robot.next_package().unwrap() {
            let effect = self.session.handle(
                package.kind,
                package.payload,
                &mut self.ownership,
                &mut answers,
            );
            if let Effect::Inputs(names, values) = effect {
                self.robot.write_inputs(&names, &values);
            }
        }
        if !self.has(Fault::BridgeDead) {
            assert_eq!(self.at_bridge.push(&answers), answers.len());
        }
    }

    /// The records of the period through watch and conditioning, as the service does it.
    fn sense(&mut self) {
        let (pose, at) = self.pose_before;
        let tool = self.tool();
        self.pose_before = (tool.0, self.now_s());
        if self.has(Fault::SensorSilent) || self.has(Fault::SensorRestart) {
            return;
        }
        for sample in self.plant.sensor_samples().to_vec() {
            let counts = self.spoilt(sample.counts);
            let mut raw = Vector6::from_fn(|i, _| f64::from(counts[i]) * self.scale[i]);
            if self.has(Fault::SensorNan) {
                raw.fill(f64::NAN);
            }
            let said = if self.has(Fault::SensorError) {
                SensorCondition::Error
            } else if sample.saturated || self.has(Fault::SensorSaturated) {
                SensorCondition::Saturated
            } else {
                SensorCondition::Good
            };
            let felt = self.wrench.filter(|(w, _)| w.bias_age_s.is_some());
            let record = SensorRecord {
                counts,
                wrench: raw.into(),
                condition: said,
                missed: 0,
                pressing_at: felt
                    .and_then(|(w, _)| pressing_at(Some(pose.translation()), &w.wrench.force)),
            };
            let taken = self.watch.take(&mut self.watching, &record);
            let Watched::Take { condition, missed } = taken else {
                continue;
            };
            let mut conditioned = self.conditioner.update(
                &mut self.conditioning,
                &Reading {
                    time_s: sample.time_s,
                    wrench: Wrench::from_vector(&raw),
                    condition,
                    missed,
                    base_from_tool: Some((pose, sample.time_s - at)),
                    motion: None,
                },
            );
            if self.has(Fault::ContactLost) {
                conditioned.wrench = Wrench::zero();
            }
            self.wrench = Some((conditioned, sample.time_s));
        }
    }

    /// What comes of a record by a fault of the sensor.
    fn spoilt(&mut self, mut counts: [i32; 6]) -> [i32; 6] {
        let (last, since) = &mut self.frozen;
        if self.faults.contains(&Fault::SensorFrozen) {
            counts = *last;
        } else if self.faults.contains(&Fault::SensorDead) {
            counts = [0; 6];
        } else if self.faults.contains(&Fault::AxisStuck) {
            counts[2] = last[2];
        } else {
            *last = counts;
        }
        *since += 1;
        if self.faults.contains(&Fault::SensorCorrupt) && since.is_multiple_of(4) {
            counts[2] += (30.0 / self.scale[2]) as i32;
        }
        counts
    }

    fn tool(&self) -> (Pose<Base, Tool>, nalgebra::Matrix6<f64>) {
        let arm = self.plant.arm();
        self.plant
            .model()
            .tool_and_jacobian(&arm.q, &self.plant.flange_from_tool())
    }

    /// The controller answers the packet in hand, and the bridge writes what it lets through.
    fn answer(&mut self, now_s: f64) {
        let (tool, jacobian) = self.tool();
        let posture = Posture {
            q: self.plant.arm().q,
            tool_m: tool.translation(),
            tool_jacobian: jacobian,
        };
        if self.has(Fault::SecondSource) {
            let admitted = self
                .bridge
                .admit(&source("controller/other-2", 2), 99, now_s);
            assert!(
                !admitted || now_s - self.spoke_s > SILENCE_S,
                "a second source is let in beside the first"
            );
        }
        if self.has(Fault::NoCommand) {
            self.bridge
                .command(&posture, None, now_s, &mut self.to_robot)
                .unwrap();
            return;
        }
        let output = self.law_step(tool, &jacobian, now_s);
        let mut values: [f64; 6] = output.qd.into();
        let mut cycle = self.bridge.cycle();
        if self.has(Fault::CommandNan) {
            values[2] = f64::NAN;
        }
        if self.has(Fault::CommandFast) {
            values[0] = 50.0;
        }
        if self.has(Fault::CommandOld) {
            cycle = cycle.saturating_sub((1.0 / self.period_s()) as u64);
        }
        let wanted = Command {
            cycle,
            kind: output.kind as u8,
            values: &values,
            acceleration: output.acceleration,
            activation: output.activation,
        };
        let admitted = self.bridge.admit(&self.source, output.activation, now_s);
        if admitted {
            self.spoke_s = now_s;
        }
        self.bridge
            .command(
                &posture,
                admitted.then_some(&wanted),
                now_s,
                &mut self.to_robot,
            )
            .unwrap();
    }

    fn law_step(
        &mut self,
        base_from_tool: Pose<Base, Tool>,
        jacobian: &nalgebra::Matrix6<f64>,
        now_s: f64,
    ) -> ControlOutput {
        let arm = self.plant.arm();
        let twist: Twist<Aligned<Tool, Base>> = Twist::from_vector(&(jacobian * arm.qd));
        let (wrench, tare) = (self.wrench, self.conditioner.tare_config());
        let mut estimates = [None; MAX_ESTIMATORS];
        estimates[0] = self.estimate.map(|(estimate, at)| EstimateInput {
            estimate,
            age_s: now_s - at,
        });
        // As the service does: a task that the bridge has latched out moves nothing any more.
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
            estimates,
            base: None,
        };
        let output = self.law.step(&input);
        if output.tare_requested && !self.conditioning.is_taring() {
            self.conditioner
                .start_tare(&mut self.conditioning, output.clearance.tare_ground());
        }
        if output.zero_withdrawn {
            self.conditioning.withdraw_tare();
        }
        // The estimator answers to the next cycle.
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
