//! The gate of an arm that takes joint torques and compensates gravity itself: for any input, its
//! output torques are finite, within every joint's limit, and within the rate limit of the robot.
//!
//! The bridge calls [`TorqueGate::step`] once per answer. A valid command is followed. After an
//! invalid one, which is refused, the arm is held. A missing command is tolerated for a few cycles,
//! then the arm is held too. After longer silence, when the arm leaves its limits, or whenever it
//! may not move, the present activation is latched out: only a newer one moves the arm again.
//!
//! Holding is a torque law of its own, since a constant or zero torque does not stop the arm: the
//! last torque fades out while damping stops the motion, and then a spring keeps the arm at its
//! position. The robot adds gravity itself.

use nalgebra::{SMatrix, Vector3};
use tangent_mechanics::Joints;
use tangent_schemas::CommandKind;

use crate::admission::{Admission, AdmissionRules};
use crate::command::Command;
use crate::motion_limits::MotionLimits;
use crate::refusal::Refusal;

/// Ratio to the limit up to which an excess torque counts as rounding and is clipped; a larger one
/// is refused.
const TORQUE_TOLERANCE: f64 = 1.01;
/// Time in which the last torque fades out, s.
const FADE_S: f64 = 0.05;
/// Time after that in which the spring of the hold grows to its stiffness, s.
const SPRING_S: f64 = 0.2;
/// Maximum share of a joint's limit that the hold's spring uses.
const SPRING_SHARE: f64 = 0.3;
/// Margin on the speed limits: the measurement is noisy, and a torque does not set a speed.
const SPEED_ROOM: f64 = 1.2;

/// Limits of an arm that takes joint torques; per joint from base to flange.
#[derive(Clone, Debug, PartialEq)]
pub struct TorqueLimits<const N: usize> {
    /// Limits on joints and tool. An arm that leaves them is held.
    pub motion: MotionLimits<N>,
    /// Largest joint torque, without gravity, Nm.
    pub torque_nm: Joints<N>,
    /// Largest rate of a joint torque, Nm/s.
    pub torque_rate_nm_per_s: Joints<N>,
    /// Stiffness of the hold, Nm/rad.
    pub hold_stiffness: Joints<N>,
    /// Damping of the hold, Nm s/rad.
    pub hold_damping: Joints<N>,
    /// Number of cycles without a valid command for which the last one is followed.
    pub patience_cycles: u32,
    /// Time without commands after which the activation is latched out, s.
    pub silence_latch_s: f64,
}

/// Measured state of the arm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture<const N: usize> {
    /// Joint positions, rad.
    pub q: Joints<N>,
    /// Joint velocities, rad/s.
    pub qd: Joints<N>,
    /// Torque that the robot applies now, without gravity, Nm.
    pub torque: Joints<N>,
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
    /// The robot follows, but no source may move it: it is held.
    Hold,
    /// The robot does not follow torques now.
    Off,
}

/// A limit that the arm itself exceeded, whatever the torques were.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trip {
    /// Joint (from 0), speed, rad/s, and limit, rad/s.
    JointSpeed(usize, f64, f64),
    /// Joint (from 0), position, rad.
    JointPosition(usize, f64),
    /// Tool speed, m/s, and limit, m/s.
    ToolSpeed(f64, f64),
    /// Turn rate of the tool, rad/s, and limit, rad/s.
    ToolTurnRate(f64, f64),
    /// Coordinate (0 to 2), position, m.
    Workspace(usize, f64),
}

impl std::fmt::Display for Trip {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::JointSpeed(joint, value, limit) => write!(
                f,
                "joint {} at {value:.2} rad/s, limit {limit:.2} rad/s",
                joint + 1
            ),
            Self::JointPosition(joint, value) => {
                write!(f, "joint {} at {value:.3} rad, at its limit", joint + 1)
            }
            Self::ToolSpeed(value, limit) => {
                write!(f, "tool at {value:.3} m/s, limit {limit:.3} m/s")
            }
            Self::ToolTurnRate(value, limit) => {
                write!(f, "tool at {value:.2} rad/s, limit {limit:.2} rad/s")
            }
            Self::Workspace(axis, value) => write!(
                f,
                "tool at {} = {value:.3} m, outside its box",
                ['x', 'y', 'z'][*axis]
            ),
        }
    }
}

