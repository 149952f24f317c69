//! The last guard before the motors of an arm that takes torques: what it is told, what it lets through.
//!
//! Pure; [`super::TorqueCell`] asks it once per period. A good command is followed within the joints' efforts. A bad one is
//! refused with the reason, silence is ridden out for two periods; then the arm brakes and holds where it stands, and the
//! present activation is latched out, so that only a newer one moves the arm again. One source at a time commands the arm; when the
//! lease changes hands, the new holder's activation and all older ones are latched out, as in the bridges.

use tangent_mechanics::{Arm, Joints};
use tangent_runtime::lease::{Admission, Lease, Source};
use tangent_schemas::Text;
use tangent_schemas::convert::{cut_format, joints};
use tangent_schemas::tangent::ArmCommand;

/// Periods without a good command in which the last one is kept.
const PATIENCE: u32 = 2;
/// Commands that answer a state further back than this are old.
const LATE_CYCLES: u64 = 3;
/// Silence after which the activation is latched out, periods.
const LATCH: u32 = 100;
/// A torque this much beyond the effort is rounding, and is cut; beyond it, it is refused.
const EFFORT_TOLERANCE: f64 = 1.01;
/// Periods in which the hold takes over from the last torque.
const BLEND: u32 = 20;
/// Braking: deceleration per speed, 1/s.
const BRAKE_PER_S: f64 = 30.0;
/// Holding: bandwidth of the spring, rad/s, critically damped.
const HOLD_RAD_PER_S: f64 = 20.0;
/// Below this joint speed the arm stands, rad/s.
const STANDS_RAD_PER_S: f64 = 0.02;

/// Why a command was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TorqueRefusal {
    /// Velocities, or something unknown.
    #[error("kind {0} is not 0 (hold), 2 (joint torque) or 3 (soft stop)")]
    Kind(u8),
    /// Another arm's.
    #[error("{0} joint values, the arm has 6 joints")]
    Joints(usize),
    /// NaN or infinite.
    #[error("joint {0}: the torque is not a finite number")]
    NotFinite(usize),
    /// More than the motor gives.
    #[error("joint {joint}: {torque_nm:.1} Nm is beyond its effort of {effort_nm:.1} Nm")]
    Effort {
        /// From 1.
        joint: usize,
        /// As asked for.
        torque_nm: f64,
        /// Allowed.
        effort_nm: f64,
    },
    /// Answers a state of long ago, or one that is yet to come.
    #[error("answers cycle {answered}, now is {now}")]
    Cycle {
        /// As stamped.
        answered: u64,
        /// Of the arm.
        now: u64,
    },
    /// Answers a state that was answered before.
    #[error("cycle {0} was already answered")]
    Duplicate(u64),
    /// Of a task that the arm has ended.
    #[error("activation {0} is latched out: start a task anew")]
    Latched(u64),
    /// Somebody else holds the arm.
    #[error("the arm is driven by another")]
    Lease,
}

/// What the motors are to give, and what it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Stance {
    /// Follows the commands.
    Follow,
    /// Brakes, then holds here.
    Rest { held: Option<Joints<6>>, since: u32 },
}

/// The guard with its memory.
pub struct TorqueGate {
    model: Arm<6>,
    lease: Lease,
    stance: Stance,
    torque: Joints<6>,
    silent: u32,
    /// Answered by the last command that was followed.
    pub cycle_accepted: u64,
    activation_seen: u64,
    /// Commands of this activation or an older one do not move the arm.
    pub activation_latched: u64,
    /// Commands refused since the start, and why the last one was.
    pub refused: u64,
    /// See `refused`.
    pub refusal: Option<TorqueRefusal>,
    /// Periods without a good command while one was due.
    pub missed: u64,
}

impl TorqueGate {
    /// Holds `q` until told otherwise.
    pub fn new(model: Arm<6>, q: &Joints<6>) -> Self {
        Self {
            torque: model.gravity(q),
            model,
            lease: Lease::default(),
            stance: Stance::Rest {
                held: Some(*q),
                since: BLEND,
            },
            silent: 0,
            cycle_accepted: 0,
            activation_seen: 0,
            activation_latched: 0,
            refused: 0,
            refusal: None,
            missed: 0,
        }
    }

    /// Who commands.
    pub fn holder(&self) -> Option<&Source> {
        self.lease.holder()
    }

    /// The last refusal in words; empty when there was none.
    pub fn reason(&self) -> Text {
        self.refusal
            .map_or_else(Text::new, |why| cut_format(format_args!("{why}")))
    }

