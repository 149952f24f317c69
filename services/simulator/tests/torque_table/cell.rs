//! A torque cell in simulated time: arm, object, force sensor and camera, the gate before the
//! motors, conditioning, the object's pose, the law. There is no bus, clock or thread, so that a
//! fault occurs in exactly the cycle that a test names.

use std::sync::OnceLock;

use tangent_actuation::lease::Source;
use tangent_control::hybrid_dynamics::{HybridDynamics, HybridInput, HybridOutput};
use tangent_control::{
    Clearance, Fault as TaskFault, Law, Phase, StateInterval, TorqueLaw, UntaredLoad,
};
use tangent_estimation::build_object_estimator;
use tangent_estimation::object_pose::{ObjectEstimate, ObjectPoseEstimator, ObjectSample};
use tangent_mechanics::{Arm, Base, Joints, Pose, Tool, Wrench};
use tangent_schemas::convert::joint_array;
use tangent_schemas::tangent::ArmCommand;
use tangent_sensing::{SensorWatchState, Validity};
use tangent_simulation::{ObjectPlant, ObjectScenario, Truth, stated_arm};
use tangent_torque_arm::TorqueGate;

use crate::fault::Fault;
use crate::table::arrivals::{Arrivals, Way, newest};
use crate::table::sensor::{RecordFaults, SensorChain};
use crate::table::{TableCell, Trial, source};

/// Scenario: a plane with friction, a cold sensor and a wrong model.
const PLANE: &str = include_str!("../../../../scenarios/lippiello/lippiello_realistic.toml");
/// Changes to the scenario: soon on the surface, and soon off it.
const CHANGES: [&str; 4] = [
    "plant.start.clearance_m=0.005",
    "task.end.retract_distance_m=0.02",
    "plant.arm.sub_steps=2",
    "control.touch.settle_s=0.3",
];
/// Cycles in which the watch of the sensor learns its normal variation, and the result; nothing is
/// judged before.
const LEARNS: u64 = 1_100;
static LEARNT: OnceLock<SensorWatchState> = OnceLock::new();

/// The simulated torque cell.
pub struct Cell {
    plant: ObjectPlant,
    gate: TorqueGate,
    model: Arm<6>,
    torque: Joints<6>,
    scenario: ObjectScenario,
    sensor: SensorChain,
    /// The last record before a sensor's fault.
    kept: [i32; 6],
    estimator: Box<dyn ObjectPoseEstimator>,
    /// The estimate that the law has, and the cycle to which it belongs.
    estimate: Option<(ObjectEstimate, u64)>,
    interval: StateInterval,
    law: HybridDynamics,
    activation: u64,
    source: Source,
    starts: u8,
    spoke_s: f64,
    arrivals: Arrivals<ArmCommand>,
    pub output: Option<HybridOutput>,
    pub trial: Trial<Fault>,
}

impl Cell {
    /// Simulated time, s.
    pub fn now_s(&self) -> f64 {
        self.plant.time_s()
    }

    pub fn gate(&self) -> &TorqueGate {
        &self.gate
    }

    pub fn activation(&self) -> u64 {
        self.activation
    }

    /// Torques that the gate last passed to the motors, Nm.
    pub fn given(&self) -> Joints<6> {
        self.torque
    }

    fn tool(&self) -> Pose<Base, Tool> {
        self.model.base_from_flange(&self.plant.arm().q) * self.plant.flange_from_tool()
    }

    /// Effects of faults when they begin, and actions of people when they end.
    fn begin_and_end(&mut self) {
        let Some((begun, ended)) = self.trial.changes() else {
            return;
        };
        for fault in begun {
            if fault == Fault::SensorRestart {
                self.sensor.restart();
            }
        }
        for fault in ended {
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
                Fault::CommandSwapped => self.arrivals.forget(),
                _ => {}
            }
        }
    }

    /// The command of this period that the gate accepts, if one arrives.
    fn commands(&mut self) -> Option<ArmCommand> {
        let now_s = self.now_s();
        let mut queue = Vec::new();
        if self.has(Fault::SecondSource) {
            let other = ArmCommand {
                cycle: self.trial.cycle,
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
        let (gate, spoke_s) = (&mut self.gate, &mut self.spoke_s);
        newest(queue, &self.source, spoke_s, now_s, |source, sent| {
            gate.admit(source, sent.activation, now_s)
        })
    }

    /// The commands that arrive when the controller sends `sent`.
    fn on_the_way(&mut self, sent: ArmCommand) -> Vec<ArmCommand> {
        let way = match () {
            () if self.has(Fault::CommandRepeated) => Way::Repeated,
            () if self.has(Fault::CommandSwapped) => Way::Swapped,
            () => Way::Open,
        };
        let faults = &self.trial.faults;
        self.arrivals.pass(way, sent, |sent| {
            if faults.contains(&Fault::CommandNan) {
                sent.values[3] = f64::NAN;
            }
            if faults.contains(&Fault::CommandStrong) {
                sent.values[1] = 1e5;
            }
            if faults.contains(&Fault::CommandKind) {
                sent.kind = 1;
            }
            if faults.contains(&Fault::CommandOld) {
                sent.cycle = sent.cycle.saturating_sub(1000);
            }
            if faults.contains(&Fault::CommandAhead) {
                sent.cycle += 5;
            }
        })
    }

    /// Passes the records of the period through watch and conditioning, as the service does.
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
            let faults = RecordFaults {
                nan: self.has(Fault::SensorNan),
                error: self.has(Fault::SensorError),
                saturated: self.has(Fault::SensorSaturated),
                contact_lost: self.has(Fault::ContactLost),
            };
            self.sensor.take(&sample, counts, faults, (tool, 0.0));
        }
    }

    /// The controller answers a state.
    fn law_step(&mut self, now_s: f64) -> ArmCommand {
        let arm = self.plant.arm();
        let latched = self.gate.admission().activation_latched();
        // As in the service: a task that the gate has rejected moves the arm no more.
        let ended = self.law.phase().is_active() && latched >= self.activation;
        let (wrench, tare) = (self.sensor.wrench, self.sensor.conditioner.tare_config());
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
                (self.trial.cycle - cycle) as f64 * self.plant.period_s()
            }),
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
        self.output = Some(output);
        self.look(&input, wrench.map_or(0.0, |(w, _)| w.delay_s));
        ArmCommand {
            cycle: self.trial.cycle,
            kind: if output.phase.is_active() { 2 } else { 0 },
            values: joint_array(&output.torque),
            activation: self.activation,
            source: self.source.name,
            ..ArmCommand::default()
        }
    }

    /// Estimates the object's pose for the next cycles.
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
            self.estimate = Some((said, self.trial.cycle));
        }
    }
}

