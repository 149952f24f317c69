//! The gate of an arm that follows joint velocities: for any input, its output stays within every
//! limit.
//!
//! The bridge calls [`VelocityGate::step`] once per package to the robot. A valid command is
//! followed within the limits on joint speed, joint acceleration, joint position and tool speed.
//! After an invalid one, which is refused, the arm ramps to zero. A missing command is tolerated
//! for a few cycles, then the arm ramps to zero too. After longer silence, or whenever the arm may
//! not move, the present activation is latched out: only a newer one moves the arm again.
//!
//! One invariant makes all limits compatible: the output velocity can always be brought to zero
//! along its own direction, at the joints' acceleration limits, before any joint reaches its end
//! stop. Slowing down along its own direction violates no other limit, so there is always a safe
//! output.

use nalgebra::{SMatrix, Vector3};
use tangent_mechanics::Joints;
use tangent_schemas::CommandKind;

use crate::admission::{Admission, AdmissionRules};
use crate::command::Command;
use crate::motion_limits::MotionLimits;
use crate::refusal::Refusal;

/// Share of the tool's speed limits that is used; the rest covers the change of the Jacobian within
/// a cycle.
const TOOL_SPEED_SHARE: f64 = 0.98;
/// Distance that the tool keeps from the walls of its box, m: its path while stopping is not
/// exactly straight.
const WALL_MARGIN_M: f64 = 0.002;
/// Ratio to the limit up to which an excess speed counts as rounding and is scaled; a larger one is
/// refused.
const SPEED_TOLERANCE: f64 = 1.01;

/// Limits of an arm that follows joint velocities.
#[derive(Clone, Debug, PartialEq)]
pub struct VelocityLimits<const N: usize> {
    /// Limits on joints and tool.
    pub motion: MotionLimits<N>,
    /// Largest joint acceleration, base to flange, rad/s².
    pub acceleration_rad_per_s2: Joints<N>,
    /// Time from sending a velocity until the arm follows it, s: a stop may begin this much later
    /// than planned.
    pub response_s: f64,
    /// Number of cycles without a valid command for which the last one is followed.
    pub patience_cycles: u32,
    /// Time without commands after which the activation is latched out, s.
    pub silence_latch_s: f64,
}

/// Measured position of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture<const N: usize> {
    /// Joint positions, rad.
    pub q: Joints<N>,
    /// Position of the tool's origin, base axes, m.
    pub tool_m: Vector3<f64>,
    /// Jacobian from joint velocity to the twist of the tool's origin, base axes: m/s above rad/s.
    pub tool_jacobian: SMatrix<f64, 6, N>,
}

/// Whether the robot follows commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Permission {
    /// The robot follows, and may be moved.
    Move,
    /// The robot follows, but must come to rest.
    RampDown,
    /// The robot does not follow: it stands, or its own controller is stopping it.
    Off,
}

impl Permission {
    /// The stricter of two permissions.
    pub fn min_with(self, other: Self) -> Self {
        match (self, other) {
            (Self::Off, _) | (_, Self::Off) => Self::Off,
            (Self::RampDown, _) | (_, Self::RampDown) => Self::RampDown,
            _ => Self::Move,
        }
    }
}

/// Output to the robot in this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed<const N: usize> {
    /// Joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Whether a command is being followed or the arm is ramping to rest; otherwise the robot only
    /// holds.
    pub streaming: bool,
    /// Whether the robot itself must stop and latch.
    pub soft_stop: bool,
}

/// The gate of an arm that follows joint velocities, with its state. The crate documentation has an
/// example.
#[derive(Clone, Debug)]
pub struct VelocityGate<const N: usize> {
    limits: VelocityLimits<N>,
    period_s: f64,
    /// Admission of the commands.
    pub admission: Admission<Target<N>>,
    qd: Joints<N>,
    limited: u64,
}

/// Motion requested by a command.
#[derive(Clone, Copy, Debug)]
pub struct Target<const N: usize> {
    qd: Joints<N>,
    acceleration: f64,
}

