//! How a torque-controlled tool leaves contact: moving off before its zero is taken, and the
//! retraction at the end.
//!
//! Shared by both torque laws. This module gives the distance, speed and direction; the laws give
//! the starting point and what holds the tool meanwhile. `leave_watch` judges the force during the
//! motion.

use nalgebra::Vector3;

use crate::leaving::clearance::Clearance;
use crate::leaving::config::LeaveConfig;
use crate::leaving::leave_watch::{LeaveWatch, Leaving};
use crate::leaving::retreat::{Ceiling, Met};
use crate::limits::Limits;
use crate::limits::faults::Fault;
use crate::limits::wrench_guard::WrenchVerdict;
use crate::parameters::PathProfileConfig;
use crate::phase_machine::Phase;
use crate::task::profile::Profile;
use crate::task::{EndSpec, Task};

/// Share of its distance that a retraction must actually cover to count.
const GONE_SHARE: f64 = 0.5;
/// Least distance of a retraction to where the tool is free, m, and what an arm that gives way may
/// lack of any.
const FREE_LEAST_M: f64 = 1e-3;
/// Time for which a retraction's reference must have stood at its end before the retraction is
/// over, s.
const SETTLE_S: f64 = 0.1;
/// Deceleration of a sliding tool when its retraction begins, m/s². A harder one would show in the
/// reading: a force sensor measures the inertial force of its load, which looks like an obstacle.
const RUN_OUT_M_PER_S2: f64 = 0.5;

/// Contact state of the tool, and the motion that ends the contact.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Departure {
    /// Whether the tool may touch something: persists after the run.
    pub clearance: Clearance,
    watch: LeaveWatch,
    left: Leaving,
    /// Distance and speed of phase `clear`, m and m/s.
    clear: (f64, f64),
    /// Direction away from the surface that replaces the last good normal.
    pub way_off: Option<Vector3<f64>>,
    retraction: Option<Retraction>,
    /// Clock of the retraction, s: slower without a usable wrench.
    retraction_s: f64,
    /// Phase after the retraction.
    after: Phase,
    /// Whether a retraction has covered its distance since the last touch.
    off: bool,
}

/// A retraction: direction, start, and remaining sliding motion.
#[derive(Clone, Copy, Debug)]
struct Retraction {
    /// Direction: unit, base axes.
    along: Vector3<f64>,
    distance_m: f64,
    /// Whether it ends where the tool was tared, and has touched nothing since.
    to_free: bool,
    profile: Profile,
    run_out: RunOut,
}

/// Sliding motion across the retraction that decelerates to rest.
#[derive(Clone, Copy, Debug)]
struct RunOut {
    /// Offset since the start, base axes, m.
    gone: Vector3<f64>,
    /// Velocity, base axes, m/s.
    velocity: Vector3<f64>,
}

impl RunOut {
    /// Remaining sliding of a tool with this velocity that leaves a surface in direction `along`
    /// (unit).
    fn new(velocity: &Vector3<f64>, along: &Vector3<f64>) -> Self {
        Self {
            gone: Vector3::zeros(),
            velocity: velocity - along * velocity.dot(along),
        }
    }

    fn step(&mut self, dt_s: f64) {
        let speed = self.velocity.norm();
        let less = RUN_OUT_M_PER_S2 * dt_s;
        self.velocity *= if speed > less {
            1.0 - less / speed
        } else {
            0.0
        };
        self.gone += self.velocity * dt_s;
    }
}

/// Parameters of law and task that a departure uses.
pub(crate) struct Rules {
    pub leave: LeaveConfig,
    pub path: PathProfileConfig,
    pub end: EndSpec,
    pub reference_n: f64,
    pub ceiling: Ceiling,
}

impl Rules {
    pub fn new(leave: LeaveConfig, path: PathProfileConfig, task: &Task, limits: &Limits) -> Self {
        Self {
            ceiling: Ceiling::of(limits),
            leave,
            path,
            end: task.end,
            reference_n: task.force.reference_n,
        }
    }
}

/// Measured load in one period.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LoadFelt {
    /// Force, base axes, N.
    pub force: Vector3<f64>,
    pub torque_nm: f64,
    /// Whether the untared reading is beyond its limit.
    pub hidden: bool,
    /// Whether the zero can be trusted: neither lost nor taken in contact.
    pub zeroed: bool,
}

