//! Phase `travel`: the way in joint space to the task's start pose, and home after it.
//!
//! Called by the run's phase machine each cycle; the controller turns it into joint velocities. The
//! sensor may not be tared yet, so a touch shows as a change of the force since the way began.

use nalgebra::Vector3;
use tangent_mechanics::{Arm, Joints};

use super::config::ControllerConfig;
use super::interface::ControlInput;
use super::percept::{Percept, Requests};
use super::run::Run;
use super::urgent::{outside, urgent_fault};
use crate::error::ControlError;
use crate::joint_move::{JointMoveLimits, left_rad};
use crate::leaving::clearance::Clearance;
use crate::limits::Limits;
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::phase_machine::Phase;
use crate::task::program::Program;
use crate::task::{StartSpec, Task};

/// Joint acceleration on the way, rad/s².
const ACCELERATION_RAD_PER_S2: f64 = 0.5;
/// Highest speed of the tool on the way, m/s.
const TOOL_SPEED_M_PER_S: f64 = 0.1;
/// Distance of a joint from its target at which the arm has arrived, rad.
const ARRIVED_RAD: f64 = 1e-3;
/// Joint speed below which the arm has come to rest there, rad/s.
const AT_REST_RAD_PER_S: f64 = 0.01;
/// Time for which the force must have changed, s: one wrong sample does not count.
const TOUCHED_S: f64 = 0.012;
/// Progress that counts, rad, and the longest time without any, s.
const PROGRESS: (f64, f64) = (2e-3, 3.0);

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

/// State of one way.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Travel {
    homewards: bool,
    /// Distance of the joint that is furthest from its target, rad.
    left_rad: f64,
    /// Smallest distance so far, rad, and the time since it was reached, s.
    nearest_rad: f64,
    stalled_s: f64,
    /// Force when the way began, tool axes, N.
    force_before: Option<Vector3<f64>>,
    touched_s: f64,
    begun: bool,
}

impl Default for Travel {
    fn default() -> Self {
        Self {
            homewards: false,
            left_rad: f64::INFINITY,
            nearest_rad: f64::INFINITY,
            stalled_s: 0.0,
            force_before: None,
            touched_s: 0.0,
            begun: false,
        }
    }
}

impl Travel {
    /// Takes the arm's joint positions of this cycle.
    pub fn look<const N: usize>(&mut self, q: &Joints<N>, target: &Joints<N>) {
        self.left_rad = left_rad(q, target);
    }

    /// Limits of the way of `spec`.
    pub fn limits<const N: usize>(
        spec: &StartSpec,
        arm: &Arm<N>,
        limits: &Limits,
    ) -> JointMoveLimits<N> {
        let fastest = arm.limits().velocity * limits.joint_speed_share;
        JointMoveLimits {
            speed_rad_per_s: fastest.map(|v| v.min(spec.speed_rad_per_s)),
            acceleration_rad_per_s2: ACCELERATION_RAD_PER_S2
                .min(limits.joint_acceleration_max_rad_per_s2),
            tool_speed_m_per_s: TOOL_SPEED_M_PER_S.min(limits.speed_max_m_per_s),
            tool_turn_rate_rad_per_s: limits.turn_rate_max_rad_per_s,
        }
    }

    /// Whether the force has changed by more than `force_max_n` since the way began.
    fn has_touched(&mut self, force: &Vector3<f64>, force_max_n: f64, dt_s: f64) -> bool {
        let before = *self.force_before.get_or_insert(*force);
        self.touched_s = if (force - before).norm() > force_max_n {
            self.touched_s + dt_s
        } else {
            0.0
        };
        self.touched_s > TOUCHED_S
    }

    /// Whether the arm has made no progress for too long; `moves`: it is meant to move.
    fn is_blocked(&mut self, moves: bool, dt_s: f64) -> bool {
        let (step_rad, patience_s) = PROGRESS;
        if self.left_rad < self.nearest_rad - step_rad {
            self.nearest_rad = self.left_rad;
            self.stalled_s = 0.0;
        } else if moves {
            self.stalled_s += dt_s;
        }
        self.stalled_s > patience_s
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
            self.travel = Travel {
                homewards: true,
                ..Travel::default()
            };
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
            self.clearance = Clearance::Unknown;
            return self.leave(percept, Some(Fault::TravelTouched));
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
