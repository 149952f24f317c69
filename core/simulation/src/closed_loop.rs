//! Plant, conditioning, estimators and controller in one thread; `tangent evaluate` runs this.
//!
//! The parts are those of the live system, and so are the delays between them: samples of the
//! period that ended, an estimate of the cycle before, and a command that takes effect in the next
//! period.

use serde::Serialize;
use tangent_control::{
    CommandKind, ContactSign, ControlError, ControlInput, ControlOutput, Controller,
    ControllerConfig, ControllerWord, EstimateInput, Limits, MAX_ESTIMATORS, Phase, Program, Task,
    UntaredLoad,
};
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator, build};
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, Wrench, manipulability};
use tangent_sensing::{
    BasePose, BaseTracker, ConditionedWrench, Payload, TareConfig, TareGround, Validity,
    WrenchConditioner, WrenchConditionerState,
};

use crate::digest::TrajectoryDigest;
use crate::measurement::{ArmMeasurement, VelocityCommand};
use crate::metrics::object_pose::ObjectPoseFigures;
use crate::metrics::tactile::TactileFigures;
use crate::metrics::{CycleSample, EstimateSample, Figures, TruthSample};
use crate::obstacle::Obstacle;
use crate::plant::Plant;
use crate::platform::OdometrySample;
use crate::scenario::{PIPELINE_CYCLES_MAX, Scenario, ScenarioError};
use crate::truth::Truth;
use crate::watched_sensor::WatchedSensor;

/// Time for which a run continues after its task has ended, s.
const AFTER_END_S: f64 = 0.2;

/// Result that `evaluate --json` prints. The caller adds the wall time, as `core/` has no clock.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evaluation {
    /// Name of the scenario.
    pub scenario: String,
    /// Preset of the control law.
    pub controller: String,
    /// Estimator in use at the end.
    pub estimator: String,
    /// Seed of the random numbers.
    pub seed: u64,
    /// Simulated time, s.
    pub duration_s: f64,
    /// Number of arm periods.
    pub steps: u64,
    /// Wall time of the run, s.
    pub wall_s: Option<f64>,
    /// Simulated time over wall time.
    pub real_time_factor: Option<f64>,
    /// Figures computed from the samples.
    #[serde(flatten)]
    pub figures: Figures,
    /// Figures of scenarios of kind `object_pose` only.
    pub object_pose: Option<ObjectPoseFigures>,
    /// Figures of scenarios of kind `visuo_tactile` only.
    pub tactile: Option<TactileFigures>,
    /// Always null here; only a live run has it.
    pub r#loop: Option<()>,
    /// Phase at the end.
    pub phase: &'static str,
    /// Fault that ended the task early; null if there was none.
    pub fault: Option<&'static str>,
    /// Hash of the whole trajectory.
    pub state_digest: String,
}

impl Evaluation {
    /// Adds the wall time of the run.
    pub fn with_wall_time(mut self, wall_s: f64) -> Self {
        self.wall_s = Some(wall_s);
        self.real_time_factor = (wall_s > 0.0).then(|| self.duration_s / wall_s);
        self
    }
}

/// One cycle of the loop, as shown to an observer.
#[derive(Clone, Copy, Debug)]
pub struct LoopCycle<'a> {
    /// What the arm reported.
    pub arm: &'a ArmMeasurement,
    /// Inputs of the controller.
    pub input: &'a ControlInput,
    /// Outputs of the controller.
    pub output: &'a ControlOutput,
    /// Newest estimate of the estimator in use.
    pub estimate: Option<&'a NormalEstimate>,
    /// Newest estimate of each of the task's estimators, in its order.
    pub estimates: &'a [Option<NormalEstimate>],
    /// True state of the contact.
    pub truth: &'a Truth,
}

/// Runs a scenario to its end.
///
/// # Errors
/// As [`ClosedLoop::new`].
pub fn evaluate(scenario: &Scenario) -> Result<Evaluation, ScenarioError> {
    evaluate_with(scenario, |_| ())
}

