//! The gate before the motors of an arm with a torque interface: which commands it receives, and
//! which it lets through.
//!
//! The thread of the arm calls it once per period. Commands are accepted by the rules of the
//! bridges ([`tangent_actuation`]); in addition, a refused command ends its task, unless it only
//! repeats an answer. A valid command is followed within the joints' effort limits. Silence is
//! tolerated for two periods; then the arm brakes and holds its position.

use tangent_actuation::Command;
use tangent_actuation::admission::{Admission, AdmissionRules};
use tangent_actuation::lease::{Lease, LeaseDecision, Source};
use tangent_actuation::torque::read_torques;
use tangent_mechanics::{Arm, Joints};
use tangent_schemas::CommandKind;
use tangent_schemas::tangent::ArmCommand;

/// Number of periods without a valid command in which the last one is kept.
const PATIENCE: u32 = 2;
/// Silence after which the activation is rejected, s.
const SILENCE_LATCH_S: f64 = 0.1;
/// Number of periods in which the hold replaces the last torque.
const BLEND: u32 = 20;
/// Braking: deceleration per speed, 1/s.
const BRAKE_PER_S: f64 = 30.0;
/// Holding: bandwidth of the spring, rad/s, critically damped.
const HOLD_RAD_PER_S: f64 = 20.0;
/// Joint speed below which the arm counts as standing, rad/s.
const STANDS_RAD_PER_S: f64 = 0.02;

/// State of an arm that brakes and is then held.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Rest {
    /// Position at which it is held, once it stands, rad.
    held: Option<Joints<6>>,
    /// Number of periods since braking began.
    since: u32,
}

/// The gate with its state.
pub struct TorqueGate {
    model: Arm<6>,
    period_s: f64,
    /// Largest torque of each joint, Nm.
    effort: Joints<6>,
    lease: Lease,
    admission: Admission<Joints<6>>,
    /// `None` while commands are followed.
    rest: Option<Rest>,
    /// Whether the arm must not move in the next period.
    forbidden: bool,
    torque: Joints<6>,
}

impl TorqueGate {
    /// Holds `q` (rad) until a command is accepted; stepped every `period_s` (s).
    pub fn new(model: Arm<6>, q: &Joints<6>, period_s: f64) -> Self {
        Self {
            torque: model.gravity(q),
            effort: (model.limits().effort).unwrap_or_else(|| Joints::repeat(f64::INFINITY)),
            model,
            period_s,
            lease: Lease::default(),
            admission: Admission::new(AdmissionRules {
                moves: CommandKind::JointTorque,
                patience_cycles: PATIENCE,
                silence_latch_s: SILENCE_LATCH_S,
                refusal_ends_task: true,
            }),
            rest: Some(Rest {
                held: Some(*q),
                since: BLEND,
            }),
            forbidden: false,
        }
    }

    /// Lease that decides which source commands the arm.
    pub fn lease(&self) -> &Lease {
        &self.lease
    }

    /// Rules for accepting commands, with their counters.
    pub fn admission(&self) -> &Admission<Joints<6>> {
        &self.admission
    }

    /// Whether a command from `source` may be given to [`TorqueGate::step`]: only one source at a
    /// time commands the arm. `activation`: activation of the command; a new source must start a
    /// new task.
    pub fn admit(&mut self, source: &Source, activation: u64, now_s: f64) -> bool {
        let rests = self.rest.is_some_and(|rest| rest.held.is_some());
        match self.lease.admit(source, now_s, rests) {
            LeaseDecision::Held => true,
            LeaseDecision::Taken => {
                self.admission.change_hands(activation);
                true
            }
            LeaseDecision::Refused => false,
        }
    }

    /// Forbids motion in the next period: the arm comes to rest, and its task ends.
    pub fn forbid(&mut self) {
        self.forbidden = true;
        self.admission.latch();
    }

    /// Torques (Nm) for the next period, which begins with the arm at `q` (rad) and `qd` (rad/s)
    /// after its cycle `cycle`. `command` arrived since the last call, from the source that
    /// [`TorqueGate::admit`] accepted.
    pub fn step(
        &mut self,
        command: Option<&ArmCommand>,
        cycle: u64,
        q: &Joints<6>,
        qd: &Joints<6>,
    ) -> Joints<6> {
        let may_move = !std::mem::take(&mut self.forbidden);
        let effort = &self.effort;
        let arrived = command.map(Command::from);
        let heard = self
            .admission
            .begin(cycle, may_move, arrived.as_ref(), |c| {
                read_torques(effort, c)
            });
        self.admission.count_missed(cycle);
        self.admission.latch_after_silence(self.period_s);
        if let Some(torque) = self.admission.followed(heard) {
            self.rest = None;
            self.torque = torque.zip_map(effort, |torque, most| torque.clamp(-most, most));
        } else {
            self.come_to_rest(q, qd);
        }
        self.torque
    }

    fn come_to_rest(&mut self, q: &Joints<6>, qd: &Joints<6>) {
        let rest = self.rest.get_or_insert_default();
        if rest.held.is_none() && qd.amax() < STANDS_RAD_PER_S {
            rest.held = Some(*q);
        }
        let acceleration = match rest.held {
            None => -qd * BRAKE_PER_S,
            Some(place) => {
                (place - q) * (HOLD_RAD_PER_S * HOLD_RAD_PER_S) - qd * (2.0 * HOLD_RAD_PER_S)
            }
        };
        let (mass, bias) = self.model.mass_matrix_and_bias(q, qd);
        let hold = mass * acceleration + bias;
        let share = 1.0 / f64::from(BLEND.saturating_sub(rest.since).max(1));
        rest.since = rest.since.saturating_add(1);
        let blended = self.torque + (hold - self.torque) * share;
        if blended.iter().all(|x| x.is_finite()) {
            self.torque = blended;
        }
    }
}

#[cfg(test)]
mod tests;
