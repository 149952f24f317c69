//! Where a moving base is and how it moves, out of the poses that its platform publishes (`base/pose`).
//!
//! Called by the controller, the estimators' service and the closed loop of `evaluate`: `take` for every pose, `at` once
//! per cycle. What comes out lives in a frame that is fixed to the floor and coincides with the base where it was first
//! seen: `world` up to a constant. So numbers stay small on any map, and when the map jumps under the platform
//! (relocalisation) the frame stays where the surface is.

mod config;
mod pose_filter;

use nalgebra::{Isometry3, Matrix6, Vector3};
use tangent_mechanics::{Aligned, Base, Pose, Tool, Twist, World};

pub use config::BaseConfig;
use pose_filter::PoseFilter;

/// One message of the platform.
#[derive(Clone, Copy, Debug)]
pub struct BasePose {
    /// Who sent it: another publisher's poses begin anew.
    pub publisher: [u8; 16],
    /// Time of measurement on the platform's clock, s.
    pub stamp_s: f64,
    /// Time of arrival on the reader's clock, s. The two clocks need not agree.
    pub arrived_s: f64,
    /// Position in world axes, m, and the quaternion as it came: x, y, z, w.
    pub position: Vector3<f64>,
    /// Not normalised yet.
    pub quaternion: [f64; 4],
    /// Of position (m²), then of small turns about the fixed axes (rad²). All zero: not known.
    pub covariance: Matrix6<f64>,
}

/// Why the base's motion cannot be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BaseTrouble {
    /// Nothing was received yet, and the cell says that the base moves.
    Missing,
    /// No pose within the patience.
    Silent,
    /// The pose jumped or has only begun: not steady for long enough.
    Unsettled,
    /// A number is not finite.
    NotFinite,
    /// The quaternion's length is not one.
    NotUnit,
    /// Not newer than the last one.
    OutOfOrder,
    /// It arrived long after its time.
    Late,
    /// Its covariance is too large.
    Uncertain,
    /// Moves faster than a tool can be kept on a surface.
    TooFast,
}

impl BaseTrouble {
    /// What is wrong and what to do, in words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Missing => {
                "no base/pose, and the cell has a moving base: is the platform running?"
            }
            Self::Silent => "base/pose fell silent: check the platform's odometry",
            Self::Unsettled => {
                "base/pose jumps: a relocalisation, a slipping wheel or two publishers"
            }
            Self::NotFinite => "base/pose is not a finite number",
            Self::NotUnit => "base/pose has a quaternion whose length is not one",
            Self::OutOfOrder => {
                "base/pose comes out of order: two publishers, or a clock that was set back"
            }
            Self::Late => "base/pose comes too late: check the network to the platform",
            Self::Uncertain => {
                "base/pose is too uncertain: its covariance is beyond base.position_sd_max_m or _rad"
            }
            Self::TooFast => {
                "the base moves too fast to work from (base.speed_max_m_per_s, base.turn_rate_max_rad_per_s)"
            }
        }
    }
}

/// The base as believed at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseMotion {
    /// In the fixed frame.
    pub world_from_base: Pose<World, Base>,
    /// Of the base's origin against the floor, base axes.
    pub twist: Twist<Base>,
    /// Age of the newest pose in use, s; infinite without one.
    pub age_s: f64,
    /// Why not to rely on it; the motion is then what was known last, fading.
    pub trouble: Option<BaseTrouble>,
}

impl BaseMotion {
    /// Standing, at the origin.
    pub fn still() -> Self {
        Self {
            world_from_base: Pose::identity(),
            twist: Twist::zero(),
            age_s: f64::INFINITY,
            trouble: None,
        }
    }

    /// The same with the base at `origin` for the fixed frame.
    pub fn seen_from(&self, origin: &Pose<World, Base>) -> Self {
        let origin_from_base = origin.inverse() * self.world_from_base;
        Self {
            world_from_base: Pose::from_isometry(*origin_from_base.isometry()),
            ..*self
        }
    }

    /// No number is NaN or infinite, but the age.
    pub fn is_finite(&self) -> bool {
        let pose = self.world_from_base.isometry();
        pose.translation.vector.iter().all(|x| x.is_finite())
            && pose.rotation.coords.iter().all(|x| x.is_finite())
            && self.twist.is_finite()
    }

    /// Velocity against the floor of what is fixed to the base at `point` (base axes, m): linear, angular, base axes.
    pub fn carries(&self, point: &Vector3<f64>) -> Twist<Aligned<Tool, Base>> {
        Twist::new(
            self.twist.linear + self.twist.angular.cross(point),
            self.twist.angular,
        )
    }

