//! Plant, camera, touch estimator and `unified_force_impedance` in one thread; `tangent evaluate`
//! runs this for scenarios of kind `visuo_tactile`.

use nalgebra::{Vector3, Vector6};
use tangent_control::{Phase, UnifiedForceImpedance, UnifiedInput, UnifiedOutput, VisionInput};
use tangent_estimation::{ContactSample, NormalEstimate, NormalEstimator};
use tangent_mechanics::{Arm, Joints, Pose, Twist, Wrench};
use tangent_sensing::{RecordVerdict, RecordWatch, RecordWatchConfig, RecordWatchState, Validity};

use crate::closed_loop::Evaluation;
use crate::digest::TrajectoryDigest;
use crate::metrics::tactile::{TactileFigures, TactileSample};
use crate::metrics::{CycleSample, EstimateSample, Figures, TruthSample};
use crate::obstacle::Obstacle;
use crate::own_hold::OwnHold;
use crate::scenario::ScenarioError;
use crate::tactile_plant::{JOINTS, TactileMeasurement, TactilePlant};
use crate::tactile_scenario::TactileScenario;
use crate::truth::Truth;

/// Time for which a run continues after its task has ended, s.
const AFTER_END_S: f64 = 0.2;

/// One cycle of the loop, as shown to an observer.
pub struct TactileCycle<'a> {
    /// Inputs of the controller.
    pub input: &'a UnifiedInput,
    /// Outputs of the controller.
    pub output: &'a UnifiedOutput,
    /// True state of the contact.
    pub truth: &'a Truth,
    /// Sample for the figures common to all laws.
    pub cycle: &'a CycleSample,
    /// Sample for the figures of this law.
    pub sample: &'a TactileSample,
    /// The cell.
    pub plant: &'a TactilePlant,
}

/// Changes the inputs before they arrive, to test failures.
pub trait TactileDisturbance {
    /// A normal before the law receives it; `None` for a lost frame.
    fn vision(&mut self, _time_s: f64, normal: VisionInput) -> Option<VisionInput> {
        Some(normal)
    }

    /// Alters all other inputs of the law.
    fn input(&mut self, _input: &mut UnifiedInput) {}

    /// External wrench on the tool, base axes, N and Nm.
    fn push(&mut self, _time_s: f64) -> Vector6<f64> {
        Vector6::zeros()
    }
}

/// A disturbance that changes nothing.
#[derive(Clone, Copy, Debug, Default)]
pub struct Calm;

impl TactileDisturbance for Calm {}

/// Runs a scenario to its end.
///
/// # Errors
/// As [`TactileLoop::new`].
pub fn evaluate_tactile(scenario: &TactileScenario) -> Result<Evaluation, ScenarioError> {
    evaluate_tactile_with(scenario, &mut Calm, |_| ())
}

