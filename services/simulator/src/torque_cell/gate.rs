//! The last guard before the motors of an arm that takes torques: what it is told, what it lets through.
//!
//! Pure; [`super::TorqueCell`] asks it once per period. A good command is followed within the joints' efforts. A bad one is
//! refused with the reason, silence is ridden out for two periods; then the arm brakes and holds where it stands, and the
//! present activation is latched out, so that only a newer one moves the arm again.

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

    /// Torques (Nm) for the next period, in which the arm is at `q`, `qd` after its cycle `cycle`. `command` is what arrived
    /// since the last call, from `source`, at `now_s`.
    pub fn step(
        &mut self,
        command: Option<(&ArmCommand, Source)>,
        cycle: u64,
        now_s: f64,
        q: &Joints<6>,
        qd: &Joints<6>,
    ) -> Joints<6> {
        let mut answered = false;
        if let Some((command, source)) = command {
            match self.judge(command, &source, cycle, now_s) {
                Ok(wanted) => {
                    answered = true;
                    self.silent = 0;
                    self.cycle_accepted = command.cycle;
                    self.activation_seen = self.activation_seen.max(command.activation);
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
                    if why != TorqueRefusal::Lease && self.stance == Stance::Follow {
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

    fn judge(
        &mut self,
        command: &ArmCommand,
        source: &Source,
        cycle: u64,
        now_s: f64,
    ) -> Result<Option<Joints<6>>, TorqueRefusal> {
        let rests = self.stance != Stance::Follow;
        if self.lease.admit(source, now_s, rests) == Admission::Refused {
            return Err(TorqueRefusal::Lease);
        }
        let answered = command.cycle;
        if answered > cycle || answered + LATE_CYCLES < cycle {
            return Err(TorqueRefusal::Cycle {
                answered,
                now: cycle,
            });
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
mod tests {
    use super::*;
    use tangent_mechanics::ModelData;
    use tangent_schemas::convert::joint_array;
    use tangent_simulation::{TorqueArm, TorqueArmConfig};

    struct Bench {
        gate: TorqueGate,
        arm: TorqueArm<6>,
        cycle: u64,
        speeds: Vec<f64>,
        torques: Vec<Joints<6>>,
    }

    fn source(id: u8) -> Source {
        Source {
            publisher: [id; 16],
            ..Source::default()
        }
    }

    impl Bench {
        fn new() -> Self {
            let model = Arm::<6>::new(&ModelData::builtin("smart3s_substitute").unwrap()).unwrap();
            let q = model.home();
            Self {
                gate: TorqueGate::new(model, &q),
                arm: TorqueArm::new(model, &TorqueArmConfig::default(), q),
                cycle: 10,
                speeds: Vec::new(),
                torques: Vec::new(),
            }
        }

        /// What moves joint 1 at 0.3 rad/s.
        fn command(&self) -> ArmCommand {
            let mut wanted = Joints::<6>::zeros();
            wanted[0] = 0.3;
            let (mass, bias) = self
                .arm
                .model()
                .mass_matrix_and_bias(&self.arm.q, &self.arm.qd);
            let torque = mass * ((wanted - self.arm.qd) * 20.0) + bias;
            ArmCommand {
                cycle: self.cycle,
                kind: 2,
                values: joint_array(&torque),
                activation: 1,
                ..ArmCommand::default()
            }
        }

        fn cycle(&mut self, command: Option<&ArmCommand>) {
            let torque = self.gate.step(
                command.map(|c| (c, source(1))),
                self.cycle,
                self.cycle as f64 * 1e-3,
                &self.arm.q,
                &self.arm.qd,
            );
            for _ in 0..4 {
                self.arm.step(&torque, &Joints::<6>::zeros(), 0.25e-3);
            }
            self.cycle += 1;
            self.speeds.push(self.arm.qd.amax());
            self.torques.push(torque);
        }

        fn moving(mut self) -> Self {
            for _ in 0..500 {
                let command = self.command();
                self.cycle(Some(&command));
            }
            assert!(self.arm.qd[0] > 0.25);
            self
        }
    }

    #[test]
    fn the_arm_holds_until_it_is_told_to_move() {
        let mut bench = Bench::new();
        let start = bench.arm.q;
        for _ in 0..1000 {
            bench.cycle(None);
        }
        assert!((bench.arm.q - start).amax() < 1e-6);
        assert_eq!(bench.gate.missed, 0);
    }

    #[test]
    fn silence_is_ridden_out_then_the_arm_comes_to_rest_smoothly_and_stays() {
        let mut bench = Bench::new().moving();
        bench.cycle(None);
        bench.cycle(None);
        assert!(bench.speeds.last().unwrap() > &0.25);
        let torques = bench.torques.len();
        for _ in 0..400 {
            bench.cycle(None);
        }
        assert!(bench.speeds.last().unwrap() < &1e-3);
        let effort = bench.gate.model.limits().effort.unwrap();
        for pair in bench.torques[torques..].windows(2) {
            let step = (pair[1] - pair[0]).component_div(&effort).amax();
            assert!(step < 0.05, "{step} of the effort at once");
        }
        assert_eq!(bench.gate.activation_latched, 1);
        let late = bench.command();
        bench.cycle(Some(&late));
        assert_eq!(bench.gate.refusal, Some(TorqueRefusal::Latched(1)));
        let mut anew = bench.command();
        anew.activation = 2;
        bench.cycle(Some(&anew));
        assert_eq!(bench.gate.stance, Stance::Follow);
    }

    #[test]
    fn what_makes_no_sense_is_refused_with_the_reason_and_ends_the_motion() {
        type Spoil = fn(&mut ArmCommand);
        let bad: [(Spoil, &str); 6] = [
            (|c| c.values[2] = f64::NAN, "joint 3"),
            (|c| c.values[1] = 1e9, "effort"),
            (|c| c.values.truncate(5), "5 joint values"),
            (|c| c.kind = 1, "kind 1"),
            (|c| c.cycle -= 50, "cycle"),
            (|c| c.cycle += 5, "cycle"),
        ];
        for (spoil, word) in bad {
            let mut bench = Bench::new().moving();
            let mut command = bench.command();
            spoil(&mut command);
            bench.cycle(Some(&command));
            let reason = bench.gate.reason();
            assert!(reason.contains(word), "{reason}");
            for _ in 0..400 {
                bench.cycle(None);
            }
            assert!(bench.speeds.last().unwrap() < &1e-3, "{word}");
        }
    }

    #[test]
    fn a_second_source_is_refused_and_the_first_goes_on() {
        let mut bench = Bench::new().moving();
        let command = bench.command();
        let (q, qd) = (bench.arm.q, bench.arm.qd);
        bench.gate.step(
            Some((&command, source(2))),
            bench.cycle,
            bench.cycle as f64 * 1e-3,
            &q,
            &qd,
        );
        assert_eq!(bench.gate.refusal, Some(TorqueRefusal::Lease));
        assert_eq!(bench.gate.stance, Stance::Follow);
    }

    #[test]
    fn a_hold_brings_it_to_rest_without_latching() {
        let mut bench = Bench::new().moving();
        for _ in 0..400 {
            let mut hold = bench.command();
            hold.kind = 0;
            bench.cycle(Some(&hold));
        }
        assert!(bench.speeds.last().unwrap() < &1e-3);
        assert_eq!(bench.gate.activation_latched, 0);
    }
}
