//! Position and motion of a moving base, estimated from the poses that its platform publishes
//! (`base/pose`).
//!
//! Called by the controller, the estimator service and the closed loop of `evaluate`: `take` for
//! every pose, `at` once per cycle. The result is in a [`World`] that is fixed to the floor and
//! coincides with the base at its first pose, so that numbers stay small on any map. When the map
//! jumps under the platform (relocalisation), this frame stays fixed to the surface.

mod config;
mod pose_filter;

use nalgebra::{Matrix6, Vector3};
use tangent_mechanics::{Aligned, Base, Point, Pose, Tool, Twist, World};

pub use config::BaseConfig;
use pose_filter::PoseFilter;

/// Frame of the platform's map. Relocalisation moves it in [`World`].
#[derive(Clone, Copy, Debug)]
struct Map;

/// One pose message of the platform.
#[derive(Clone, Copy, Debug)]
pub struct BasePose {
    /// Id of the publisher. Another publisher may have another clock and map.
    pub publisher: [u8; 16],
    /// Time of measurement on the platform's clock, s.
    pub stamp_s: f64,
    /// Time of arrival on the reader's clock, s. The two clocks need not agree.
    pub arrived_s: f64,
    /// Position of the base in the platform's map, m.
    pub position: Vector3<f64>,
    /// Orientation as received: x, y, z, w, not normalised.
    pub quaternion: [f64; 4],
    /// Covariance of position (m²), then of small rotations about the fixed axes (rad²). All zero:
    /// not known.
    pub covariance: Matrix6<f64>,
}

/// Why the motion of the base is not reliable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BaseTrouble {
    /// No pose has been received, and the cell requires one.
    Missing,
    /// No pose has arrived within the patience.
    Silent,
    /// The pose has jumped or has only just begun: it has not been steady for long enough.
    Unsettled,
    /// A number is not finite, or the position is implausibly far away.
    NotFinite,
    /// The quaternion is not of unit length.
    NotUnit,
    /// The pose is not newer than the last one.
    OutOfOrder,
    /// The pose arrived too long after its measurement.
    Late,
    /// A variance is too large, or negative.
    Uncertain,
    /// The base moves too fast to keep a tool on a surface.
    TooFast,
}

impl BaseTrouble {
    /// What is wrong and what to do, as text.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Missing => {
                "no base/pose, and the cell has a moving base: is the platform running?"
            }
            Self::Silent => "base/pose is no longer received: check the platform's odometry",
            Self::Unsettled => {
                "base/pose is not steady: it has only begun, or it jumps (relocalisation, slip, two publishers)"
            }
            Self::NotFinite => "base/pose is not a finite number",
            Self::NotUnit => "base/pose has a quaternion whose length is not one",
            Self::OutOfOrder => {
                "base/pose arrives out of order: two publishers, or a clock that was set back"
            }
            Self::Late => "base/pose arrives too late: check the network to the platform",
            Self::Uncertain => {
                "base/pose is too uncertain: its covariance is beyond base.position_sd_max_m or _rad"
            }
            Self::TooFast => {
                "the base moves too fast to work on (base.speed_max_m_per_s, base.turn_rate_max_rad_per_s)"
            }
        }
    }
}

/// Estimated pose and motion of the base at one moment.
///
/// ```
/// use nalgebra::Vector3;
/// use tangent_mechanics::{Pose, Twist};
/// use tangent_sensing::BaseMotion;
///
/// // The arm must move backwards to hold its tool over a fixed point while the platform drives.
/// let base = BaseMotion {
///     twist: Twist::new(Vector3::new(0.05, 0.0, 0.0), Vector3::zeros()),
///     ..BaseMotion::still()
/// };
/// let arm = base.against_base(&Pose::identity(), &Twist::zero());
/// assert_eq!(arm.linear, Vector3::new(-0.05, 0.0, 0.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseMotion {
    /// Pose of the base in the world.
    pub world_from_base: Pose<World, Base>,
    /// Twist of the base's origin relative to the floor, base axes, m/s and rad/s.
    pub twist: Twist<Base>,
    /// Age of the newest pose in use, s; infinite without one.
    pub age_s: f64,
    /// Why the motion is not reliable; it is then the last known motion, decaying.
    pub trouble: Option<BaseTrouble>,
}

