//! Plant, camera, touch estimator and `unified_force_impedance` in one thread; `tangent evaluate`
//! runs this for scenarios of kind `visuo_tactile`.

use nalgebra::Vector3;
use tangent_control::{
    EstimateInput, LawInput, MAX_ESTIMATORS, Phase, UnifiedForceImpedance, UnifiedInput,
    UnifiedOutput, VisionInput,
};
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator};
use tangent_mechanics::{Joints, Pose, Twist, Wrench};
use tangent_sensing::{RecordVerdict, RecordWatch, RecordWatchConfig, RecordWatchState, Validity};

use super::plant::{VisuoTactileMeasurement, VisuoTactilePlant};
use super::scenario::VisuoTactileScenario;
use crate::arms::loaded_arm::joints_of;
use crate::arms::own_hold::OwnHold;
use crate::contact::Obstacle;
use crate::digest::TrajectoryDigest;
use crate::disturbance::{Disturbance, Undisturbed};
use crate::evaluation::{Evaluation, RunEnd, run_to_end};
use crate::metrics::visuo_tactile::{VisuoTactileFigures, VisuoTactileSample};
use crate::metrics::{CycleSample, EstimateSample, TruthSample};
use crate::scenario_file::ScenarioError;
use crate::stated::StatedCell;
use crate::truth::Truth;

/// One cycle of the loop, as shown to an observer.
pub struct VisuoTactileCycle<'a, const N: usize = 7> {
    /// Inputs of the controller.
    pub input: &'a UnifiedInput<N>,
    /// Outputs of the controller.
    pub output: &'a UnifiedOutput<N>,
    /// True state of the contact.
    pub truth: &'a Truth,
    /// Sample for the figures common to all laws.
    pub cycle: &'a CycleSample,
    /// Sample for the figures of this law.
    pub sample: &'a VisuoTactileSample,
    /// The cell.
    pub plant: &'a VisuoTactilePlant<N>,
}

/// Runs a scenario to its end.
///
/// # Errors
/// As [`VisuoTactileLoop::new`].
pub fn evaluate_visuo_tactile(
    scenario: &VisuoTactileScenario,
) -> Result<Evaluation, ScenarioError> {
    match joints_of(&scenario.plant.robot)? {
        6 => evaluate_visuo_tactile_of::<6>(scenario, &mut Undisturbed, |_| ()),
        _ => evaluate_visuo_tactile_of::<7>(scenario, &mut Undisturbed, |_| ()),
    }
}

