//! Phase `travel`: the way in joint space to the task's start pose, and home after it.
//!
//! Called by the run's phase machine each cycle; the controller turns it into joint velocities. The
//! sensor may not be tared yet, so a touch shows as a change of the force since the way began.

use tangent_mechanics::Joints;

use super::config::ControllerConfig;
use super::interface::ControlInput;
use super::joint_way::JointWay;
use super::percept::{Percept, Requests};
use super::run::Run;
use super::urgent::{outside, urgent_fault};
use crate::error::ControlError;
use crate::leaving::clearance::Clearance;
use crate::limits::Limits;
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;
use crate::task::program::Program;
use crate::task::{StartSpec, Task};

/// Distance of a joint from its target at which the arm has arrived, rad.
const ARRIVED_RAD: f64 = 1e-3;
/// Joint speed below which the arm has come to rest there, rad/s.
const AT_REST_RAD_PER_S: f64 = 0.01;

/// Start pose and home of a program, for its arm.
#[derive(Clone, Copy, Debug)]
pub(super) struct TravelPoses<const N: usize> {
    start: Option<Joints<N>>,
    home: Option<Joints<N>>,
}

impl<const N: usize> Default for TravelPoses<N> {
    fn default() -> Self {
        Self {
            start: None,
            home: None,
        }
    }
}

impl<const N: usize> TravelPoses<N> {
    /// Those of `task`.
    ///
    /// # Errors
    /// The number of joints is not that of the arm.
    pub fn of(task: &Task) -> Result<Self, ControlError> {
        let joints = |spec: &Option<StartSpec>, table| {
            spec.as_ref().map(|s| s.joints::<N>(table)).transpose()
        };
        Ok(Self {
            start: joints(&task.start, "start")?,
            home: joints(&task.home, "home")?,
        })
    }

    /// Joint positions to which the arm moves now, rad; `None` in every phase but `travel`.
    pub fn target<'a>(&'a self, run: &Run) -> Option<&'a Joints<N>> {
        if run.phase != Phase::Travel {
            None
        } else if run.travel.homewards {
            self.home.as_ref()
        } else {
            self.start.as_ref()
        }
    }
}

impl Run {
    /// The pose of `task` to which the arm travels in this run.
    pub(super) fn pose<'a>(&self, task: &'a Task) -> Option<&'a StartSpec> {
        if self.travel.homewards {
            task.home.as_ref()
        } else {
            task.start.as_ref()
        }
    }

    /// Goes home after a task that has ended well in free space.
    pub(super) fn go_home(&mut self, percept: &Percept) {
        if self.phase == Phase::Done && self.clearance == Clearance::Free {
            self.travel = JointWay::home();
            self.enter(Phase::Travel, percept);
        }
    }

    /// Phase `travel`: ends where the arm arrives, and at once if something is touched.
    pub(super) fn decide_travel<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        limits: &Limits,
        requests: &Requests,
        input: &ControlInput<N>,
        percept: &Percept,
    ) {
        let Some(spec) = self.pose(&program.task) else {
            return self.leave(percept, Some(Fault::TravelBlocked));
        };
        if requests.stopping {
            return self.leave(percept, None);
        }
        let hidden = |load| limits.is_untared_beyond(load);
        let fault = match percept.verdict {
            WrenchVerdict::Retract(reason) => Some(Fault::Wrench(reason)),
            // Home comes after a tare; before it, an unloaded sensor may show any force.
            _ if self.travel.homewards => urgent_fault(limits, percept),
            _ if percept.untared.as_ref().is_some_and(hidden) => Some(Fault::UntaredLimit),
            _ => outside(limits, percept),
        };
        if fault.is_some() {
            return self.leave(percept, fault);
        }
        let felt = percept.wrench.map(|_| input.wrench.force);
        if let Some(force) = &felt
            && self.travel.has_touched(force, spec.force_max_n, input.dt_s)
        {
            // The direction away from what was touched is not known.
            let none = input.base_from_tool.rotate(&self.travel.force_before());
            return self.begin_to_yield(percept, Fault::TravelTouched, none, spec.force_max_n);
        }
        let near = self.travel.left_rad <= spec.tolerance_rad;
        let stands_there = !std::mem::replace(&mut self.travel.begun, true) && near;
        let rests = input.qd.amax() < AT_REST_RAD_PER_S;
        let moves = felt.is_some() && !self.paused && input.speed_scaling > 0.0;
        let blocked = self.travel.is_blocked(moves, input.dt_s);
        if self.paused {
            return;
        }
        if stands_there || rests && (self.travel.left_rad <= ARRIVED_RAD || blocked && near) {
            return self.arrive(program, config, input, percept);
        }
        if blocked {
            self.leave(percept, Some(Fault::TravelBlocked));
        }
    }

    /// The arm stands in the start pose, or at home.
    fn arrive<const N: usize>(
        &mut self,
        program: &Program,
        config: &ControllerConfig,
        input: &ControlInput<N>,
        percept: &Percept,
    ) {
        if self.travel.homewards {
            return self.enter(Phase::Done, percept);
        }
        // Approach and path are relative to the tool's pose here.
        self.begin(program, config, input);
        self.enter(program.task.phase_when_free(), percept);
    }
}
