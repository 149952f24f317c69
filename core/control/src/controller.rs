//! The controller: phases, laws and guards composed into one step per robot cycle.

use nalgebra::Vector3;
use tangent_mechanics::{Aligned, Arm, Base, Flange, Pose, Tool, Twist};

use crate::alignment::{alignment_error, alignment_rate};
use crate::force_law::ForceSample;
use crate::interface::{is_arm_state, is_place, is_time, is_velocity};
use crate::joint_velocity::JointVelocity;
use crate::limits::clamp_norm;
use crate::moving_base::MovingBase;
use crate::percept::{Percept, Requests};
use crate::run::Run;
use crate::switching::ChoiceRules;
use crate::touchdown::{approach_speed, seek_speed};
use crate::{
    Clearance, CommandKind, ControlError, ControlInput, ControlOutput, ControllerConfig,
    EstimateInput, EstimatorName, EstimatorNames, Fault, Limits, MAX_ESTIMATORS, Parameter, Phase,
    Program, SwitchRefusal, Task, TwistLimiter,
};

/// One arm's controller. `start` a program, then `step` once per robot packet.
pub struct Controller {
    arm: Arm<6>,
    flange_from_tool: Pose<Flange, Tool>,
    limits: Limits,
    config: ControllerConfig,
    program: Option<Program>,
    names: EstimatorNames,
    activation: u64,
    requests: Requests,
    run: Run,
    moving_base: MovingBase,
    limiter: TwistLimiter,
    joints: JointVelocity,
    estimates: [Option<EstimateInput>; MAX_ESTIMATORS],
    /// Targets of the live parameters, in the order of [`Parameter::ALL`]; `config` follows them on
    /// a ramp.
    targets: [f64; 4],
    speed_m_per_s: f64,
}

/// Time in which a changed gain comes into force, s.
const GAIN_RAMP_S: f64 = 0.3;

