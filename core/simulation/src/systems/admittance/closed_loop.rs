//! Plant, conditioning, estimators and controller in one thread; `tangent evaluate` runs this for
//! scenarios of the `admittance` system.
//!
//! The parts are those of the live system, and so are the delays between them: the controller gets
//! samples of the period that ended and an estimate of the previous cycle, and its command takes
//! effect in the next period.

use nalgebra::Vector3;
use tangent_control::{
    CommandKind, ContactSign, ControlError, ControlInput, ControlOutput, Controller,
    ControllerConfig, ControllerWord, EstimateInput, Limits, MAX_ESTIMATORS, Memory, Program, Task,
};
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator, build};
use tangent_mechanics::{Aligned, Base, Flange, Pose, Tool, Twist, Wrench, manipulability};
use tangent_sensing::{BasePose, BaseTracker, ConditionedWrench, Validity};

use super::plant::AdmittancePlant;
use super::scenario::{AdmittanceScenario, PIPELINE_CYCLES_MAX};
use crate::arms::measurement::{ArmMeasurement, VelocityCommand};
use crate::arms::platform::OdometrySample;
use crate::contact::Obstacle;
use crate::digest::TrajectoryDigest;
use crate::evaluation::{Evaluation, RunEnd, run_to_end};
use crate::metrics::{CycleSample, EstimateSample, TruthSample};
use crate::scenario_file::ScenarioError;
use crate::sensors::wrench_channel::WrenchChannel;
use crate::truth::Truth;

/// One cycle of the loop, as shown to an observer.
#[derive(Clone, Copy, Debug)]
pub struct AdmittanceCycle<'a> {
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
/// As [`AdmittanceLoop::new`].
pub fn evaluate_admittance(scenario: &AdmittanceScenario) -> Result<Evaluation, ScenarioError> {
    evaluate_admittance_with(scenario, |_| ())
}

