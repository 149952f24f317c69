//! One run of a program: the memory that starts fresh with every task, and the phase machine's
//! decisions.
//!
//! Called by the controller each cycle: `perceive` first, then `decide`; `controller` turns the
//! outcome into motion.

use nalgebra::Vector3;
use tangent_sensing::Validity;

use crate::answer::DepthRule;
use crate::clearance::{LeaveWatch, Leaving};
use crate::estimator_choice::{EstimateStatus, EstimatorChoice};
use crate::force_law::ForceLaw;
use crate::interface::is_wrench;
use crate::moving_base::MovingBase;
use crate::percept::{Percept, Requests};
use crate::response_guard::{Doing, ResponseGuard, Touch};
use crate::surface::Surface;
use crate::switching::ChoiceRules;
use crate::touchdown::{approach_speed, seek_speed, stiffness_expected};
use crate::tracking::Tracking;
use crate::urgent::urgent_fault;
use crate::wrench_guard::{WrenchGuard, WrenchVerdict};
use crate::{
    Clearance, ControlInput, ControllerConfig, Fault, Limits, Phase, Program, ZeroAtLimit,
};

/// Why the tool stands on the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum HoldReason {
    Paused,
    PathEnd,
    NoEstimate,
    /// How the base moves is not known.
    NoBase,
    /// Not even force is controlled: nothing moves. Back to the phase it came from when the wrench
    /// is good again.
    NoWrench(Phase),
}

/// Slope that the normal in use may be off by: 20 degrees, for touch alone finds it while it
/// slides.
const SLOPE: f64 = 0.36;

/// One run of a program.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Run {
    pub phase: Phase,
    pub hold: HoldReason,
    pub fault: Option<Fault>,
    pub choice: EstimatorChoice,
    pub surface: Surface,
    pub tracking: Tracking,
    pub force: ForceLaw,
    pub in_contact: bool,
    pub lost_count: u32,
    pub approach: Vector3<f64>,
    /// The way off that stands in for the last good normal.
    pub way_off: Option<Vector3<f64>>,
    pub retract: Vector3<f64>,
    guard: WrenchGuard,
    response: ResponseGuard,
    begun: bool,
    touched: bool,
    estimated: bool,
    in_phase_s: f64,
    elapsed_s: f64,
    settled_s: f64,
    low_cycles: u32,
    /// How long there has been no normal to use while pressing; a wrench that comes and goes does
    /// not start it anew.
    blind_s: f64,
    /// How long the motion of the base has not been known.
    adrift_s: f64,
    /// Reason, time and place of start of the phase that a silent wrench interrupted.
    interrupted: (HoldReason, f64, Vector3<f64>),
    pub phase_start: Vector3<f64>,
    /// A person paused the task: nothing moves but what keeps the force.
    pub paused: bool,
    /// Part of `in_phase_s` that was spent paused.
    paused_s: f64,
    /// A retraction has gone its way since the last touch.
    pub off: bool,
    /// The phase begins where the next cycle finds the tool.
    starts_here: bool,
    /// Whether the tool may touch something, base axes: outlasts the run.
    pub clearance: Clearance,
    pub leave: LeaveWatch,
    pub left: Leaving,
    /// Where the tool stood when the zero in force was taken; none once the surface was felt after
    /// it.
    tared_at: Option<Vector3<f64>>,
    /// The tool has lifted off for a new zero in this run.
    pub renewed: bool,
    /// The zero turned out to be taken in contact.
    pub zero_withdrawn: bool,
}

impl Run {
    /// Nothing happens until the first `perceive` of an active phase.
    pub fn idle() -> Self {
        Self {
            phase: Phase::Idle,
            hold: HoldReason::Paused,
            fault: None,
            choice: EstimatorChoice::default(),
            surface: Surface::new(Vector3::z()),
            tracking: Tracking::new(Vector3::z(), Vector3::x(), Vector3::zeros()),
            force: ForceLaw::new(1e4),
            in_contact: false,
            lost_count: 0,
            approach: -Vector3::z(),
            way_off: None,
            retract: Vector3::z(),
            guard: WrenchGuard::default(),
            response: ResponseGuard::default(),
            begun: false,
            touched: false,
            estimated: false,
            in_phase_s: 0.0,
            elapsed_s: 0.0,
            settled_s: 0.0,
            low_cycles: 0,
            blind_s: 0.0,
            adrift_s: 0.0,
            interrupted: (HoldReason::Paused, 0.0, Vector3::zeros()),
            phase_start: Vector3::zeros(),
            paused: false,
            paused_s: 0.0,
            off: false,
            starts_here: false,
            clearance: Clearance::Assumed,
            leave: LeaveWatch::default(),
            left: Leaving::Going,
            tared_at: None,
            renewed: false,
            zero_withdrawn: false,
        }
    }

