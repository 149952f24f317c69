//! The last guard before the robot: whatever it is told, the torques that leave are finite, inside every joint's limit, and
//! never change faster than the robot bears.
//!
//! Pure; the cycle calls [`Guard::step`] once per answer. A good command is followed. A bad one is refused and the arm goes
//! over to being held; silence is ridden out for a few cycles, then it is held too. After longer silence, when the arm leaves
//! its limits, or whenever it may not move, the present activation is latched out: only a newer one moves the arm again.
//!
//! Holding is a torque law of its own, since a torque that merely stays or vanishes is no stop: the last torque fades out
//! while damping takes the motion away, and a spring to where the arm then is keeps it there. The robot adds gravity itself.

use nalgebra::{SMatrix, Vector3};
use tangent_mechanics::Joints;
use tangent_runtime::config::FRANKA_TORQUE_RATE_SHARE;

pub use crate::refusal::Refusal;

/// A torque this much beyond its limit is rounding, and is cut; beyond it, it is refused.
const TORQUE_TOLERANCE: f64 = 1.01;
/// The last torque fades out over this time, s.
const FADE_S: f64 = 0.05;
/// The spring of the hold grows to its stiffness over this time after that, s.
const SPRING_S: f64 = 0.2;
/// Share of a joint's limit that the hold's spring uses at most.
const SPRING_SHARE: f64 = 0.3;
/// Speed limits are judged with this much room: what is measured is noisy, and a torque does not set a speed.
const SPEED_ROOM: f64 = 1.2;

/// Limits of the cell, per joint from base to flange.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardLimits {
    /// Without gravity, Nm.
    pub torque_nm: Joints<7>,
    /// The robot's own bound, Nm/s.
    pub torque_rate_nm_per_s: Joints<7>,
    /// rad/s.
    pub speed_rad_per_s: Joints<7>,
    /// rad.
    pub position_lower_rad: Joints<7>,
    /// rad.
    pub position_upper_rad: Joints<7>,
    /// Speed of the tool's origin, m/s.
    pub tool_speed_max_m_per_s: f64,
    /// Turn rate of the tool, rad/s.
    pub tool_turn_rate_max_rad_per_s: f64,
    /// The tool's origin stays inside this box: lower corner, base axes, m.
    pub workspace_lower_m: Vector3<f64>,
    /// Upper corner, base axes, m.
    pub workspace_upper_m: Vector3<f64>,
    /// Stiffness of the hold, Nm/rad.
    pub hold_stiffness: Joints<7>,
    /// Damping of the hold, Nm s/rad.
    pub hold_damping: Joints<7>,
    /// Cycles without a good command through which the last one is kept.
    pub patience_cycles: u32,
    /// Silence after which the activation is latched out, s.
    pub silence_latch_s: f64,
}

/// A command as it arrived; only new arrivals are given to the guard.
#[derive(Clone, Copy, Debug)]
pub struct Wanted<'a> {
    /// `ArmState.cycle` that it answers.
    pub cycle: u64,
    /// 0 hold, 2 joint torque, 3 soft stop.
    pub kind: u8,
    /// Without gravity, Nm.
    pub values: &'a [f64],
    /// Counts task starts.
    pub activation: u64,
}

/// Where the arm is and what its joints do, as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// rad.
    pub q: Joints<7>,
    /// rad/s.
    pub qd: Joints<7>,
    /// The torque that the robot goes by now, without gravity, Nm.
    pub torque: Joints<7>,
    /// Tool's origin, base axes, m.
    pub tool_m: Vector3<f64>,
    /// Joint velocity to the twist of the tool's origin, base axes: m/s above rad/s.
    pub tool_jacobian: SMatrix<f64, 6, 7>,
}

/// Whether the robot would follow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Permission {
    /// It would.
    Move,
    /// It would, but nobody may move it: it is held.
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
pub struct Allowed {
    /// Without gravity, Nm.
    pub torque: Joints<7>,
    /// A command is being followed; otherwise the arm is held.
    pub following: bool,
    /// The robot itself shall end the motion.
    pub soft_stop: bool,
}

#[derive(Clone, Copy, Debug)]
struct Hold {
    from: Joints<7>,
    q: Joints<7>,
    age_s: f64,
}

/// The guard with its memory.
#[derive(Clone, Debug)]
pub struct Guard {
    limits: GuardLimits,
    period_s: f64,
    target: Option<Joints<7>>,
    hold: Option<Hold>,
    silent_cycles: u32,
    cycle_stepped: u64,
    cycle_accepted: u64,
    activation_seen: u64,
    activation_latched: u64,
    refused: u64,
    refusal: Option<Refusal>,
    missed: u64,
    limited: u64,
    trip: Option<Trip>,
}

impl Guard {
    /// `period_s`: the robot's control period.
    pub fn new(limits: GuardLimits, period_s: f64) -> Self {
        Self {
            limits,
            period_s,
            target: None,
            hold: None,
            silent_cycles: 0,
            cycle_stepped: 0,
            cycle_accepted: 0,
            activation_seen: 0,
            activation_latched: 0,
            refused: 0,
            refusal: None,
            missed: 0,
            limited: 0,
            trip: None,
        }
    }

