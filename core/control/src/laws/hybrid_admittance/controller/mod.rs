//! The controller: phases, laws and guards composed into one step per robot cycle.

mod cycle;
mod requests;

use tangent_mechanics::{Arm, Flange, Pose, Tool};

use super::config::ControllerConfig;
use super::joint_velocity::JointVelocity;
use super::loop_delay::{LoopDelay, LoopDelayState};
use super::moving_base::MovingBase;
use super::percept::Requests;
use super::run::Run;
use super::travel::TravelPoses;
use crate::coverage::{Coverage, CoverageResult};
use crate::error::ControlError;
use crate::inputs::{EstimateInput, MAX_ESTIMATORS};
use crate::learning::EndedPass;
use crate::leaving::clearance::Clearance;
use crate::limits::{Limits, TwistLimiter};
use crate::parameters::law_config::LawConfig;
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::program::{EstimatorNames, Program, RunMemory};

/// One arm's controller. Call `start` with a program, then `step` once per robot packet.
///
/// ```
/// use nalgebra::{UnitQuaternion, Vector3};
/// use tangent_control::{
///     ControlInput, Controller, ControllerConfig, Limits, MAX_ESTIMATORS, Phase, Task,
/// };
/// use tangent_mechanics::{Arm, Joints, ModelData, Pose, Twist, Wrench};
/// use tangent_sensing::Validity;
///
/// let arm = Arm::<6>::new(&ModelData::builtin("ur5")?)?;
/// let flange_from_tool = Pose::new(Vector3::new(0.0, 0.0, 0.15), UnitQuaternion::identity());
/// let limits = Limits::default();
/// let config = ControllerConfig::default();
/// let mut controller = Controller::new(arm, flange_from_tool, limits, config)?;
/// let task: Task = r#"
///     name = "wipe"
///     tare = false
///     force.reference_n = 3.0
///     [path]
///     kind = "line"
///     to_m = [0.04, 0.0]
///     speed_m_per_s = 0.02
/// "#
/// .parse()?;
///
/// // The tool points down and touches nothing.
/// let q = Joints::<6>::from([0.3, -1.6, 1.7, -1.67, -1.57, 0.0]);
/// let mut input = ControlInput {
///     time_s: 0.0,
///     dt_s: 0.008,
///     q,
///     qd: Joints::<6>::zeros(),
///     base_from_tool: arm.base_from_flange(&q) * flange_from_tool,
///     twist: Twist::zero(),
///     speed_scaling: 1.0,
///     arm_ready: true,
///     wrench: Wrench::zero(),
///     wrench_validity: Validity::Valid,
///     wrench_age_s: 0.004,
///     wrench_delay_s: 0.0,
///     bias_age_s: None,
///     zero_bound_n: None,
///     untared: None,
///     arm_force: None,
///     estimates: [None; MAX_ESTIMATORS],
///     objects: [None; MAX_ESTIMATORS],
///     vision: None,
///     base: None,
/// };
///
/// // Without a task, the arm is commanded to stand still.
/// let output = controller.step(&input);
/// assert_eq!((output.phase, output.qd), (Phase::Idle, Joints::<6>::zeros()));
///
/// // A task that needs no tare begins with the approach, along the tool's z axis.
/// controller.start_task(&task)?;
/// input.time_s += input.dt_s;
/// let output = controller.step(&input);
/// assert_eq!(output.phase, Phase::Approach);
/// assert!(output.twist_commanded.linear.z < 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Controller<const N: usize = 6> {
    arm: Arm<N>,
    flange_from_tool: Pose<Flange, Tool>,
    limits: Limits,
    config: ControllerConfig,
    program: Option<Program>,
    /// The program's own, moved here while it runs.
    memory: RunMemory,
    /// Start pose and home of the program.
    poses: TravelPoses<N>,
    names: EstimatorNames,
    activation: u64,
    requests: Requests,
    run: Run,
    moving_base: MovingBase,
    limiter: TwistLimiter,
    joints: JointVelocity<N>,
    loop_delay: LoopDelay,
    delay: LoopDelayState<N>,
    estimates: [Option<EstimateInput>; MAX_ESTIMATORS],
    /// Targets of the live parameters, in the order of `Parameter::ALL`; `config` ramps to them.
    targets: [f64; 4],
    speed_m_per_s: f64,
}

impl<const N: usize> Controller<N> {
    /// Stays idle until a program is started. `config` is for tasks that name no preset.
    pub fn new(
        arm: Arm<N>,
        flange_from_tool: Pose<Flange, Tool>,
        limits: Limits,
        config: ControllerConfig,
    ) -> Result<Self, ControlError> {
        limits.check()?;
        config.check()?;
        Ok(Self {
            arm,
            flange_from_tool,
            limits,
            config,
            program: None,
            memory: RunMemory::default(),
            poses: TravelPoses::default(),
            names: EstimatorNames::new(),
            activation: 0,
            requests: Requests::default(),
            run: Run::idle(),
            moving_base: MovingBase::default(),
            limiter: TwistLimiter::default(),
            joints: JointVelocity::default(),
            loop_delay: LoopDelay::default(),
            delay: LoopDelayState::default(),
            estimates: [None; MAX_ESTIMATORS],
            targets: [0.0; 4],
            speed_m_per_s: 0.0,
        })
    }

    /// The pass that has ended, for the memory of the next one; `None` while a task runs, if the
    /// task does not learn, and when it was taken before.
    pub fn take_pass(&mut self) -> Option<EndedPass> {
        if self.run.phase.is_active() {
            return None;
        }
        let program = self.program.as_ref()?;
        let completed = self.run.fault.is_none() && self.run.tracking.is_finished(&program.path);
        let learner = self.memory.learner.take()?;
        Some(EndedPass { learner, completed })
    }

    /// Dose over the region of the running or last task, and its rounds so far; `None` without
    /// `[coverage]`.
    pub fn coverage(&self) -> Option<&Coverage> {
        self.memory.coverage.as_deref()
    }

    /// What the running or last task has covered, as it is now; `None` without `[coverage]`.
    /// Allocates.
    pub fn coverage_result(&self) -> Option<CoverageResult> {
        let ended = !self.run.phase.is_active();
        Some(self.memory.coverage.as_deref()?.result(ended))
    }

    /// What the task has covered, once at the end of each round that another one follows, and at
    /// the end of the task; otherwise `None`. Allocates nothing.
    pub fn take_coverage(&mut self) -> Option<CoverageResult> {
        let ended = !self.run.phase.is_active();
        self.memory.coverage.as_deref_mut()?.take_result(ended)
    }

    /// Whether the tool may touch something. The next start depends on it.
    pub fn clearance(&self) -> Clearance {
        self.run.clearance
    }

    /// Estimators to which `ControlInput::estimates` refers, in this order.
    pub fn estimators(&self) -> &EstimatorNames {
        &self.names
    }

    /// The phase after the last step.
    pub fn phase(&self) -> Phase {
        self.run.phase
    }

    /// Number of task starts.
    pub fn activation(&self) -> u64 {
        self.activation
    }

    /// Limits in effect.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Parameters of the law in effect.
    pub fn config(&self) -> &ControllerConfig {
        &self.config
    }

    /// Delay from command to measured force that the arm showed in free space, s, and its standard
    /// deviation, s; `None` before a measurement. It outlives a task.
    pub fn loop_delay_measured_s(&self) -> Option<(f64, f64)> {
        self.loop_delay.measured_s(&self.delay)
    }

    /// The running or last task.
    pub fn task(&self) -> Option<&Task> {
        self.program.as_ref().map(|program| &program.task)
    }
}