impl BaseMotion {
    /// A base at rest at the origin of the world.
    pub fn still() -> Self {
        Self {
            world_from_base: Pose::identity(),
            twist: Twist::zero(),
            age_s: f64::INFINITY,
            trouble: None,
        }
    }

    /// Pose of a second world frame, fixed to the floor where the base is now.
    pub fn world_here(&self) -> Pose<World, World> {
        Pose::from_isometry(*self.world_from_base.isometry())
    }

    /// This motion in a second world frame, whose pose in the present one is `origin`
    /// ([`BaseMotion::world_here`]).
    pub fn seen_from(&self, origin: &Pose<World, World>) -> Self {
        Self {
            world_from_base: origin.inverse() * self.world_from_base,
            ..*self
        }
    }

    /// Whether all numbers are finite; the age need not be.
    pub fn is_finite(&self) -> bool {
        let pose = self.world_from_base.isometry();
        pose.translation.vector.iter().all(|x| x.is_finite())
            && pose.rotation.coords.iter().all(|x| x.is_finite())
            && self.twist.is_finite()
    }

    /// Velocity relative to the floor, base axes, of a tool that is fixed to the base at `point`.
    pub fn carries(&self, point: &Point<Base>) -> Twist<Aligned<Tool, Base>> {
        Twist::new(
            self.twist.linear + self.twist.angular.cross(&point.coordinates()),
            self.twist.angular,
        )
    }

    /// Velocity of the tool relative to the floor, in world axes.
    pub fn over_ground(
        &self,
        base_from_tool: &Pose<Base, Tool>,
        twist: &Twist<Aligned<Tool, Base>>,
    ) -> Twist<Aligned<Tool, World>> {
        let sum = *twist + self.carries(&base_from_tool.origin());
        Twist::new(
            self.world_from_base.rotate(&sum.linear),
            self.world_from_base.rotate(&sum.angular),
        )
    }

    /// Inverse of [`BaseMotion::over_ground`]: velocity of the tool relative to the base.
    pub fn against_base(
        &self,
        base_from_tool: &Pose<Base, Tool>,
        twist: &Twist<Aligned<Tool, World>>,
    ) -> Twist<Aligned<Tool, Base>> {
        let in_base: Twist<Aligned<Tool, Base>> = Twist::new(
            self.world_from_base.unrotate(&twist.linear),
            self.world_from_base.unrotate(&twist.angular),
        );
        in_base - self.carries(&base_from_tool.origin())
    }
}

/// Gap between two stamps after which the velocity is estimated anew, s.
const GAP_S: f64 = 0.5;
/// If the stamps of two messages differ by so much more than their arrivals, one of the clocks was
/// set, s.
const CLOCK_STEP_S: f64 = 0.5;
/// Time for which stamps must stay behind before the publisher's clock counts as set back, s.
const SET_BACK_S: f64 = 1.0;
/// Rate at which the smallest clock offset seen so far is relaxed, s/s: clocks drift by up to 100
/// ppm.
const CLOCK_DRIFT: f64 = 2e-4;
/// Allowed deviation of a quaternion's length from one: rounding to single precision.
const UNIT_TOLERANCE: f64 = 1e-3;
/// Assumed acceleration of a platform that carries a working arm, m/s² and rad/s². It bounds how
/// far the step between two poses may deviate from the estimated motion.
const ACCELERATION: f64 = 0.2;
/// Share of the estimated motion by which a step may deviate besides, as the filter follows a
/// changing velocity with a lag.
const LEARNING_SHARE: f64 = 0.5;
/// Bound on the coordinates of a pose, m: no platform and no map is larger.
const REACH_M: f64 = 1e8;

/// State from the poses received so far.
#[derive(Clone, Copy, Debug)]
struct Track {
    publisher: [u8; 16],
    stamp_s: f64,
    arrived_s: f64,
    /// Offset from the platform's clock to the reader's: the smallest seen so far, s.
    clock_offset_s: f64,
    /// Last measured pose.
    map_from_base: Pose<Map, Base>,
    world_from_map: Pose<World, Map>,
    filter: PoseFilter,
    /// Time since which the pose has been steady, on the reader's clock, s.
    steady_since_s: f64,
    refused: Option<BaseTrouble>,
}

