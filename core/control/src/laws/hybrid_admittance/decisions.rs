//! The phase machine of the hybrid admittance: the next phase from the evaluated inputs.

use nalgebra::Vector3;
use tangent_sensing::Validity;

use super::acting_point::ActingPoint;
use super::config::ControllerConfig;
use super::hops::PRESSED_S;
use super::interface::ControlInput;
use super::ledge::Way;
use super::losses::{Felt, Touch};
use super::pace::{Circles, Exploration};
use super::percept::{Percept, Requests};
use super::run::{HoldReason, Run};
use super::side_load::SideLoad;
use super::touchdown::{approach_speed, real_touch_n};
use super::urgent::urgent_fault;
use crate::estimator_choice::EstimateStatus;
use crate::limits::Limits;
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;
use crate::task::ZeroAtLimit;
use crate::task::program::Program;

/// Longest time for which the path waits for an arm that does not follow, s.
const STALLED_MAX_S: f64 = 5.0;
/// Longest time after the end of a contact for which a tool with something in its way brakes
/// harder, s.
const BRAKES_S: f64 = 0.15;
/// Longest time for which the tool explores before it lifts off for the first stroke, s.
const EXPLORED_MAX_S: f64 = 10.0;

impl Run {
    /// Advances the phase machine.
    #[expect(
        clippy::too_many_arguments,
        reason = "one cycle's whole view, each part with its own owner"
    )]
    pub fn decide<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        requests: &Requests,
        reference_n: f64,
        input: &ControlInput<N>,
        percept: &Percept,
    ) {
        let dt = input.dt_s;
        self.in_phase_s += dt;
        let just_left = self.phase.is_pressing() || self.in_phase_s < BRAKES_S;
        self.gives_way &= just_left;
        self.brakes &= just_left;
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
        if self.phase == Phase::Travel {
            return self.decide_travel(program, config, limits, requests, input, percept);
        }
        if self.phase != Phase::Retract {
            if requests.stopping {
                return self.leave(percept, None);
            }
            if self.phase != Phase::Tare
                && let Some(fault) =
                    urgent_fault(limits, percept).or_else(|| self.zero_fault(program, input))
            {
                let fault = self.cause(fault, percept);
                return self.leave(percept, Some(fault));
            }
            if self.zero_doubt.lifts_off() {
                return self.lift_off(percept);
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
            if self.is_unread {
                return self.leave(percept, Some(Fault::ForceUnread));
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
            if self.response.has_fallen_away() || self.goes_round_rim(config, percept) {
                return self.leave(percept, Some(Fault::SurfaceEnds));
            }
            if !self.in_contact && self.phase.is_pressing() && !self.stands_without_wrench() {
                if self.phase == Phase::Contact
                    && self
                        .touch
                        .was_none(&self.felt, real_touch_n(config, reference_n))
                {
                    return self.approach_on(percept);
                }
                self.lost_count += 1;
                if self.lost_count > config.contact.lost_count_max {
                    return self.leave(percept, Some(Fault::ContactUnstable));
                }
                self.tracking.freeze();
                self.seeks_lost = true;
                if self.hops.is_under_way() {
                    // Beside the place of the losses, and no more of them.
                    if self.hops.slips() {
                        return self.hop(percept);
                    }
                    return self.enter(Phase::Seek, percept);
                }
                self.felt.moved = self.phase == Phase::Slide || self.exploration.has_begun();
                let (position, normal) = (&percept.position, &self.surface.normal);
                let here = self.losses.count(position, normal, &self.felt);
                if config.contact.lost_here_max > 0 && here > config.contact.lost_here_max {
                    let fault = if self.losses.is_rim() {
                        Fault::SurfaceEnds
                    } else {
                        Fault::ContactUnstable
                    };
                    return self.leave(percept, Some(fault));
                }
                let aside = self.tracking.aside();
                let (hop_m, slid) = (config.pace.hop_m, self.losses.slid());
                if !self.losses.is_rim() && self.hops.offer(hop_m, slid, &percept.position, &aside)
                {
                    self.losses.felt_around();
                    return self.hop(percept);
                }
                return self.enter(Phase::Seek, percept);
            }
        }
        match self.phase {
            Phase::Tare => {
                // A tare younger than this phase is the requested one.
                if input.bias_age_s.is_some_and(|age| age < self.in_phase_s)
                    && input.wrench_validity == Validity::Valid
                {
                    // An untared sensor's offset can look like a touch; only contact detected from
                    // here on counts.
                    self.in_contact = false;
                    self.low_s = 0.0;
                    self.tared_at = Some(percept.position);
                    self.zero_doubt.disprove();
                    // A task that lifted off for a new zero returns to where it was.
                    self.seeks_lost = false;
                    let back = if self.touched {
                        Phase::Seek
                    } else {
                        Phase::Approach
                    };
                    if !self.paused {
                        self.enter(back, percept);
                    }
                } else if waited_s > task.timeouts.tare_s {
                    let fault = if self.zero_doubt.is_open() {
                        Fault::Wrench(Validity::ZeroJumped)
                    } else {
                        Fault::NoTare
                    };
                    self.leave(percept, Some(fault));
                }
            }
            Phase::Approach => {
                let way = (percept.position - self.phase_start).dot(&self.approach);
                let patience =
                    5.0 + 3.0 * task.approach.distance_max_m / approach_speed(program, config);
                if self.in_contact {
                    self.touch(program, config, percept, approach_speed(program, config));
                } else if way > task.approach.distance_max_m || waited_s > patience {
                    self.leave(percept, Some(Fault::NoSurface));
                }
            }
            Phase::Contact
                if self
                    .touch
                    .denies_zero(&self.felt, real_touch_n(config, reference_n)) =>
            {
                self.zero_withdrawn = true;
                self.leave(percept, Some(Fault::ZeroInContact));
            }
            Phase::Contact => {
                let near = config.contact.settled_share * reference_n;
                let arrived = (self.force.reference_n() - reference_n).abs() < 1e-9;
                let hops = self.hops.is_under_way();
                let real_n = real_touch_n(config, reference_n);
                let settles = percept.force_n.is_some_and(|force_n| {
                    if hops {
                        force_n >= real_n
                    } else {
                        arrived && (force_n - reference_n).abs() < near
                    }
                });
                if settles {
                    self.settled_s += dt;
                } else {
                    self.settled_s = 0.0;
                }
                let settled_s = if hops {
                    PRESSED_S
                } else {
                    config.contact.settled_s
                };
                if self.settled_s > settled_s {
                    if self.paused {
                        // Stands.
                    } else if self.hops.next() {
                        self.hop(percept);
                    } else {
                        self.enter(Phase::Slide, percept);
                    }
                } else if waited_s > task.timeouts.contact_s {
                    self.leave(percept, Some(Fault::ForceNotReached));
                }
            }
            Phase::Slide => {
                self.stalled_s =
                    if self.tracking.waits() || self.tracking.stands() && self.gives_way {
                        self.stalled_s + dt
                    } else {
                        0.0
                    };
                if self.stalled_s > STALLED_MAX_S {
                    return self.leave(percept, Some(Fault::PathBlocked));
                }
                match self.way_on(config.pace.over_m, dt) {
                    Way::On => {}
                    Way::Over if self.is_beside_surface(percept) => {
                        return self.leave(percept, Some(Fault::SurfaceEnds));
                    }
                    Way::Over => return self.step_over(program, config.pace.over_m, percept),
                    Way::Blocked => return self.leave(percept, Some(Fault::PathBlocked)),
                }
                let reason = if let EstimateStatus::None(_) = percept.estimate {
                    Some(HoldReason::NoEstimate)
                } else if percept.base.is_some() {
                    Some(HoldReason::NoBase)
                } else if requests.paused {
                    Some(HoldReason::Paused)
                } else if self.tracking.at_lift(&program.path).is_some() {
                    // The normal is explored where the tool first touched, and not where the next
                    // stroke begins.
                    if !self.exploration.is_open() || waited_s > EXPLORED_MAX_S {
                        self.take_off(percept);
                    }
                    return;
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
                let speed = self.seek_speed(config, reference_n, &percept.position);
                let most_m = if self.seeks_lost {
                    limits
                        .blind_distance_max_m
                        .min(config.contact.seek_distance_max_m)
                } else {
                    limits.blind_distance_max_m
                };
                let patience = 1.0 + 3.0 * most_m / speed;
                let hop_m = self.hops.seek_distance_m();
                if hop_m.is_some_and(|hop_m| way > hop_m) && self.hops.turn_back() {
                    self.hop(percept);
                } else if self.in_contact {
                    self.touch(program, config, percept, speed);
                } else if way > most_m || waited_s > patience {
                    self.leave(percept, Some(Fault::SurfaceLost));
                }
            }
            Phase::Retract => {
                self.decide_retract(program, config, limits, input, percept);
                if task.home.is_some() && !requests.stopping {
                    self.go_home(percept);
                }
            }
            Phase::Lift => self.decide_lift(program, config, limits, reference_n, percept, dt),
            Phase::Clear | Phase::Travel | Phase::Idle | Phase::Done | Phase::Fault => {}
        }
    }

    /// What a sliding tool does about something in the way, with `over_m` as in the parameters.
    fn way_on(&mut self, over_m: f64, dt_s: f64) -> Way {
        if self.paused {
            return Way::On;
        }
        match (self.gives_way, self.exploration.is_open()) {
            (true, _) => {}
            (false, true) => self.losses.explores(&self.surface.normal, dt_s),
            (false, false) => self.losses.slides_on(dt_s),
        }
        if over_m <= 0.0 {
            return Way::On;
        }
        let clock_s = self.tracking.clock_s();
        self.ledge.step(self.gives_way, clock_s, dt_s)
    }

    /// The cause of a fault. A force along the surface, at a rim or beside it, is that of the rim;
    /// and so is a pressing force that does not answer while the tool, beside the surface, is held
    /// aside. A normal that turns without a way follows a force that need not point along the
    /// surface any more.
    fn cause(&self, fault: Fault, percept: &Percept) -> Fault {
        let is_beside = self.is_beside_surface(percept);
        let is_rim = match fault {
            Fault::Wrench(Validity::Misdirected) => {
                is_beside || self.losses.is_rim_at(&percept.position)
            }
            Fault::Wrench(Validity::Unresponsive) => is_beside && self.felt.is_aside(),
            _ => false,
        };
        match fault {
            _ if is_rim => Fault::SurfaceEnds,
            Fault::Wrench(Validity::Misdirected) if self.turn.has_tripped() => Fault::NormalAstray,
            _ => fault,
        }
    }

    /// Whether the normal turns away where contact was lost, or further than the path can follow.
    fn goes_round_rim(&self, config: &ControllerConfig, percept: &Percept) -> bool {
        let (position, normal) = (&percept.position, &self.surface.normal);
        self.phase.is_pressing()
            && config.contact.lost_here_max > 0
            && (self.losses.turns_away(position, normal) || self.tracking.faces_away(normal))
    }

    fn is_beside_surface(&self, percept: &Percept) -> bool {
        let (position, normal) = (&percept.position, &self.surface.normal);
        self.losses.is_beside(position, normal)
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
                    // Pressing starts again from rest wherever the tool stopped; the phase's time
                    // continues.
                    let start;
                    self.enter(from, percept);
                    (self.hold, self.in_phase_s, start) = self.interrupted;
                    if matches!(from, Phase::Approach | Phase::Seek) {
                        // The distance already covered still counts.
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

    fn touch(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        percept: &Percept,
        speed_m_per_s: f64,
    ) {
        let Some(force_n) = percept.force_n else {
            return;
        };
        let tared_at = self.tared_at.take();
        let near = |at: Vector3<f64>| (percept.position - at).norm() < config.leave.touch_at_once_m;
        self.force.touch(config, force_n, speed_m_per_s);
        // A tool that lands where the surface is known need not explore it.
        let knows_landing = std::mem::take(&mut self.lift.knows_landing);
        if self.hops.is_on_the_way_out() {
            self.exploration = Exploration::default();
        } else if !knows_landing {
            self.exploration.offer(if program.task.coverage.is_some() {
                Circles::WITH_DOSE
            } else {
                Circles::AT_TOUCH
            });
        }
        self.acting = ActingPoint::default();
        self.side = SideLoad::default();
        self.off = false;
        self.touch = Touch {
            from: self.phase,
            start: self.phase_start,
            touched: self.touched,
            tared_at,
            at_tare: tared_at.is_some_and(near),
            knows_landing,
            unreal: self.touch.unreal,
        };
        if !self.touched {
            self.touched = true;
            self.tracking.begin_at(percept.position);
        }
        self.settled_s = 0.0;
        self.low_s = 0.0;
        self.felt = Felt::default();
        self.enter(Phase::Contact, percept);
    }

    /// Goes on with what a touch that was none has interrupted. The distance covered counts.
    fn approach_on(&mut self, percept: &Percept) {
        let before = self.touch;
        self.touched = before.touched;
        self.tared_at = before.tared_at;
        self.lift.knows_landing = before.knows_landing;
        self.tracking.freeze();
        self.enter(before.from, percept);
        self.phase_start = before.start;
    }
}