/// Output to the robot in this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed<const N: usize> {
    /// Torque without gravity, Nm.
    pub torque: Joints<N>,
    /// Whether a command is being followed; otherwise the arm is held.
    pub following: bool,
    /// Whether the robot itself must end the motion.
    pub soft_stop: bool,
}

#[derive(Clone, Copy, Debug)]
struct Hold<const N: usize> {
    from: Joints<N>,
    q: Joints<N>,
    age_s: f64,
}

/// The gate of an arm that takes joint torques, with its state.
///
/// ```
/// use nalgebra::{SMatrix, Vector3};
/// use tangent_actuation::torque::{Permission, Posture, TorqueGate, TorqueLimits};
/// use tangent_actuation::{Command, MotionLimits};
/// use tangent_mechanics::Joints;
/// use tangent_schemas::CommandKind;
///
/// let limits = TorqueLimits::<7> {
///     motion: MotionLimits {
///         speed_rad_per_s: Joints::repeat(1.0),
///         position_lower_rad: Joints::repeat(-2.0),
///         position_upper_rad: Joints::repeat(2.0),
///         tool_speed_max_m_per_s: 0.25,
///         tool_turn_rate_max_rad_per_s: 1.0,
///         workspace_lower_m: Vector3::repeat(-1.0),
///         workspace_upper_m: Vector3::repeat(1.0),
///     },
///     torque_nm: Joints::repeat(10.0),
///     torque_rate_nm_per_s: Joints::repeat(900.0),
///     hold_stiffness: Joints::repeat(100.0),
///     hold_damping: Joints::repeat(10.0),
///     patience_cycles: 2,
///     silence_latch_s: 0.1,
/// };
/// let mut gate = TorqueGate::new(limits, 0.001);
/// let posture = Posture {
///     q: Joints::zeros(),
///     qd: Joints::zeros(),
///     torque: Joints::zeros(),
///     tool_m: Vector3::zeros(),
///     tool_jacobian: SMatrix::zeros(),
/// };
/// let command = Command {
///     cycle: 1,
///     kind: CommandKind::JointTorque.number(),
///     values: &[5.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
///     acceleration: 0.0,
///     activation: 1,
/// };
/// let allowed = gate.step(1, Permission::Move, &posture, Some(&command));
/// assert!(allowed.following);
/// // A step in the command leaves as a ramp of 900 Nm/s.
/// assert!((allowed.torque[0] - 0.9).abs() < 1e-12);
/// ```
#[derive(Clone, Debug)]
pub struct TorqueGate<const N: usize> {
    limits: TorqueLimits<N>,
    period_s: f64,
    /// Admission of the commands.
    pub admission: Admission<Joints<N>>,
    hold: Option<Hold<N>>,
    limited: u64,
    trip: Option<Trip>,
}

impl<const N: usize> TorqueGate<N> {
    /// `period_s`: the robot's control period.
    pub fn new(limits: TorqueLimits<N>, period_s: f64) -> Self {
        Self {
            admission: Admission::new(AdmissionRules {
                moves: CommandKind::JointTorque,
                patience_cycles: limits.patience_cycles,
                silence_latch_s: limits.silence_latch_s,
                refusal_ends_task: false,
            }),
            limits,
            period_s,
            hold: None,
            limited: 0,
            trip: None,
        }
    }

    /// Processes one cycle. `arrived` is a command that was not passed before; `cycle` is the
    /// number of the robot's present packet.
    pub fn step(
        &mut self,
        cycle: u64,
        permission: Permission,
        posture: &Posture<N>,
        arrived: Option<&Command<'_>>,
    ) -> Allowed<N> {
        let most = &self.limits.torque_nm;
        let may_move = permission == Permission::Move;
        let heard = self.admission.begin(cycle, may_move, arrived, |command| {
            read_torques(most, command)
        });
        if permission == Permission::Off || heard.soft_stop {
            // The robot's own controller is active; the next motion starts from zero torque.
            self.hold = None;
            return Allowed {
                torque: Joints::zeros(),
                following: false,
                soft_stop: heard.soft_stop,
            };
        }
        self.admission.count_missed(cycle);
        if self.admission.is_commanded() {
            self.trip = self.tripped(posture);
            if self.trip.is_some() {
                self.admission.latch();
            }
        }
        self.admission.latch_after_silence(self.period_s);
        let followed = self.admission.followed(heard);
        let aim = match followed {
            Some(target) => {
                self.hold = None;
                target
            }
            None => self.held(posture),
        };
        Allowed {
            torque: self.limit(&aim, posture, followed.is_some()),
            following: followed.is_some(),
            soft_stop: false,
        }
    }

