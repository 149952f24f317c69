//! The controller: phases, laws and guards composed into one step per robot cycle.

use nalgebra::Vector3;
use tangent_mechanics::{Arm, Flange, Joints, Pose, Tool, Twist, manipulability};

use super::config::ControllerConfig;
use super::interface::{ControlInput, ControlOutput};
use super::joint_velocity::JointVelocity;
use super::joint_way::JointWay;
use super::loop_delay::{DelaySample, LoopDelay, LoopDelayState};
use super::motion::{Learning, ramp_gains, wanted_twist};
use super::moving_base::MovingBase;
use super::percept::{Percept, Requests};
use super::run::Run;
use super::travel::TravelPoses;
use crate::contact::alignment::alignment_error;
use crate::coverage::{Coverage, CoverageResult};
use crate::error::ControlError;
use crate::estimator_choice::switching::{ChoiceRules, SwitchRefusal};
use crate::inputs::{EstimateInput, MAX_ESTIMATORS};
use crate::joint_move;
use crate::learning::EndedPass;
use crate::leaving::clearance::Clearance;
use crate::limits::faults::Fault;
use crate::limits::plausibility::{is_arm_state, is_place, is_time, is_velocity};
use crate::limits::{Limits, TwistLimiter};
use crate::parameters::law_config::LawConfig;
use crate::parameters::live::Parameter;
use crate::phase_machine::Phase;
use crate::task::Task;
use crate::task::program::{EstimatorName, EstimatorNames, Program, RunMemory};
use tangent_schemas::CommandKind;

