//! How a run leaves contact: moving off before a tare, lifting off for a new zero, and the
//! retraction at the end.
//!
//! Called by the run's phase machine each cycle; `leave_watch` judges the force during the motion.

use nalgebra::Vector3;
use tangent_sensing::Validity;

use super::config::ControllerConfig;
use super::interface::ControlInput;
use super::percept::{Percept, Requests};
use super::run::Run;
use super::touchdown::{free_speed_max, stiffness_expected};
use super::urgent::outside;
use super::zero_doubt::ZeroJump;
use crate::leaving::clearance::Clearance;
use crate::leaving::leave_watch::Leaving;
use crate::leaving::retreat::{Ceiling, Met};
use crate::leaving::yielding::{YieldRules, Yielding};
use crate::limits::Limits;
use crate::limits::faults::Fault;
use crate::limits::plausibility::is_wrench;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;
use crate::task::program::Program;

/// Minimum sliding time after the return of a tool for its new zero to have helped, s.
const SLID_ON_S: f64 = 0.5;
/// Age of a doubted reading up to which it still stops a retraction, s.
const DOUBTED_AGE_MAX_S: f64 = 0.05;

impl Run {
    /// Records where the tool may touch, and the direction away from the surface. Nothing moves in
    /// `tare`.
    pub(crate) fn remember<const N: usize>(&mut self, input: &ControlInput<N>, percept: &Percept) {
        if self.phase.is_before_approach() {
            return;
        }
        if self.yielding.is_some() {
            // What is in the way is not where the surface was.
            self.clearance = Clearance::Unknown;
            return;
        }
        self.clearance = if input.base.is_some() {
            // On a moving base: at the next start the surface is at another place in base axes.
            Clearance::Unknown
        } else {
            Clearance::Possible {
                normal: if self.phase == Phase::Retract {
                    self.retract
                } else {
                    self.way_off()
                },
                position: percept.position,
            }
        };
    }

    /// Phase `clear`: moves off along the last known normal until the force has been steady over
    /// the required distance. Without a wrench the tool stands until there is one again; any other
    /// fault ends the task.
    pub(crate) fn decide_clear(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        requests: &Requests,
        percept: &Percept,
        dt_s: f64,
    ) {
        let leave = &config.leave;
        let way_m = (percept.position - self.phase_start).dot(&self.retract);
        let release_max_n = (2.0 * program.task.force.reference_n).max(10.0);
        let fault = match (&self.clearance, percept.verdict) {
            // The base has moved, or the arm was moved between the start and this cycle.
            (Clearance::Unknown, _) if !self.has_touched() => Some(Fault::NotClear),
            (Clearance::Possible { position, .. }, _)
                if !self.has_touched() && (self.phase_start - position).norm() > leave.near_m =>
            {
                Some(Fault::NotClear)
            }
            (_, WrenchVerdict::Retract(reason)) => Some(Fault::Wrench(reason)),
            _ => outside(limits, percept),
        };
        if requests.stopping || fault.is_some() {
            return self.leave(percept, fault);
        }
        let Some(wrench) = &percept.wrench else {
            return;
        };
        match self.leave.clear(
            leave,
            &self.retract,
            way_m,
            &wrench.force,
            release_max_n,
            dt_s,
        ) {
            Leaving::Opposed => {
                let none = self.leave.none();
                self.begin_to_yield(percept, Fault::NotClear, none, leave.grow_n);
            }
            Leaving::Free => {
                self.clearance = Clearance::Free;
                self.tracking.freeze();
                let next = if self.has_touched() {
                    Phase::Tare
                } else {
                    program.first_phase()
                };
                self.enter(next, percept);
            }
            Leaving::Going => {
                let patience_s = self.clear_patience_s(program, config, limits);
                if way_m > leave.distance_max_m || self.time_in_phase_s() > patience_s {
                    self.leave(percept, Some(Fault::NotClear));
                }
            }
        }
    }