impl TableCell for Cell {
    type Setup = ();
    type Fault = Fault;
    const PATIENCE: u64 = 20_000;
    const AT_REST: f64 = 2e-3;
    const PAUSE_IS_A_PHASE: bool = false;

    fn new((): ()) -> Self {
        let changes: Vec<String> = CHANGES.iter().map(|s| (*s).to_owned()).collect();
        let scenario = ObjectScenario::parse("lippiello_realistic", PLANE, &changes).unwrap();
        let corners = scenario.estimation.target.corners();
        let plant = ObjectPlant::<6>::new(&scenario.plant, corners, scenario.seed).unwrap();
        let model = stated_arm::<6>(&scenario.plant.robot, &scenario.plant.tool).unwrap();
        let mut sensor = SensorChain::new(
            &scenario.sensing,
            &scenario.plant.tool.payload,
            plant.flange_from_sensor().inverse() * plant.flange_from_tool(),
            &scenario.plant.sensor,
        );
        let law = HybridDynamics::new(
            model,
            plant.flange_from_tool(),
            scenario.limits,
            &scenario.law().unwrap(),
            &scenario.task,
            Box::new(scenario.object_surface().unwrap()),
        )
        .unwrap();
        let q = plant.arm().q;
        let camera = scenario.plant.camera.model();
        let learnt = LEARNT.get().copied();
        sensor.watching = learnt.unwrap_or_default();
        let mut cell = Self {
            gate: TorqueGate::new(model, &q, plant.period_s()),
            torque: model.gravity(&q),
            model,
            sensor,
            kept: [0; 6],
            estimator: build_object_estimator(scenario.estimator(), &scenario.estimation, &camera)
                .unwrap(),
            estimate: None,
            interval: StateInterval::default(),
            law,
            activation: 0,
            source: source("controller/cell-1", 1),
            starts: 1,
            spoke_s: 0.0,
            arrivals: Arrivals::default(),
            output: None,
            trial: Trial::default(),
            plant,
            scenario,
        };
        // No task has been started yet.
        cell.law.begin(Clearance::Assumed);
        cell.law.stop();
        cell.until("the arm is ready", |c| {
            c.is_ready() && c.sensor.wrench.is_some()
        });
        if learnt.is_none() {
            cell.steps(LEARNS);
            // Another thread may have set it first.
            let _ = LEARNT.set(cell.sensor.watching);
            return Self::new(());
        }
        cell
    }

    /// One period: the arm publishes its state, passes the answer through the gate, and moves.
    fn step(&mut self) {
        self.trial.cycle += 1;
        self.begin_and_end();
        if self.has(Fault::EmergencyStop) {
            self.gate.forbid();
        }
        let arm = self.plant.arm();
        let newest = self.commands();
        let cycle = self.trial.cycle;
        self.torque = self.gate.step(newest.as_ref(), cycle, &arm.q, &arm.qd);
        assert!(self.torque.iter().all(|x| x.is_finite()));
        self.plant.step(&self.torque);
        self.sense();
        let force_n = self.plant.truth().wrench.force.norm();
        self.trial.peak_n = self.trial.peak_n.max(force_n);
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
        self.law.phase() == Phase::Slide && self.output.is_some_and(|o| o.path_progress > 0.002)
    }

    /// A controller holds the arm, and no other source drives it.
    fn is_ready(&self) -> bool {
        !self.has(Fault::EmergencyStop) && self.gate.lease().holder() == Some(&self.source)
    }

    fn in_words(&self) -> String {
        let fault = self.output.and_then(|o| o.fault);
        format!(
            "{:?}, {:?}, {fault:?}",
            self.law.phase(),
            self.gate.admission().refusal()
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

    /// As the service does for a start request while the arm is ready.
    fn start_task(&mut self) {
        let clearance = self.law.clearance();
        let at = self.tool().translation();
        self.law.check_start(&clearance, &at).unwrap();
        self.law.begin(clearance);
        let latched = self.gate.admission().activation_latched();
        self.activation = self.activation.max(latched) + 1;
    }

    fn pause_task(&mut self) {
        self.law.pause(true).unwrap();
    }

    fn stop_task(&mut self) {
        self.law.stop();
    }
}
