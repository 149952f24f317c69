//! A torque cell in simulated time: arm, object, force sensor and camera, the gate before the
//! motors, conditioning, the object's pose, the law. There is no bus, clock or thread, so that a
//! fault comes in the very cycle that a test names.

use std::sync::OnceLock;

use nalgebra::Vector6;
use tangent_actuation::lease::{SILENCE_S, Source};
use tangent_control::hybrid_dynamics::{HybridDynamics, HybridInput, HybridOutput};
use tangent_control::{Clearance, ControlError, Phase, StateInterval, UntaredLoad};
use tangent_estimation::build_object_estimator;
use tangent_estimation::object_pose::{ObjectEstimate, ObjectPoseEstimator, ObjectSample};
use tangent_mechanics::{Arm, Base, Joints, Pose, Tool, Wrench};
use tangent_schemas::Name;
use tangent_schemas::convert::joint_array;
use tangent_schemas::tangent::ArmCommand;
use tangent_sensing::{
    ConditionedWrench, Payload, Reading, RecordWatchConfig, SensorCondition, SensorRecord,
    SensorWatch, SensorWatchState, Validity, Watched, WrenchConditioner, WrenchConditionerState,
    pressing_at,
};
use tangent_simulation::{ObjectPlant, ObjectScenario, Truth, loaded_arm};
use tangent_simulator::torque_cell::TorqueGate;

use crate::fault::Fault;

/// The plane with friction, a cold sensor and a model that is wrong.
const PLANE: &str = include_str!("../../../../scenarios/lippiello/lippiello_realistic.toml");
/// Soon on the surface, and soon off it.
const CHANGES: [&str; 4] = [
    "plant.start.clearance_m=0.005",
    "task.end.retract_distance_m=0.02",
    "plant.arm.sub_steps=2",
    "control.touch.settle_s=0.3",
];
/// Longest wait for anything, cycles.
const PATIENCE: u64 = 20_000;
/// Cycles in which the watch of the sensor learns how it lives, and what it has learnt; nothing is
/// judged before.
const LEARNS: u64 = 1_100;
static LEARNT: OnceLock<SensorWatchState> = OnceLock::new();

/// The cell.
pub struct Cell {
    plant: ObjectPlant,
    gate: TorqueGate,
    model: Arm<6>,
    torque: Joints<6>,
    scenario: ObjectScenario,
    conditioner: WrenchConditioner,
    conditioning: WrenchConditionerState,
    watch: SensorWatch,
    watching: SensorWatchState,
    /// The last record before a sensor's fault.
    kept: [i32; 6],
    wrench: Option<(ConditionedWrench, f64)>,
    scale: [f64; 6],
    estimator: Box<dyn ObjectPoseEstimator>,
    /// What the law has of it, and of which cycle.
    estimate: Option<(ObjectEstimate, u64)>,
    interval: StateInterval,
    law: HybridDynamics,
    activation: u64,
    source: Source,
    starts: u8,
    spoke_s: f64,
    last_sent: Option<ArmCommand>,
    held_back: Option<ArmCommand>,
    pub output: Option<HybridOutput>,
    pub cycle: u64,
    /// What is wrong now.
    pub faults: Vec<Fault>,
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

impl Cell {
    /// Held, with a controller that waits for a task.
    pub fn new() -> Self {
        let changes: Vec<String> = CHANGES.iter().map(|s| (*s).to_owned()).collect();
        let scenario = ObjectScenario::parse("lippiello_realistic", PLANE, &changes).unwrap();
        let corners = scenario.estimation.target.corners();
        let plant = ObjectPlant::new(&scenario.plant, corners, scenario.seed).unwrap();
        let model = loaded_arm::<6>(&scenario.plant.robot, &scenario.plant.tool, false).unwrap();
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
        let law = HybridDynamics::new(
            model,
            plant.flange_from_tool(),
            scenario.limits,
            &scenario.law().unwrap(),
            &scenario.task,
            Box::new(scenario.object_surface().unwrap()),
        )
        .unwrap();
        let sensor = &scenario.plant.sensor;
        let ([fx, fy, fz], [tx, ty, tz]) = (sensor.range_n, sensor.range_nm);
        let (n, nm) = (1.0 / sensor.counts_per_n, 1.0 / sensor.counts_per_nm);
        let q = plant.arm().q;
        let camera = scenario.plant.camera.model();
        let learnt = LEARNT.get().copied();
        let mut cell = Self {
            gate: TorqueGate::new(model, &q, plant.period_s()),
            torque: model.gravity(&q),
            model,
            conditioning: WrenchConditionerState::default(),
            conditioner,
            watch: SensorWatch::new(
                &RecordWatchConfig::default(),
                sensor.rate_hz,
                [fx, fy, fz, tx, ty, tz],
            ),
            watching: learnt.unwrap_or_default(),
            kept: [0; 6],
            wrench: None,
            scale: [n, n, n, nm, nm, nm],
            estimator: build_object_estimator(scenario.estimator(), &scenario.estimation, &camera)
                .unwrap(),
            estimate: None,
            interval: StateInterval::default(),
            law,
            activation: 0,
            source: source("controller/cell-1", 1),
            starts: 1,
            spoke_s: 0.0,
            last_sent: None,
            held_back: None,
            output: None,
            cycle: 0,
            faults: Vec::new(),
            faults_before: Vec::new(),
            peak_n: 0.0,
            plant,
            scenario,
        };
        // No task was started yet.
        cell.law.begin(Clearance::Assumed);
        cell.law.stop();
        cell.until("the arm is ready", |c| c.is_ready() && c.wrench.is_some());
        if learnt.is_none() {
            cell.steps(LEARNS);
            // Another thread may have been first.
            let _ = LEARNT.set(cell.watching);
            return Self::new();
        }
        cell
    }

