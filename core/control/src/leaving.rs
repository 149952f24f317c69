//! How a run leaves what it touches: off before a tare, off for a new zero, and the retraction at
//! the end.
//!
//! Called by the run's phase machine each cycle; what the force says of the motion is judged in
//! `clearance`.

use tangent_sensing::Validity;

use crate::clearance::{Ceiling, Leaving, Met};
use crate::percept::{Percept, Requests};
use crate::run::Run;
use crate::urgent::outside;
use crate::wrench_guard::WrenchVerdict;
use crate::{Clearance, ControlInput, ControllerConfig, Fault, Limits, Phase, Program};

/// A tool that has slid for less than this since it came back has got nowhere, s.
const SLID_ON_S: f64 = 0.5;

impl Run {
    /// Keeps in mind where the tool may touch, and which way is away. Nothing moves in `tare`.
    pub(crate) fn remember(&mut self, input: &ControlInput, percept: &Percept) {
        if matches!(self.phase, Phase::Tare | Phase::Clear) {
            return;
        }
        self.clearance = if input.base.is_some() {
            // By the next start the surface is elsewhere, seen from the base.
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

    /// Phase `clear`: off along the last known normal until the force has been steady over some
    /// way. Without a wrench it stands until there is one again; whatever else happens ends the
    /// task.
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
            Leaving::Opposed => self.leave(percept, Some(Fault::NotClear)),
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
                let patience_s = 2.0 + 3.0 * leave.distance_max_m / leave.speed_m_per_s;
                if way_m > leave.distance_max_m || self.time_in_phase_s() > patience_s {
                    self.leave(percept, Some(Fault::NotClear));
                }
            }
        }
    }

    /// The retraction: ends after its way, and at once where something is in the way.
    pub(crate) fn decide_retract(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        input: &ControlInput,
        percept: &Percept,
    ) {
        let end = &program.task.end;
        let way_m = (percept.position - self.phase_start).dot(&self.retract);
        match &percept.wrench {
            Some(wrench) => {
                let hidden = |load| limits.is_untared_beyond(load);
                let met = Met {
                    way_m,
                    force: wrench.force,
                    torque_nm: wrench.torque.norm(),
                    hidden: percept.untared.as_ref().is_some_and(hidden),
                    zeroed: !self.zero_withdrawn
                        && (input.bias_age_s.is_some() || !program.task.tare),
                    dt_s: input.dt_s,
                };
                self.left = self
                    .leave
                    .retract(&config.leave, &Ceiling::of(limits), &met);
                if self.left == Leaving::Opposed {
                    // On along the same way it would press harder; which way is away is not known
                    // now.
                    self.clearance = Clearance::Unknown;
                    self.fault = self.fault.or(Some(Fault::RetractOpposed));
                    return self.enter(Phase::Fault, percept);
                }
            }
            None => {
                self.leave.blind();
                self.left = Leaving::Going;
            }
        }
        let speed = end
            .retract_speed_m_per_s
            .min(config.leave.blind_speed_m_per_s);
        let patience_s = 1.0 + 3.0 * end.retract_distance_m / speed;
        let arrived = way_m >= end.retract_distance_m;
        if arrived || self.time_in_phase_s() > patience_s {
            self.off = arrived;
            if arrived && self.left == Leaving::Free {
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

    /// Speed of the retraction, m/s: slow where nothing tells what it meets.
    pub(crate) fn retract_speed(
        &self,
        program: &Program,
        config: &ControllerConfig,
        percept: &Percept,
    ) -> f64 {
        let wanted = program.task.end.retract_speed_m_per_s;
        if percept.wrench.is_some() {
            wanted
        } else {
            wanted.min(config.leave.blind_speed_m_per_s)
        }
    }

    /// A task that took a zero goes on with none: the sensor's service began anew, or took it back.
    pub(crate) fn zero_fault(&self, program: &Program, input: &ControlInput) -> Option<Fault> {
        let lost = program.task.tare
            && input.bias_age_s.is_none()
            && input.wrench_validity == Validity::Valid;
        lost.then_some(Fault::ZeroLost)
    }

    /// The zero's drift may exceed what the task allows, in a phase that can be left for a new one.
    pub(crate) fn is_zero_old(&self, program: &Program, input: &ControlInput) -> bool {
        let Some(error_max_n) = program.task.zero.error_max_n else {
            return false;
        };
        matches!(self.phase, Phase::Slide | Phase::Hold)
            && !self.stands_without_wrench()
            && input
                .zero_bound_n
                .is_none_or(|bound_n| bound_n > error_max_n)
    }

    /// A zero that was taken anew in this run is too old as soon as the tool is back: another one
    /// would not help.
    pub(crate) fn is_new_zero_no_help(&self) -> bool {
        self.renewed && self.phase == Phase::Slide && self.time_in_phase_s() < SLID_ON_S
    }

    /// Off the surface for a new zero; the path waits.
    pub(crate) fn lift_off(&mut self, percept: &Percept) {
        self.renewed = true;
        self.tracking.freeze();
        self.retract = self.way_off();
        self.enter(Phase::Clear, percept);
    }
}