/// `None` without a good wrench.
pub(crate) type Load = Option<LoadFelt>;

/// Position of the tool at the start of the motion, and now, base axes, m.
pub(crate) struct Way {
    pub from: Vector3<f64>,
    pub at: Vector3<f64>,
    /// Velocity, m/s. Zero if the law itself is compliant when the reference stops.
    pub velocity: Vector3<f64>,
    /// Where the tool was tared, if it has touched nothing since.
    pub free_at: Option<Vector3<f64>>,
}

impl Way {
    fn gone_m(&self, along: &Vector3<f64>) -> f64 {
        (self.at - self.from).dot(along)
    }
}

/// Reference motion, base axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    /// Offset from the start of the motion, m.
    pub offset: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity: Vector3<f64>,
}

/// Outcome of one cycle of phase `clear`.
pub(crate) enum Clearing {
    Going(Step),
    /// The tool is free.
    Free,
    Failed(Fault),
}

/// Outcome of one cycle of a retraction.
pub(crate) enum Retracting {
    Going(Step),
    /// The retraction ends with this step; then this phase follows.
    Ended(Step, Phase),
    /// An obstacle opposes the motion.
    Opposed,
}

impl Departure {
    /// State before any motion.
    pub fn new(clearance: Clearance) -> Self {
        Self {
            clearance,
            ..Self::default()
        }
    }

    /// The tool touches: an earlier retraction no longer counts.
    pub fn touched(&mut self) {
        self.off = false;
    }

    /// Whether the tool may still be where it touched.
    pub fn may_be_on_surface(&self) -> bool {
        !self.off && !self.clearance.is_free()
    }

    /// Records where the tool may touch, and the direction away from the surface.
    pub fn remember(&mut self, phase: Phase, normal: Vector3<f64>, position: Vector3<f64>) {
        if phase.is_active() && !matches!(phase, Phase::Tare | Phase::Clear) {
            let retracting = self.retraction.filter(|_| phase == Phase::Retract);
            self.clearance = Clearance::Possible {
                normal: retracting.map_or(normal, |r| r.along),
                position,
            };
        }
    }

    /// Phase `clear`: moves off along the last known normal until the force has been steady over
    /// the required distance. In any doubt, and without a wrench, the tool stands still.
    pub fn clear(
        &mut self,
        rules: &Rules,
        way: &Way,
        (verdict, load): (WrenchVerdict, Load),
        paused: bool,
        dt_s: f64,
    ) -> Clearing {
        let leave = &rules.leave;
        let along = match (self.clearance.way_out(leave, &way.from), verdict) {
            (Ok(_), WrenchVerdict::Retract(why)) => return Clearing::Failed(Fault::Wrench(why)),
            (Ok(Some(normal)), _) => normal,
            _ => return Clearing::Failed(Fault::NotClear),
        };
        let (mut way_m, mut speed) = self.clear;
        // Without a wrench the tool waits: obstacles could not be detected.
        let goes = load.is_some() && !paused;
        let wanted = if goes { leave.speed_m_per_s } else { 0.0 };
        let change = rules.path.acceleration_m_per_s2 * dt_s;
        speed += (wanted - speed).clamp(-change, change);
        way_m += speed * dt_s;
        self.clear = (way_m, speed);
        if let Some(LoadFelt { force, .. }) = load {
            let release_max_n = (2.0 * rules.reference_n).max(10.0);
            let gone_m = way.gone_m(&along);
            match self
                .watch
                .clear(leave, &along, gone_m, &force, release_max_n, dt_s)
            {
                Leaving::Free => {
                    self.clearance = Clearance::Free;
                    return Clearing::Free;
                }
                Leaving::Going if way_m <= leave.distance_max_m => {}
                Leaving::Going | Leaving::Opposed => return Clearing::Failed(Fault::NotClear),
            }
        }
        Clearing::Going(Step {
            offset: along * way_m,
            velocity: along * speed,
        })
    }

    /// Begins a retraction, with the phase that follows it.
    pub fn begin_retraction(&mut self, then: Phase) {
        self.watch = LeaveWatch::default();
        self.left = Leaving::Going;
        self.retraction_s = 0.0;
        self.retraction = None;
        self.after = then;
    }

