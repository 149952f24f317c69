//! The gate of an arm that follows joint velocities: whatever it is told, what it lets through
//! stays inside every limit.
//!
//! The bridge calls [`VelocityGate::step`] once per package to the robot. A good command is
//! followed within the limits on joint speed, joint acceleration, joint position and tool speed. A
//! bad one is refused and the arm ramps to zero; silence is ridden out for a few cycles, then it
//! ramps to zero too. After longer silence, or whenever the arm may not move, the present
//! activation is latched out: only a newer one moves the arm again.
//!
//! What makes the limits hold together is one invariant: the velocity let through can always be
//! brought to zero along its own direction, at the joints' acceleration limits, before any joint
//! meets its stop. Slowing down along its own direction breaks no other limit, so there is always a
//! safe answer.

use nalgebra::{SMatrix, Vector3};
use tangent_mechanics::Joints;
use tangent_schemas::CommandKind;

use crate::admission::{Admission, AdmissionRules};
use crate::{Command, Refusal};

/// Share of the tool's speed limits that is used; the rest covers what the Jacobian changes within
/// a cycle.
const TOOL_SPEED_SHARE: f64 = 0.98;
/// The tool keeps this far from the walls of its box, m: its path while it stops is not quite
/// straight.
const WALL_MARGIN_M: f64 = 0.002;
/// A command this much beyond the speed limit is rounding, and is scaled; beyond it, it is refused.
const SPEED_TOLERANCE: f64 = 1.01;

/// Limits of the cell, per joint from base to flange.
#[derive(Clone, Debug, PartialEq)]
pub struct VelocityLimits<const N: usize> {
    /// rad/s.
    pub speed_rad_per_s: Joints<N>,
    /// rad/s².
    pub acceleration_rad_per_s2: Joints<N>,
    /// rad.
    pub position_lower_rad: Joints<N>,
    /// rad.
    pub position_upper_rad: Joints<N>,
    /// Speed of the tool's origin, m/s.
    pub tool_speed_max_m_per_s: f64,
    /// Turn rate of the tool, rad/s.
    pub tool_turn_rate_max_rad_per_s: f64,
    /// The tool's origin stays inside this box: lower corner, base axes, m.
    pub workspace_lower_m: Vector3<f64>,
    /// Upper corner, base axes, m.
    pub workspace_upper_m: Vector3<f64>,
    /// Time from a velocity sent to the arm following it, s: how much later than planned a stop may
    /// begin.
    pub response_s: f64,
    /// Cycles without a good command through which the last one is kept.
    pub patience_cycles: u32,
    /// Silence after which the activation is latched out, s.
    pub silence_latch_s: f64,
}

/// Where the arm is, as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture<const N: usize> {
    /// rad.
    pub q: Joints<N>,
    /// Tool's origin, base axes, m.
    pub tool_m: Vector3<f64>,
    /// Joint velocity to the twist of the tool's origin, base axes: m/s above rad/s.
    pub tool_jacobian: SMatrix<f64, 6, N>,
}

/// Whether the robot would follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Permission {
    /// It would.
    Move,
    /// It would, but shall come to rest.
    RampDown,
    /// It does not follow, and stands or is being stopped by its own controller.
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

/// What goes to the robot this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed<const N: usize> {
    /// rad/s.
    pub qd: Joints<N>,
    /// A command is being followed, or the arm is being ramped to rest; otherwise the robot just
    /// holds.
    pub streaming: bool,
    /// The robot itself shall stop and latch.
    pub soft_stop: bool,
}

/// The gate with its memory.
#[derive(Clone, Debug)]
pub struct VelocityGate<const N: usize> {
    limits: VelocityLimits<N>,
    period_s: f64,
    /// Which commands are taken.
    pub admission: Admission<Target<N>>,
    qd: Joints<N>,
    limited: u64,
}

/// What a command asks of the arm.
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

    /// The robot's control period, s, once it is known.
    pub fn set_period(&mut self, period_s: f64) {
        self.period_s = period_s;
    }

    /// One cycle. `arrived` is a command that was not given before. `cycle` is the number of the
    /// robot packet in hand; the same number again is a heartbeat, sent because the robot's next
    /// packet is late.
    pub fn step(
        &mut self,
        cycle: u64,
        permission: Permission,
        posture: &Posture<N>,
        arrived: Option<&Command<'_>>,
    ) -> Allowed<N> {
        let limits = &self.limits;
        let may_move = permission == Permission::Move;
        let heard = self
            .admission
            .hear(cycle, may_move, arrived, |command| read(limits, command));
        if permission == Permission::Off || heard.soft_stop {
            // The robot follows its own stop, not us; the next motion starts from rest.
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

    /// Velocity let through last, rad/s.
    pub fn qd(&self) -> &Joints<N> {
        &self.qd
    }

    /// Cycles in which a limit changed what was commanded.
    pub fn limited(&self) -> u64 {
        self.limited
    }

    /// Acceleration to tell the robot's own ramp, rad/s²: the gate's steps are never steeper.
    pub fn acceleration(&self) -> f64 {
        self.limits.acceleration_rad_per_s2.max()
    }

    /// The velocity nearest to the target that keeps every limit and the invariant.
    fn limit(&mut self, target: &Target<N>, posture: &Posture<N>) -> Joints<N> {
        let limits = &self.limits;
        let mut scale: f64 = 1.0;
        for (value, limit) in target.qd.iter().zip(&limits.speed_rad_per_s) {
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

        // Straight towards the aim, as far as every joint's acceleration goes.
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

    /// The tool's speed and turn rate as shares of their limits, the larger of both.
    fn tool_excess(&self, qd: &Joints<N>, posture: &Posture<N>) -> f64 {
        let twist = posture.tool_jacobian * qd;
        let speed = twist.fixed_rows::<3>(0).norm() / self.limits.tool_speed_max_m_per_s;
        let turn = twist.fixed_rows::<3>(3).norm() / self.limits.tool_turn_rate_max_rad_per_s;
        speed.max(turn)
    }

    /// Slower along its own direction, as hard as the acceleration limits allow.
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

    /// What must stop in time: for each joint and each coordinate of the tool that moves, its speed
    /// and the room left in that direction (rad/s and rad, m/s and m); room is negative beyond the
    /// limit.
    fn approaches(
        &self,
        qd: &Joints<N>,
        posture: &Posture<N>,
    ) -> impl Iterator<Item = (f64, f64)> + use<N> {
        let l = &self.limits;
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

    /// How far a stop may be off in time, s: half a cycle of the discrete ramp, and the arm's
    /// response.
    fn lag_s(&self) -> f64 {
        0.5 * self.period_s + self.limits.response_s
    }

    /// The invariant: a stop along its own direction ends before every joint's stop and every wall.
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
            // The positive root, in the form that does not cancel.
            let root = 2.0 * room / (c + (c * c + 4.0 * a * room).sqrt());
            // A hair less, so that rounding does not break the invariant it stands for.
            scale = scale.min(root * (1.0 - 1e-12));
        }
        scale
    }
}

/// What a command of joint velocities asks for, or why it is refused.
fn read<const N: usize>(
    limits: &VelocityLimits<N>,
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

/// How far `x` may still go in the direction of `v`.
fn room(v: f64, x: f64, lower: f64, upper: f64) -> f64 {
    if v > 0.0 { upper - x } else { x - lower }
}