    /// Ready for the first cycle of `program`. In doubt whether the tool hangs free, it moves off
    /// first.
    pub fn start(program: &Program, clearance: Clearance) -> Self {
        Self {
            phase: if !clearance.is_free() {
                Phase::Clear
            } else {
                program.first_phase()
            },
            clearance,
            ..Self::idle()
        }
    }

    /// Takes the cycle's measurements: what touches, where the surface faces, whether the wrench
    /// can be believed. `input` is as placed by `moving_base`.
    pub fn perceive(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        input: &ControlInput,
        moving_base: &MovingBase,
        reference_n: f64,
    ) -> Percept {
        let pose = &input.base_from_tool;
        let (position, z_tool) = (pose.translation(), pose.z_axis());
        if !self.begun {
            self.begin(program, config, input);
        }
        if std::mem::take(&mut self.starts_here) {
            self.phase_start = position;
        }
        let validity = self.answering(input, reference_n, limits.blind_distance_max_m);
        let verdict = if self.phase == Phase::Tare {
            WrenchVerdict::Good
        } else {
            self.guard.step(
                &config.patience,
                validity,
                is_wrench(&input.wrench),
                input.wrench_age_s,
                input.dt_s,
            )
        };
        let good = verdict == WrenchVerdict::Good && is_wrench(&input.wrench);
        let wrench = good.then(|| pose.align_wrench(&input.wrench));
        let on_surface = self.phase.is_pressing() || self.phase == Phase::Seek;
        let mut estimate = EstimateStatus::Waiting;
        if on_surface {
            let slid = if self.phase == Phase::Seek {
                Vector3::zeros()
            } else {
                input.twist.linear
            };
            let way = crate::alignment::tangential(&slid, &self.surface.normal).norm() * input.dt_s;
            estimate = self.choice.step(
                &ChoiceRules::new(&config.normal, &config.patience, &program.task.switching),
                &input.estimates,
                &self.surface.normal,
                way,
                input.dt_s,
            );
            let usable = match &estimate {
                EstimateStatus::Usable(estimate) if self.phase != Phase::Seek => Some(estimate),
                _ => None,
            };
            self.estimated |= usable.is_some();
            if self.estimated {
                self.surface.step(&config.normal, usable, &slid, input.dt_s);
            } else {
                // Until somebody knows better, the surface faces the tool (Tugal et al., IV.B.d):
                // the torques alone lay the tool flat.
                self.surface = Surface::new(-z_tool);
            }
        } else if !self.touched {
            self.surface = Surface::new(-z_tool);
        }
        let against = if self.touched {
            self.surface.normal
        } else {
            -self.approach
        };
        let force_n = wrench.map(|wrench| wrench.force.dot(&against));
        if matches!(self.phase, Phase::Tare | Phase::Clear) {
            // An unloaded sensor may read anything before its bias is taken.
            self.in_contact = false;
        } else if let Some(force_n) = force_n {
            self.feel(config, force_n, reference_n);
        }
        Percept {
            position,
            position_in_base: moving_base.point(&position),
            base: input.base.and_then(|base| base.trouble),
            out_of_reach: moving_base.out_of_reach(),
            z_tool,
            wrench,
            verdict,
            untared: input.untared.filter(|_| good),
            force_n,
            estimate,
        }
    }