    /// The tool's velocity against the floor, in axes of the fixed frame.
    pub fn over_ground(
        &self,
        base_from_tool: &Pose<Base, Tool>,
        twist: &Twist<Aligned<Tool, Base>>,
    ) -> Twist<Aligned<Tool, World>> {
        let sum = *twist + self.carries(&base_from_tool.translation());
        Twist::new(
            self.world_from_base.rotate(&sum.linear),
            self.world_from_base.rotate(&sum.angular),
        )
    }

    /// Undoes [`BaseMotion::over_ground`]: what the arm has to do for the tool to move so.
    pub fn against_base(
        &self,
        base_from_tool: &Pose<Base, Tool>,
        twist: &Twist<Aligned<Tool, World>>,
    ) -> Twist<Aligned<Tool, Base>> {
        let in_base: Twist<Aligned<Tool, Base>> = Twist::new(
            self.world_from_base.unrotate(&twist.linear),
            self.world_from_base.unrotate(&twist.angular),
        );
        in_base - self.carries(&base_from_tool.translation())
    }
}

/// A gap after which the motion is learnt anew, s.
const GAP_S: f64 = 0.5;
/// Two clocks that disagree by more about the time between two messages: one of them was set, s.
const CLOCK_STEP_S: f64 = 0.5;
/// A publisher whose stamps stay behind for so long has had its clock set back, s.
const SET_BACK_S: f64 = 1.0;
/// How fast the quickest arrival is forgotten, s/s: clocks drift by up to 100 ppm.
const CLOCK_DRIFT: f64 = 2e-4;
/// A quaternion's length may be off by rounding to single precision, not more.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Acceleration of a platform that carries an arm at work: what a step may differ by over a gap, m/s² and rad/s².
const ACCELERATION: f64 = 0.2;
/// A velocity that changes while the filter still learns it accounts for this share of the step.
const LEARNING_SHARE: f64 = 0.5;
/// No platform and no map reaches further, m.
const REACH_M: f64 = 1e8;

#[derive(Clone, Copy, Debug)]
struct Track {
    publisher: [u8; 16],
    stamp_s: f64,
    arrived_s: f64,
    /// From the platform's clock to the reader's, by the quickest message so far.
    clock_offset_s: f64,
    /// The last pose as measured, and what takes the map to the fixed frame.
    measured: Isometry3<f64>,
    fixed_from_map: Isometry3<f64>,
    filter: PoseFilter,
    /// Since when it has been steady, on the reader's clock.
    steady_since_s: f64,
    refused: Option<BaseTrouble>,
}

/// Follows one base. A fresh one has never heard of a platform.
#[derive(Clone, Copy, Debug)]
pub struct BaseTracker {
    config: BaseConfig,
    track: Option<Track>,
    refusals: u64,
}

impl BaseTracker {
    /// The configuration must have passed [`BaseConfig::check`].
    pub fn new(config: &BaseConfig) -> Self {
        Self {
            config: *config,
            track: None,
            refusals: 0,
        }
    }

    /// Poses refused so far.
    pub fn refusals(&self) -> u64 {
        self.refusals
    }

    /// Takes a pose.
    ///
    /// # Errors
    /// Why it is not used. It then counts as silence, with that reason.
    pub fn take(&mut self, pose: &BasePose) -> Result<(), BaseTrouble> {
        let result = self.accept(pose);
        if let Err(trouble) = result {
            self.refusals += 1;
            if let Some(track) = &mut self.track {
                track.refused = Some(trouble);
            }
        }
        result
    }

    fn accept(&mut self, pose: &BasePose) -> Result<(), BaseTrouble> {
        let measured = self.read(pose)?;
        let config = self.config;
        let Some(track) = &mut self.track else {
            // The fixed frame begins where the base is seen first.
            self.track = Some(Track {
                publisher: pose.publisher,
                stamp_s: pose.stamp_s,
                arrived_s: pose.arrived_s,
                clock_offset_s: pose.arrived_s - pose.stamp_s,
                measured,
                fixed_from_map: measured.inverse(),
                filter: PoseFilter::at_rest(&Isometry3::identity()),
                steady_since_s: pose.arrived_s,
                refused: None,
            });
            return Ok(());
        };
        let since_s = pose.arrived_s - track.arrived_s;
        let said_s = pose.stamp_s - track.stamp_s;
        let anew = pose.publisher != track.publisher || said_s - since_s > CLOCK_STEP_S;
        if !anew && said_s <= 0.0 {
            if since_s < SET_BACK_S {
                return Err(BaseTrouble::OutOfOrder);
            }
        } else if !anew {
            let least = track.clock_offset_s + since_s.max(0.0) * CLOCK_DRIFT;
            let offset = pose.arrived_s - pose.stamp_s;
            if offset - least > config.patience_s {
                return Err(BaseTrouble::Late);
            }
            track.clock_offset_s = least.min(offset);
        }
        let anew = anew || said_s <= 0.0;
        if anew {
            // Its clock and its map may be others: the motion goes on as it was, until its poses tell more.
            track.clock_offset_s = pose.arrived_s - pose.stamp_s;
            let known = config.patience_s;
            track.filter = track.filter.after(since_s, known);
            track.fixed_from_map = track.filter.pose() * measured.inverse();
            track.steady_since_s = pose.arrived_s;
        } else if said_s > GAP_S {
            // The map still holds, the velocity does not.
            track.filter = PoseFilter::at_rest(&(track.fixed_from_map * measured));
            track.steady_since_s = pose.arrived_s;
        } else {
            if jumped(&config, track, &measured, said_s) {
                let predicted = track.filter.after(said_s, config.patience_s);
                track.fixed_from_map = predicted.pose() * measured.inverse();
                track.steady_since_s = pose.arrived_s;
            }
            track.filter.take(
                &(track.fixed_from_map * measured),
                said_s,
                config.filter_rad_per_s,
            );
        }
        track.publisher = pose.publisher;
        track.stamp_s = pose.stamp_s;
        track.arrived_s = pose.arrived_s;
        track.measured = measured;
        track.refused = None;
        Ok(())
    }