    /// The retraction along `away` (taken at its start): slow without a usable wrench, and stopped
    /// by an obstacle.
    pub fn retract(
        &mut self,
        rules: &Rules,
        away: Vector3<f64>,
        way: &Way,
        load: Load,
        dt_s: f64,
    ) -> Retracting {
        let (leave, end) = (&rules.leave, &rules.end);
        let retraction = self.retraction.get_or_insert_with(|| {
            let along = self.way_off.unwrap_or(away);
            let most_m = end.retract_distance_m;
            let back_m = way.free_at.map(|at| (at - way.from).dot(&along));
            let distance_m = back_m.map_or(most_m, |back_m| back_m.clamp(FREE_LEAST_M, most_m));
            Retraction {
                along,
                distance_m,
                to_free: back_m.is_some_and(|back_m| back_m <= most_m),
                profile: Profile::new(
                    distance_m,
                    end.retract_speed_m_per_s,
                    rules.path.acceleration_m_per_s2,
                    rules.path.jerk_m_per_s3,
                ),
                run_out: RunOut::new(&way.velocity, &along),
            }
        });
        retraction.run_out.step(dt_s);
        let Retraction {
            along,
            distance_m,
            to_free,
            profile,
            run_out,
        } = *retraction;
        let gone_m = way.gone_m(&along);
        let rate = if let Some(felt) = load {
            let met = Met {
                along,
                position: way.at,
                force: felt.force,
                torque_nm: felt.torque_nm,
                hidden: felt.hidden,
                zeroed: felt.zeroed,
                dt_s,
            };
            self.left = self.watch.retract(leave, &rules.ceiling, &met);
            1.0
        } else {
            self.watch.blind();
            self.left = Leaving::Going;
            (leave.blind_speed_m_per_s / end.retract_speed_m_per_s).min(1.0)
        };
        if self.left == Leaving::Opposed {
            // Moving on in the same direction would press harder; the direction away is now
            // unknown.
            self.clearance = Clearance::Unknown;
            return Retracting::Opposed;
        }
        self.retraction_s += rate * dt_s;
        let (way_m, speed) = profile.at(self.retraction_s);
        let step = Step {
            offset: along * way_m + run_out.gone,
            velocity: along * (rate * speed) + run_out.velocity,
        };
        if self.retraction_s <= profile.duration_s() + SETTLE_S {
            return Retracting::Going(step);
        }
        // An arm that did not follow has not left the surface.
        self.off = gone_m > GONE_SHARE * distance_m - FREE_LEAST_M;
        if self.off && (to_free || self.left == Leaving::Free) {
            self.clearance = Clearance::Free;
        }
        Retracting::Ended(step, self.after)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distance of a retraction from the origin, m, and whether the tool is then known to be free.
    fn retracted(free_at: Option<Vector3<f64>>) -> (f64, bool) {
        let task = r#"
            name = "line"
            estimators = ["first"]
            force.reference_n = 3.0
            path = { kind = "line", to_m = [0.04, 0.0], speed_m_per_s = 0.02 }
        "#;
        let task: Task = task.parse().unwrap();
        let (leave, path) = (LeaveConfig::default(), PathProfileConfig::default());
        let rules = Rules::new(leave, path, &task, &Limits::default());
        let mut departure = Departure::new(Clearance::Unknown);
        departure.begin_retraction(Phase::Fault);
        let mut way = Way {
            from: Vector3::zeros(),
            at: Vector3::zeros(),
            velocity: Vector3::zeros(),
            free_at,
        };
        loop {
            // The sensor is silent.
            match departure.retract(&rules, Vector3::z(), &way, None, 0.008) {
                Retracting::Going(step) => way.at = step.offset,
                Retracting::Ended(..) => return (way.at.z, departure.clearance.is_free()),
                Retracting::Opposed => panic!("opposed"),
            }
        }
    }

    #[test]
    fn a_tool_that_has_touched_nothing_goes_back_to_where_it_was_tared_and_is_free_there() {
        let (way_m, free) = retracted(Some(Vector3::new(0.01, 0.0, 0.012)));
        assert!((way_m - 0.012).abs() < 1e-6 && free, "{way_m} m");
        let (way_m, free) = retracted(None);
        assert!((way_m - 0.05).abs() < 1e-6 && !free, "{way_m} m");
        // Tared further away than a retraction goes.
        let (way_m, free) = retracted(Some(Vector3::z() * 0.08));
        assert!((way_m - 0.05).abs() < 1e-6 && !free, "{way_m} m");
    }
}