impl<const N: usize> VelocityGate<N> {
    /// `period_s`: the robot's control period.
    pub fn new(limits: VelocityLimits<N>, period_s: f64) -> Self {
        Self {
            admission: Admission::new(AdmissionRules {
                moves: CommandKind::JointVelocity,
                patience_cycles: limits.patience_cycles,
                silence_latch_s: limits.silence_latch_s,
                refusal_ends_task: false,
            }),
            limits,
            period_s,
            qd: Joints::zeros(),
            limited: 0,
        }
    }

    /// Sets the robot's control period, s, once it is known.
    pub fn set_period(&mut self, period_s: f64) {
        self.period_s = period_s;
    }

    /// Processes one cycle. `arrived` is a command that was not passed before. `cycle` is the
    /// number of the robot's present packet; the same number again is a heartbeat, sent because the
    /// robot's next packet is late.
    pub fn step(
        &mut self,
        cycle: u64,
        permission: Permission,
        posture: &Posture<N>,
        arrived: Option<&Command<'_>>,
    ) -> Allowed<N> {
        let limits = &self.limits.motion;
        let may_move = permission == Permission::Move;
        let heard = self
            .admission
            .begin(cycle, may_move, arrived, |command| read(limits, command));
        if permission == Permission::Off || heard.soft_stop {
            // The robot makes its own stop; the next motion starts from rest.
            self.qd = Joints::zeros();
            return Allowed {
                qd: self.qd,
                streaming: false,
                soft_stop: heard.soft_stop,
            };
        }
        self.admission.count_missed(cycle);
        self.admission.latch_after_silence(self.period_s);
        let followed = self.admission.followed(heard);
        let target = followed.unwrap_or(Target {
            qd: Joints::zeros(),
            acceleration: f64::INFINITY,
        });
        self.qd = self.limit(&target, posture);
        Allowed {
            qd: self.qd,
            streaming: followed.is_some() || self.qd != Joints::<N>::zeros(),
            soft_stop: false,
        }
    }

    /// Last output velocity, rad/s.
    pub fn qd(&self) -> &Joints<N> {
        &self.qd
    }

    /// Number of cycles in which a limit changed the command.
    pub fn limited(&self) -> u64 {
        self.limited
    }

    /// Acceleration for the robot's own ramp, rad/s²: the gate's steps are never steeper.
    pub fn acceleration(&self) -> f64 {
        self.limits.acceleration_rad_per_s2.max()
    }

    /// The velocity nearest to the target that satisfies every limit and the invariant.
    fn limit(&mut self, target: &Target<N>, posture: &Posture<N>) -> Joints<N> {
        let mut scale: f64 = 1.0;
        for (value, limit) in target.qd.iter().zip(&self.limits.motion.speed_rad_per_s) {
            if value.abs() > *limit {
                scale = scale.min(limit / value.abs());
            }
        }
        let excess = self.tool_excess(&target.qd, posture) / TOOL_SPEED_SHARE;
        if excess > 1.0 {
            scale = scale.min(1.0 / excess);
        }
        scale = scale.min(self.scale_that_can_stop(&target.qd, posture));
        let aim = target.qd * scale;
        if scale < 1.0 {
            self.limited += 1;
        }

        // Straight towards the target, as far as the acceleration limit of every joint permits.
        let step = aim - self.qd;
        let mut share: f64 = 1.0;
        for (i, delta) in step.iter().enumerate() {
            let acceleration = self.limits.acceleration_rad_per_s2[i].min(target.acceleration);
            let reach = acceleration * self.period_s;
            if delta.abs() > reach {
                share = share.min(reach / delta.abs());
            }
        }
        let next = if share < 1.0 {
            self.qd + step * share
        } else {
            aim
        };
        if self.tool_excess(&next, posture) <= 1.0 && self.can_stop(&next, posture) {
            next
        } else {
            self.brake()
        }
    }

    /// Tool speed and turn rate as shares of their limits; the larger of the two.
    fn tool_excess(&self, qd: &Joints<N>, posture: &Posture<N>) -> f64 {
        let limits = &self.limits.motion;
        let twist = posture.tool_jacobian * qd;
        let speed = twist.fixed_rows::<3>(0).norm() / limits.tool_speed_max_m_per_s;
        let turn = twist.fixed_rows::<3>(3).norm() / limits.tool_turn_rate_max_rad_per_s;
        speed.max(turn)
    }