    /// Number of cycles in which a limit changed the command.
    pub fn limited(&self) -> u64 {
        self.limited
    }

    /// Limit that the arm exceeded when it last moved, if any.
    pub fn trip(&self) -> Option<&Trip> {
        self.trip.as_ref()
    }

    /// Torque that brings the arm to rest and keeps it there.
    fn held(&mut self, posture: &Posture<N>) -> Joints<N> {
        let hold = self.hold.get_or_insert(Hold {
            from: posture.torque,
            q: posture.q,
            age_s: 0.0,
        });
        if hold.age_s < FADE_S {
            // The spring's rest position is that of the arm once the old torque is gone.
            hold.q = posture.q;
        }
        let fade = smooth(hold.age_s / FADE_S);
        let grow = smooth((hold.age_s - FADE_S) / SPRING_S);
        let limits = &self.limits;
        let torque = Joints::from_fn(|i, _| {
            let most = SPRING_SHARE * limits.torque_nm[i];
            let spring = limits.hold_stiffness[i] * (hold.q[i] - posture.q[i]);
            let damping = -limits.hold_damping[i] * posture.qd[i];
            hold.from[i] * (1.0 - fade) + damping * fade + grow * spring.clamp(-most, most)
        });
        hold.age_s += self.period_s;
        torque
    }

    /// Limits a torque to the joints' limits, and to the rate limit relative to the torque that the
    /// robot applies now.
    fn limit(&mut self, aim: &Joints<N>, posture: &Posture<N>, counts: bool) -> Joints<N> {
        let limits = &self.limits;
        let period_s = self.period_s;
        let torque = Joints::from_fn(|i, _| {
            let reach = limits.torque_rate_nm_per_s[i] * period_s;
            let most = limits.torque_nm[i];
            aim[i]
                .clamp(-most, most)
                .clamp(posture.torque[i] - reach, posture.torque[i] + reach)
        });
        if counts && torque != *aim {
            self.limited += 1;
        }
        torque
    }

    fn tripped(&self, posture: &Posture<N>) -> Option<Trip> {
        let l = &self.limits.motion;
        for i in 0..N {
            let (q, qd) = (posture.q[i], posture.qd[i]);
            if qd.abs() > SPEED_ROOM * l.speed_rad_per_s[i] {
                return Some(Trip::JointSpeed(i, qd, l.speed_rad_per_s[i]));
            }
            // A joint outside its range may move back inside.
            let (lower, upper) = (l.position_lower_rad[i], l.position_upper_rad[i]);
            if (q < lower && qd <= 0.0) || (q > upper && qd >= 0.0) {
                return Some(Trip::JointPosition(i, q));
            }
        }
        let twist = posture.tool_jacobian * posture.qd;
        let speed = twist.fixed_rows::<3>(0).norm();
        if speed > SPEED_ROOM * l.tool_speed_max_m_per_s {
            return Some(Trip::ToolSpeed(speed, l.tool_speed_max_m_per_s));
        }
        let turn = twist.fixed_rows::<3>(3).norm();
        if turn > SPEED_ROOM * l.tool_turn_rate_max_rad_per_s {
            return Some(Trip::ToolTurnRate(turn, l.tool_turn_rate_max_rad_per_s));
        }
        (0..3).find_map(|i| {
            let (x, v) = (posture.tool_m[i], twist[i]);
            let out = (x < l.workspace_lower_m[i] && v <= 0.0)
                || (x > l.workspace_upper_m[i] && v >= 0.0);
            out.then_some(Trip::Workspace(i, x))
        })
    }
}

/// Torques (Nm) of a command, each within `most` except for rounding, or the reason of their
/// refusal.
///
/// # Errors
/// [`Refusal`]: another number of joints, a value that is not finite, or one that exceeds its
/// limit.
pub fn read_torques<const N: usize>(
    most: &Joints<N>,
    command: &Command<'_>,
) -> Result<Joints<N>, Refusal> {
    let torque: Joints<N> = command.joints()?;
    for (joint, (value, limit)) in torque.iter().zip(most).enumerate() {
        if value.abs() > limit * TORQUE_TOLERANCE {
            return Err(Refusal::Torque {
                joint,
                value: *value,
                limit: *limit,
            });
        }
    }
    Ok(torque)
}

/// Smooth step from 0 to 1, continuous in value and slope.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