    /// Starts the task, as the service does with one that is asked for while the arm is ready.
    pub fn start_task(&mut self) -> Result<(), ControlError> {
        let clearance = self.law.clearance();
        self.law
            .check_start(&clearance, &self.tool().translation())?;
        self.law.begin(clearance);
        self.activation = self
            .activation
            .max(self.gate.admission().activation_latched())
            + 1;
        Ok(())
    }

    /// Ends the task.
    pub fn stop_task(&mut self) {
        self.law.stop();
    }

    /// A task in this phase, as far as it has come in the first cycle of it.
    pub fn in_phase(phase: Phase) -> Self {
        let mut cell = match phase {
            Phase::Slide => return Self::sliding(),
            Phase::Hold | Phase::Retract | Phase::Clear => Self::sliding(),
            _ => Self::new(),
        };
        match phase {
            Phase::Hold => cell.law.pause(true).unwrap(),
            Phase::Retract => cell.law.stop(),
            Phase::Clear => {
                // A task that ended on the surface.
                cell.faults = vec![Fault::NoCommand];
                cell.steps(400);
                cell.faults.clear();
                cell.until("the task is over", |c| !c.phase().is_active());
                cell.start_task().unwrap();
            }
            _ => cell.start_task().unwrap(),
        }
        // A pause keeps the phase that it comes in.
        if phase != Phase::Hold {
            cell.until("it is in the phase", |c| c.phase() == phase);
        }
        cell.peak_n = 0.0;
        cell
    }

    /// On the path.
    pub fn sliding() -> Self {
        let mut cell = Self::new();
        cell.start_task().unwrap();
        cell.until("it slides", |c| {
            c.law.phase() == Phase::Slide && c.output.is_some_and(|o| o.path_progress > 0.002)
        });
        cell.peak_n = 0.0;
        cell
    }

    /// Simulated time, s.
    pub fn now_s(&self) -> f64 {
        self.plant.time_s()
    }

    pub fn phase(&self) -> Phase {
        self.law.phase()
    }

    pub fn reference_n(&self) -> f64 {
        self.scenario.task.force.reference_n
    }

    pub fn gate(&self) -> &TorqueGate {
        &self.gate
    }

    /// A task could move the arm: it is taken, and nobody else drives it.
    pub fn is_ready(&self) -> bool {
        !self.has(Fault::EmergencyStop) && self.gate.lease().holder() == Some(&self.source)
    }

    pub fn activation(&self) -> u64 {
        self.activation
    }

    /// What the gate gave to the motors last, Nm.
    pub fn given(&self) -> Joints<6> {
        self.torque
    }

    pub fn truth(&self) -> Truth {
        self.plant.truth()
    }