    /// What the wrench says of itself, or what its answer to the tool's motion says of it.
    fn answering(&mut self, input: &ControlInput, reference_n: f64, blind_max_m: f64) -> Validity {
        if !input.wrench_validity.is_valid() {
            return input.wrench_validity;
        }
        let pose = &input.base_from_tool;
        let normal = if self.touched {
            self.surface.normal
        } else {
            -self.approach
        };
        self.response.step(&Touch {
            doing: Doing::of(self.phase),
            position: pose.translation(),
            normal,
            wrench: input.wrench.vector(),
            force_n: pose.rotate(&input.wrench.force).dot(&normal),
            reference_n,
            stiffness_n_per_m: self.force.stiffness_measured_n_per_m(),
            rests: input.base.is_none(),
            fresh: input.wrench_age_s <= input.dt_s,
            depth: Some(DepthRule {
                settling: self.phase == Phase::Contact,
                slope: SLOPE,
                blind_max_m,
            }),
            dt_s: input.dt_s,
        })
    }

    fn begin(&mut self, program: &Program, config: &ControllerConfig, input: &ControlInput) {
        let pose = &input.base_from_tool;
        let task = &program.task;
        self.begun = true;
        self.approach = task.approach.direction.in_base(pose);
        self.retract = match self.clearance {
            Clearance::Possible { normal, .. } => normal,
            Clearance::Assumed | Clearance::Free | Clearance::Unknown => -self.approach,
        };
        self.tracking = Tracking::new(
            -self.approach,
            task.plane.x_axis.in_base(pose),
            pose.translation(),
        );
        self.surface = Surface::new(-pose.z_axis());
        self.force = ForceLaw::new(stiffness_expected(program, config));
        self.phase_start = pose.translation();
    }

    /// Contact by force, with hysteresis and a count against noise.
    fn feel(&mut self, config: &ControllerConfig, force_n: f64, reference_n: f64) {
        let contact = &config.contact;
        let touch = (contact.touch_share * reference_n).max(contact.noise_n);
        let lost = (contact.lost_share * reference_n)
            .max(0.5 * contact.noise_n)
            .min(0.7 * touch);
        if force_n >= touch {
            self.in_contact = true;
        }
        if force_n < lost {
            self.low_cycles = self.low_cycles.saturating_add(1);
            if self.low_cycles >= contact.lost_cycles {
                self.in_contact = false;
            }
        } else {
            self.low_cycles = 0;
        }
    }