    /// One answer. `arrived` is a command that was not given before; `cycle` the number of the robot's packet in hand.
    pub fn step(
        &mut self,
        cycle: u64,
        permission: Permission,
        posture: &Posture,
        arrived: Option<&Wanted<'_>>,
    ) -> Allowed {
        let mut soft_stop = false;
        let mut bad = false;
        self.silent_cycles = self.silent_cycles.saturating_add(1);
        if let Some(wanted) = arrived {
            self.activation_seen = self.activation_seen.max(wanted.activation);
            if permission != Permission::Move {
                self.latch();
            }
            match self.accept(cycle, wanted) {
                Ok(()) => {
                    soft_stop = wanted.kind == 3;
                    self.silent_cycles = 0;
                }
                Err(refusal) => {
                    self.refused += 1;
                    self.refusal = Some(refusal);
                    bad = refusal.is_bad();
                }
            }
        }
        if permission != Permission::Move || soft_stop {
            self.latch();
        }
        if permission == Permission::Off || soft_stop {
            // The robot goes by its own controller; the next motion starts from nothing.
            self.hold = None;
            return Allowed {
                torque: Joints::zeros(),
                following: false,
                soft_stop,
            };
        }
        if self.target.is_some() {
            if cycle > self.cycle_stepped && self.silent_cycles > 0 {
                self.missed += 1;
            }
            self.trip = self.tripped(posture);
            let silent_s = f64::from(self.silent_cycles) * self.period_s;
            if self.trip.is_some() || silent_s > self.limits.silence_latch_s {
                self.latch();
            }
        }
        self.cycle_stepped = self.cycle_stepped.max(cycle);
        let followed = self
            .target
            .filter(|_| !bad && self.silent_cycles <= self.limits.patience_cycles);
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

    /// Refuses the present activation, and older ones, from now on; the arm is held.
    pub fn latch(&mut self) {
        self.activation_latched = self.activation_latched.max(self.activation_seen);
        self.target = None;
    }

    /// Somebody else commands from now on, who brought `activation`: like every one before, it moves nothing.
    pub fn change_hands(&mut self, activation: u64) {
        self.activation_seen = self.activation_seen.max(activation);
        self.latch();
    }

    /// A command is kept that may be followed.
    pub fn is_commanded(&self) -> bool {
        self.target.is_some()
    }

    /// Cycle of the last command accepted.
    pub fn cycle_accepted(&self) -> u64 {
        self.cycle_accepted
    }

    /// Newest activation that is refused.
    pub fn activation_latched(&self) -> u64 {
        self.activation_latched
    }

    /// Commands refused since the start.
    pub fn refused(&self) -> u64 {
        self.refused
    }

    /// Why the last refused command was.
    pub fn refusal(&self) -> Option<&Refusal> {
        self.refusal.as_ref()
    }

    /// Packets of the robot that no good command answered while one was due.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// Cycles in which a limit changed what was commanded.
    pub fn limited(&self) -> u64 {
        self.limited
    }

    /// The limit that the arm left when it was last moved, if it did.
    pub fn trip(&self) -> Option<&Trip> {
        self.trip.as_ref()
    }

    fn accept(&mut self, cycle: u64, wanted: &Wanted<'_>) -> Result<(), Refusal> {
        if wanted.cycle > cycle {
            return Err(Refusal::Future {
                cycle: wanted.cycle,
            });
        }
        let age = cycle - wanted.cycle;
        if age > u64::from(self.limits.patience_cycles) {
            return Err(Refusal::Old { age });
        }
        if wanted.cycle <= self.cycle_accepted {
            return Err(Refusal::Duplicate {
                cycle: wanted.cycle,
            });
        }
        let target = match wanted.kind {
            0 | 3 => None,
            2 => Some(self.target_of(wanted.values)?),
            kind => return Err(Refusal::Kind { kind }),
        };
        if target.is_some() && wanted.activation <= self.activation_latched {
            return Err(Refusal::Latched {
                activation: wanted.activation,
                latched: self.activation_latched,
            });
        }
        self.cycle_accepted = wanted.cycle;
        self.target = target;
        Ok(())
    }

    fn target_of(&self, values: &[f64]) -> Result<Joints<7>, Refusal> {
        let Ok(values) = <[f64; 7]>::try_from(values) else {
            return Err(Refusal::JointCount { got: values.len() });
        };
        if values.iter().any(|v| !v.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        for (joint, (value, limit)) in values.iter().zip(&self.limits.torque_nm).enumerate() {
            if value.abs() > limit * TORQUE_TOLERANCE {
                return Err(Refusal::Torque {
                    joint,
                    value: *value,
                    limit: *limit,
                });
            }
        }
        Ok(Joints::from(values))
    }

    /// Torque that brings the arm to rest and keeps it there.
    fn held(&mut self, posture: &Posture) -> Joints<7> {
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
    fn limit(&mut self, aim: &Joints<7>, posture: &Posture, counts: bool) -> Joints<7> {
        let limits = &self.limits;
        let period_s = self.period_s;
        let torque = Joints::from_fn(|i, _| {
            let reach = FRANKA_TORQUE_RATE_SHARE * limits.torque_rate_nm_per_s[i] * period_s;
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

    fn tripped(&self, posture: &Posture) -> Option<Trip> {
        let l = &self.limits;
        for i in 0..7 {
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

/// From 0 to 1 without a step in value or slope.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}