impl Controller {
    /// Stands idle until a program is started. `config` is for tasks that name no preset.
    pub fn new(
        arm: Arm<6>,
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
            names: EstimatorNames::new(),
            activation: 0,
            requests: Requests::default(),
            run: Run::idle(),
            moving_base: MovingBase::default(),
            limiter: TwistLimiter::default(),
            joints: JointVelocity::default(),
            estimates: [None; MAX_ESTIMATORS],
            targets: [0.0; 4],
            speed_m_per_s: 0.0,
        })
    }

    /// Makes a program of a task and starts it. Allocates: for the closed loop and tests, not for
    /// the robot's cycle.
    pub fn start_task(&mut self, task: &Task) -> Result<(), ControlError> {
        let program = Program::new(task, &self.config)?;
        self.start(program, 0).map(drop)
    }

    /// Starts a program from idle, done or fault; gives back the one before, to be dropped outside
    /// the loop. `latched` is the activation that the bridge has latched out: the new one is
    /// greater.
    pub fn start(
        &mut self,
        program: Program,
        latched: u64,
    ) -> Result<Option<Program>, ControlError> {
        if self.run.phase.is_active() {
            return Err(self.wrong_phase("start a task", "stop the running task first"));
        }
        if self.run.clearance == Clearance::Unknown {
            return Err(ControlError::MayTouch { moved_m: None });
        }
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
        Ok(self.program.replace(program))
    }

    /// Whether a task may start with the tool at `position` (base axes, m).
    ///
    /// # Errors
    /// [`ControlError::MayTouch`] where the tool may touch something and which way is away is not
    /// known.
    pub fn check_start(&self, position: &Vector3<f64>) -> Result<(), ControlError> {
        let leave = &self.config.leave;
        self.run.clearance.way_out(leave, position).map(drop)
    }

    /// Whether the tool may touch something: what the next start goes by.
    pub fn clearance(&self) -> Clearance {
        self.run.clearance
    }

    /// What a controller before this one knew, or what a person says who has looked.
    ///
    /// # Errors
    /// While a task runs.
    pub fn set_clearance(&mut self, clearance: Clearance) -> Result<(), ControlError> {
        if self.run.phase.is_active() {
            return Err(self.wrong_phase("say that the tool hangs free", "stop the task first"));
        }
        self.run.clearance = clearance;
        Ok(())
    }

    /// Stands still in every phase: the path stops where it is, what presses keeps its force, and
    /// no time limit runs.
    ///
    /// # Errors
    /// When no task runs, or it is leaving the surface.
    pub fn pause(&mut self) -> Result<(), ControlError> {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return Err(self.wrong_phase("pause", "there is no path to stop"));
        }
        self.requests.paused = true;
        Ok(())
    }

    /// Goes on after [`Controller::pause`].
    pub fn resume(&mut self) -> Result<(), ControlError> {
        if !self.run.phase.is_active() || self.run.phase == Phase::Retract {
            return Err(self.wrong_phase("resume", "start the task again"));
        }
        self.requests.paused = false;
        Ok(())
    }

    /// A task is paused.
    pub fn is_paused(&self) -> bool {
        self.requests.paused && self.run.phase.is_active() && self.run.phase != Phase::Retract
    }

    /// Ends the task: retracts, then done. Nothing to do when none runs.
    pub fn stop(&mut self) {
        self.requests.stopping = true;
    }

    /// Ends the task with a retraction along `away` (base axes) in place of the last good normal:
    /// for tests of what a wrong one does.
    #[doc(hidden)]
    pub fn stop_along(&mut self, away: Vector3<f64>) {
        self.run.way_off = Some(away);
        self.stop();
    }

    /// The task has ended, and the tool may still be where it touched: after a fault that let
    /// nothing move.
    pub fn is_left_on_surface(&self) -> bool {
        self.run.is_left_on_surface()
    }

    /// Retracts a tool that [is left on the surface](Self::is_left_on_surface) along the last good
    /// normal, over the way of the task's end. `latched` as in [`Controller::start`]: this is a
    /// motion of its own, with an activation of its own.
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

    /// Adds an estimator to [`Controller::estimators`] without using it; its place in the list,
    /// none when it is full.
    pub fn listen_to(&mut self, name: EstimatorName) -> Option<usize> {
        if let Some(index) = self.names.iter().position(|n| *n == name) {
            return Some(index);
        }
        self.names.try_push(name).ok()?;
        Some(self.names.len() - 1)
    }

    /// Switches to another estimator of [`Controller::estimators`], if it is fresh, valid and near
    /// the normal in use; `force` waives the last two. The normal then turns at a bounded rate.
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

    /// Sets a live parameter, clamped to its range; it comes into force over a ramp. A task's start
    /// sets all of them to the task's and the preset's.
    pub fn set(&mut self, parameter: Parameter, value: f64) {
        let (lower, upper) = parameter.range();
        if value.is_finite() {
            self.targets[parameter as usize] = value.clamp(lower, upper);
        }
    }

    /// Value that a live parameter is on its way to.
    pub fn get(&self, parameter: Parameter) -> f64 {
        self.targets[parameter as usize]
    }

    /// Estimators that `ControlInput::estimates` stands for, in this order.
    pub fn estimators(&self) -> &EstimatorNames {
        &self.names
    }

    /// The phase after the last step.
    pub fn phase(&self) -> Phase {
        self.run.phase
    }

    /// Counts task starts.
    pub fn activation(&self) -> u64 {
        self.activation
    }

    /// Limits in force.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// Parameters of the law in force.
    pub fn config(&self) -> &ControllerConfig {
        &self.config
    }

    /// The running or last task.
    pub fn task(&self) -> Option<&Task> {
        self.program.as_ref().map(|program| &program.task)
    }

    /// One robot cycle. Allocates nothing.
    pub fn step(&mut self, input: &ControlInput) -> ControlOutput {
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
        let (Some(program), true) = (&self.program, self.run.phase.is_active()) else {
            return self.stand(input);
        };
        ramp_gains(&mut self.config, &self.targets, input.dt_s);
        let reference_n = self.targets[Parameter::ForceReference as usize];
        let speed_target = self.targets[Parameter::Speed as usize];
        let percept = self.run.perceive(
            program,
            &self.config,
            &self.limits,
            &placed,
            &self.moving_base,
            reference_n,
        );
        self.run.decide(
            program,
            &self.config,
            &self.limits,
            &self.requests,
            reference_n,
            &placed,
            &percept,
        );
        if !self.run.phase.is_active() {
            return self.stand(input);
        }
        let speed_factor = speed_target / self.speed_m_per_s * input.speed_scaling.clamp(0.0, 1.0);
        let wanted = wanted_twist(
            &mut self.run,
            program,
            &self.config,
            &self.limits,
            &placed,
            &percept,
            reference_n,
            speed_factor,
        );
        // The sensor is tared at rest; everything else is done relative to the floor.
        let wanted = if self.run.phase == Phase::Tare {
            wanted
        } else {
            self.moving_base.against_base(&input.base_from_tool, wanted)
        };
        let twist = self.limiter.step(&self.limits, wanted, input.dt_s);
        let (qd, manipulability) = self.joints.step(
            &self.arm,
            &self.flange_from_tool,
            &self.limits,
            &input.q,
            &twist,
            input.dt_s,
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

    /// No task moves the arm: whatever still moves slows down, then nothing is asked.
    fn stand(&mut self, input: &ControlInput) -> ControlOutput {
        self.limiter.reset();
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

    /// What is to be said in any phase.
    fn report(&self, input: &ControlInput) -> ControlOutput {
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
                self.targets[Parameter::ForceReference as usize]
            } else {
                0.0
            },
            path_reference: if active {
                self.moving_base.point(&run.tracking.reference)
            } else {
                hold.path_reference
            },
            path_progress: run.tracking.progress(&program.path),
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

/// The tool's velocity that the phase asks for, base axes: motion in the tangent plane, force along
/// the normal, the tool turned square.
#[allow(clippy::too_many_arguments)] // One cycle's whole state; a struct for it would only be built and taken apart.
fn wanted_twist(
    run: &mut Run,
    program: &Program,
    config: &ControllerConfig,
    limits: &Limits,
    input: &ControlInput,
    percept: &Percept,
    reference_n: f64,
    speed_factor: f64,
) -> Twist<Aligned<Tool, Base>> {
    let normal = run.surface.normal;
    let still = Vector3::zeros();
    match run.phase {
        // Nowhere to go while the task is paused, or the motion of the base is not known.
        Phase::Approach | Phase::Seek if percept.base.is_some() || run.paused => {
            run.tracking.freeze();
            Twist::zero()
        }
        Phase::Approach => Twist::new(run.approach * approach_speed(program, config), still),
        Phase::Seek => {
            run.tracking.freeze();
            let speed = seek_speed(config, reference_n, run.force.stiffness_n_per_m());
            Twist::new(normal * -speed, still)
        }
        Phase::Retract => {
            let speed = run.retract_speed(program, config, percept);
            Twist::new(run.retract * speed, still)
        }
        // A tool that does not feel what it meets stands.
        Phase::Clear if percept.wrench.is_none() || run.paused => Twist::zero(),
        Phase::Clear => Twist::new(run.retract * config.leave.speed_m_per_s, still),
        Phase::Hold if run.stands_without_wrench() => {
            run.tracking.freeze();
            run.force.rest();
            Twist::zero()
        }
        Phase::Contact | Phase::Slide | Phase::Hold => {
            let factor = if run.phase == Phase::Slide {
                speed_factor
            } else {
                0.0
            };
            let along = run.tracking.step(
                &config.path,
                &program.path,
                factor,
                &percept.position,
                &normal,
                input.dt_s,
            );
            let (speed, turn) = if let Some(wrench) = percept.wrench {
                run.force.step(
                    config,
                    limits,
                    reference_n,
                    &ForceSample {
                        wrench,
                        base_from_tool: input.base_from_tool,
                        normal,
                        along,
                        wrench_delay_s: input.wrench_delay_s,
                        settling: run.phase == Phase::Contact,
                        dt_s: input.dt_s,
                    },
                )
            } else {
                run.force.rest();
                (0.0, still)
            };
            let align = clamp_norm(
                alignment_rate(config.alignment.gain_per_s, &percept.z_tool, &normal),
                config.alignment.turn_rate_max_rad_per_s,
            );
            let ahead = if config.alignment.feed_forward && run.phase == Phase::Slide {
                run.surface.turn_rate
            } else {
                still
            };
            Twist::new(along + normal * speed, align + ahead + turn)
        }
        Phase::Idle | Phase::Done | Phase::Fault | Phase::Tare => Twist::zero(),
    }
}

/// Gains move towards their targets over `GAIN_RAMP_S`; force and speed have ramps of their own.
fn ramp_gains(config: &mut ControllerConfig, targets: &[f64; 4], dt_s: f64) {
    let share = (dt_s / GAIN_RAMP_S).min(1.0);
    let gain = &mut config.alignment.gain_per_s;
    *gain += (targets[Parameter::AlignmentGain as usize] - *gain) * share;
    let damping = &mut config.force.damping_n_s_per_m;
    *damping += (targets[Parameter::Damping as usize] - *damping) * share;
    config.force.damping_max_n_s_per_m = config.force.damping_max_n_s_per_m.max(*damping);
}

fn is_sane(input: &ControlInput) -> bool {
    is_time(input.time_s, input.dt_s)
        && input.speed_scaling.is_finite()
        && is_arm_state(&input.q, &input.qd)
        && is_place(&input.base_from_tool)
        && is_velocity(&input.twist)
        && input
            .base
            .is_none_or(|base| is_place(&base.world_from_base) && is_velocity(&base.twist))
}