    /// Moves the phase machine on.
    #[expect(
        clippy::too_many_arguments,
        reason = "one cycle's whole view, each part with its own owner"
    )]
    pub fn decide(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        requests: &Requests,
        reference_n: f64,
        input: &ControlInput,
        percept: &Percept,
    ) {
        let dt = input.dt_s;
        self.in_phase_s += dt;
        self.paused = requests.paused;
        if self.paused {
            self.paused_s += dt;
        } else {
            self.elapsed_s += dt;
        }
        // No time limit runs while the task is paused.
        let waited_s = self.in_phase_s - self.paused_s;
        let blind = matches!(percept.estimate, EstimateStatus::None(_));
        self.blind_s = if blind && self.phase.is_pressing() {
            self.blind_s + dt
        } else {
            0.0
        };
        self.adrift_s = percept.base.map_or(0.0, |_| self.adrift_s + dt);
        let task = &program.task;
        self.remember(input, percept);
        if self.phase == Phase::Clear {
            return self.decide_clear(program, config, limits, requests, percept, input.dt_s);
        }
        if self.phase != Phase::Retract {
            if requests.stopping {
                return self.leave(percept, None);
            }
            if self.phase != Phase::Tare
                && let Some(fault) =
                    urgent_fault(limits, percept).or_else(|| self.zero_fault(program, input))
            {
                return self.leave(percept, Some(fault));
            }
            if self.is_zero_old(program, input) {
                let stops = task.zero.at_limit == ZeroAtLimit::Stop || input.base.is_some();
                if stops || self.is_new_zero_no_help() {
                    return self.leave(percept, Some(Fault::ZeroOld));
                }
                return self.lift_off(percept);
            }
            if let Some(trouble) = percept.base
                && self.phase != Phase::Tare
                && self.adrift_s > config.patience.base_retract_s
            {
                return self.leave(percept, Some(Fault::Base(trouble)));
            }
            if task.timeouts.task_s > 0.0 && self.elapsed_s > task.timeouts.task_s {
                return self.leave(percept, Some(Fault::TaskTimeout));
            }
            if matches!(percept.verdict, WrenchVerdict::Stop(_)) {
                if !self.stands_without_wrench() {
                    let from = self.phase;
                    self.interrupted = (self.hold, self.in_phase_s, self.phase_start);
                    self.enter(Phase::Hold, percept);
                    self.hold = HoldReason::NoWrench(from);
                }
                return;
            }
            if !self.in_contact && self.phase.is_pressing() && !self.stands_without_wrench() {
                self.lost_count += 1;
                if self.lost_count > config.contact.lost_count_max {
                    return self.leave(percept, Some(Fault::ContactUnstable));
                }
                self.tracking.freeze();
                return self.enter(Phase::Seek, percept);
            }
        }
        match self.phase {
            Phase::Tare => {
                // A tare younger than this phase is the one that was asked for.
                if input.bias_age_s.is_some_and(|age| age < self.in_phase_s)
                    && input.wrench_validity == Validity::Valid
                {
                    // An untared sensor's zero can look like a touch; only what is felt from here
                    // on is one.
                    self.in_contact = false;
                    self.low_cycles = 0;
                    self.tared_at = Some(percept.position);
                    // A task that lifted off for its zero goes back to where it was.
                    let back = if self.touched {
                        Phase::Seek
                    } else {
                        Phase::Approach
                    };
                    if !self.paused {
                        self.enter(back, percept);
                    }
                } else if waited_s > task.timeouts.tare_s {
                    self.leave(percept, Some(Fault::NoTare));
                }
            }
            Phase::Approach => {
                let way = (percept.position - self.phase_start).dot(&self.approach);
                let patience =
                    5.0 + 3.0 * task.approach.distance_max_m / approach_speed(program, config);
                if self.in_contact {
                    self.touch(config, percept, approach_speed(program, config));
                } else if way > task.approach.distance_max_m || waited_s > patience {
                    self.leave(percept, Some(Fault::NoSurface));
                }
            }
            Phase::Contact => {
                let near = config.contact.settled_share * reference_n;
                let arrived = (self.force.reference_n() - reference_n).abs() < 1e-9;
                let is_near = |force_n: f64| (force_n - reference_n).abs() < near;
                if arrived && percept.force_n.is_some_and(is_near) {
                    self.settled_s += dt;
                } else {
                    self.settled_s = 0.0;
                }
                if self.settled_s > config.contact.settled_s {
                    if !self.paused {
                        self.enter(Phase::Slide, percept);
                    }
                } else if waited_s > task.timeouts.contact_s {
                    self.leave(percept, Some(Fault::ForceNotReached));
                }
            }
            Phase::Slide => {
                let reason = if let EstimateStatus::None(_) = percept.estimate {
                    Some(HoldReason::NoEstimate)
                } else if percept.base.is_some() {
                    Some(HoldReason::NoBase)
                } else if requests.paused {
                    Some(HoldReason::Paused)
                } else if self.tracking.is_finished(&program.path) {
                    Some(HoldReason::PathEnd)
                } else {
                    None
                };
                if let Some(reason) = reason {
                    self.enter(Phase::Hold, percept);
                    self.hold = reason;
                }
            }
            Phase::Hold => self.decide_hold(program, config, requests, percept),
            Phase::Seek => {
                let way = -(percept.position - self.phase_start).dot(&self.surface.normal);
                let stiffness = self.force.stiffness_n_per_m();
                let speed = seek_speed(config, reference_n, stiffness);
                let patience = 1.0 + 3.0 * limits.blind_distance_max_m / speed;
                if self.in_contact {
                    self.touch(config, percept, speed);
                } else if way > limits.blind_distance_max_m || waited_s > patience {
                    self.leave(percept, Some(Fault::SurfaceLost));
                }
            }
            Phase::Retract => self.decide_retract(program, config, limits, input, percept),
            Phase::Clear | Phase::Idle | Phase::Done | Phase::Fault => {}
        }
    }

    fn decide_hold(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        requests: &Requests,
        percept: &Percept,
    ) {
        match self.hold {
            HoldReason::NoWrench(from) => {
                if percept.verdict == WrenchVerdict::Good {
                    // Pressing again starts from rest, wherever it stopped; its time runs on.
                    let start;
                    self.enter(from, percept);
                    (self.hold, self.in_phase_s, start) = self.interrupted;
                    if matches!(from, Phase::Approach | Phase::Seek) {
                        // The way already gone counts on.
                        self.phase_start = start;
                    }
                }
            }
            HoldReason::Paused => {
                if !requests.paused {
                    self.enter(Phase::Slide, percept);
                }
            }
            HoldReason::NoBase => {
                if percept.base.is_none() {
                    self.enter(Phase::Slide, percept);
                }
            }
            HoldReason::PathEnd => {
                if !self.paused && self.in_phase_s - self.paused_s >= program.task.end.hold_s {
                    self.leave(percept, None);
                }
            }
            HoldReason::NoEstimate => match percept.estimate {
                EstimateStatus::None(reason) => {
                    if self.blind_s > config.patience.estimate_retract_s {
                        self.leave(percept, Some(Fault::Estimate(reason)));
                    }
                }
                _ => self.enter(Phase::Slide, percept),
            },
        }
    }

    /// Not even force is controlled now.
    pub fn stands_without_wrench(&self) -> bool {
        self.phase == Phase::Hold && matches!(self.hold, HoldReason::NoWrench(_))
    }

    fn touch(&mut self, config: &ControllerConfig, percept: &Percept, speed_m_per_s: f64) {
        let Some(force_n) = percept.force_n else {
            return;
        };
        let tared_at = self.tared_at.take();
        let near = |at: Vector3<f64>| (percept.position - at).norm() < config.leave.touch_at_once_m;
        if tared_at.is_some_and(near) {
            self.zero_withdrawn = true;
            return self.leave(percept, Some(Fault::ZeroInContact));
        }
        self.force.touch(config, force_n, speed_m_per_s);
        self.off = false;
        if !self.touched {
            self.touched = true;
            self.tracking.begin_at(percept.position);
        }
        self.settled_s = 0.0;
        self.low_cycles = 0;
        self.enter(Phase::Contact, percept);
    }

    /// Off the surface along the last good normal; straight to the end where nothing has moved yet.
    pub(crate) fn leave(&mut self, percept: &Percept, fault: Option<Fault>) {
        self.fault = fault.or(self.fault);
        if matches!(self.phase, Phase::Tare | Phase::Clear) && !self.touched {
            let phase = if self.fault.is_some() {
                Phase::Fault
            } else {
                Phase::Done
            };
            return self.enter(phase, percept);
        }
        self.retract = self.way_off();
        self.enter(Phase::Retract, percept);
    }

    /// Away from the surface: along the last good normal, or back where the approach came from.
    pub(crate) fn way_off(&self) -> Vector3<f64> {
        if let Some(way) = self.way_off {
            way
        } else if self.touched {
            self.surface.normal
        } else {
            -self.approach
        }
    }

    /// The surface was felt in this run.
    pub(crate) fn has_touched(&self) -> bool {
        self.touched
    }

    /// Time in the phase, s, without what was spent paused.
    pub(crate) fn time_in_phase_s(&self) -> f64 {
        self.in_phase_s - self.paused_s
    }

    pub(crate) fn enter(&mut self, phase: Phase, percept: &Percept) {
        self.phase = phase;
        self.in_phase_s = 0.0;
        self.paused_s = 0.0;
        self.phase_start = percept.position;
        self.leave = LeaveWatch::default();
        self.left = Leaving::Going;
        if phase == Phase::Seek {
            self.low_cycles = 0;
        }
    }

    /// The task has ended, and the tool may still be where it touched.
    pub fn is_left_on_surface(&self) -> bool {
        !self.phase.is_active() && self.touched && !self.off && !self.clearance.is_free()
    }

    /// Off a surface that the end of the task left the tool on, along the last good normal, as at
    /// the end of any task.
    pub fn leave_again(&mut self) {
        self.retract = self.surface.normal;
        self.phase = Phase::Retract;
        self.in_phase_s = 0.0;
        self.paused_s = 0.0;
        self.starts_here = true;
        self.leave = LeaveWatch::default();
        self.left = Leaving::Going;
    }

    /// Ends at once, without a motion: the arm cannot be moved.
    pub fn abort(&mut self, fault: Fault) {
        self.phase = Phase::Fault;
        self.fault = Some(fault);
    }
}
