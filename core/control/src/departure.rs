//! How a tool that torques move leaves what it touches: off before its zero is taken, and the
//! retraction at the end.
//!
//! One for both laws of torques: it says how far and how fast along which way, they say from where,
//! and what holds the tool meanwhile. What the force says of the motion is judged in `clearance`.

use nalgebra::Vector3;

use crate::clearance::{Ceiling, LeaveWatch, Leaving, Met};
use crate::config::PathProfileConfig;
use crate::task::{EndSpec, Task};
use crate::wrench_guard::WrenchVerdict;
use crate::{Clearance, Fault, LeaveConfig, Limits, Phase, Profile};

/// Share of its way that a retraction really has to go to count.
const GONE_SHARE: f64 = 0.5;
/// A retraction's reference has stood so long at its end before it is over, s.
const SETTLE_S: f64 = 0.1;
/// Deceleration of a tool that slid when its retraction begins, m/s². A harder one would show in
/// the reading: a force sensor feels the inertia of what it carries, and takes it for an obstacle.
const RUN_OUT_M_PER_S2: f64 = 0.5;

/// What is known of the tool's touch, and the motion that ends it.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Departure {
    /// Whether the tool may touch something: outlasts the run.
    pub clearance: Clearance,
    watch: LeaveWatch,
    left: Leaving,
    /// Way and speed of phase `clear`, m and m/s.
    clear: (f64, f64),
    /// The way off that stands in for the last good normal.
    pub way_off: Option<Vector3<f64>>,
    retraction: Option<Retraction>,
    /// Clock of the retraction, s: slower where nothing is felt.
    retraction_s: f64,
    /// The phase after it.
    after: Phase,
    /// A retraction has gone its way since the last touch.
    off: bool,
}

/// Which way, how, and what is left of the sliding.
#[derive(Clone, Copy, Debug)]
struct Retraction {
    /// Unit, base axes.
    along: Vector3<f64>,
    profile: Profile,
    run_out: RunOut,
}

/// A motion across the retraction that comes to rest.
#[derive(Clone, Copy, Debug)]
struct RunOut {
    /// Since its start, base axes, m.
    gone: Vector3<f64>,
    /// m/s
    velocity: Vector3<f64>,
}

impl RunOut {
    /// Of a tool with this velocity that leaves `along` (unit) a surface.
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

/// Parameters of law and task that a departure goes by.
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

/// What is felt in one period.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LoadFelt {
    /// N, base axes.
    pub force: Vector3<f64>,
    pub torque_nm: f64,
    /// The untared reading is beyond its limit.
    pub hidden: bool,
    /// The zero is one to go by: neither lost nor taken in contact.
    pub zeroed: bool,
}

/// None without a good wrench.
pub(crate) type Load = Option<LoadFelt>;

/// Where the tool was at the start of the motion, and where it is, base axes, m.
pub(crate) struct Way {
    pub from: Vector3<f64>,
    pub at: Vector3<f64>,
    /// m/s. Zero where the law itself gives when the reference stops.
    pub velocity: Vector3<f64>,
}

impl Way {
    fn gone_m(&self, along: &Vector3<f64>) -> f64 {
        (self.at - self.from).dot(along)
    }
}

/// The reference, base axes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Step {
    /// From where the motion started, m.
    pub offset: Vector3<f64>,
    /// m/s
    pub velocity: Vector3<f64>,
}

/// How phase `clear` goes on.
pub(crate) enum Clearing {
    Going(Step),
    /// The tool hangs free.
    Free,
    Failed(Fault),
}

/// How a retraction goes on.
pub(crate) enum Retracting {
    Going(Step),
    /// Over with this step, and then this phase.
    Ended(Step, Phase),
    /// Something is in the way.
    Opposed,
}

impl Departure {
    /// Nothing moved yet.
    pub fn new(clearance: Clearance) -> Self {
        Self {
            clearance,
            ..Self::default()
        }
    }

    /// The tool touches: what a retraction did before is void.
    pub fn touched(&mut self) {
        self.off = false;
    }

    /// It may still be where it touched.
    pub fn may_be_on_surface(&self) -> bool {
        !self.off && !self.clearance.is_free()
    }

    /// Keeps in mind where the tool may touch, and which way is away.
    pub fn remember(&mut self, phase: Phase, normal: Vector3<f64>, position: Vector3<f64>) {
        if phase.is_active() && !matches!(phase, Phase::Tare | Phase::Clear) {
            let retracting = self.retraction.filter(|_| phase == Phase::Retract);
            self.clearance = Clearance::Possible {
                normal: retracting.map_or(normal, |r| r.along),
                position,
            };
        }
    }

    /// Phase `clear`: off along the last known normal until the force has been steady over some
    /// way. In any doubt it stands, and without a wrench until there is one again.
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
        // A tool that does not feel what it meets waits.
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

    /// A retraction begins, and then comes this phase.
    pub fn begin_retraction(&mut self, then: Phase) {
        self.watch = LeaveWatch::default();
        self.left = Leaving::Going;
        self.retraction_s = 0.0;
        self.retraction = None;
        self.after = then;
    }

    /// The retraction, at its start along `away`: slow where nothing is felt, and it stops where
    /// something is in the way.
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
            Retraction {
                along,
                profile: Profile::new(
                    end.retract_distance_m,
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
            profile,
            run_out,
        } = *retraction;
        let gone_m = way.gone_m(&along);
        let rate = if let Some(felt) = load {
            let met = Met {
                way_m: gone_m,
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
            // On along the same way it would press harder; which way is away is not known now.
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
        // An arm that did not follow has left nothing.
        self.off = gone_m > GONE_SHARE * end.retract_distance_m;
        if self.off && self.left == Leaving::Free {
            self.clearance = Clearance::Free;
        }
        Retracting::Ended(step, self.after)
    }
}