    /// The retraction: ends after its distance, and at once if an obstacle opposes it.
    pub(crate) fn decide_retract<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        input: &ControlInput<N>,
        percept: &Percept,
    ) {
        let end = &program.task.end;
        let way_m = (percept.position - self.phase_start).dot(&self.retract);
        // A reading that does not answer to the motion still shows what the tool runs into.
        let doubted = percept.wrench.is_none()
            && input.wrench_validity == Validity::Valid
            && is_wrench(&input.wrench)
            && input.wrench_age_s <= DOUBTED_AGE_MAX_S;
        let read = doubted.then(|| input.base_from_tool.align_wrench(&input.wrench));
        let wrench = percept.wrench.or(read);
        let speed_max_m_per_s = self.retract_speed_max(program, config, limits);
        if let Some(yielding) = &mut self.yielding {
            let rules = YieldRules {
                damping_n_s_per_m: config.force.damping_max_n_s_per_m,
                speed_max_m_per_s,
            };
            let goes_on = wrench.is_some_and(|wrench| {
                yielding.step(&rules, &percept.position, &wrench.force, input.dt_s)
            });
            if !goes_on {
                self.enter(Phase::Fault, percept);
            }
            return;
        }
        if let Some(wrench) = wrench {
            let hidden = |load| limits.is_untared_beyond(load);
            let met = Met {
                along: self.retract,
                position: percept.position,
                force: wrench.force,
                torque_nm: wrench.torque.norm(),
                hidden: percept.untared.as_ref().is_some_and(hidden),
                zeroed: !doubted
                    && !self.zero_withdrawn
                    && (input.bias_age_s.is_some() || !program.task.tare),
                dt_s: input.dt_s,
            };
            self.left = self
                .leave
                .retract(&config.leave, &Ceiling::of(limits), &met);
            if self.left == Leaving::Opposed {
                let fault = self.fault.unwrap_or(Fault::RetractOpposed);
                let none = self.leave.none();
                return self.begin_to_yield(percept, fault, none, config.leave.opposed_n);
            }
        }
        if percept.wrench.is_none() {
            self.leave.blind();
            self.left = Leaving::Going;
        }
        let speed = speed_max_m_per_s.min(config.leave.blind_speed_m_per_s);
        let patience_s = 1.0 + 3.0 * end.retract_distance_m / speed;
        // A tool that has touched nothing is free where its approach began, and need not go
        // further.
        let start_m = self.way_to_start_m();
        let back = start_m.is_some_and(|start_m| way_m >= start_m);
        let arrived = back || way_m >= end.retract_distance_m;
        if arrived || self.time_in_phase_s() > patience_s {
            self.off = arrived;
            if back || (arrived && self.left == Leaving::Free) {
                self.clearance = Clearance::Free;
            }
            let phase = if self.fault.is_some() {
                Phase::Fault
            } else {
                Phase::Done
            };
            self.enter(phase, percept);
        }
    }

    /// Ends a motion for what it has met, with `none` the force that counts as none (base axes, N):
    /// moving on in the same direction would press harder, and the direction away is now unknown.
    /// Until the end of the task, the tool gives way.
    pub(super) fn begin_to_yield(
        &mut self,
        percept: &Percept,
        fault: Fault,
        none: Vector3<f64>,
        opposed_n: f64,
    ) {
        let yielding = Yielding::new(percept.position, none, opposed_n);
        self.fault = Some(fault);
        self.clearance = Clearance::Unknown;
        self.enter(Phase::Retract, percept);
        self.yielding = Some(yielding);
    }

    /// Highest speed of a motion that should touch nothing, m/s, for what it meets from `noticed_n`
    /// (N) on. Where a contact is soft, what is above it need not be.
    pub(super) fn free_speed_max(
        &self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        noticed_n: f64,
    ) -> f64 {
        let expected = stiffness_expected(program, config);
        let stiffest = self.force.stiffness_n_per_m().max(expected);
        free_speed_max(config, limits.force_max_n, noticed_n, stiffest)
    }

    /// Speed straight off the surface, m/s, that does not exceed `most`: from rest, so that a way
    /// that leads into the surface is noticed while it is slow.
    fn speeding_up(&self, config: &ControllerConfig, most: f64) -> f64 {
        most.min(config.path.acceleration_m_per_s2 * self.in_phase_s)
    }

    fn clear_speed_max(
        &self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
    ) -> f64 {
        let leave = &config.leave;
        let most = self.free_speed_max(program, config, limits, leave.grow_n);
        leave.speed_m_per_s.min(most)
    }

    /// Speed in phase `clear`, and straight off the surface in phase `lift`, m/s.
    pub(super) fn clear_speed(
        &self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
    ) -> f64 {
        self.speeding_up(config, self.clear_speed_max(program, config, limits))
    }

    /// Longest phase `clear`, and longest way straight off the surface in phase `lift`, s.
    pub(super) fn clear_patience_s(
        &self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
    ) -> f64 {
        let speed = self.clear_speed_max(program, config, limits);
        2.0 + 3.0 * config.leave.distance_max_m / speed
    }

    fn retract_speed_max(
        &self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
    ) -> f64 {
        let most = self.free_speed_max(program, config, limits, config.leave.opposed_n);
        program.task.end.retract_speed_m_per_s.min(most)
    }

    /// Speed of the retraction, m/s: slow without a usable wrench.
    pub(crate) fn retract_speed(
        &self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        percept: &Percept,
    ) -> f64 {
        let most = self.retract_speed_max(program, config, limits);
        let most = if percept.wrench.is_some() {
            most
        } else {
            most.min(config.leave.blind_speed_m_per_s)
        };
        self.speeding_up(config, most)
    }

    /// Distance of a retraction back to where the tool was tared, m, if it has touched nothing
    /// since.
    fn way_to_start_m(&self) -> Option<f64> {
        let tared_at = self.tared_at.filter(|_| !self.touched)?;
        Some((tared_at - self.phase_start).dot(&self.retract).max(0.0))
    }

    /// Fault of a task that took a zero and has lost it: the sensor's service restarted or withdrew
    /// it.
    pub(crate) fn zero_fault<const N: usize>(
        &self,
        program: &Program,
        input: &ControlInput<N>,
    ) -> Option<Fault> {
        let lost = program.task.tare
            && input.bias_age_s.is_none()
            && input.wrench_validity == Validity::Valid;
        lost.then_some(Fault::ZeroLost)
    }

    /// Whether the zero's drift may exceed what the task allows, in a phase that can be interrupted
    /// for a new zero.
    pub(crate) fn is_zero_old<const N: usize>(
        &self,
        program: &Program,
        input: &ControlInput<N>,
    ) -> bool {
        let Some(error_max_n) = program.task.zero.error_max_n else {
            return false;
        };
        matches!(self.phase, Phase::Slide | Phase::Hold)
            && !self.stands_without_wrench()
            && input
                .zero_bound_n
                .is_none_or(|bound_n| bound_n > error_max_n)
    }

    /// What follows if the sensor's zero seems to have jumped now.
    pub(crate) fn zero_jump<const N: usize>(
        &self,
        program: &Program,
        input: &ControlInput<N>,
    ) -> ZeroJump {
        if !self.touched || !program.task.tare || input.base.is_some() {
            return ZeroJump::Fault;
        }
        match self.phase {
            // The same jump is reported for some cycles.
            Phase::Clear if self.zero_doubt.is_open() => ZeroJump::Proved,
            Phase::Hold if self.stands_without_wrench() => ZeroJump::Fault,
            Phase::Contact | Phase::Slide | Phase::Seek | Phase::Hold => {
                self.zero_doubt.on_surface()
            }
            _ => ZeroJump::Fault,
        }
    }

    /// Whether a zero taken anew in this run was too old as soon as the tool was back: another one
    /// would not help.
    pub(crate) fn is_new_zero_no_help(&self) -> bool {
        self.renewed && self.phase == Phase::Slide && self.time_in_phase_s() < SLID_ON_S
    }

    /// Lifts the tool off for a new zero; the path waits.
    pub(crate) fn lift_off(&mut self, percept: &Percept) {
        self.renewed = true;
        self.tracking.freeze();
        self.retract = self.way_off();
        self.enter(Phase::Clear, percept);
    }
}