    /// Slows down along the present direction, as hard as the acceleration limits allow.
    fn brake(&self) -> Joints<N> {
        let stop_s = self.stop_time_s(&self.qd);
        if stop_s <= self.period_s {
            Joints::zeros()
        } else {
            self.qd * (1.0 - self.period_s / stop_s)
        }
    }

    /// Time to bring `qd` to zero along its own direction, s.
    fn stop_time_s(&self, qd: &Joints<N>) -> f64 {
        qd.iter()
            .zip(&self.limits.acceleration_rad_per_s2)
            .map(|(v, a)| v.abs() / a)
            .fold(0.0, f64::max)
    }

    /// For each joint and each coordinate of the tool that moves: its speed and the remaining
    /// distance in that direction (rad/s and rad, m/s and m); the distance is negative beyond the
    /// limit.
    fn approaches(
        &self,
        qd: &Joints<N>,
        posture: &Posture<N>,
    ) -> impl Iterator<Item = (f64, f64)> + use<N> {
        let l = &self.limits.motion;
        let tool = (posture.tool_jacobian * qd).fixed_rows::<3>(0).into_owned();
        let joints: [(f64, f64); N] = std::array::from_fn(|i| {
            let (lower, upper) = (l.position_lower_rad[i], l.position_upper_rad[i]);
            (qd[i].abs(), room(qd[i], posture.q[i], lower, upper))
        });
        let walls: [(f64, f64); 3] = std::array::from_fn(|i| {
            let (lower, upper) = (l.workspace_lower_m[i], l.workspace_upper_m[i]);
            let room = room(tool[i], posture.tool_m[i], lower, upper);
            (tool[i].abs(), room - WALL_MARGIN_M)
        });
        joints
            .into_iter()
            .chain(walls)
            .filter(|(speed, _)| *speed > 0.0)
    }

    /// Uncertainty of a stop in time, s: half a cycle of the discrete ramp, and the arm's response.
    fn lag_s(&self) -> f64 {
        0.5 * self.period_s + self.limits.response_s
    }

    /// The invariant: a stop along the direction of `qd` ends before every joint's end stop and
    /// every wall.
    fn can_stop(&self, qd: &Joints<N>, posture: &Posture<N>) -> bool {
        let reach_s = 0.5 * self.stop_time_s(qd) + self.lag_s();
        self.approaches(qd, posture)
            .all(|(speed, room)| speed * reach_s <= room)
    }

    /// The largest scale of `qd`, at most 1, for which the invariant holds:
    /// `|v|σ (σ t/2 + lag) = room`.
    fn scale_that_can_stop(&self, qd: &Joints<N>, posture: &Posture<N>) -> f64 {
        let half_stop_s = 0.5 * self.stop_time_s(qd);
        let lag_s = self.lag_s();
        let mut scale: f64 = 1.0;
        for (speed, room) in self.approaches(qd, posture) {
            if speed * (half_stop_s + lag_s) <= room {
                continue;
            }
            if room <= 0.0 {
                return 0.0;
            }
            let (a, c) = (speed * half_stop_s, speed * lag_s);
            // The positive root, in a form without cancellation.
            let root = 2.0 * room / (c + (c * c + 4.0 * a * room).sqrt());
            // Slightly less, so that rounding does not violate the invariant.
            scale = scale.min(root * (1.0 - 1e-12));
        }
        scale
    }
}

/// Motion requested by a command of joint velocities, or the reason of its refusal.
fn read<const N: usize>(
    limits: &MotionLimits<N>,
    command: &Command<'_>,
) -> Result<Target<N>, Refusal> {
    let qd: Joints<N> = command.joints()?;
    if command.acceleration.is_nan() {
        return Err(Refusal::NotFinite);
    }
    for (joint, (value, limit)) in qd.iter().zip(&limits.speed_rad_per_s).enumerate() {
        if value.abs() > limit * SPEED_TOLERANCE {
            return Err(Refusal::Speed {
                joint,
                value: *value,
                limit: *limit,
            });
        }
    }
    Ok(Target {
        qd,
        acceleration: if command.acceleration > 0.0 {
            command.acceleration
        } else {
            f64::INFINITY
        },
    })
}

/// Remaining distance of `x` in the direction of `v`.
fn room(v: f64, x: f64, lower: f64, upper: f64) -> f64 {
    if v > 0.0 { upper - x } else { x - lower }
}
