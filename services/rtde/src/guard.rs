//! The last guard before the robot: whatever it is told, what it lets through stays inside every limit.
//!
//! Pure; the cycle calls [`Guard::step`] once per package to the robot. A good command is followed within the limits
//! on joint speed, joint acceleration, joint position and tool speed. A bad one is refused and the arm ramps to zero;
//! silence is ridden out for a few cycles, then it ramps to zero too. After longer silence, or whenever the arm may not
//! move, the present activation is latched out: only a newer one moves the arm again.
//!
//! What makes the limits hold together is one invariant: the velocity let through can always be brought to zero along
//! its own direction, at the joints' acceleration limits, before any joint meets its stop. Slowing down along its own
//! direction breaks no other limit, so there is always a safe answer.

use nalgebra::{Matrix6, Vector3, Vector6};

pub use crate::refusal::Refusal;

/// Share of the tool's speed limits that is used; the rest covers what the Jacobian changes within a cycle.
const TOOL_SPEED_SHARE: f64 = 0.98;
/// The tool keeps this far from the walls of its box, m: its path while it stops is not quite straight.
const WALL_MARGIN_M: f64 = 0.002;
/// A command this much beyond the speed limit is rounding, and is scaled; beyond it, it is refused.
const SPEED_TOLERANCE: f64 = 1.01;

/// Limits of the cell, per joint from base to flange.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardLimits {
    /// rad/s.
    pub speed_rad_per_s: Vector6<f64>,
    /// rad/s².
    pub acceleration_rad_per_s2: Vector6<f64>,
    /// rad.
    pub position_lower_rad: Vector6<f64>,
    /// rad.
    pub position_upper_rad: Vector6<f64>,
    /// Speed of the tool's origin, m/s.
    pub tool_speed_max_m_per_s: f64,
    /// Turn rate of the tool, rad/s.
    pub tool_turn_rate_max_rad_per_s: f64,
    /// The tool's origin stays inside this box: lower corner, base axes, m.
    pub workspace_lower_m: Vector3<f64>,
    /// Upper corner, base axes, m.
    pub workspace_upper_m: Vector3<f64>,
    /// Time from a velocity sent to the arm following it, s: how much later than planned a stop may begin.
    pub response_s: f64,
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
    /// 0 hold, 1 joint velocity, 2 joint torque, 3 soft stop.
    pub kind: u8,
    /// rad/s.
    pub values: &'a [f64],
    /// Bound on joint acceleration, rad/s²; zero or less means the cell's own limit.
    pub acceleration: f64,
    /// Counts task starts.
    pub activation: u64,
}

/// Where the arm is, as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Posture {
    /// rad.
    pub q: Vector6<f64>,
    /// Tool's origin, base axes, m.
    pub tool_m: Vector3<f64>,
    /// Joint velocity to the twist of the tool's origin, base axes: m/s above rad/s.
    pub tool_jacobian: Matrix6<f64>,
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

/// What goes to the robot this cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Allowed {
    /// rad/s.
    pub qd: Vector6<f64>,
    /// A command is being followed, or the arm is being ramped to rest; otherwise the robot just holds.
    pub streaming: bool,
    /// The robot itself shall stop and latch.
    pub soft_stop: bool,
}

/// The guard with its memory.
#[derive(Clone, Debug)]
pub struct Guard {
    limits: GuardLimits,
    period_s: f64,
    qd: Vector6<f64>,
    target: Option<Target>,
    silent_cycles: u32,
    cycle_stepped: u64,
    cycle_accepted: u64,
    activation_seen: u64,
    activation_latched: u64,
    refused: u64,
    refusal: Option<Refusal>,
    missed: u64,
    limited: u64,
}

#[derive(Clone, Copy, Debug)]
struct Target {
    qd: Vector6<f64>,
    acceleration: f64,
    moves: bool,
}

impl Guard {
    /// `period_s`: the robot's control period.
    pub fn new(limits: GuardLimits, period_s: f64) -> Self {
        Self {
            limits,
            period_s,
            qd: Vector6::zeros(),
            target: None,
            silent_cycles: 0,
            cycle_stepped: 0,
            cycle_accepted: 0,
            activation_seen: 0,
            activation_latched: 0,
            refused: 0,
            refusal: None,
            missed: 0,
            limited: 0,
        }
    }

    /// The robot's control period, s, once it is known.
    pub fn set_period(&mut self, period_s: f64) {
        self.period_s = period_s;
    }