    /// Largest joint speed of the arm, rad/s.
    pub fn robot_speed(&self) -> f64 {
        self.plant.arm().qd.amax()
    }

    fn tool(&self) -> Pose<Base, Tool> {
        self.model.base_from_flange(&self.plant.arm().q) * self.plant.flange_from_tool()
    }

    /// Cycles until `done`.
    pub fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let begun = self.cycle;
        while !done(self) {
            self.step();
            assert!(
                self.cycle - begun < PATIENCE,
                "never: {what}; {:?}, {:?}, {:?}",
                self.law.phase(),
                self.gate.reason(),
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

    /// One period: the arm says its state, lets the answer through the gate, and moves.
    pub fn step(&mut self) {
        self.cycle += 1;
        self.begin_and_end();
        if self.has(Fault::EmergencyStop) {
            self.gate.forbid();
        }
        let arm = self.plant.arm();
        let newest = self.commands();
        self.torque = self.gate.step(newest.as_ref(), self.cycle, &arm.q, &arm.qd);
        assert!(self.torque.iter().all(|x| x.is_finite()));
        self.plant.step(&self.torque);
        self.sense();
        self.peak_n = self.peak_n.max(self.plant.truth().wrench.force.norm());
    }

    /// What faults do when they begin, and people when they are over.
    fn begin_and_end(&mut self) {
        if self.faults == self.faults_before {
            return;
        }
        let before = std::mem::replace(&mut self.faults_before, self.faults.clone());
        let now = self.faults.clone();
        for fault in now.iter().filter(|fault| !before.contains(fault)) {
            if *fault == Fault::SensorRestart {
                let zero = self.conditioning.reference().copied();
                self.conditioning = WrenchConditionerState::default();
                self.conditioning.set_tare(zero);
            }
        }
        for fault in before.iter().filter(|fault| !now.contains(fault)) {
            match fault {
                Fault::ControllerDead => {
                    self.starts += 1;
                    self.source = source("controller/cell-n", self.starts);
                    let known = self.law.clearance();
                    self.activation = 0;
                    self.law.begin(known);
                    self.law.stop();
                    self.output = None;
                }
                Fault::CommandSwapped => self.held_back = None,
                _ => {}
            }
        }
    }

    /// What arrives in this period, as the gate lets it in.
    fn commands(&mut self) -> Option<ArmCommand> {
        let now_s = self.now_s();
        let mut queue = Vec::new();
        if self.has(Fault::SecondSource) {
            let other = ArmCommand {
                cycle: self.cycle,
                kind: 2,
                values: joint_array(&Joints::<6>::repeat(1.0)),
                activation: 99,
                ..ArmCommand::default()
            };
            queue.push((source("controller/other-2", 200), other));
        }
        let gone = [Fault::NoCommand, Fault::ControllerDead, Fault::StateSilent];
        if !gone.into_iter().any(|fault| self.has(fault)) {
            let sent = self.law_step(now_s);
            let arriving = self.on_the_way(sent);
            queue.extend(arriving.into_iter().map(|sent| (self.source, sent)));
        }
        let mut newest = None;
        for (source, sent) in queue {
            let admitted = self.gate.admit(&source, sent.activation, now_s);
            let own = source == self.source;
            assert!(
                own || !admitted || now_s - self.spoke_s > SILENCE_S,
                "a second source is let in beside the first"
            );
            if admitted {
                if own {
                    self.spoke_s = now_s;
                }
                newest = Some(sent);
            }
        }
        newest
    }

    /// What arrives of an answer.
    fn on_the_way(&mut self, mut sent: ArmCommand) -> Vec<ArmCommand> {
        if self.has(Fault::CommandRepeated) {
            return self.last_sent.clone().into_iter().collect();
        }
        self.last_sent = Some(sent.clone());
        if self.has(Fault::CommandNan) {
            sent.values[3] = f64::NAN;
        }
        if self.has(Fault::CommandStrong) {
            sent.values[1] = 1e5;
        }
        if self.has(Fault::CommandKind) {
            sent.kind = 1;
        }
        if self.has(Fault::CommandOld) {
            sent.cycle = sent.cycle.saturating_sub(1000);
        }
        if self.has(Fault::CommandAhead) {
            sent.cycle += 5;
        }
        if self.has(Fault::CommandSwapped) {
            return match self.held_back.take() {
                Some(older) => vec![sent, older],
                None => {
                    self.held_back = Some(sent);
                    Vec::new()
                }
            };
        }
        vec![sent]
    }

    /// The records of the period through watch and conditioning, as the service does it.
    fn sense(&mut self) {
        if self.has(Fault::SensorSilent) || self.has(Fault::SensorRestart) {
            return;
        }
        let tool = self.tool();
        for sample in self.plant.sensor_samples().to_vec() {
            let mut counts = sample.counts;
            if self.has(Fault::SensorFrozen) {
                counts = self.kept;
            } else if self.has(Fault::AxisStuck) {
                counts[2] = self.kept[2];
            } else {
                self.kept = counts;
            }
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
                    .and_then(|(w, _)| pressing_at(Some(tool.translation()), &w.wrench.force)),
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
                    base_from_tool: Some((tool, 0.0)),
                    motion: None,
                },
            );
            if self.has(Fault::ContactLost) {
                conditioned.wrench = Wrench::zero();
            }
            self.wrench = Some((conditioned, sample.time_s));
        }
    }