    /// Whether a command from `source` may be given to [`TorqueGate::step`]: only one source at a time commands the arm.
    /// `activation`: what it brings; a source that was not heard before has to start a task anew.
    pub fn admit(&mut self, source: &Source, activation: u64, now_s: f64) -> bool {
        let rests = matches!(self.stance, Stance::Rest { held: Some(_), .. });
        match self.lease.admit(source, now_s, rests) {
            Admission::Held => true,
            Admission::Taken => {
                self.activation_seen = self.activation_seen.max(activation);
                self.latch();
                true
            }
            Admission::Refused => {
                self.refused += 1;
                self.refusal = Some(TorqueRefusal::Lease);
                false
            }
        }
    }

    /// Torques (Nm) for the next period, in which the arm is at `q`, `qd` after its cycle `cycle`. `command` is what arrived
    /// since the last call, from the source that [`TorqueGate::admit`] let in.
    pub fn step(
        &mut self,
        command: Option<&ArmCommand>,
        cycle: u64,
        q: &Joints<6>,
        qd: &Joints<6>,
    ) -> Joints<6> {
        let mut answered = false;
        if let Some(command) = command {
            self.activation_seen = self.activation_seen.max(command.activation);
            match self.judge(command, cycle) {
                Ok(wanted) => {
                    answered = true;
                    self.silent = 0;
                    self.cycle_accepted = command.cycle;
                    match wanted {
                        Some(torque) => {
                            self.stance = Stance::Follow;
                            self.torque = torque;
                        }
                        None => self.rest(),
                    }
                }
                Err(why) => {
                    self.refused += 1;
                    self.refusal = Some(why);
                    // A second answer to one state says nothing new: it neither moves the arm nor ends what moves it.
                    let repeated = matches!(why, TorqueRefusal::Duplicate(_));
                    if !repeated && self.stance == Stance::Follow {
                        self.latch();
                        self.rest();
                    }
                }
            }
        }
        if !answered {
            self.silent = self.silent.saturating_add(1);
            if self.stance == Stance::Follow {
                self.missed += 1;
                if self.silent > PATIENCE {
                    self.rest();
                }
            }
            if self.silent == LATCH {
                self.latch();
            }
        }
        self.act(q, qd)
    }

    /// The arm may not move now: it comes to rest, and the task is over to it.
    pub fn forbid(&mut self) {
        if self.stance == Stance::Follow {
            self.rest();
        }
        self.latch();
    }

    fn judge(&self, command: &ArmCommand, cycle: u64) -> Result<Option<Joints<6>>, TorqueRefusal> {
        let answered = command.cycle;
        if answered > cycle || cycle - answered > LATE_CYCLES {
            return Err(TorqueRefusal::Cycle {
                answered,
                now: cycle,
            });
        }
        if answered <= self.cycle_accepted {
            return Err(TorqueRefusal::Duplicate(answered));
        }
        match command.kind {
            0 | 3 => return Ok(None),
            2 => {}
            other => return Err(TorqueRefusal::Kind(other)),
        }
        if command.activation <= self.activation_latched {
            return Err(TorqueRefusal::Latched(command.activation));
        }
        let mut torque: Joints<6> =
            joints(&command.values).map_err(|_| TorqueRefusal::Joints(command.values.len()))?;
        for i in 0..6 {
            if !torque[i].is_finite() {
                return Err(TorqueRefusal::NotFinite(i + 1));
            }
            let Some(effort) = self.model.limits().effort else {
                continue;
            };
            if torque[i].abs() > effort[i] * EFFORT_TOLERANCE {
                return Err(TorqueRefusal::Effort {
                    joint: i + 1,
                    torque_nm: torque[i],
                    effort_nm: effort[i],
                });
            }
            torque[i] = torque[i].clamp(-effort[i], effort[i]);
        }
        Ok(Some(torque))
    }

    fn latch(&mut self) {
        self.activation_latched = self.activation_latched.max(self.activation_seen);
    }

    fn rest(&mut self) {
        if self.stance == Stance::Follow {
            self.stance = Stance::Rest {
                held: None,
                since: 0,
            };
        }
    }

    fn act(&mut self, q: &Joints<6>, qd: &Joints<6>) -> Joints<6> {
        let Stance::Rest { held, since } = &mut self.stance else {
            return self.torque;
        };
        if held.is_none() && qd.amax() < STANDS_RAD_PER_S {
            *held = Some(*q);
        }
        let acceleration = match held {
            None => -qd * BRAKE_PER_S,
            Some(place) => {
                (*place - q) * (HOLD_RAD_PER_S * HOLD_RAD_PER_S) - qd * (2.0 * HOLD_RAD_PER_S)
            }
        };
        let (mass, bias) = self.model.mass_matrix_and_bias(q, qd);
        let hold = mass * acceleration + bias;
        let share = 1.0 / f64::from(BLEND.saturating_sub(*since).max(1));
        *since = since.saturating_add(1);
        let blended = self.torque + (hold - self.torque) * share;
        if blended.iter().all(|x| x.is_finite()) {
            self.torque = blended;
        }
        self.torque
    }
}

#[cfg(test)]
mod tests;