/// Runs a scenario to its end and passes every cycle to `watch`.
///
/// # Errors
/// As [`AdmittanceLoop::new`].
pub fn evaluate_admittance_with(
    scenario: &AdmittanceScenario,
    watch: impl FnMut(&AdmittanceCycle<'_>),
) -> Result<Evaluation, ScenarioError> {
    evaluate_admittance_samples(scenario, watch).map(|(evaluation, _)| evaluation)
}

/// Runs a scenario to its end, passes every cycle to `watch` and returns all samples with the
/// figures.
///
/// # Errors
/// As [`AdmittanceLoop::new`].
pub fn evaluate_admittance_samples(
    scenario: &AdmittanceScenario,
    watch: impl FnMut(&AdmittanceCycle<'_>),
) -> Result<(Evaluation, Vec<CycleSample>), ScenarioError> {
    let mut closed_loop = AdmittanceLoop::new(scenario)?;
    Ok(run_admittance(&mut closed_loop, scenario, watch))
}

/// Runs a loop to its end, passes every cycle to `watch` and returns all samples with the figures.
pub(super) fn run_admittance(
    closed_loop: &mut AdmittanceLoop,
    scenario: &AdmittanceScenario,
    mut watch: impl FnMut(&AdmittanceCycle<'_>),
) -> (Evaluation, Vec<CycleSample>) {
    let (mut fault, mut estimator) = (None, 0);
    let samples = run_to_end(scenario.duration_s, closed_loop.plant.period_s(), || {
        let sample = closed_loop.step(&mut watch);
        fault = closed_loop.output.fault.or(fault);
        estimator = closed_loop.output.estimator;
        sample
    });
    let estimator = closed_loop.controller.estimators().get(estimator);
    let end = RunEnd {
        scenario: &scenario.name,
        controller: scenario.preset(),
        estimator: &estimator.map(ToString::to_string).unwrap_or_default(),
        seed: scenario.seed,
        duration_s: closed_loop.plant.time_s(),
        fault,
        state_digest: closed_loop.digest.clone().finish(),
    };
    let mut evaluation = Evaluation::of(end, &samples);
    evaluation.coverage = closed_loop.controller.coverage_result();
    (evaluation, samples)
}

/// The closed loop, stepped cycle by cycle.
pub struct AdmittanceLoop {
    plant: AdmittancePlant,
    wrench: WrenchChannel,
    estimators: Vec<Box<dyn NormalEstimator>>,
    controller: Controller,
    base: BaseTracker,
    flange_from_tool: Pose<Flange, Tool>,
    /// Measured tool pose of the period before, and its time.
    pose_before: (Pose<Base, Tool>, f64),
    exchange_cycles: usize,
    estimate_cycles: usize,
    /// Commands in transit to the arm, oldest first.
    commands: [VelocityCommand; PIPELINE_CYCLES_MAX + 1],
    /// Estimates in transit to the controller, newest first.
    estimates: [[Option<NormalEstimate>; MAX_ESTIMATORS]; PIPELINE_CYCLES_MAX + 1],
    output: ControlOutput,
    digest: TrajectoryDigest,
    config: ControllerConfig,
    limits: Limits,
    /// Whether the robot accepts commands.
    arm_ready: bool,
}

impl AdmittanceLoop {
    /// Builds the cell and starts the task.
    ///
    /// # Errors
    /// The cell of the scenario cannot be built, or its task, law or estimators are not usable.
    pub fn new(scenario: &AdmittanceScenario) -> Result<Self, ScenarioError> {
        Self::with_memory(scenario, None)
    }

    /// Builds the cell and starts the task with what earlier passes learnt.
    ///
    /// # Errors
    /// As [`AdmittanceLoop::new`], or the memory is of another path.
    pub fn with_memory(
        scenario: &AdmittanceScenario,
        memory: Option<Memory>,
    ) -> Result<Self, ScenarioError> {
        let plant = AdmittancePlant::new(&scenario.plant, scenario.seed)?;
        let flange_from_tool = plant.flange_from_tool();
        let wrench = WrenchChannel::new(
            &scenario.sensing,
            &scenario.plant.tool,
            &scenario.plant.sensor,
        )?;
        let config = scenario.controller_config()?;
        // The preset is already part of `config`, together with the scenario's own parameters.
        let mut task = scenario.task.clone();
        task.controller = None;
        task.complete(&scenario.estimation.contact.tip);
        let mut controller =
            Controller::new(*plant.model(), flange_from_tool, scenario.limits, config)?;
        let mut program = Program::new(&task, &config)?;
        if let Some(memory) = memory {
            program.remember(memory)?;
        }
        controller.start(program, 1)?;
        let estimators = controller
            .estimators()
            .iter()
            .map(|name| build(name, &scenario.estimation))
            .collect::<Result<Vec<_>, _>>()?;
        let input = blank_input(&plant);
        Ok(Self {
            wrench,
            estimators,
            controller,
            base: BaseTracker::new(&scenario.base),
            flange_from_tool,
            pose_before: (input.base_from_tool, 0.0),
            exchange_cycles: scenario.pipeline.exchange_cycles,
            estimate_cycles: scenario.pipeline.estimate_cycles,
            commands: [VelocityCommand::hold(); PIPELINE_CYCLES_MAX + 1],
            estimates: [[None; MAX_ESTIMATORS]; PIPELINE_CYCLES_MAX + 1],
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

    /// Sets whether the robot accepts commands; otherwise it is in a protective stop.
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
        self.wrench.restart();
    }

    /// Removes the zeros that the sensor service has stored.
    pub fn forget_zeros(&mut self) {
        self.wrench.forget_zeros();
    }

    /// Requests a tare as an operator does; `said_clear`: the operator states that the tool hangs
    /// free.
    ///
    /// # Errors
    /// The sign of contact in the controller's state for which the tare is refused.
    pub fn ask_for_tare(&mut self, said_clear: bool) -> Result<(), ContactSign> {
        let word = ControllerWord::of(self.controller.phase(), &self.controller.clearance());
        self.wrench.ask_for_tare(word, said_clear)
    }

    /// Newest conditioned wrench; `None` before the first sample.
    pub fn shown(&self) -> Option<&ConditionedWrench> {
        self.wrench.shown()
    }

    /// The cell.
    pub fn plant(&self) -> &AdmittancePlant {
        &self.plant
    }

    /// Puts an obstacle in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.plant.put_in_the_way(obstacle);
    }

    /// Pushes on the tool's origin with a force (base axes, N) from now on, as a person's hand
    /// does.
    pub fn push_by_hand(&mut self, force: Vector3<f64>) {
        self.plant.push_by_hand(force);
    }

    /// The controller, for pausing, switching and stopping.
    pub fn controller(&mut self) -> &mut Controller {
        &mut self.controller
    }

    /// Runs one arm period: the plant moves, then sensors, estimators and controller process what
    /// it reports.
    pub fn step(&mut self, watch: &mut impl FnMut(&AdmittanceCycle<'_>)) -> CycleSample {
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
            self.wrench.take(sample, pose, sample.time_s - at);
        }
        self.pose_before = (base_from_tool, arm.time_s);

        let mut input = blank_input(&self.plant);
        input.base_from_tool = base_from_tool;
        input.twist = twist;
        input.arm_ready = self.arm_ready;
        if let Some((conditioned, age_s)) = self.wrench.newest(arm.time_s) {
            input.wrench = conditioned.wrench;
            input.wrench_validity = conditioned.validity;
            input.wrench_age_s = age_s;
            input.wrench_delay_s = conditioned.delay_s;
            input.bias_age_s = conditioned.bias_age_s;
            input.zero_bound_n = self.wrench.zero_bound_n(&conditioned);
            input.untared = Some(self.wrench.untared_load(&conditioned));
        }

        for sample in self.plant.odometry() {
            // The tracker counts a rejected pose as a missing one.
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
        let ground = self.output.clearance.tare_ground();
        let tare = self.output.tare_requested.then_some(ground);
        self.wrench.obey(tare, self.output.zero_withdrawn);
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
        watch(&AdmittanceCycle {
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

/// The arm's part of a controller input, without a wrench and without estimates.
fn blank_input(plant: &AdmittancePlant) -> ControlInput {
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
        arm_force: plant.arm_force(),
        estimates: [None; MAX_ESTIMATORS],
        objects: [None; MAX_ESTIMATORS],
        vision: None,
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