    /// The controller answers a state.
    fn law_step(&mut self, now_s: f64) -> ArmCommand {
        let arm = self.plant.arm();
        let latched = self.gate.admission().activation_latched();
        // As the service does: a task that the gate has latched out moves nothing any more.
        let ended = self.law.phase().is_active() && latched >= self.activation;
        let (wrench, tare) = (self.wrench, self.conditioner.tare_config());
        let estimate = self.estimate;
        let input = HybridInput {
            time_s: now_s,
            dt_s: self.interval.step(now_s, self.plant.period_s()),
            q: arm.q,
            qd: arm.qd,
            arm_ready: self.is_ready() && !ended,
            wrench: wrench.map_or_else(Wrench::zero, |(w, _)| w.wrench),
            wrench_validity: wrench.map_or(Validity::Missing, |(w, _)| w.validity),
            wrench_age_s: wrench.map_or(f64::INFINITY, |(_, at)| now_s - at),
            bias_age_s: wrench.and_then(|(w, _)| w.bias_age_s),
            zero_bound_n: wrench
                .and_then(|(w, _)| w.bias_age_s)
                .map(|age_s| tare.drift_bound_n(age_s)),
            untared: wrench.map(|(w, _)| UntaredLoad {
                beyond_reference_n: w.reference.map(|(zero, _)| (w.untared - zero).force.norm()),
                rated_share: tare.rated_share(&w.untared),
            }),
            estimate: estimate.map(|(said, _)| said),
            estimate_age_s: estimate.map_or(f64::INFINITY, |(_, cycle)| {
                (self.cycle - cycle) as f64 * self.plant.period_s()
            }),
        };
        let output = self.law.step(&input);
        if output.tare_requested && !self.conditioning.is_taring() {
            self.conditioner
                .start_tare(&mut self.conditioning, output.clearance.tare_ground());
        }
        if output.zero_withdrawn {
            self.conditioning.withdraw_tare();
        }
        self.output = Some(output);
        self.look(&input, wrench.map_or(0.0, |(w, _)| w.delay_s));
        ArmCommand {
            cycle: self.cycle,
            kind: if output.phase.is_active() { 2 } else { 0 },
            values: joint_array(&output.torque),
            activation: self.activation,
            source: self.source.name,
            ..ArmCommand::default()
        }
    }

    /// The object's pose for the cycles to come.
    fn look(&mut self, input: &HybridInput, wrench_delay_s: f64) {
        let mut newest = None;
        while let Some(frame) = self.plant.take_frame() {
            newest = Some(frame);
        }
        let base_from_flange = self.model.base_from_flange(&input.q);
        let said = self.estimator.update(&ObjectSample {
            time_s: input.time_s,
            base_from_flange,
            base_from_tool: base_from_flange * self.plant.flange_from_tool(),
            wrench: input.wrench,
            wrench_delay_s,
            wrench_validity: input.wrench_validity,
            wrench_bias_age_s: input.bias_age_s,
            frame: newest.filter(|_| !self.has(Fault::CameraDark)),
        });
        if !self.has(Fault::EstimateSilent) {
            self.estimate = Some((said, self.cycle));
        }
    }
}