    /// The message as a pose, if it is one.
    fn read(&self, pose: &BasePose) -> Result<Isometry3<f64>, BaseTrouble> {
        let [x, y, z, w] = pose.quaternion;
        let quaternion = nalgebra::Quaternion::new(w, x, y, z);
        let finite = pose.stamp_s.is_finite()
            && pose.arrived_s.is_finite()
            && pose.position.iter().all(|x| x.abs() < REACH_M)
            && quaternion.coords.iter().all(|x| x.is_finite())
            && pose.covariance.iter().all(|x| x.is_finite());
        if !finite {
            return Err(BaseTrouble::NotFinite);
        }
        if (quaternion.norm() - 1.0).abs() > UNIT_TOLERANCE {
            return Err(BaseTrouble::NotUnit);
        }
        let c = &self.config;
        for i in 0..6 {
            let most = if i < 3 {
                c.position_sd_max_m
            } else {
                c.orientation_sd_max_rad
            };
            let variance = pose.covariance[(i, i)];
            // A negative variance is what some drivers send for "do not use this".
            if variance > most * most || variance < 0.0 {
                return Err(BaseTrouble::Uncertain);
            }
        }
        Ok(Isometry3::from_parts(
            pose.position.into(),
            nalgebra::UnitQuaternion::from_quaternion(quaternion),
        ))
    }

    /// The base at `now_s` on the reader's clock; none where no platform was ever heard and none is required.
    pub fn at(&self, now_s: f64) -> Option<BaseMotion> {
        let Some(track) = &self.track else {
            return self.config.required.then(|| BaseMotion {
                trouble: Some(BaseTrouble::Missing),
                ..BaseMotion::still()
            });
        };
        let c = &self.config;
        let age_s = (now_s - track.stamp_s - track.clock_offset_s).max(0.0) + c.latency_s;
        let now = track.filter.after(age_s, c.patience_s + c.latency_s);
        let silent = now_s - track.arrived_s > c.patience_s;
        let fast = now.velocity.norm() > c.speed_max_m_per_s
            || now.turn_rate.norm() > c.turn_rate_max_rad_per_s;
        let trouble = if silent {
            Some(track.refused.unwrap_or(BaseTrouble::Silent))
        } else if now_s - track.steady_since_s < c.settle_s {
            Some(BaseTrouble::Unsettled)
        } else {
            fast.then_some(BaseTrouble::TooFast)
        };
        let world_from_base = Pose::from_isometry(now.pose());
        Some(BaseMotion {
            twist: Twist::new(
                world_from_base.unrotate(&now.velocity),
                world_from_base.unrotate(&now.turn_rate),
            ),
            world_from_base,
            age_s,
            trouble,
        })
    }
}

/// More than the motion accounts for.
fn jumped(config: &BaseConfig, track: &Track, measured: &Isometry3<f64>, dt_s: f64) -> bool {
    let (before, after) = (
        track.fixed_from_map * track.measured,
        track.fixed_from_map * measured,
    );
    let step = after.translation.vector - before.translation.vector;
    let turn = (after.rotation * before.rotation.inverse()).scaled_axis();
    let beyond = |step: Vector3<f64>, rate: &Vector3<f64>, most: f64| {
        let slack = LEARNING_SHARE * rate.norm() * dt_s + 0.5 * ACCELERATION * dt_s * dt_s;
        (step - rate * dt_s).norm() > most + slack
    };
    beyond(step, &track.filter.velocity, config.jump_m)
        || beyond(turn, &track.filter.turn_rate, config.jump_rad)
}

#[cfg(test)]
mod tests;