/// Runs a scenario of an arm with seven joints to its end with a disturbance and passes every cycle
/// to `watch`.
///
/// # Errors
/// As [`VisuoTactileLoop::new`].
pub fn evaluate_visuo_tactile_with(
    scenario: &VisuoTactileScenario,
    disturbance: &mut dyn Disturbance,
    watch: impl FnMut(&VisuoTactileCycle<'_>),
) -> Result<Evaluation, ScenarioError> {
    evaluate_visuo_tactile_of::<7>(scenario, disturbance, watch)
}

/// Runs a scenario of an arm with `N` joints to its end with a disturbance and passes every cycle
/// to `watch`.
///
/// # Errors
/// As [`VisuoTactileLoop::new`].
pub fn evaluate_visuo_tactile_of<const N: usize>(
    scenario: &VisuoTactileScenario,
    disturbance: &mut dyn Disturbance<N>,
    mut watch: impl FnMut(&VisuoTactileCycle<'_, N>),
) -> Result<Evaluation, ScenarioError> {
    let mut closed = VisuoTactileLoop::new(scenario)?;
    let period = closed.plant.period_s();
    let mut samples = Vec::new();
    let cycles = run_to_end(scenario.duration_s, period, || {
        let (cycle, sample) = closed.step(disturbance, &mut watch);
        samples.push(sample);
        cycle
    });
    let figures = VisuoTactileFigures::of(&samples, period, closed.plant.frames());
    let end = RunEnd {
        scenario: &scenario.name,
        controller: &scenario.controller,
        estimator: closed.touch.name(),
        seed: scenario.seed,
        duration_s: closed.plant.time_s(),
        fault: closed.output.and_then(|output| output.fault),
        state_digest: closed.digest.finish(),
    };
    Ok(Evaluation {
        tactile: Some(figures),
        ..Evaluation::of(end, &cycles)
    })
}

/// The closed loop, stepped period by period.
pub struct VisuoTactileLoop<const N: usize = 7> {
    plant: VisuoTactilePlant<N>,
    touch: Box<dyn NormalEstimator>,
    controller: UnifiedForceImpedance<N>,
    wrench_lag_s: f64,
    watch: (RecordWatch, RecordWatchState),
    up: Vector3<f64>,
    vision: Option<VisionInput>,
    felt: Option<NormalEstimate>,
    torque: Joints<N>,
    output: Option<UnifiedOutput<N>>,
    digest: TrajectoryDigest,
    /// The cell as its controller knows it.
    stated: StatedCell<N>,
    /// Own hold of the robot while it accepts no torques; `None` while it does.
    stopped: Option<OwnHold<N>>,
}

impl<const N: usize> VisuoTactileLoop<N> {
    /// Builds the cell and starts the task.
    ///
    /// # Errors
    /// The cell of the scenario cannot be built, or its task, law or estimator is not usable.
    pub fn new(scenario: &VisuoTactileScenario) -> Result<Self, ScenarioError> {
        let plant = VisuoTactilePlant::new(&scenario.plant, scenario.seed)?;
        let stated = scenario.plant.stated::<N>()?;
        Ok(Self {
            touch: scenario.touch()?,
            controller: scenario.controller()?,
            watch: (
                RecordWatch::new(&RecordWatchConfig::default(), 1.0 / plant.period_s()),
                RecordWatchState::default(),
            ),
            wrench_lag_s: scenario.law()?.touch.wrench_lag_s,
            torque: stated.arm.gravity(&plant.measured().q),
            up: -scenario.task.approach.direction.in_base(
                &(stated.arm.base_from_flange(&plant.measured().q) * stated.flange_from_tool),
            ),
            stated,
            stopped: None,
            plant,
            vision: None,
            felt: None,
            output: None,
            digest: TrajectoryDigest::default(),
        })
    }

    /// The cell.
    pub fn plant(&self) -> &VisuoTactilePlant<N> {
        &self.plant
    }

    /// Puts an obstacle in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.plant.put_in_the_way(obstacle);
    }

    /// The law, for requests between two periods.
    pub fn controller(&mut self) -> &mut UnifiedForceImpedance<N> {
        &mut self.controller
    }

    /// Sets whether the robot accepts torques; otherwise it is in a protective stop and holds
    /// itself.
    pub fn set_arm_ready(&mut self, ready: bool) {
        self.stopped = (!ready).then(OwnHold::default);
    }

    /// Runs one period: the plant moves, then estimator and law process what it reports.
    pub fn step(
        &mut self,
        disturbance: &mut dyn Disturbance<N>,
        watch: &mut impl FnMut(&VisuoTactileCycle<'_, N>),
    ) -> (CycleSample, VisuoTactileSample) {
        let time = self.plant.time_s();
        self.plant.push(&disturbance.push(time));
        self.plant.step(&self.torque);
        let arm = self.plant.measured();
        if let Some(normal) = self.plant.take_normal() {
            self.vision = disturbance.vision(arm.time_s, normal).or(self.vision);
        }
        let flange_from_tool = self.stated.flange_from_tool;
        let (base_from_tool, jacobian) =
            self.stated.arm.tool_and_jacobian(&arm.q, &flange_from_tool);
        let mut estimates = [None; MAX_ESTIMATORS];
        estimates[0] = self.felt.map(|estimate| EstimateInput {
            estimate,
            age_s: self.plant.period_s(),
        });
        let mut input = self.controller.choose(&LawInput {
            time_s: arm.time_s,
            dt_s: self.plant.period_s(),
            q: arm.q,
            qd: arm.qd,
            base_from_tool,
            twist: Twist::from_vector(&(jacobian * arm.qd)),
            speed_scaling: 1.0,
            arm_ready: self.stopped.is_none(),
            wrench: arm.wrench,
            wrench_validity: Validity::Valid,
            wrench_age_s: 0.0,
            wrench_delay_s: 0.0,
            bias_age_s: None,
            zero_bound_n: None,
            untared: None,
            arm_force: None,
            estimates,
            objects: [None; MAX_ESTIMATORS],
            vision: self.vision,
            base: None,
        });
        disturbance.input(&mut input);
        self.judge(&mut input);
        let output = self.controller.step(&input);
        self.torque = match &mut self.stopped {
            Some(hold) => hold.torque(&self.stated.arm, &arm.q, &arm.qd, &self.torque, input.dt_s),
            None => output.torque,
        };
        self.output = Some(output);
        self.feel(&input, &output);
        let truth = self.plant.truth();
        let (cycle, sample) = self.samples(&input, &output, &truth);
        watch(&VisuoTactileCycle {
            input: &input,
            output: &output,
            truth: &truth,
            cycle: &cycle,
            sample: &sample,
            plant: &self.plant,
        });
        self.digest_cycle(&arm, &output, &truth);
        (cycle, sample)
    }

    /// Marks a wrench estimate as invalid once it, or one of its axes, no longer changes, as the
    /// robot's bridge does.
    fn judge(&mut self, input: &mut UnifiedInput<N>) {
        let wrench = input.wrench.vector();
        let counts = std::array::from_fn(|i| (wrench[i] * 1e6).round() as i32);
        let (watch, state) = &mut self.watch;
        let found = match watch.take(state, &counts, None) {
            RecordVerdict::Plausible => return,
            RecordVerdict::Frozen => Validity::Frozen,
            RecordVerdict::AxisStuck(_) => Validity::AxisStuck,
        };
        if input.wrench_validity.is_valid() {
            input.wrench_validity = found;
        }
    }

    /// Estimates the normal from contact for the next period, with the wrench as cleaned by the
    /// law.
    fn feel(&mut self, input: &UnifiedInput<N>, output: &UnifiedOutput<N>) {
        let stated = &self.stated;
        let jacobian = stated.arm.jacobian_at(&input.q, &stated.flange_from_tool);
        let zeroed = !matches!(output.phase, Phase::Tare | Phase::Clear);
        let felt = output
            .wrench
            .filter(|_| zeroed && input.wrench_validity.is_valid());
        let twist = Twist::from_vector(&(jacobian * input.qd));
        self.felt = Some(self.touch.update(&ContactSample {
            time_s: input.time_s,
            dt_s: input.dt_s,
            base_from_tool: output.base_from_tool,
            twist,
            twist_commanded: twist,
            // Ignored while it is not valid.
            wrench: felt.unwrap_or(Wrench::zero()),
            wrench_delay_s: self.wrench_lag_s,
            wrench_validity: if felt.is_some() {
                Validity::Valid
            } else {
                Validity::Missing
            },
            wrench_bias_age_s: felt.map(|_| input.time_s),
            base: None,
        }));
    }

    fn samples(
        &self,
        input: &UnifiedInput<N>,
        output: &UnifiedOutput<N>,
        truth: &Truth,
    ) -> (CycleSample, VisuoTactileSample) {
        // The reference is a position across the approach direction. Its height is that of the
        // surface, where the tool should touch it.
        let wanted = self
            .plant
            .surface_along(&output.path_reference, &self.up)
            .unwrap_or(output.path_reference);
        let cycle = CycleSample {
            time_s: input.time_s,
            phase: output.phase,
            estimate: Some(EstimateSample {
                normal: output.normal,
                covariance: output.normal_covariance,
                valid: output.normal_validity.is_valid(),
            }),
            truth: Some(TruthSample {
                normal: truth.normal,
                tool_z: truth.base_from_tool.z_axis(),
                in_contact: truth.in_contact,
                force_n: truth.wrench.force.dot(&truth.normal),
            }),
            tool_position: output.base_from_tool.translation(),
            tool_z: output.base_from_tool.z_axis(),
            force_n: output.force_n,
            force_reference_n: output.force_reference_n,
            in_contact: output.in_contact,
            path_reference: wanted,
            path_error_m: output.path_error_m,
            joint_speed_rad_per_s: input.qd.amax(),
            manipulability: output.manipulability,
            motion_tank_j: Some(output.tanks.motion_j),
            force_tank_j: Some(output.tanks.force_j),
        };
        let tool: Pose<_, _> = truth.base_from_tool;
        let force = tool.unrotate(&truth.wrench.force);
        (
            cycle,
            VisuoTactileSample::of(input.time_s, output, &wanted, &force),
        )
    }

    fn digest_cycle(
        &mut self,
        arm: &VisuoTactileMeasurement<N>,
        output: &UnifiedOutput<N>,
        truth: &Truth,
    ) {
        self.digest.add(arm.q.as_slice());
        self.digest.add(arm.qd.as_slice());
        self.digest.add(arm.wrench.vector().as_slice());
        self.digest.add(output.torque.as_slice());
        self.digest.add(output.normal.as_slice());
        self.digest.add(truth.wrench.vector().as_slice());
    }
}