/// Runs a scenario to its end with a disturbance and passes every cycle to `watch`.
///
/// # Errors
/// As [`TactileLoop::new`].
pub fn evaluate_tactile_with(
    scenario: &TactileScenario,
    disturbance: &mut dyn TactileDisturbance,
    mut watch: impl FnMut(&TactileCycle<'_>),
) -> Result<Evaluation, ScenarioError> {
    let mut closed = TactileLoop::new(scenario)?;
    let period = closed.plant.period_s();
    let steps = (scenario.duration_s / period).round() as u64;
    let mut cycles = Vec::with_capacity(steps as usize);
    let mut samples = Vec::with_capacity(steps as usize);
    let mut ended_at = None;
    for _ in 0..steps {
        let (cycle, sample) = closed.step(disturbance, &mut watch);
        cycles.push(cycle);
        samples.push(sample);
        if !cycle.phase.is_active() {
            let since = *ended_at.get_or_insert(cycle.time_s);
            if cycle.time_s - since >= AFTER_END_S {
                break;
            }
        }
    }
    let last = closed.output;
    Ok(Evaluation {
        scenario: scenario.name.clone(),
        controller: scenario.controller.clone(),
        estimator: closed.touch.name().to_owned(),
        seed: scenario.seed,
        duration_s: closed.plant.time_s(),
        steps: cycles.len() as u64,
        wall_s: None,
        real_time_factor: None,
        figures: Figures::of(&cycles),
        object_pose: None,
        tactile: Some(TactileFigures::of(&samples, period, closed.plant.frames())),
        r#loop: None,
        phase: last.map_or(Phase::Idle, |o| o.phase).name(),
        fault: last.and_then(|o| o.fault).map(|f| f.text()),
        state_digest: closed.digest.finish(),
    })
}

/// The closed loop, stepped period by period.
pub struct TactileLoop {
    plant: TactilePlant,
    touch: Box<dyn NormalEstimator>,
    controller: UnifiedForceImpedance,
    wrench_lag_s: f64,
    watch: (RecordWatch, RecordWatchState),
    up: Vector3<f64>,
    vision: Option<VisionInput>,
    felt: Option<NormalEstimate>,
    torque: Joints<JOINTS>,
    output: Option<UnifiedOutput>,
    digest: TrajectoryDigest,
    /// As the robot knows itself.
    stated: Arm<JOINTS>,
    /// The robot does not take torques: it holds itself.
    stopped: Option<OwnHold<JOINTS>>,
}

impl TactileLoop {
    /// Builds the cell and starts the task.
    ///
    /// # Errors
    /// The cell of the scenario cannot be built, or its task, law or estimator is not usable.
    pub fn new(scenario: &TactileScenario) -> Result<Self, ScenarioError> {
        let plant = TactilePlant::new(&scenario.plant, scenario.seed)?;
        let start = plant.truth().base_from_tool;
        Ok(Self {
            touch: scenario.touch()?,
            controller: scenario.controller(&plant)?,
            watch: (
                RecordWatch::new(&RecordWatchConfig::default(), 1.0 / plant.period_s()),
                RecordWatchState::default(),
            ),
            wrench_lag_s: scenario.law()?.touch.wrench_lag_s,
            up: -scenario.task.approach.direction.in_base(&start),
            torque: plant.stated_model()?.gravity(&plant.measured().q),
            stated: plant.stated_model()?,
            stopped: None,
            plant,
            vision: None,
            felt: None,
            output: None,
            digest: TrajectoryDigest::default(),
        })
    }

    /// The cell.
    pub fn plant(&self) -> &TactilePlant {
        &self.plant
    }

    /// Puts something in the way of a tool that leaves the surface under it.
    pub fn put_in_the_way(&mut self, obstacle: Obstacle) {
        self.plant.put_in_the_way(obstacle);
    }

    /// The law, for those who ask something of it between two periods.
    pub fn controller(&mut self) -> &mut UnifiedForceImpedance {
        &mut self.controller
    }

    /// The robot takes torques, or is in a protective stop and holds itself.
    pub fn set_arm_ready(&mut self, ready: bool) {
        self.stopped = (!ready).then(OwnHold::default);
    }

    /// One period: the plant moves, then everybody answers to what it reports.
    pub fn step(
        &mut self,
        disturbance: &mut dyn TactileDisturbance,
        watch: &mut impl FnMut(&TactileCycle<'_>),
    ) -> (CycleSample, TactileSample) {
        let time = self.plant.time_s();
        self.plant.push(&disturbance.push(time));
        self.plant.step(&self.torque);
        let arm = self.plant.measured();
        if let Some(normal) = self.plant.take_normal() {
            self.vision = disturbance.vision(arm.time_s, normal).or(self.vision);
        }
        let mut input = UnifiedInput {
            time_s: arm.time_s,
            dt_s: self.plant.period_s(),
            q: arm.q,
            qd: arm.qd,
            arm_ready: self.stopped.is_none(),
            wrench: arm.wrench,
            wrench_validity: Validity::Valid,
            wrench_age_s: 0.0,
            untared: None,
            vision: self.vision,
            touch: self.felt,
            touch_age_s: self.plant.period_s(),
        };
        disturbance.input(&mut input);
        self.judge(&mut input);
        let output = self.controller.step(&input);
        self.torque = match &mut self.stopped {
            Some(hold) => hold.torque(&self.stated, &arm.q, &arm.qd, &self.torque, input.dt_s),
            None => output.torque,
        };
        self.output = Some(output);
        self.feel(&input, &output);
        let truth = self.plant.truth();
        let (cycle, sample) = self.samples(&input, &output, &truth);
        watch(&TactileCycle {
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
    fn judge(&mut self, input: &mut UnifiedInput) {
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

    /// Estimates the normal by touch for the next period, from the wrench as cleaned by the law.
    fn feel(&mut self, input: &UnifiedInput, output: &UnifiedOutput) {
        let jacobian = self
            .plant
            .arm()
            .model()
            .jacobian_at(&input.q, &self.plant.flange_from_tool());
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
        input: &UnifiedInput,
        output: &UnifiedOutput,
        truth: &Truth,
    ) -> (CycleSample, TactileSample) {
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
            TactileSample::of(input.time_s, output, &wanted, &force),
        )
    }

    fn digest_cycle(&mut self, arm: &TactileMeasurement, output: &UnifiedOutput, truth: &Truth) {
        self.digest.add(arm.q.as_slice());
        self.digest.add(arm.qd.as_slice());
        self.digest.add(arm.wrench.vector().as_slice());
        self.digest.add(output.torque.as_slice());
        self.digest.add(output.normal.as_slice());
        self.digest.add(truth.wrench.vector().as_slice());
    }
}