/// Tracks the motion of one base. A new tracker has received no pose.
///
/// ```
/// use nalgebra::{Matrix6, Vector3};
/// use tangent_sensing::{BaseConfig, BasePose, BaseTracker, BaseTrouble};
///
/// let mut tracker = BaseTracker::new(&BaseConfig::default());
/// assert!(tracker.at(0.0).is_none(), "a base without poses counts as fixed");
/// for i in 0..100 {
///     let time_s = 0.02 * f64::from(i);
///     tracker.take(&BasePose {
///         publisher: [1; 16],
///         stamp_s: time_s,
///         arrived_s: time_s,
///         position: Vector3::new(0.03 * time_s, 0.0, 0.0),
///         quaternion: [0.0, 0.0, 0.0, 1.0],
///         covariance: Matrix6::zeros(),
///     })?;
/// }
/// let motion = tracker.at(1.98).expect("poses were received");
/// assert_eq!(motion.trouble, None);
/// assert!((motion.twist.linear.x - 0.03).abs() < 1e-3);
/// # Ok::<(), BaseTrouble>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct BaseTracker {
    config: BaseConfig,
    track: Option<Track>,
    refusals: u64,
}

impl BaseTracker {
    /// Creates a tracker. The configuration must have passed [`BaseConfig::check`].
    pub fn new(config: &BaseConfig) -> Self {
        Self {
            config: *config,
            track: None,
            refusals: 0,
        }
    }

    /// Number of poses refused so far.
    pub fn refusals(&self) -> u64 {
        self.refusals
    }

    /// Takes a pose.
    ///
    /// # Errors
    /// Why the pose is refused. A refused pose counts as silence, with that reason.
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
            // The world coincides with the base at its first pose.
            self.track = Some(Track {
                publisher: pose.publisher,
                stamp_s: pose.stamp_s,
                arrived_s: pose.arrived_s,
                clock_offset_s: pose.arrived_s - pose.stamp_s,
                map_from_base: measured,
                world_from_map: Pose::identity() * measured.inverse(),
                filter: PoseFilter::at_rest(&Pose::identity()),
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
            // The clock and the map may be different ones: the estimated motion continues until
            // further poses correct it.
            track.clock_offset_s = pose.arrived_s - pose.stamp_s;
            let known = config.patience_s;
            track.filter = track.filter.after(since_s, known);
            track.world_from_map = track.filter.pose() * measured.inverse();
            track.steady_since_s = pose.arrived_s;
        } else if said_s > GAP_S {
            // The map is still valid, the velocity is not.
            track.filter = PoseFilter::at_rest(&(track.world_from_map * measured));
            track.steady_since_s = pose.arrived_s;
        } else {
            if jumped(&config, track, &measured, said_s) {
                let predicted = track.filter.after(said_s, config.patience_s);
                track.world_from_map = predicted.pose() * measured.inverse();
                track.steady_since_s = pose.arrived_s;
            }
            track.filter.take(
                &(track.world_from_map * measured),
                said_s,
                config.filter_rad_per_s,
            );
        }
        track.publisher = pose.publisher;
        track.stamp_s = pose.stamp_s;
        track.arrived_s = pose.arrived_s;
        track.map_from_base = measured;
        track.refused = None;
        Ok(())
    }

    /// Checks the numbers of a message and converts it to a pose.
    fn read(&self, pose: &BasePose) -> Result<Pose<Map, Base>, BaseTrouble> {
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
        Ok(Pose::new(
            pose.position,
            nalgebra::UnitQuaternion::from_quaternion(quaternion),
        ))
    }

    /// Motion of the base at `now_s` on the reader's clock; `None` if no pose was received and none
    /// is required.
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
        let world_from_base = now.pose();
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

/// Whether the step between two poses exceeds what the estimated motion explains.
fn jumped(config: &BaseConfig, track: &Track, measured: &Pose<Map, Base>, dt_s: f64) -> bool {
    let (before, after) = (
        track.world_from_map * track.map_from_base,
        track.world_from_map * *measured,
    );
    let step = after.translation() - before.translation();
    let turn = (after.rotation() * before.rotation().inverse()).scaled_axis();
    let beyond = |step: Vector3<f64>, rate: &Vector3<f64>, most: f64| {
        let slack = LEARNING_SHARE * rate.norm() * dt_s + 0.5 * ACCELERATION * dt_s * dt_s;
        (step - rate * dt_s).norm() > most + slack
    };
    beyond(step, &track.filter.velocity, config.jump_m)
        || beyond(turn, &track.filter.turn_rate, config.jump_rad)
}

#[cfg(test)]
mod tests;
