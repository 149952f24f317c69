//! The gate of an arm that takes joint torques and compensates gravity itself: whatever it is told,
//! the torques that leave are finite, inside every joint's limit, and never change faster than the
//! robot bears.
//!
//! The bridge calls [`TorqueGate::step`] once per answer. A good command is followed. A bad one is
//! refused and the arm goes over to being held; silence is ridden out for a few cycles, then it is
//! held too. After longer silence, when the arm leaves its limits, or whenever it may not move, the
//! present activation is latched out: only a newer one moves the arm again.
//!
//! Holding is a torque law of its own, since a torque that merely stays or vanishes is no stop: the
//! last torque fades out while damping takes the motion away, and a spring to where the arm then is
//! keeps it there. The robot adds gravity itself.

use nalgebra::{SMatrix, Vector3};
use tangent_mechanics::Joints;
use tangent_schemas::CommandKind;

use crate::admission::{Admission, AdmissionRules};
use crate::{Command, Refusal};

/// A torque this much beyond its limit is rounding, and is cut; beyond it, it is refused.
const TORQUE_TOLERANCE: f64 = 1.01;
/// The last torque fades out over this time, s.
const FADE_S: f64 = 0.05;
/// The spring of the hold grows to its stiffness over this time after that, s.
const SPRING_S: f64 = 0.2;
/// Share of a joint's limit that the hold's spring uses at most.
const SPRING_SHARE: f64 = 0.3;
/// Speed limits are judged with this much room: what is measured is noisy, and a torque does not
/// set a speed.
const SPEED_ROOM: f64 = 1.2;

/// Limits of the cell, per joint from base to flange.
#[derive(Clone, Debug, PartialEq)]
pub struct TorqueLimits<const N: usize> {
    /// Without gravity, Nm.
    pub torque_nm: Joints<N>,
    /// Nm/s.
    pub torque_rate_nm_per_s: Joints<N>,
    /// rad/s.
    pub speed_rad_per_s: Joints<N>,
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
    /// Stiffness of the hold, Nm/rad.
    pub hold_stiffness: Joints<N>,
    /// Damping of the hold, Nm s/rad.
    pub hold_damping: Joints<N>,
    /// Cycles without a good command through which the last one is kept.
    pub patience_cycles: u32,
    /// Silence after which the activation is latched out, s.
    pub silence_latch_s: f64,
}

/// Where the arm is and what its joints do, as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture<const N: usize> {
    /// rad.
    pub q: Joints<N>,
    /// rad/s.
    pub qd: Joints<N>,
    /// The torque that the robot goes by now, without gravity, Nm.
    pub torque: Joints<N>,
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
    /// It would, but no source may move it: it is held.
    Hold,
    /// It does not follow torques now.
    Off,
}

/// A limit that the arm itself left, whatever the torques were.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trip {
    /// Joint (from 0), rad/s, limit.
    JointSpeed(usize, f64, f64),
    /// Joint (from 0), rad.
    JointPosition(usize, f64),
    /// m/s, limit.
    ToolSpeed(f64, f64),
    /// rad/s, limit.
    ToolTurnRate(f64, f64),
    /// Coordinate (0 to 2), m.
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

/// What goes to the robot this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed<const N: usize> {
    /// Without gravity, Nm.
    pub torque: Joints<N>,
    /// A command is being followed; otherwise the arm is held.
    pub following: bool,
    /// The robot itself shall end the motion.
    pub soft_stop: bool,
}

#[derive(Clone, Copy, Debug)]
struct Hold<const N: usize> {
    from: Joints<N>,
    q: Joints<N>,
    age_s: f64,
}

/// The gate with its memory.
#[derive(Clone, Debug)]
pub struct TorqueGate<const N: usize> {
    limits: TorqueLimits<N>,
    period_s: f64,
    /// Which commands are taken.
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

    /// One answer. `arrived` is a command that was not given before; `cycle` the number of the
    /// robot's packet in hand.
    pub fn step(
        &mut self,
        cycle: u64,
        permission: Permission,
        posture: &Posture<N>,
        arrived: Option<&Command<'_>>,
    ) -> Allowed<N> {
        let most = &self.limits.torque_nm;
        let may_move = permission == Permission::Move;
        let heard = self.admission.hear(cycle, may_move, arrived, |command| {
            read_torques(most, command)
        });
        if permission == Permission::Off || heard.soft_stop {
            // The robot goes by its own controller; the next motion starts from nothing.
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

    /// Cycles in which a limit changed what was commanded.
    pub fn limited(&self) -> u64 {
        self.limited
    }

    /// The limit that the arm left when it was last moved, if it did.
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
            // The spring's rest is where the arm is once the old torque has gone.
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

    /// Inside the joints' limits, and within reach of what the robot goes by now.
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
        let l = &self.limits;
        for i in 0..N {
            let (q, qd) = (posture.q[i], posture.qd[i]);
            if qd.abs() > SPEED_ROOM * l.speed_rad_per_s[i] {
                return Some(Trip::JointSpeed(i, qd, l.speed_rad_per_s[i]));
            }
            // On its way back inside it may go on.
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

/// Torques (Nm) of a command, each within `most` but for rounding, or why they are refused.
///
/// # Errors
/// [`Refusal`]: another number of joints, a value that is not finite or beyond its limit.
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

/// From 0 to 1 without a step in value or slope.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