/// Speed scaling of the robot above which the arm carries out the commands as they are.
const UNSCALED: f64 = 0.999;

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
    /// Targets of the live parameters, in the order of [`Parameter::ALL`]; `config` ramps to them.
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

    /// Makes a program from a task and starts it. Allocates: for the closed loop and tests, not for
    /// the robot's cycle.
    pub fn start_task(&mut self, task: &Task) -> Result<(), ControlError> {
        let program = Program::new(task, &self.config)?;
        self.start(program, 0).map(drop)
    }

    /// Starts a program from idle, done or fault. Returns the previous one, which must be dropped
    /// outside the loop. `latched` is the activation that the bridge has latched out: the new one
    /// is greater.
    pub fn start(
        &mut self,
        mut program: Program,
        latched: u64,
    ) -> Result<Option<Program>, ControlError> {
        if self.run.phase.is_active() {
            return Err(self.wrong_phase("start a task", "stop the running task first"));
        }
        if self.run.clearance == Clearance::Unknown {
            return Err(ControlError::MayTouch { moved_m: None });
        }
        self.poses = TravelPoses::of(&program.task)?;
        self.activation = self.activation.max(latched).saturating_add(1);
        self.requests = Requests::default();
        self.run = Run::start(&program, self.run.clearance);
        self.moving_base = MovingBase::default();
        self.names = program.estimators.clone();
        self.config = program.config;
        self.speed_m_per_s = program.task.path.speed_m_per_s();
        self.targets = [
            program.task.force.reference_n,
            self.speed_m_per_s,
            self.config.alignment.gain_per_s,
            self.config.force.damping_n_s_per_m,
        ];
        let new = std::mem::take(&mut program.memory);
        let learner = new.learner.as_ref();
        self.run.knows_surface = learner.is_some_and(|learner| learner.knows_surface());
        let old = std::mem::replace(&mut self.memory, new);
        let mut before = self.program.replace(program);
        if let Some(before) = &mut before {
            before.memory = old;
        }
        Ok(before)
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

    /// Whether a task may start with the tool at `position` (base axes, m).
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] if the tool may touch something and the direction away from it is
    /// not known.
    pub fn check_start(&self, position: &Vector3<f64>) -> Result<(), ControlError> {
        let leave = &self.config.leave;
        self.run.clearance.way_out(leave, position).map(drop)
    }

    /// Whether the tool may touch something. The next start depends on it.
    pub fn clearance(&self) -> Clearance {
        self.run.clearance
    }

    /// Sets the clearance known from an earlier controller or confirmed by a person.
    ///
    /// # Errors
    /// A task runs.
    pub fn set_clearance(&mut self, clearance: Clearance) -> Result<(), ControlError> {
        if self.run.phase.is_active() {
            return Err(self.wrong_phase("state that the tool hangs free", "stop the task first"));
        }
        self.run.clearance = clearance;
        Ok(())
    }

    /// Stands still in every phase: the path stops where it is, a pressing tool keeps its force,
    /// and no time limit runs.
    ///
    /// # Errors
    /// No task runs, or it is leaving the surface.
    pub fn pause(&mut self) -> Result<(), ControlError> {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return Err(self.wrong_phase("pause", "there is no path to stop"));
        }
        self.requests.paused = true;
        Ok(())
    }

    /// Resumes after [`Controller::pause`].
    pub fn resume(&mut self) -> Result<(), ControlError> {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return Err(self.wrong_phase("resume", "start the task again"));
        }
        self.requests.paused = false;
        Ok(())
    }

    /// Whether a task is paused.
    pub fn is_paused(&self) -> bool {
        self.requests.paused && self.run.phase.is_active() && self.run.phase != Phase::Retract
    }

    /// Ends the task: retracts, then done. No effect if no task runs.
    pub fn stop(&mut self) {
        self.requests.stopping = true;
    }

    /// Ends the task with a retraction along `away` (base axes) instead of the last good normal:
    /// for tests with a wrong direction.
    #[doc(hidden)]
    pub fn stop_along(&mut self, away: Vector3<f64>) {
        self.run.way_off = Some(away);
        self.stop();
    }

    /// Whether the task has ended with the tool possibly still on the surface, after a fault in
    /// which nothing could move.
    pub fn is_left_on_surface(&self) -> bool {
        self.run.is_left_on_surface()
    }

    /// Retracts a tool that [is left on the surface](Self::is_left_on_surface) along the last good
    /// normal, by the retraction distance of the task. `latched` as in [`Controller::start`]: the
    /// motion has its own activation.
    pub fn leave_surface(&mut self, latched: u64) {
        if self.run.is_left_on_surface() {
            self.activation = self.activation.max(latched) + 1;
            self.requests = Requests::default();
            self.run.leave_again();
        }
    }

    fn wrong_phase(&self, request: &'static str, remedy: &'static str) -> ControlError {
        ControlError::WrongPhase {
            request,
            phase: self.run.phase.name(),
            remedy,
        }
    }

    /// Adds an estimator to [`Controller::estimators`] without using it. Returns its place in the
    /// list, `None` if the list is full.
    pub fn listen_to(&mut self, name: EstimatorName) -> Option<usize> {
        if let Some(index) = self.names.iter().position(|n| *n == name) {
            return Some(index);
        }
        self.names.try_push(name).ok()?;
        Some(self.names.len() - 1)
    }

    /// Switches to another estimator of [`Controller::estimators`] if it is fresh, valid and near
    /// the normal in use; `force` waives the last two conditions. The normal then turns at a
    /// bounded rate.
    pub fn select_estimator(&mut self, name: &str, force: bool) -> Result<(), SwitchRefusal> {
        if !self.run.phase.is_active() {
            return Err(SwitchRefusal::NoTask);
        }
        let index = self
            .names
            .iter()
            .position(|n| n.as_str() == name)
            .ok_or(SwitchRefusal::Unknown)?;
        let program = self.program.as_ref().ok_or(SwitchRefusal::NoTask)?;
        self.run.choice.select(
            &ChoiceRules::new(
                &self.config.normal,
                &self.config.patience,
                &program.task.switching,
            ),
            &self.estimates,
            &self.run.surface.normal,
            index,
            force,
        )
    }

    /// Sets a live parameter, clamped to its range; it takes effect over a ramp. A task's start
    /// sets all of them to the values of the task and the preset.
    pub fn set(&mut self, parameter: Parameter, value: f64) {
        let (lower, upper) = parameter.range();
        if value.is_finite() {
            self.targets[parameter as usize] = value.clamp(lower, upper);
        }
    }

    /// Value of a live parameter, or its target during a ramp.
    pub fn get(&self, parameter: Parameter) -> f64 {
        self.targets[parameter as usize]
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

    /// One robot cycle. Allocates nothing.
    pub fn step(&mut self, input: &ControlInput<N>) -> ControlOutput<N> {
        if !is_sane(input) {
            if self.run.phase.is_active() {
                self.run.abort(Fault::ArmState);
            }
            return self.stand(input);
        }
        let placed = self.moving_base.place(input);
        self.estimates = placed.estimates;
        if self.run.phase.is_active() && !input.arm_ready {
            self.run.abort(Fault::ArmNotReady);
        }
        if let (Some(coverage), Some(program)) = (&mut self.memory.coverage, &mut self.program) {
            self.run.next_round(coverage, &mut program.path);
        }
        let (Some(program), true) = (&self.program, self.run.phase.is_active()) else {
            return self.stand(input);
        };
        ramp_gains(&mut self.config, &self.targets, input.dt_s);
        let (setting, in_use) = (&program.config.force, &mut self.config.force);
        (in_use.loop_delay_s, in_use.loop_delay_sd_s) = self
            .loop_delay
            .in_use_s(&self.delay, (setting.loop_delay_s, setting.loop_delay_sd_s));
        let reference_n = self.reference_n(program);
        let speed_target = self.targets[Parameter::Speed as usize];
        self.run
            .compare_with_arm(&self.limits, &self.flange_from_tool, &placed);
        let percept = self.run.perceive(
            program,
            &self.config,
            &self.limits,
            &placed,
            &self.moving_base,
            reference_n,
        );
        if let Some(target) = self.poses.target(&self.run) {
            self.run.travel.look(&input.q, target);
        }
        self.run.decide(
            program,
            &self.config,
            &self.limits,
            &self.requests,
            reference_n,
            &placed,
            &percept,
        );
        let planning = self
            .memory
            .coverage
            .as_ref()
            .is_some_and(|c| c.is_planning());
        if self.run.awaits_route() && !planning {
            let chart = self.memory.chart.as_deref();
            self.run.set_route(program, &self.config, chart, &percept);
        }
        if !self.run.phase.is_active() {
            return self.stand(input);
        }
        if let Some(target) = self.poses.target(&self.run) {
            let target = *target;
            return self.travel(input, &percept, &target);
        }
        if let Some(chart) = &mut self.memory.chart {
            self.run.record_surface(program, chart, &percept);
        }
        if let Some(coverage) = &mut self.memory.coverage {
            self.run
                .record_dose(program, coverage, &percept, input.dt_s);
        }
        let speed_factor = speed_target / self.speed_m_per_s * input.speed_scaling.clamp(0.0, 1.0);
        let sensing_s = input.wrench_delay_s + input.wrench_age_s.clamp(0.0, input.dt_s);
        let measured_s = self
            .loop_delay
            .measured_s(&self.delay)
            .map(|(mean, _)| mean);
        let delay_s = measured_s.unwrap_or(self.config.force.loop_delay_s);
        let learning = self.memory.learner.as_deref_mut().map(|learner| Learning {
            learner,
            lead_s: (delay_s - sensing_s).max(0.0),
        });
        let wanted = wanted_twist(
            &mut self.run,
            program,
            &self.config,
            &self.limits,
            &placed,
            &percept,
            reference_n,
            speed_factor,
            learning,
        );
        // The sensor is tared with the arm at rest; all other phases are relative to the floor.
        let wanted = if self.run.phase == Phase::Tare {
            wanted
        } else {
            self.moving_base.against_base(&input.base_from_tool, wanted)
        };
        let twist = if self.run.gives_way {
            self.limiter.brake(&self.limits, wanted, input.dt_s)
        } else {
            self.limiter.step(&self.limits, wanted, input.dt_s)
        };
        if let Some(learner) = &mut self.memory.learner {
            learner.commanded(&twist.linear, input.dt_s);
        }
        let (qd, manipulability) = self.joints.step(
            &self.arm,
            &self.flange_from_tool,
            &self.limits,
            &input.q,
            &twist,
            self.run
                .phase
                .is_pressing()
                .then_some(&self.run.surface.normal),
            input.dt_s,
        );
        let moves_freely = matches!(
            self.run.phase,
            Phase::Tare
                | Phase::Clear
                | Phase::Approach
                | Phase::Seek
                | Phase::Lift
                | Phase::Retract
        );
        self.loop_delay.step(
            &mut self.delay,
            &DelaySample {
                q: input.q,
                commanded: qd,
                sensing_s,
                free: moves_freely && input.speed_scaling > UNSCALED,
                dt_s: input.dt_s,
            },
        );
        if self.moving_base.moves() {
            let jacobian = self.arm.jacobian_at(&input.q, &self.flange_from_tool);
            let made = Twist::from_vector(&(jacobian * qd));
            self.moving_base.follow(&twist, &made, input.dt_s);
        }
        let run = &self.run;
        ControlOutput {
            kind: CommandKind::JointVelocity,
            qd,
            acceleration: self.limits.joint_acceleration_max_rad_per_s2,
            twist_commanded: twist,
            manipulability,
            alignment_error_rad: alignment_error(&percept.z_tool, &run.surface.normal),
            path_error_m: run.tracking.error_m(&percept.position, &run.surface.normal),
            force_n: percept.force_n,
            wrench: percept.wrench.map(|_| input.wrench),
            ..self.report(input)
        }
    }

    /// Moves the arm in joint space.
    fn travel(
        &mut self,
        input: &ControlInput<N>,
        percept: &Percept,
        target: &Joints<N>,
    ) -> ControlOutput<N> {
        self.limiter.reset();
        self.delay.interrupt();
        let jacobian = self.arm.jacobian_at(&input.q, &self.flange_from_tool);
        let spec = self.program.as_ref().and_then(|p| self.run.pose(&p.task));
        let limits = spec.map(|spec| JointWay::limits(spec, &self.arm, &self.limits));
        let goes = !self.run.paused && percept.wrench.is_some();
        let qd = limits.map_or_else(Joints::<N>::zeros, |limits| {
            let target = goes.then_some(target);
            joint_move::step(
                &limits,
                self.joints.last(),
                &input.q,
                target,
                &jacobian,
                input.dt_s,
            )
        });
        self.joints.follow(&qd);
        ControlOutput {
            kind: CommandKind::JointVelocity,
            qd,
            acceleration: self.limits.joint_acceleration_max_rad_per_s2,
            twist_commanded: Twist::from_vector(&(jacobian * qd)),
            manipulability: manipulability(&jacobian),
            force_n: percept.force_n,
            wrench: percept.wrench.map(|_| input.wrench),
            ..self.report(input)
        }
    }

    /// Pressing force asked for at this place of the path, N. A stroke's own force is scaled as the
    /// live parameter scales the task's.
    fn reference_n(&self, program: &Program) -> f64 {
        let target_n = self.targets[Parameter::ForceReference as usize];
        match program.path.force_n(self.run.tracking.clock_s()) {
            Some(force_n) => force_n * target_n / program.task.force.reference_n,
            None => target_n,
        }
    }

    /// No task moves the arm: any remaining motion slows down, then no motion is commanded.
    fn stand(&mut self, input: &ControlInput<N>) -> ControlOutput<N> {
        self.limiter.reset();
        self.delay.interrupt();
        let dt = if input.dt_s.is_finite() {
            input.dt_s.clamp(0.0, 0.02)
        } else {
            0.0
        };
        let (qd, stands) = self.joints.slow_down(&self.limits, dt);
        ControlOutput {
            kind: if stands || !input.arm_ready {
                CommandKind::Hold
            } else {
                CommandKind::JointVelocity
            },
            qd,
            acceleration: self.limits.joint_acceleration_max_rad_per_s2,
            ..self.report(input)
        }
    }

    /// Outputs that are reported in every phase.
    fn report(&self, input: &ControlInput<N>) -> ControlOutput<N> {
        let run = &self.run;
        let active = run.phase.is_active();
        let estimate_age = input.estimates[run.choice.index].map(|e| e.age_s);
        let hold = ControlOutput {
            clearance: run.clearance,
            ..ControlOutput::hold(input)
        };
        let Some(program) = &self.program else {
            return hold;
        };
        ControlOutput {
            phase: run.phase,
            activation: self.activation,
            estimator: run.choice.index,
            estimator_cause: run.choice.cause,
            estimator_switches: run.choice.switches,
            normal: if active {
                self.moving_base.direction(&run.surface.normal)
            } else {
                hold.normal
            },
            force_reference_n: if run.phase.is_pressing() {
                self.reference_n(program)
            } else {
                0.0
            },
            path_reference: if active {
                self.moving_base.point(&run.tracking.reference)
            } else {
                hold.path_reference
            },
            path_progress: {
                let progress = run.tracking.progress(&program.path);
                (self.memory.coverage.as_ref()).map_or(progress, |c| c.progress(progress))
            },
            estimate_age_s: estimate_age.unwrap_or(-1.0),
            contact_lost_count: run.lost_count,
            in_contact: active && run.in_contact,
            tare_requested: run.phase == Phase::Tare,
            stiffness_n_per_m: run.force.stiffness_n_per_m(),
            damping_n_s_per_m: run.force.damping_n_s_per_m(),
            force_tank_j: run.force.tank_j(),
            fault: run.fault,
            zero_withdrawn: run.zero_withdrawn,
            ..hold
        }
    }
}

fn is_sane<const N: usize>(input: &ControlInput<N>) -> bool {
    is_time(input.time_s, input.dt_s)
        && input.speed_scaling.is_finite()
        && is_arm_state(&input.q, &input.qd)
        && is_place(&input.base_from_tool)
        && is_velocity(&input.twist)
        && input
            .base
            .is_none_or(|base| is_place(&base.world_from_base) && is_velocity(&base.twist))
}