    /// One cycle. `arrived` is a command that was not given before. `cycle` is the number of the robot packet in hand; the
    /// same number again is a heartbeat, sent because the robot's next packet is late.
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
                    bad = matches!(
                        refusal,
                        Refusal::Kind { .. }
                            | Refusal::JointCount { .. }
                            | Refusal::NotFinite
                            | Refusal::Speed { .. }
                    );
                }
            }
        }
        if permission != Permission::Move || soft_stop {
            self.latch();
        }
        if permission == Permission::Off || soft_stop {
            // The robot follows its own stop, not us; the next motion starts from rest.
            self.qd = Vector6::zeros();
            return Allowed {
                qd: self.qd,
                streaming: false,
                soft_stop,
            };
        }

        let due = self.target.is_some_and(|t| t.moves);
        let has_packet = cycle > self.cycle_stepped;
        self.cycle_stepped = self.cycle_stepped.max(cycle);
        if due && has_packet && self.silent_cycles > 0 {
            self.missed += 1;
        }
        if due && f64::from(self.silent_cycles) * self.period_s > self.limits.silence_latch_s {
            self.latch();
        }
        let target = match self.target {
            Some(target) if !bad && self.silent_cycles <= self.limits.patience_cycles => target,
            _ => Target {
                qd: Vector6::zeros(),
                acceleration: f64::INFINITY,
                moves: false,
            },
        };
        self.qd = self.limit(&target, posture);
        Allowed {
            qd: self.qd,
            streaming: target.moves || self.qd != Vector6::zeros(),
            soft_stop: false,
        }
    }

    /// Refuses the present activation, and older ones, from now on; what moves ramps to rest.
    pub fn latch(&mut self) {
        self.activation_latched = self.activation_latched.max(self.activation_seen);
        self.target = None;
    }

    /// Somebody else commands from now on, who brought `activation`: like every one before, it moves nothing.
    pub fn change_hands(&mut self, activation: u64) {
        self.activation_seen = self.activation_seen.max(activation);
        self.latch();
    }

    /// Velocity let through last, rad/s.
    pub fn qd(&self) -> &Vector6<f64> {
        &self.qd
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

    /// Packets of the robot that no good command answered while one was due. A packet that itself is late is not among them.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// Cycles in which a limit changed what was commanded.
    pub fn limited(&self) -> u64 {
        self.limited
    }

    /// Acceleration to tell the robot's own ramp, rad/s²: the guard's steps are never steeper.
    pub fn acceleration(&self) -> f64 {
        self.limits.acceleration_rad_per_s2.max()
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
            1 => Some(self.target(wanted)?),
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

    fn target(&self, wanted: &Wanted<'_>) -> Result<Target, Refusal> {
        let Ok(values) = <[f64; 6]>::try_from(wanted.values) else {
            return Err(Refusal::JointCount {
                got: wanted.values.len(),
            });
        };
        if wanted.acceleration.is_nan() || values.iter().any(|v| !v.is_finite()) {
            return Err(Refusal::NotFinite);
        }
        for (joint, (value, limit)) in values.iter().zip(&self.limits.speed_rad_per_s).enumerate() {
            if value.abs() > limit * SPEED_TOLERANCE {
                return Err(Refusal::Speed {
                    joint,
                    value: *value,
                    limit: *limit,
                });
            }
        }
        Ok(Target {
            qd: Vector6::from(values),
            acceleration: if wanted.acceleration > 0.0 {
                wanted.acceleration
            } else {
                f64::INFINITY
            },
            moves: true,
        })
    }

    /// The velocity nearest to the target that keeps every limit and the invariant.
    fn limit(&mut self, target: &Target, posture: &Posture) -> Vector6<f64> {
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
    fn tool_excess(&self, qd: &Vector6<f64>, posture: &Posture) -> f64 {
        let twist = posture.tool_jacobian * qd;
        let speed = twist.fixed_rows::<3>(0).norm() / self.limits.tool_speed_max_m_per_s;
        let turn = twist.fixed_rows::<3>(3).norm() / self.limits.tool_turn_rate_max_rad_per_s;
        speed.max(turn)
    }

    /// Slower along its own direction, as hard as the acceleration limits allow.
    fn brake(&self) -> Vector6<f64> {
        let stop_s = self.stop_time_s(&self.qd);
        if stop_s <= self.period_s {
            Vector6::zeros()
        } else {
            self.qd * (1.0 - self.period_s / stop_s)
        }
    }

    /// Time to bring `qd` to zero along its own direction, s.
    fn stop_time_s(&self, qd: &Vector6<f64>) -> f64 {
        qd.iter()
            .zip(&self.limits.acceleration_rad_per_s2)
            .map(|(v, a)| v.abs() / a)
            .fold(0.0, f64::max)
    }

    /// What must stop in time: for each joint and each coordinate of the tool that moves, its speed and the room left
    /// in that direction (rad/s and rad, m/s and m); room is negative beyond the limit.
    fn approaches(
        &self,
        qd: &Vector6<f64>,
        posture: &Posture,
    ) -> impl Iterator<Item = (f64, f64)> + use<> {
        let l = &self.limits;
        let tool = (posture.tool_jacobian * qd).fixed_rows::<3>(0).into_owned();
        let joints: [(f64, f64); 6] = std::array::from_fn(|i| {
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

    /// How far a stop may be off in time, s: half a cycle of the discrete ramp, and the arm's response.
    fn lag_s(&self) -> f64 {
        0.5 * self.period_s + self.limits.response_s
    }

    /// The invariant: a stop along its own direction ends before every joint's stop and every wall.
    fn can_stop(&self, qd: &Vector6<f64>, posture: &Posture) -> bool {
        let reach_s = 0.5 * self.stop_time_s(qd) + self.lag_s();
        self.approaches(qd, posture)
            .all(|(speed, room)| speed * reach_s <= room)
    }

    /// The largest scale of `qd`, at most 1, for which the invariant holds: `|v|σ (σ t/2 + lag) = room`.
    fn scale_that_can_stop(&self, qd: &Vector6<f64>, posture: &Posture) -> f64 {
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

/// How far `x` may still go in the direction of `v`.
fn room(v: f64, x: f64, lower: f64, upper: f64) -> f64 {
    if v > 0.0 { upper - x } else { x - lower }
}