/// Runs a scenario to its end and passes every cycle to `watch`.
///
/// # Errors
/// As [`ClosedLoop::new`].
pub fn evaluate_with(
    scenario: &Scenario,
    mut watch: impl FnMut(&LoopCycle<'_>),
) -> Result<Evaluation, ScenarioError> {
    let mut closed_loop = ClosedLoop::new(scenario)?;
    let steps = (scenario.duration_s / closed_loop.plant.period_s()).round() as u64;
    let mut samples = Vec::with_capacity(steps as usize);
    let mut ended_at = None;
    let (mut phase, mut fault, mut estimator) = (Phase::Idle, None, 0);
    for _ in 0..steps {
        let sample = closed_loop.step(&mut watch);
        samples.push(sample);
        let output = &closed_loop.output;
        phase = output.phase;
        fault = output.fault.or(fault);
        estimator = output.estimator;
        if !phase.is_active() {
            let since = *ended_at.get_or_insert(sample.time_s);
            if sample.time_s - since >= AFTER_END_S {
                break;
            }
        }
    }
    let names = closed_loop.controller.estimators();
    let preset = scenario
        .task
        .controller
        .as_ref()
        .unwrap_or(&scenario.controller);
    Ok(Evaluation {
        scenario: scenario.name.clone(),
        controller: preset.clone(),
        estimator: names
            .get(estimator)
            .map(|n| n.to_string())
            .unwrap_or_default(),
        seed: scenario.seed,
        duration_s: closed_loop.plant.time_s(),
        steps: samples.len() as u64,
        wall_s: None,
        real_time_factor: None,
        figures: Figures::of(&samples),
        object_pose: None,
        tactile: None,
        r#loop: None,
        phase: phase.name(),
        fault: fault.map(|f| f.text()),
        state_digest: closed_loop.digest.finish(),
    })
}

/// The closed loop, stepped cycle by cycle.
pub struct ClosedLoop {
    plant: Plant,
    conditioner: WrenchConditioner,
    conditioning: WrenchConditionerState,
    estimators: Vec<Box<dyn NormalEstimator>>,
    controller: Controller,
    base: BaseTracker,
    flange_from_tool: Pose<tangent_mechanics::Flange, Tool>,
    /// Measured tool pose of the period before, and its time.
    pose_before: (Pose<Base, Tool>, f64),
    sensor: WatchedSensor,
    exchange_cycles: usize,
    estimate_cycles: usize,
    /// Commands in transit to the arm, oldest first.
    commands: [VelocityCommand; PIPELINE_CYCLES_MAX + 1],
    /// Estimates in transit to the controller, newest first.
    estimates: [[Option<NormalEstimate>; MAX_ESTIMATORS]; PIPELINE_CYCLES_MAX + 1],
    conditioned: Option<ConditionedWrench>,
    wrench_time: f64,
    output: ControlOutput,
    digest: TrajectoryDigest,
    config: ControllerConfig,
    limits: Limits,
    /// Whether the robot accepts commands.
    arm_ready: bool,
}

impl ClosedLoop {
    /// Builds the cell and starts the task.
    ///
    /// # Errors
    /// The cell of the scenario cannot be built, or its task, law or estimators are not usable.
    pub fn new(scenario: &Scenario) -> Result<Self, ScenarioError> {
        let plant = Plant::new(&scenario.plant, scenario.seed)?;
        let (flange_from_tool, flange_from_sensor) =
            (plant.flange_from_tool(), plant.flange_from_sensor());
        let payload = &scenario.plant.tool.payload;
        let conditioner = WrenchConditioner::new(
            &scenario.sensing,
            &Payload {
                mass_kg: payload.mass_kg,
                com_in_sensor_m: payload.com_in_sensor_m,
                inertia_kg_m2: payload.inertia_kg_m2,
            },
            flange_from_sensor.inverse() * flange_from_tool,
            scenario.plant.sensor.rate_hz,
        )?;
        let config = scenario.controller_config()?;
        // The preset is already part of `config`, together with the scenario's own parameters.
        let mut task = scenario.task.clone();
        task.controller = None;
        let mut controller =
            Controller::new(*plant.model(), flange_from_tool, scenario.limits, config)?;
        controller.start(Program::new(&task, &config)?, 1)?;
        let estimators = controller
            .estimators()
            .iter()
            .map(|name| build(name, &scenario.estimation))
            .collect::<Result<Vec<_>, _>>()?;
        let input = blank_input(&plant);
        Ok(Self {
            conditioner,
            conditioning: WrenchConditionerState::default(),
            estimators,
            controller,
            base: BaseTracker::new(&scenario.base),
            flange_from_tool,
            pose_before: (input.base_from_tool, 0.0),
            sensor: WatchedSensor::new(&scenario.plant.sensor),
            exchange_cycles: scenario.pipeline.exchange_cycles,
            estimate_cycles: scenario.pipeline.estimate_cycles,
            commands: [VelocityCommand::hold(); PIPELINE_CYCLES_MAX + 1],
            estimates: [[None; MAX_ESTIMATORS]; PIPELINE_CYCLES_MAX + 1],
            conditioned: None,
            wrench_time: 0.0,
            output: ControlOutput::hold(&input),
            digest: TrajectoryDigest::default(),
            config,
            limits: scenario.limits,
            arm_ready: true,
            plant,
        })
    }

    /// Starts a task as the service does. It is refused if the tool may touch something and the
    /// direction away from it is not known.
    ///
    /// # Errors
    /// Why the task cannot start.
    pub fn start(&mut self, task: &Task) -> Result<(), ControlError> {
        let program = Program::new(task, &self.config)?;
        self.controller
            .check_start(&self.pose_before.0.translation())?;
        self.controller.start(program, 0).map(drop)
    }

    /// Sets whether the robot accepts commands or is in a protective stop.
    pub fn set_arm_ready(&mut self, ready: bool) {
        self.arm_ready = ready;
    }

    /// Replaces the controller by a new one, as after a crash. The new one knows only what the
    /// service stores: where the tool may touch something.
    ///
    /// # Errors
    /// None with the parameters of the controller before.
    pub fn restart_controller(&mut self) -> Result<(), ControlError> {
        let mut fresh = Controller::new(
            *self.plant.model(),
            self.flange_from_tool,
            self.limits,
            self.config,
        )?;
        for name in self.controller.estimators() {
            fresh.listen_to(*name);
        }
        fresh.set_clearance(self.controller.clearance())?;
        self.controller = fresh;
        self.commands = [VelocityCommand::hold(); PIPELINE_CYCLES_MAX + 1];
        Ok(())
    }

    /// Replaces the sensor service by a new one, as after a crash. The last good zero is kept.
    pub fn restart_sensor(&mut self) {
        restart(&mut self.conditioning);
    }

    /// Removes the zeros that the sensor service has stored.
    pub fn forget_zeros(&mut self) {
        self.conditioning.forget_reference();
        self.conditioning.set_tare(None);
    }

    /// Requests a tare as an operator does; `said_clear`: the operator states that the tool hangs
    /// free.
    ///
    /// # Errors
    /// The sign of contact in the controller's state for which the tare is refused.
    pub fn ask_for_tare(&mut self, said_clear: bool) -> Result<(), ContactSign> {
        let word = ControllerWord::of(self.controller.phase(), &self.controller.clearance());
        take_tare(&self.conditioner, &mut self.conditioning, word, said_clear)
    }

    /// Newest conditioned wrench; `None` before the first sample.
    pub fn shown(&self) -> Option<&ConditionedWrench> {
        self.conditioned.as_ref()
    }

    /// The cell.
    pub fn plant(&self) -> &Plant {
        &self.plant
    }

    /// Puts something in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.plant.put_in_the_way(obstacle);
    }

    /// The controller, for pausing, switching and stopping.
    pub fn controller(&mut self) -> &mut Controller {
        &mut self.controller
    }

    /// Runs one arm period: the plant moves, then sensors, estimators and controller process what
    /// it reports.
    pub fn step(&mut self, watch: &mut impl FnMut(&LoopCycle<'_>)) -> CycleSample {
        self.plant.step(&self.commands[0]);
        let arm = self.plant.arm();
        let (base_from_tool, jacobian) = self
            .plant
            .model()
            .tool_and_jacobian(&arm.q, &self.flange_from_tool);
        let twist: Twist<Aligned<Tool, Base>> = Twist::from_vector(&(jacobian * arm.qd));

        for sample in self.plant.sensor_samples() {
            // The arm's packet of this period comes after these samples: they refer to the pose of
            // the period before.
            let (pose, at) = self.pose_before;
            let felt = self.conditioned.as_ref().filter(|c| c.bias_age_s.is_some());
            let Some(mut reading) = self.sensor.take(sample, &pose.translation(), felt) else {
                continue;
            };
            reading.base_from_tool = Some((pose, sample.time_s - at));
            self.conditioned = Some(self.conditioner.update(&mut self.conditioning, &reading));
            self.wrench_time = sample.time_s;
        }
        self.pose_before = (base_from_tool, arm.time_s);

        let mut input = blank_input(&self.plant);
        input.base_from_tool = base_from_tool;
        input.twist = twist;
        input.arm_ready = self.arm_ready;
        if let Some(conditioned) = &self.conditioned {
            input.wrench = conditioned.wrench;
            input.wrench_validity = conditioned.validity;
            input.wrench_delay_s = conditioned.delay_s;
            input.bias_age_s = conditioned.bias_age_s;
            let tare = self.conditioner.tare_config();
            input.zero_bound_n = conditioned
                .bias_age_s
                .map(|age_s| tare.drift_bound_n(age_s));
            input.untared = Some(untared_load(tare, conditioned));
            input.wrench_age_s = arm.time_s - self.wrench_time;
        }

        for sample in self.plant.odometry() {
            // A refused pose counts in the tracker, as silence.
            let _ = self.base.take(&base_pose(sample));
        }
        input.base = self.base.at(input.time_s);

        let contact = ContactSample {
            time_s: input.time_s,
            dt_s: input.dt_s,
            base_from_tool,
            twist,
            twist_commanded: self.output.twist_commanded,
            wrench: input.wrench,
            wrench_delay_s: input.wrench_delay_s,
            wrench_validity: input.wrench_validity,
            wrench_bias_age_s: input.bias_age_s,
            base: input.base,
        };
        self.estimates[..=self.estimate_cycles].rotate_right(1);
        for (slot, estimator) in self.estimates[0].iter_mut().zip(&mut self.estimators) {
            *slot = Some(estimator.update(&contact));
        }
        let age_s = self.estimate_cycles as f64 * input.dt_s;
        for (slot, estimate) in input
            .estimates
            .iter_mut()
            .zip(&self.estimates[self.estimate_cycles])
        {
            *slot = estimate.map(|estimate| EstimateInput { estimate, age_s });
        }

        self.output = self.controller.step(&input);
        if self.output.tare_requested && !self.conditioning.is_taring() {
            let ground = self.output.clearance.tare_ground();
            self.conditioner.start_tare(&mut self.conditioning, ground);
        }
        if self.output.zero_withdrawn {
            self.conditioning.withdraw_tare();
        }
        let command = match self.output.kind {
            // A velocity-controlled arm accepts no torques.
            CommandKind::Hold | CommandKind::SoftStop | CommandKind::JointTorque => {
                VelocityCommand::hold()
            }
            CommandKind::JointVelocity if !self.arm_ready => VelocityCommand::hold(),
            CommandKind::JointVelocity => VelocityCommand {
                qd: self.output.qd,
                acceleration: self.output.acceleration,
            },
        };
        // Without an exchange, the command takes effect in the period that begins now; otherwise as
        // many periods later.
        self.commands[..=self.exchange_cycles].rotate_left(1);
        self.commands[self.exchange_cycles] = command;

        let truth = self.plant.truth();
        let estimate = self.estimates[0]
            .get(self.output.estimator)
            .copied()
            .flatten();
        watch(&LoopCycle {
            arm: &arm,
            input: &input,
            output: &self.output,
            estimate: estimate.as_ref(),
            estimates: &self.estimates[0],
            truth: &truth,
        });
        self.digest_cycle(&arm, &input.wrench, estimate.as_ref(), &truth);
        CycleSample {
            time_s: arm.time_s,
            phase: self.output.phase,
            estimate: estimate.map(|e| EstimateSample {
                normal: e.normal,
                covariance: e.covariance,
                valid: e.validity.is_valid(),
            }),
            truth: Some(TruthSample {
                normal: truth.normal,
                tool_z: truth.base_from_tool.z_axis(),
                in_contact: truth.in_contact,
                force_n: truth.wrench.force.dot(&truth.normal),
            }),
            tool_position: base_from_tool.translation(),
            tool_z: base_from_tool.z_axis(),
            force_n: self.output.force_n,
            force_reference_n: self.output.force_reference_n,
            in_contact: self.output.in_contact,
            path_reference: self.output.path_reference,
            path_error_m: self.output.path_error_m,
            joint_speed_rad_per_s: arm.qd.amax(),
            manipulability: manipulability(&jacobian),
            motion_tank_j: None,
            force_tank_j: self.output.force_tank_j,
        }
    }

    fn digest_cycle(
        &mut self,
        arm: &ArmMeasurement,
        wrench: &Wrench<Tool>,
        estimate: Option<&NormalEstimate>,
        truth: &Truth,
    ) {
        self.digest.add(arm.q.as_slice());
        self.digest.add(arm.qd.as_slice());
        self.digest.add(wrench.vector().as_slice());
        self.digest.add(self.output.qd.as_slice());
        self.digest.add(truth.wrench.vector().as_slice());
        if let Some(estimate) = estimate {
            self.digest.add(estimate.normal.as_slice());
            self.digest.add(estimate.covariance.as_slice());
        }
    }
}

/// A tare that a person asks for, as the sensor's service decides it.
///
/// # Errors
/// What the controller's word says against it.
pub(crate) fn take_tare(
    conditioner: &WrenchConditioner,
    conditioning: &mut WrenchConditionerState,
    word: ControllerWord,
    said_clear: bool,
) -> Result<(), ContactSign> {
    if let Some(sign) = ContactSign::of(Some(word), None)
        && !(said_clear && sign.can_be_waived())
    {
        return Err(sign);
    }
    let ground = if said_clear {
        TareGround::SaidClear
    } else {
        TareGround::Assumed
    };
    conditioner.start_tare(conditioning, ground);
    Ok(())
}

/// The sensor's service dies and another takes its place, which knows the last good zero.
pub(crate) fn restart(conditioning: &mut WrenchConditionerState) {
    let zero = conditioning.reference().copied();
    *conditioning = WrenchConditionerState::default();
    conditioning.set_tare(zero);
}

/// What the reading says before any zero is taken off, as the sensor's service tells it.
pub(crate) fn untared_load(tare: &TareConfig, conditioned: &ConditionedWrench) -> UntaredLoad {
    UntaredLoad {
        beyond_reference_n: conditioned
            .reference
            .map(|(zero, _)| (conditioned.untared - zero).force.norm()),
        rated_share: tare.rated_share(&conditioned.untared),
    }
}

/// The arm's part of a controller input, without a wrench and without estimates.
fn blank_input(plant: &Plant) -> ControlInput {
    let arm = plant.arm();
    ControlInput {
        time_s: arm.time_s,
        dt_s: plant.period_s(),
        q: arm.q,
        qd: arm.qd,
        base_from_tool: plant.model().base_from_flange(&arm.q) * plant.flange_from_tool(),
        twist: Twist::zero(),
        speed_scaling: 1.0,
        arm_ready: true,
        wrench: Wrench::zero(),
        wrench_validity: Validity::Missing,
        wrench_age_s: f64::INFINITY,
        wrench_delay_s: 0.0,
        bias_age_s: None,
        zero_bound_n: None,
        untared: None,
        estimates: [None; MAX_ESTIMATORS],
        base: None,
    }
}

/// Pose message of the platform for an odometry sample.
fn base_pose(sample: &OdometrySample) -> BasePose {
    let pose = &sample.world_from_base;
    let mut variances = nalgebra::Vector6::repeat(sample.position_variance_m2);
    variances
        .fixed_rows_mut::<3>(3)
        .fill(sample.orientation_variance_rad2);
    BasePose {
        publisher: [1; 16],
        stamp_s: sample.stamp_s,
        arrived_s: sample.published_s,
        position: pose.translation.vector,
        quaternion: pose.rotation.coords.into(),
        covariance: nalgebra::Matrix6::from_diagonal(&variances),
    }
}
